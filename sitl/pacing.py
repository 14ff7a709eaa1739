"""The vehicles' clock against the wall clock, where nobody is waited for."""

import math


class Pace:
    """A clock that is to run `speed` times as fast as the wall clock; as fast as it where speed is infinite."""

    def __init__(self, speed: float, tick_us: int) -> None:
        """`tick_us`: a tick that begins later than another one should is a missed deadline."""
        self._speed = 1.0 if math.isinf(speed) else speed
        self._tick_s = tick_us * 1e-6 / self._speed  # wall clock
        self._from: tuple[int, float] | None = None
        self.missed = 0
        self.lateness_s: list[float] = []

    def restart(self) -> None:
        """Begin anew at the next call of `deadline`: what was late is not made up for."""
        self._from = None

    def deadline(self, now_us: int, wall: float, ahead_us: int = 0) -> float:
        """When (s, wall clock) the clock is to show `now_us + ahead_us`; it shows `now_us` now, at `wall`."""
        if self._from is None:
            self._from = (now_us, wall)
        first, start = self._from
        return start + (now_us + ahead_us - first) * 1e-6 / self._speed

    def begun(self, late_s: float) -> None:
        """A tick began so late."""
        self.lateness_s.append(late_s)
        if late_s > self._tick_s:
            self.missed += 1
