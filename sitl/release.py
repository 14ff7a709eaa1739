"""How vehicles that are held are let go, and when a flight's time begins."""

from collections.abc import Callable

from bridge.wire.values import IN_AIR, ON_GROUND
from sitl.firmware.autopilot import Autopilot
from sitl.plant import Plant
from sitl.settings import Event
from sitl.untethered_plant import UntetheredPlant


class Release:
    """Held vehicles are let go together once each carries itself; on the ground time begins once all are armed."""

    def __init__(self, sink: Callable[[Event], None], began: Callable[[int], None]) -> None:
        """`began` is told when a flight's time begins (us)."""
        self.at_us: int | None = None
        self._releasing = False
        self._sink, self._began = sink, began

    def settle(self, now: int, plant: Plant | UntetheredPlant, vehicles: list[Autopilot]) -> None:
        """Release, land, go back to the start. A release is told with the state that it begins from."""
        if plant.restrained and self._releasing:
            plant.restrained = self._releasing = False
            self._begin(now, "every vehicle is armed and under command: released")
        elif plant.restrained:
            self._releasing = all(v.carries(now) for v in vehicles)
        elif isinstance(plant, Plant) and plant.grounded:
            if self.at_us is None and all(v.armed for v in vehicles):
                self._begin(now, "every vehicle is armed, on the ground")
        elif isinstance(plant, Plant) and not any(v.armed for v in vehicles):
            plant.reset()
            self._sink(Event(now, "reset", "all", "every vehicle is disarmed: back to the initial state, held"))
        for vehicle, stands in zip(vehicles, plant.standing(), strict=True):
            vehicle.set_landed(ON_GROUND if stands and not self._releasing else IN_AIR)

    def _begin(self, now: int, text: str) -> None:
        self._sink(Event(now, "release", "all", text))
        self.at_us = now
        self._began(now)
