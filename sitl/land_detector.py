"""Who stands on the ground, as a land detector says it: feet on it and little thrust for a while."""

from cablequad.environment.ground import standing
from cablequad.types import Array
from sitl.parts import Part

LANDED_THRUST = 0.6  # of its weight: a vehicle that gives less, with its feet on the ground, is landing
LANDED_S = 0.3
LOOK_S = 0.004  # how often it is looked at


class LandDetector:
    """Of every vehicle of a plant."""

    def __init__(self, weight_N: Array, stand: bool) -> None:
        """`weight_N` (n,); `stand`: whether they stand at first."""
        self.standing = [stand] * len(weight_N)
        self._idle_N = LANDED_THRUST * weight_N
        self._settled_s = [0.0] * len(weight_N)
        self._since_look = 0.0

    def passed(self, seconds: float, parts: list[Part], thrust: Array) -> None:
        """So much time went by, and vehicles give `thrust` (n,) N."""
        self._since_look += seconds
        if self._since_look < LOOK_S - 1e-9:
            return
        for part in parts:
            feet = standing(part.system, part.state, part.world.ground)
            for own, i in enumerate(part.members):
                idle = thrust[i] < self._idle_N[i]
                self._settled_s[i] = self._settled_s[i] + self._since_look if feet[own] >= 2 and idle else 0.0
                if self._settled_s[i] >= LANDED_S:
                    self.standing[i] = True
                elif feet[own] == 0:
                    self.standing[i] = False
        self._since_look = 0.0
