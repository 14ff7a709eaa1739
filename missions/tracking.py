"""How well the load followed its reference: figures that accumulate over a flight, of the truth where it is known."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from bridge.guards import separation
from cablequad.pilot import Sample
from cablequad.state import Difference, State

SETTLED_M = 0.05
LAST_S = 10.0  # of the mean
LIFTED_M, TOUCHES_M = 0.05, 0.003
LOW_M, HARD_M_S, TOPPLED, HIT_M = 0.05, 1.0, 0.5, 0.25


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


class Standing(NamedTuple):
    """Where things stand on the ground."""

    load_z: float  # m, of the load
    vehicle_z: float  # m, of a vehicle


class Grounded(NamedTuple):
    """What was true of a mission from the ground."""

    load_m: tuple[float, float, float]  # where the load is in the end
    touch_down_m_s: float | None  # its vertical speed right before it first stood again
    largest_tension_N: float
    smallest_separation_m: float
    vehicles_crashed: int | None  # that hit the ground at speed or upside down, or another vehicle


class OnGround:
    """Figures of a load that is lifted and set down, from the truth."""

    def __init__(self, ground: Standing) -> None:
        self._rest_z, self._floor_z = ground.load_z, ground.vehicle_z
        self._crashed: set[int] = set()
        self._lifted, self._before = False, 0.0
        self._touch: float | None = None
        self._tension = 0.0
        self._separation = math.inf
        self._last = (0.0, 0.0, 0.0)

    def take(self, s: State, x: np.ndarray, v: np.ndarray, tension: np.ndarray) -> None:
        """The state, the vehicles' x, v (n, 3) m, m/s and the tensions (links,) N of one instant."""
        z, down = float(s.x0[2]), float(s.v0[2])
        self._lifted = self._lifted or z < self._rest_z - LIFTED_M
        if self._lifted and self._touch is None and z > self._rest_z - TOUCHES_M:
            self._touch = abs(self._before)
        self._before = down
        self._tension = max(self._tension, float(tension.max()))
        gap = separation(x)
        self._separation = min(self._separation, gap)
        low = x[:, 2] > self._floor_z - LOW_M
        if low.any() or gap < HIT_M:
            hard = (np.linalg.norm(v, axis=1) > HARD_M_S) | (s.R[:, 2, 2] < TOPPLED)
            self._crashed.update(np.flatnonzero(low & hard).tolist())
            if gap < HIT_M:
                near = np.linalg.norm(x[:, None] - x[None], axis=-1) + np.eye(len(x))
                self._crashed.update(np.flatnonzero(near.min(axis=1) < HIT_M).tolist())
        self._last = tuple(s.x0.tolist())

    def judged(self) -> Grounded:
        """The figures so far."""
        return Grounded(self._last, self._touch, self._tension, self._separation, len(self._crashed))
