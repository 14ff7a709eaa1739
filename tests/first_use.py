"""Vehicles that hear their first setpoint, and hold after it: which compiled functions were used for the first time.

Prints their names, one a line. Run by the tests in a process of its own, where nothing has been used before.
"""

import gc
import sys
from typing import Any

from numba.core.dispatcher import Dispatcher

from bridge.link import Received
from bridge.wire.values import AttitudeTarget
from missions import scenario, simulate
from sitl.server import Server

LEVEL = (1.0, 0.0, 0.0, 0.0)


def used() -> set[tuple[str, Any]]:
    """Every compiled function that was called until now, with the types it was called with."""
    return {
        (f.py_func.__qualname__, types) for f in gc.get_objects() if isinstance(f, Dispatcher) for types in f.signatures
    }


def main(firmware: str, offset: int) -> None:
    """Arm, obey a setpoint for some ticks, hold for some."""
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
                vehicle.mode = type(vehicle.mode)[control]
            target = AttitudeTarget(server.now_us // 1000, i + 1, 1, 7, LEVEL, (0.0, 0.0, 0.0), 0.5)
            frame = Received(i, ("127.0.0.1", 1), 250, 191, 0, 82, "SET_ATTITUDE_TARGET", b"", target)
            server._inbox[i].append((server.now_us, frame))
            if tick == 20:
                vehicle.leave("LAND")
        server.plant.held = False
        server._one_tick()
    print("\n".join(sorted(f"{name} {types}" for name, types in used() - before)), end="")
    server.close()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
