"""What breaks among the vehicles: on a schedule, or when a vehicle is told to (MAV_CMD_INJECT_FAILURE, a gripper)."""

import math
from typing import NamedTuple

import numpy as np

from cablequad.types import Array
from sitl.firmware.autopilot import Autopilot
from sitl.plant import Plant
from sitl.untethered_plant import UntetheredPlant

ASTRAY_M_S2 = 0.3  # how fast a position that nothing corrects runs away
EMPTY_THRUST = 0.3  # of its thrust that a vehicle with an empty battery has


class Failure(NamedTuple):
    """One thing that breaks, `at_us` after the release."""

    at_us: int
    kind: str
    vehicle: int = 0  # from 0
    rotor: int | None = 0  # from 0; None: all
    offset: Array = np.zeros(3)  # m, of the load's centre of mass
    wind: Array = np.zeros(3)  # m/s, of a gust at its height
    lasts_us: int = 3_000_000
    remaining: float = 0.1  # of the battery
    sag: float = 0.15  # of the thrust


class ActiveFailures:
    """What is broken by now, and what that does to vehicles and plant at every tick."""

    def __init__(self, failures: tuple[Failure, ...], n: int) -> None:
        self._coming = sorted(failures, key=lambda f: f.at_us)
        self._astray: dict[int, tuple[int, int]] = {}  # vehicle -> from, until (us)
        self._drains: dict[int, tuple[int, Failure]] = {}
        self.battery = [1.0] * n
        self._hooks_open: set[int] = set()

    def act(
        self, now: int, released_us: int | None, plant: Plant | UntetheredPlant, vehicles: list[Autopilot]
    ) -> list[tuple[str, str]]:
        """Break what is due; (subject, text) of each."""
        events: list[tuple[str, str]] = []
        if isinstance(plant, UntetheredPlant):
            return events
        while self._coming and released_us is not None and now - released_us >= self._coming[0].at_us:
            events.append(self._break(self._coming.pop(0), now, plant, vehicles))
        for i, vehicle in enumerate(vehicles):
            for kind, rotor in vehicle.breakage.injected:
                events.append(self._break(Failure(0, kind, i, rotor, lasts_us=2**50), now, plant, vehicles))
            vehicle.breakage.injected.clear()
            if vehicle.breakage.hook_open and i not in self._hooks_open:
                self._hooks_open.add(i)
                off = plant.cut(i)
                events.append(
                    (f"vehicle {i + 1}", "lets go of its cable" if off else "its hook opens; nothing hangs on it")
                )
        for i, (since, f) in self._drains.items():
            self.battery[i] = max(0.0, f.remaining * (1.0 - (now - since) / f.lasts_us))
            plant.weaken(i, (1.0 - f.sag) if self.battery[i] > 0.0 else EMPTY_THRUST)
        return events

    def astray(self, i: int, now: int) -> Array | None:
        """(3,) m: how far off vehicle i takes itself to be; None while it knows."""
        span = self._astray.get(i)
        if span is None or not span[0] <= now < span[1]:
            return None
        t = (now - span[0]) * 1e-6
        way = math.radians(137.5 * (i + 1))
        return 0.5 * ASTRAY_M_S2 * t * t * np.array([math.cos(way), math.sin(way), 0.3])

    def _break(self, f: Failure, now: int, plant: Plant, vehicles: list[Autopilot]) -> tuple[str, str]:
        who = f"vehicle {f.vehicle + 1}"
        match f.kind:
            case "rotor-out":
                plant.set_rotor(f.vehicle, f.rotor, 0.0)
                return who, "all rotors stop" if f.rotor is None else f"rotor {f.rotor + 1} stops"
            case "vehicle-out":
                plant.set_rotor(f.vehicle, None, 0.0)
                return who, "all rotors stop"
            case "cable-cut":
                off = plant.cut(f.vehicle)
                return f"cable {f.vehicle + 1}", "comes off the load" if off else "cannot come off: it is the last"
            case "payload-shift":
                plant.shift(f.offset)
                x, y, z = f.offset.tolist()
                return "payload", f"its centre of mass shifts by ({x:g}, {y:g}, {z:g}) m"
            case "gust":
                plant.blow(f.wind, f.lasts_us * 1e-6)
                return "wind", f"a gust of {float(np.linalg.norm(f.wind)):g} m/s over {f.lasts_us * 1e-6:g} s"
            case "gps-loss":
                self._astray[f.vehicle] = (now, now + f.lasts_us)
                return who, "no position from outside"
            case "low-battery":
                self._drains[f.vehicle] = (now, f)
                return who, f"{100 * f.remaining:g} % of its battery left, {100 * f.sag:g} % less thrust"
            case "lands" | "returns":
                vehicles[f.vehicle].leave("LAND" if f.kind == "lands" else "RTL")
                return who, f"{f.kind} on its own"
            case _:
                raise ValueError(f"failure {f.kind!r} is not known")
