"""Batteries that empty as vehicles give thrust, and give less the emptier they are."""

from typing import NamedTuple

from cablequad.types import Array
from sitl.plant import Plant

POWER = 1.5  # of thrust: what an ideal rotor needs


class Battery(NamedTuple):
    """One vehicle's battery."""

    endurance_s: float  # at the thrust that carries the vehicle alone
    sag: float  # share of its thrust that it has lost when it is empty


class Batteries:
    """What is left of each, 0 .. 1."""

    def __init__(self, batteries: tuple[Battery | None, ...], weight_N: Array) -> None:
        """`weight_N` (n,) is that of the vehicles."""
        self._weight = weight_N
        self._in_use = [(i, b) for i, b in enumerate(batteries) if b is not None]
        self.left = [1.0] * len(weight_N)

    def use(self, plant: Plant, seconds: float) -> None:
        """Take what the thrust of the last `seconds` needed, and weaken the vehicles by it."""
        for i, b in self._in_use:
            load = max(0.0, float(plant.thrust[i]) / float(self._weight[i]))
            self.left[i] = max(0.0, self.left[i] - seconds / b.endurance_s * load**POWER)
            plant.weaken(i, 1.0 - b.sag * (1.0 - self.left[i]))
