"""Which compiled functions commands use that a warm-up does not: printed one a line, with what used it.

Run by a test in a process of its own, where nothing has been used before.
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from first_use import used

import cablequad as cq
from logs.reading.reader import read
from logs.views.replay import save
from missions.analysis.check import check
from missions.analysis.drills import drills, flown, rehearsal
from missions.flight.compiled import LARGE, REST
from missions.flight.run import Options, Progress, run
from missions.scenario.loading import load, names


def commands(folder: Path) -> dict[str, Callable[[], object]]:
    """What users do, shortly."""
    options = Options(out=folder, in_process=True)

    def fly(name: str, firmware: str | None = None) -> object:
        return run(load(name, duration_s=0.2, firmware=firmware), options, Progress())

    ground = load("ground-to-ground")
    cut = next(d for d in drills(rehearsal(ground)) if d.name == "cable cut")
    flights = {f"fly {name}": partial(fly, name) for name in names()}
    return {
        "warm-up": lambda: [part.make(*part.of) for part in (*LARGE, *REST)],
        **flights,
        "fly with ArduCopters": lambda: fly("ground-to-ground", "arducopter"),
        "a mission": lambda: run(ground, options, Progress()),
        "a drill": lambda: flown(rehearsal(ground), cut, True, options),
        "simulate": lambda: cq.simulate("paper-case-1-50hz", 0.5),
        "check": lambda: check(load("paper-case-1-50hz"), True, lambda _: None),
        "replay": lambda: save(read(next(folder.glob("*.mcap"))), folder / "replay.rrd"),
    }


def main() -> None:
    """Do all of it, and print what was new."""
    with TemporaryDirectory() as folder:
        before = used()
        for name, do in commands(Path(folder)).items():
            do()
            now = used()
            for function, types in sorted((f, str(t)) for f, t in now - before) if name != "warm-up" else ():
                print(name, function, types[:200])
            before = now
            sys.stdout.flush()


if __name__ == "__main__":
    main()
