"""IMU, magnetometer, barometer and GPS of one vehicle: white noise and a constant bias, from one seeded generator."""

from collections import deque
from typing import NamedTuple

import numpy as np

from cablequad.model.earth import FIELD_GAUSS, pressure_hPa
from cablequad.types import Array


class Grades(NamedTuple):
    """One standard deviation of the noise of each sample, and of the bias that is drawn once; how GPS is late."""

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
    position_bias: float = 0.0  # m
    fix_us: int = 100_000  # between the fixes of the GPS receiver
    fix_delay_us: int = 0  # how old what it tells is


class SensorReading(NamedTuple):
    """What everything but GPS reads at an instant."""

    acceleration: Array  # (3,) m/s^2, B
    rate: Array  # (3,) rad/s, B
    field: Array  # (3,) gauss, B
    pressure: float  # hPa


class Fix(NamedTuple):
    """What the GPS receiver told last."""

    x: Array  # (3,) m, W
    v: Array  # (3,) m/s, W


class Instruments:
    """What one vehicle's sensors read."""

    temperature_C = 25.0

    def __init__(self, grades: Grades, rng: np.random.Generator) -> None:
        self._g, self._rng = grades, rng
        self.fix_us = grades.fix_us
        self._acceleration = grades.acceleration_bias * rng.normal(size=3)
        self._rate = grades.rate_bias * rng.normal(size=3)
        self._field = grades.field_bias * rng.normal(size=3)
        self._pressure = grades.pressure_bias * float(rng.normal())
        self._position = grades.position_bias * rng.normal(size=3) if grades.position_bias > 0.0 else np.zeros(3)
        self._ways: deque[tuple[int, Array, Array]] = deque()  # where it was, as far back as a fix may be late
        self._last: Fix | None = None

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
        return float(pressure_hPa(altitude_m) + self._pressure + self._g.pressure * self._rng.normal())

    def reading(self, specific_force: Array, Omega: Array, R: Array, altitude_m: float) -> SensorReading:
        """Everything but GPS."""
        return SensorReading(
            self.acceleration(specific_force), self.rate(Omega), self.field_gauss(R), self.pressure_hPa(altitude_m)
        )  # fmt: skip

    def fix(self, time_us: int, x: Array, v: Array) -> Fix:
        """What the GPS receiver tells at `time_us` of its place and speed: new at its rate, old by its delay."""
        self._ways.append((time_us, x.copy(), v.copy()))
        while len(self._ways) > 1 and self._ways[1][0] <= time_us - self._g.fix_delay_us:
            self._ways.popleft()
        if self._last is None or time_us % self._g.fix_us == 0:
            _, then, speed = self._ways[0]
            normal = self._rng.normal(size=(2, 3))
            self._last = Fix(then + self._position + self._g.position * normal[0], speed + self._g.velocity * normal[1])
        return self._last
