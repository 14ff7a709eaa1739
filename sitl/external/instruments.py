"""IMU, magnetometer, barometer and GPS of one vehicle: white noise and a constant bias, from one seeded generator."""

from typing import NamedTuple

import numpy as np

from cablequad.types import Array

FIELD_GAUSS = np.array([0.2158, 0.0121, 0.4335])  # NED, at the home position (declination 3.2 deg, inclination 63.5)
SEA_LEVEL_HPA, LAPSE, POWER = 1013.25, 2.25577e-5, 5.25588  # ISA


class Grades(NamedTuple):
    """One standard deviation of the noise of each sample, and of the bias that is drawn once."""

    acceleration: float = 0.02  # m/s^2
    rate: float = 0.002  # rad/s
    field: float = 0.0008  # gauss
    pressure: float = 0.012  # hPa: 10 cm
    position: float = 0.01  # m
    velocity: float = 0.02  # m/s
    acceleration_bias: float = 0.02
    rate_bias: float = 0.001
    field_bias: float = 0.0005
    pressure_bias: float = 0.02


class Instruments:
    """What one vehicle's sensors read."""

    temperature_C = 25.0

    def __init__(self, grades: Grades, rng: np.random.Generator) -> None:
        self._g, self._rng = grades, rng
        self._acceleration = grades.acceleration_bias * rng.normal(size=3)
        self._rate = grades.rate_bias * rng.normal(size=3)
        self._field = grades.field_bias * rng.normal(size=3)
        self._pressure = grades.pressure_bias * float(rng.normal())

    def acceleration(self, specific_force: Array) -> Array:
        """(3,) m/s^2, B."""
        return specific_force + self._acceleration + self._g.acceleration * self._rng.normal(size=3)

    def rate(self, Omega: Array) -> Array:
        """(3,) rad/s, B."""
        return Omega + self._rate + self._g.rate * self._rng.normal(size=3)

    def field_gauss(self, R: Array) -> Array:
        """(3,) gauss, B."""
        return R.T @ FIELD_GAUSS + self._field + self._g.field * self._rng.normal(size=3)

    def pressure_hPa(self, altitude_m: float) -> float:
        """At an altitude above sea level, in the standard atmosphere."""
        exact = SEA_LEVEL_HPA * (1.0 - LAPSE * altitude_m) ** POWER
        return float(exact + self._pressure + self._g.pressure * self._rng.normal())

    def altitude_m(self, pressure_hPa: float) -> float:
        """Above sea level, as a barometer makes it of its pressure."""
        return float((1.0 - (pressure_hPa / SEA_LEVEL_HPA) ** (1.0 / POWER)) / LAPSE)

    def fix(self, x: Array, v: Array) -> tuple[Array, Array]:
        """(3,) m and (3,) m/s, W: what the GPS receiver makes of where it is and how it moves."""
        normal = self._rng.normal(size=(2, 3))
        return x + self._g.position * normal[0], v + self._g.velocity * normal[1]
