"""Which compiled functions are used for the first time once a clock runs: by vehicles, or by what flies them.

Prints their names, one a line. Run by the tests in a process of its own, where nothing has been used before.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from numba.core.dispatcher import Dispatcher

from bridge.wire.link import Received
from bridge.wire.values import AttitudeTarget
from missions.flight import run
from missions.flight.processes import simulate
from missions.scenario import loading as scenario
from sitl.server import Server

LEVEL = (1.0, 0.0, 0.0, 0.0)


def used() -> set[tuple[str, Any]]:
    """Every compiled function of ours that was called until now, with the types it was called with."""
    ours = [
        module for name, module in sys.modules.items() if name.split(".")[0] in ("cablequad", "bridge", "sitl", "logs")
    ]
    functions = [f for module in ours for f in vars(module).values() if isinstance(f, Dispatcher)]
    assert functions
    return {(f.py_func.__qualname__, types) for f in functions for types in f.signatures}


def vehicles(firmware: str, offset: int) -> set[tuple[str, Any]]:
    """They hear their first setpoint, obey it for some ticks, and land."""
    flight = scenario.load("paper-case-1", firmware=firmware)
    server = Server(
        simulate.settings(flight, simulate.Serving(lockstep=False, port_offset=offset)), lambda message: None
    )
    control = "OFFBOARD" if firmware == "px4" else "GUIDED"
    before = used()
    for tick in range(40):
        server._tick += 1
        for i, vehicle in enumerate(server.vehicles):
            if tick == 0:
                vehicle._set_armed(True, 0)
                flown: Any = vehicle  # of either firmware, whose modes differ
                flown.mode = type(flown.mode)[control]
            target = AttitudeTarget(server.now_us // 1000, i + 1, 1, 7, LEVEL, (0.0, 0.0, 0.0), 0.5)
            frame = Received(i, ("127.0.0.1", 1), 250, 191, 0, 82, "SET_ATTITUDE_TARGET", b"", target)
            server.links.inbox[i].append((server.now_us, frame))
            if tick == 20:
                vehicle.leave("LAND")
        server.plant.restrained = False
        server._one_tick()
    after = used()
    server.close()
    return after - before


def controller(name: str, offset: int) -> set[tuple[str, Any]]:
    """A scenario's flight, from the first frame to the vehicles' hold."""
    found: list[set[tuple[str, Any]]] = []
    fly = run._fly

    def flown(*arguments: Any, **named: Any) -> Any:
        found.append(used())
        try:
            return fly(*arguments, **named)
        finally:
            found.append(used())

    run._fly = flown
    with TemporaryDirectory() as folder:
        flight = scenario.load(name, duration_s=3.0)
        run.run(flight, run.Options(out=Path(folder), port_offset=offset), run.Progress())
    before, after = found
    return after - before


if __name__ == "__main__":
    who, what, offset = sys.argv[1:]
    new = {"vehicles": vehicles, "controller": controller}[who](what, int(offset))
    print("\n".join(sorted(f"{name} {types}" for name, types in new)), end="")
