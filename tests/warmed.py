"""Which compiled functions commands use that a warm-up does not: printed one a line, with what used it.

Run by a test in a process of its own, where nothing has been used before.
"""

import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from conftest import next_offset
from first_use import used

import cablequad as cq
from logs.reading.reader import read
from logs.views.replay import save
from missions.analysis.check import check
from missions.analysis.drills import drills, flown, rehearsal
from missions.analysis.margins import measure
from missions.analysis.replay_control import redecide
from missions.flight.compiled import LARGE, REST
from missions.flight.processes.simulate import Serving, server_of, settings
from missions.flight.run import Options, Progress, run
from missions.scenario.loading import load, names


def commands(folder: Path) -> dict[str, Callable[[], object]]:
    """What users do, shortly."""
    options = Options(out=folder, in_process=True)

    def fly(name: str) -> object:
        return run(load(name, duration_s=0.2), options, Progress())

    def serve(**serving: Any) -> None:
        offset = next_offset()
        server_of(settings(ground, Serving(port_offset=offset, **serving)), lambda _: None).close()

    ground = load("ground-to-ground")
    cut = next(d for d in drills(rehearsal(ground)) if d.name == "cable cut")
    flights = {f"fly {name}": partial(fly, name) for name in names()}
    return {
        "warm-up": lambda: [part.make(*part.of) for part in (*LARGE, *REST)],
        **flights,
        "a mission": lambda: run(ground, options, Progress()),
        "a drill": lambda: flown(rehearsal(ground), cut, True, options),
        "simulate": lambda: cq.simulate("paper-case-1-50hz", 0.5),
        "sitl --no-load": lambda: serve(lockstep=False, untethered=True),
        "sitl --backend px4": lambda: serve(lockstep=True, backend="px4"),
        "sitl --backend ardupilot": lambda: serve(lockstep=True, backend="ardupilot"),
        "margins": lambda: measure(load("paper-case-1-50hz"), bisections=0),
        "log replay-control": lambda: redecide(max(folder.glob("ground-to-ground-2*.mcap"))),  # the last one is whole
        "check": lambda: check(load("paper-case-1-50hz"), True, lambda _: None),
        "replay": lambda: save(read(next(folder.glob("*.mcap"))), folder / "replay.rrd"),
    }


def main() -> None:
    """Do all of it, and print what was new."""
    os.cpu_count = lambda: 1  # what is spread over processes stays in this one
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
