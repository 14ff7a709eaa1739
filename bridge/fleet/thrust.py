"""Newtons <-> the thrust field of SET_ATTITUDE_TARGET, per autopilot, and what the rotors really give.

PX4 hands the field to its mixer through THR_MDL_FAC: fac x^2 + (1 - fac) x = field for a motor command x. The rotors
give F = F_max x^2, so the field that asks for F is fac F/F_max + (1 - fac) sqrt(F/F_max).

ArduCopter (GUID_OPTIONS 8) makes the field a share of F_max itself, after multiplying it by 1 / cos(commanded tilt)
unless ATC_ANGLE_BOOST is 0, and dividing it by the ratio of the air's density to that at sea level. In air of that
ratio rotors give so much less: its field is a share of what they give at sea level.
"""

import math
from typing import NamedTuple, Protocol

MAX_BOOST = 10.0  # of ArduCopter's angle boost


class ThrustLaw(Protocol):
    """One vehicle's way from newtons to the field."""

    def field(self, thrust_N: float, cos_tilt: float) -> float:
        """The field, 0..1, that makes `thrust_N` at a commanded tilt; NaN stays NaN."""


class MotorCommand(NamedTuple):
    """PX4: a motor command, whose force is its square."""

    max_thrust_N: float
    model_factor: float = 0.0  # THR_MDL_FAC

    def field(self, thrust_N: float, cos_tilt: float) -> float:
        """See ThrustLaw."""
        del cos_tilt
        share = _share(thrust_N, self.max_thrust_N)
        return self.model_factor * share + (1.0 - self.model_factor) * math.sqrt(share)


class LinearShare(NamedTuple):
    """ArduCopter: a share of the greatest thrust, boosted by the tilt or not."""

    max_thrust_N: float
    angle_boost: bool = True  # ATC_ANGLE_BOOST

    def field(self, thrust_N: float, cos_tilt: float) -> float:
        """See ThrustLaw."""
        boost = min(1.0 / max(cos_tilt, 1.0 / MAX_BOOST), MAX_BOOST) if self.angle_boost else 1.0
        return _share(thrust_N, self.max_thrust_N) / boost


def _share(thrust_N: float, max_thrust_N: float) -> float:
    return min(max(thrust_N / max_thrust_N, 0.0), 1.0) if thrust_N == thrust_N else math.nan


class ThrustScale(NamedTuple):
    """Newtons made per newton asked, by least squares through zero, and how sure that is."""

    pairs: int = 0
    asked_squared: float = 0.0
    asked_made: float = 0.0
    made_squared: float = 0.0

    def seen(self, asked_N: float, made_N: float) -> "ThrustScale":
        """With one more pair."""
        if not (math.isfinite(asked_N) and math.isfinite(made_N)):
            return self
        return ThrustScale(
            self.pairs + 1,
            self.asked_squared + asked_N * asked_N,
            self.asked_made + asked_N * made_N,
            self.made_squared + made_N * made_N,
        )

    @property
    def scale(self) -> float:
        """Newtons made per newton asked; NaN where nothing was seen."""
        return self.asked_made / self.asked_squared if self.asked_squared > 0.0 else math.nan

    @property
    def error(self) -> float:
        """One standard deviation of `scale`, from the scatter about it; NaN below three pairs."""
        if self.pairs < 3 or self.asked_squared <= 0.0:
            return math.nan
        scatter = max(0.0, self.made_squared - self.scale * self.asked_made) / (self.pairs - 1)
        return math.sqrt(scatter / self.asked_squared)


def made_thrust_N(mass_kg: float, specific_force_z: float, pull_along_z_N: float) -> float:
    """What the rotors give, from the accelerometer (m/s^2, body z, down) and the cable's pull along body z (N).

    m a = -f + pull along body z, for the specific force a that an accelerometer reads.
    """
    return pull_along_z_N - mass_kg * specific_force_z
