"""How the air moves from step to step: the weather, and gusts on top of it."""

import numpy as np

from cablequad.types import Array
from sitl.wind import Wind

AHEAD = 60  # steps that are drawn at a time


class MovingAir:
    """The wind at every step, where there is any."""

    def __init__(self, wind: Wind | None, h: float) -> None:
        """`h`: s, of a step."""
        self._wind, self._h = wind, h
        self._drawn = np.zeros((0, 3))  # m/s: of the wind
        self.calm_down()

    def calm_down(self) -> None:
        """End a gust, and begin anew."""
        self.newest: Array | None = None  # (3,) m/s, W: of the last step; None where no air has moved
        self._gust, self._gust_s, self._gust_at = np.zeros(3), 0.0, 0.0

    def blow(self, wind: Array, seconds: float) -> None:
        """A gust of (1 - cos) shape begins: MIL-F-8785C's discrete gust, up to `wind` (3,) m/s and down again."""
        self._gust, self._gust_s, self._gust_at = wind, seconds, 0.0

    def next(self, steps: int, still: bool) -> Array | None:
        """(steps, 3) m/s, W: how the air moves in the next steps; None where it rests and `still` says nothing."""
        wind = None
        if self._wind is not None:
            if len(self._drawn) < steps:
                self._drawn = np.concatenate([self._drawn, self._wind.next(AHEAD + steps)])
            wind, self._drawn = self._drawn[:steps], self._drawn[steps:]
        if wind is None and still:
            wind = np.zeros((steps, 3))
        if wind is not None and self._gust_at < self._gust_s:
            t = self._gust_at + self._h * np.arange(steps)
            share = np.where(t < self._gust_s, 0.5 * (1.0 - np.cos(2.0 * np.pi * t / self._gust_s)), 0.0)
            wind = wind + share[:, None] * self._gust
            self._gust_at += steps * self._h
        if wind is not None and (self._wind is not None or self._gust_s > 0.0):
            self.newest = wind[-1]
        return wind
