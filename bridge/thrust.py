"""Newtons -> the thrust field of SET_ATTITUDE_TARGET.

PX4 hands the field to its mixer through THR_MDL_FAC: fac x^2 + (1 - fac) x = field for a motor command x. The rotors
give F = F_max x^2, so the field that asks for F is fac F/F_max + (1 - fac) sqrt(F/F_max).
"""

import math
from typing import NamedTuple


class ThrustLaw(NamedTuple):
    """One vehicle's rotors and the linearisation its firmware does."""

    max_thrust_N: float
    model_factor: float = 0.0  # THR_MDL_FAC

    def field(self, thrust_N: float) -> float:
        """The field, 0..1, that makes `thrust_N`; NaN stays NaN."""
        share = min(max(thrust_N / self.max_thrust_N, 0.0), 1.0) if thrust_N == thrust_N else math.nan
        return self.model_factor * share + (1.0 - self.model_factor) * math.sqrt(share)
