"""The condition of vehicles and load: what is left of batteries, and what is broken."""

from collections.abc import Callable

from sitl.batteries import Batteries
from sitl.failures import ActiveFailures
from sitl.firmware.autopilot import Autopilot
from sitl.firmware.telemetry import Snapshot
from sitl.plant import Plant
from sitl.settings import Event, Settings
from sitl.untethered_plant import UntetheredPlant


class Condition:
    """Batteries that empty and failures that come, and what a vehicle takes itself to be with them."""

    def __init__(self, s: Settings, sink: Callable[[Event], None]) -> None:
        self._batteries = Batteries(s.batteries, s.system.m * s.system.g)
        self._failures = ActiveFailures(s.failures, len(s.system.m))
        self._sink = sink

    def act(
        self, now: int, span_us: int, released_us: int | None, plant: Plant | UntetheredPlant, vehicles: list[Autopilot]
    ) -> None:
        """Empty the batteries by what the last `span_us` needed, and break what is due."""
        if isinstance(plant, Plant):
            self._batteries.use(plant, span_us * 1e-6)
        for subject, text in self._failures.act(now, released_us, plant, vehicles):
            self._sink(Event(now, "failure", subject, text))

    def self_image(self, i: int, own: Snapshot) -> Snapshot:
        """What vehicle i takes itself to be, with what is broken."""
        off = self._failures.astray(i, own.boot_us)
        battery = min(self._failures.battery[i], self._batteries.left[i])
        if off is not None:
            return own._replace(x=own.x + off, gps_fix=1, battery=battery)
        return own if battery == own.battery else own._replace(battery=battery)
