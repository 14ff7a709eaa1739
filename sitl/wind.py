"""Wind: a steady part and Dryden gusts, MIL-F-8785C's continuous model for low altitude.

Intensities and scale lengths are functions of height h (ft) and of the steady wind at 20 ft; the gusts are frozen and
pass with the air's speed relative to the formation, which is that of the steady wind. They are the same for all bodies:
scale lengths are many times the size of the formation.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import linalg

from cablequad.types import Array

FEET = 0.3048  # m
LOWEST_FT = 10.0
SLOWEST_M_S = 1.0  # gusts of a still air would never pass


class Weather(NamedTuple):
    """What the wind is like."""

    mean: Array  # (3,) m/s, W
    gusts: bool
    height: float  # m above ground


class Turbulence(NamedTuple):
    """Scale lengths and intensities of the gusts along the wind, across it and vertically."""

    L: tuple[float, float, float]  # m
    sigma: tuple[float, float, float]  # m/s


def turbulence(weather: Weather) -> Turbulence:
    """MIL-F-8785C 3.7.2 for heights of 10 to 1000 ft: L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2,

    sigma_w = 0.1 W_20, sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4.
    """
    h = max(weather.height / FEET, LOWEST_FT)
    shape = 0.177 + 0.000823 * h
    along = h / shape**1.2 * FEET
    vertical = 0.1 * float(np.linalg.norm(weather.mean))
    level = vertical / shape**0.4
    return Turbulence((along, along, h * FEET), (level, level, vertical))


class Wind:
    """The wind over time, step by step; one seeded generator makes the gusts."""

    def __init__(self, weather: Weather, h: float, rng: np.random.Generator) -> None:
        self._mean = np.asarray(weather.mean, dtype=float)
        self._rng = rng
        self._gusts = weather.gusts and bool(np.any(self._mean))
        along = math.atan2(self._mean[1], self._mean[0])
        c, s = math.cos(along), math.sin(along)
        self._axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        air = turbulence(weather)
        V = max(float(np.linalg.norm(self._mean)), SLOWEST_M_S)
        filters = [_along(air.L[0] / V, air.sigma[0], h)]
        filters += [_across(air.L[k] / V, air.sigma[k], h) for k in (1, 2)]
        self._A = linalg.block_diag(*(f[0] for f in filters))
        self._noise = linalg.block_diag(*(f[1] for f in filters))
        self._read = linalg.block_diag(*(f[2] for f in filters))
        start = linalg.block_diag(*(f[3] for f in filters))
        self._x = start @ rng.normal(size=len(start))

    def next(self, steps: int) -> Array:
        """(steps, 3) m/s, W: the wind of the next steps."""
        out = np.tile(self._mean, (steps, 1))
        if self._gusts:
            kicks = self._rng.normal(size=(steps, len(self._x))) @ self._noise.T
            for k in range(steps):
                out[k] += self._axes @ (self._read @ self._x)
                self._x = self._A @ self._x + kicks[k]
        return out


Filter = tuple[Array, Array, Array, Array]  # A, noise, output row, square root of the stationary covariance


def _along(time: float, sigma: float, h: float) -> Filter:
    """H_u(s) = sigma sqrt(2 time / pi) / (1 + time s)."""
    return _sampled(np.array([[-1.0 / time]]), np.array([[1.0]]), np.array([[1.0]]), sigma, h)


def _across(time: float, sigma: float, h: float) -> Filter:
    """H_v(s) = sigma sqrt(time / pi) (1 + sqrt(3) time s) / (1 + time s)^2."""
    A = np.array([[0.0, 1.0], [-1.0 / time**2, -2.0 / time]])
    return _sampled(A, np.array([[0.0], [1.0]]), np.array([[1.0, math.sqrt(3.0) * time]]), sigma, h)


def _sampled(A: Array, B: Array, C: Array, sigma: float, h: float) -> Filter:
    """x' = A x + B n, y = C x, sampled every `h` s without error, scaled so that y has standard deviation sigma."""
    P = linalg.solve_continuous_lyapunov(A, -B @ B.T)
    scale = sigma / math.sqrt((C @ P @ C.T).item())
    A_d = linalg.expm(A * h)
    kick = P - A_d @ P @ A_d.T
    return A_d, linalg.cholesky(kick, lower=True), scale * C, linalg.cholesky(P, lower=True)
