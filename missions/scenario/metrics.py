"""How well the load followed its reference: figures that accumulate over a flight, of the truth where it is known."""

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cablequad.model.instant import Motion

SETTLED_M = 0.05
LAST_S = 10.0  # of the mean
LIFTED_M, TOUCHES_M = 0.05, 0.003
LOW_M, HARD_M_S, TOPPLED = 0.05, 1.0, 0.5


class Followed(NamedTuple):
    """Figures of one flight; errors are of the load's position against its reference unless they say otherwise."""

    final_m: float  # from the target, where the flight has one of its own to end at; else from the reference
    rms_m: float
    largest_m: float
    mean_last_m: float  # over the last 10 s
    final_speed_m_s: float
    settled_s: float | None  # since when within 5 cm of the target
    link_rms_deg: float | None  # of the link directions that the controller went by; None where no truth is known
    attitude_rms_deg: float | None  # of the load's attitude that it went by


class Following:
    """Takes every decision of a flight: by the state that was true when it was made, or the measured one."""

    def __init__(self, target: tuple[float, ...], ends_there: bool = True) -> None:
        """`ends_there`: the flight is to end at `target` (3,) m; else, as a mission's, where its reference leads."""
        self._target, self._ends_there = target, ends_there
        self._count = 0
        self._squares = self._largest = 0.0
        self._last: deque[tuple[float, float]] = deque()
        self._sum = 0.0
        self._final = self._speed = 0.0
        self._settled: float | None = None
        self._links = self._attitude = 0.0
        self._judged = 0

    def take(self, t: float, x: Sequence[float], v: Sequence[float], wanted: Sequence[float]) -> None:
        """Where the load was at `t`, how it moved and where it was to be; x, v, wanted (3,) m, m/s."""
        error = math.dist(x, wanted)
        self._count += 1
        self._squares += error * error
        self._largest = max(self._largest, error)
        self._sum += error
        self._last.append((t, error))
        while self._last[0][0] < t - LAST_S:
            self._sum -= self._last.popleft()[1]
        away = math.dist(x, self._target)
        self._final, self._speed = away if self._ends_there else error, math.hypot(*v)
        if away > SETTLED_M:
            self._settled = None
        elif self._settled is None:
            self._settled = t

    def judge(self, link_direction: np.ndarray, attitude: np.ndarray) -> None:
        """How far k decisions' states were off the true ones: angles (k, links) rad, rotation vectors (k, 3) rad."""
        self._judged += len(attitude)
        self._links += float((link_direction**2).sum()) / link_direction.shape[1]
        self._attitude += float((attitude**2).sum())

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
    hit_m: float = 0.25  # between two vehicles that hit each other


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
        self._rest_z, self._floor_z, self._hit = ground
        self._crashed: set[int] = set()
        self._lifted, self._before = False, 0.0
        self._touch: float | None = None
        self._tension = 0.0
        self._separation = math.inf
        self._last = (0.0, 0.0, 0.0)

    def take(self, m: Motion, used: np.ndarray) -> None:
        """The motion of consecutive instants, with a row for each; `used` (n, L) says which links there are."""
        for z, down in zip(m.state.x0[:, 2].tolist(), m.state.v0[:, 2].tolist(), strict=True):
            self._lifted = self._lifted or z < self._rest_z - LIFTED_M
            if self._lifted and self._touch is None and z > self._rest_z - TOUCHES_M:
                self._touch = abs(self._before)
            self._before = down
        self._tension = max(self._tension, float(m.tension[:, used].max()))
        gap = np.linalg.norm(m.x[:, :, None] - m.x[:, None], axis=-1) + np.diag(np.full(m.x.shape[1], np.inf))
        nearest = gap.min(axis=2)
        self._separation = min(self._separation, float(nearest.min()))
        low = m.x[:, :, 2] > self._floor_z - LOW_M
        hard = (np.linalg.norm(m.v, axis=2) > HARD_M_S) | (m.state.R[:, :, 2, 2] < TOPPLED)
        self._crashed.update(np.flatnonzero(((low & hard) | (nearest < self._hit)).any(axis=0)).tolist())
        self._last = tuple(m.state.x0[-1].tolist())

    def judged(self) -> Grounded:
        """The figures so far."""
        return Grounded(self._last, self._touch, self._tension, self._separation, len(self._crashed))
