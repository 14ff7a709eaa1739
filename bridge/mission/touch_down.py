"""Whether vehicles that are led down have come to stand. Nobody knows how high the ground is where they are."""

import math

from cablequad.types import Array

WINDOW_S, SMOOTH_S = 0.5, 0.3
LAGS = 0.3  # a vehicle in the air sinks by at least this share of what its reference does
RESTS = 0.2  # of the push, that one which stands seems to sink by at most


class TouchDown:
    """Those that land, looked at decision by decision."""

    def __init__(self, pushed_m: float) -> None:
        """`pushed_m`: how far below a vehicle its reference has to be."""
        self._pushed = pushed_m
        self._now = 0.0
        self._smooth: tuple[Array, Array] | None = None  # z of the vehicles and of their references
        self._window: tuple[float, Array, Array] | None = None

    def stands(self, now: float, z: Array, led: Array) -> bool:
        """Whether all stand: led further down for a while, and they do not follow. Both (n,), m, down."""
        if self._smooth is None or len(z) != len(self._smooth[0]):
            self._now, self._smooth, self._window = now, (z, led), None
            return False
        share = 1.0 - math.exp(-(now - self._now) / SMOOTH_S)
        self._now, (a, b) = now, self._smooth
        a, b = self._smooth = a + share * (z - a), b + share * (led - b)
        if float((b - a).min()) <= self._pushed:
            self._window = None
            return False
        if self._window is None:
            self._window = now, a, b
            return False
        since, a0, b0 = self._window
        if now - since < WINDOW_S:
            return False
        if bool((a - a0 <= (LAGS * (b - b0)).clip(min=RESTS * self._pushed)).all()):
            return True
        self._window = now, a, b
        return False
