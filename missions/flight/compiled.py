"""The model, the law and what writes logs are compiled once, on all cores, and kept on disk.

Whoever needs something first would compile it piece by piece in one process, and a flight needs nearly all of it.
"""

import os
import tempfile
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cablequad._jit import all_kept, mark_all_kept
from cablequad.analysis.certificate import higher_order_slope
from cablequad.model import lie
from missions.flight.options import Options, Progress
from missions.flight.processes.child_process import worker_pool
from missions.flight.processes.simulate import Serving, settings
from missions.flight.run import run
from missions.flight.terminal import telling
from missions.flight.warm_up import decide_once, observe_once, predict_once
from missions.scenario import laws
from missions.scenario.loading import load
from sitl.settings import plant_of
from sitl.untethered_plant import UntetheredPlant

FLOWN_S = 0.2


class Part(NamedTuple):
    """Something that, when it is called, compiles what it calls."""

    name: str
    make: Callable[..., None]
    of: tuple[str, ...]


def ensure() -> None:
    """Compile what is not there yet and say on the error stream what is done; at once where all is."""
    if not all_kept():
        with telling("first start") as tell:
            compile_all(tell)


def compile_all(tell: Callable[[str], None]) -> bool:
    """Compile all that is not there yet, and say how far it is; whether that could be done.

    What does not succeed is compiled when it is needed.
    """
    count = min(os.cpu_count() or 1, len(LARGE))
    done, all_of = 0, len(LARGE) + len(REST)
    try:
        with worker_pool(count) as pool:
            for together in (LARGE, REST):  # the rest calls what is large
                waiting = {pool.submit(part.make, *part.of): part.name for part in together}
                while waiting:
                    tell(f"compiling, once: {done} of {all_of} done; now {', '.join(list(waiting.values())[:count])}")
                    ended, _ = wait(waiting, return_when=FIRST_COMPLETED)
                    for future in ended:
                        future.result()
                        del waiting[future]
                        done += 1
    except (BrokenProcessPool, OSError):
        return False
    mark_all_kept()
    return True


def _plant(name: str) -> None:
    plant_of(settings(load(name), Serving(lockstep=True, await_controller=True)))


def _driven(name: str) -> None:
    values = settings(load(name), Serving(lockstep=True, await_controller=True))
    plant_of(values._replace(around=values.around._replace(driven=True)))


def _untethered(name: str) -> None:
    flight = load(name)
    UntetheredPlant(flight.system, flight.airframe, flight.initial, flight.physics_us * 1e-6)


def _law(name: str) -> None:
    flight = load(name)
    decide_once(laws.design(flight), flight)


def _observer(name: str) -> None:
    flight = load(name)
    observe_once(flight)
    predict_once(flight)


def _certificate(name: str) -> None:
    higher_order_slope(laws.design(load(name)), 0.1, np.random.default_rng(0), 1)
    lie.log(np.eye(3))


def _flight(name: str, firmware: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        flight = load(name, duration_s=FLOWN_S, firmware=firmware)
        run(flight, Options(out=Path(folder), in_process=True), Progress())


LARGE = (
    Part("the model among wind, rotors and ground", _plant, ("ground-to-ground",)),
    Part("the model by itself", _plant, ("paper-case-1-50hz",)),
    Part("the controller", _law, ("ground-to-ground",)),
    Part("its observer", _observer, ("ground-to-ground",)),
    Part("what looks for the stability certificate", _certificate, ("two-vehicles",)),
)
REST = (
    Part("sensors, messages and the log", _flight, ("ground-to-ground", "px4")),
    Part("the same for one vehicle", _flight, ("one-vehicle", "arducopter")),
    Part("vehicles without a load", _untethered, ("ground-to-ground",)),
    Part("vehicles that autopilots fly", _driven, ("ground-to-ground",)),
)
