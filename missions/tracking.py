"""How well the load followed its reference: figures that accumulate over a flight, of the truth where it is known."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from cablequad.pilot import Sample
from cablequad.state import Difference, State

SETTLED_M = 0.05
LAST_S = 10.0  # of the mean


class Followed(NamedTuple):
    """Figures of one flight; errors are of the load's position against its reference unless they say otherwise."""

    final_m: float
    rms_m: float
    largest_m: float
    mean_last_m: float  # over the last 10 s
    final_speed_m_s: float
    settled_s: float | None  # since when within 5 cm of the target
    link_rms_deg: float | None  # of the link directions that the controller went by; None where no truth is known
    attitude_rms_deg: float | None  # of the load's attitude that it went by


class Following:
    """Takes every decision of a flight with the state that was true when it was made."""

    def __init__(self, target: tuple[float, ...]) -> None:
        self._target = target
        self._count = 0
        self._squares = self._largest = 0.0
        self._last: deque[tuple[float, float]] = deque()
        self._sum = 0.0
        self._final = self._speed = 0.0
        self._settled: float | None = None
        self._links = self._attitude = 0.0
        self._judged = 0

    def take(self, sample: Sample, true: State | None, off: Difference | None, used: np.ndarray) -> None:
        """`used` (n, L) says which links there are. Without truth the state that was measured stands for it."""
        s = sample.state if true is None else true
        error = math.dist(s.x0.tolist(), sample.reference.x0.tolist())
        self._count += 1
        self._squares += error * error
        self._largest = max(self._largest, error)
        self._sum += error
        self._last.append((sample.t, error))
        while self._last[0][0] < sample.t - LAST_S:
            self._sum -= self._last.popleft()[1]
        self._final, self._speed = error, math.hypot(*s.v0.tolist())
        if math.dist(s.x0.tolist(), self._target) > SETTLED_M:
            self._settled = None
        elif self._settled is None:
            self._settled = sample.t
        if off is not None:
            self._judged += 1
            angles = off.link_direction[used]
            self._links += float(angles @ angles) / len(angles)
            self._attitude += float(off.attitude @ off.attitude)

    def followed(self) -> Followed | None:
        """The figures so far; None where nothing was flown."""
        if self._count == 0:
            return None
        judged = self._judged > 0
        rms, mean = math.sqrt(self._squares / self._count), self._sum / len(self._last)
        return Followed(
            self._final, rms, self._largest, mean, self._speed, self._settled,
            math.degrees(math.sqrt(self._links / self._judged)) if judged else None,
            math.degrees(math.sqrt(self._attitude / self._judged)) if judged else None,
        )  # fmt: skip
