"""Guards: rules with a number, checked at every tick of a mission, and what is done where one is broken."""

from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np

from cablequad.types import Array

Action = Literal["warn", "pause", "set-down"]


class Guard(NamedTuple):
    """One rule."""

    name: str
    limit: float
    action: Action
    lasts_s: float  # how long it must be broken before anything is done


class GuardInputs(NamedTuple):
    """What guards look at, of one instant."""

    x: Array  # (n, 3) m, vehicles
    R: Array  # (n, 3, 3)
    load: Array  # (3,) m
    R0: Array  # (3, 3)
    tension: Array  # (n,) N
    reserve: float  # share of the greatest thrust that nobody uses
    age_s: float
    off_plan_m: float  # of the load, from its reference
    battery: float  # 0 .. 1, the emptiest
    fence: Array  # (2, 3) m: lowest and highest corner


UPPER = frozenset({"tension_N", "tilt_deg", "load_tilt_deg", "outside_fence_m", "state_age_s", "off_plan_m"})


def guard_values(r: GuardInputs) -> dict[str, float]:
    """Every figure by its guard's name."""
    return {
        "tension_N": float(np.nanmax(r.tension)) if np.isfinite(r.tension).any() else 0.0,
        "separation_m": separation(r.x),
        "tilt_deg": _tilt(r.R),
        "load_tilt_deg": _tilt(r.R0[None]),
        "outside_fence_m": outside_fence(r.fence, [*r.x, r.load]),
        "thrust_reserve": r.reserve,
        "state_age_s": r.age_s,
        "off_plan_m": r.off_plan_m,
        "battery": r.battery,
    }


def outside_fence(fence: Array, places: Iterable[Array]) -> float:
    """m: how far the furthest of `places` (3,) is outside the fence (2, 3); negative inside."""
    return float(max(np.maximum(fence[0] - p, p - fence[1]).max() for p in places))


def separation(x: Array) -> float:
    """m: between the two vehicles that are closest."""
    if len(x) < 2:
        return float("inf")
    gap = np.linalg.norm(x[:, None] - x[None], axis=-1)
    return float(gap[np.triu_indices(len(x), 1)].min())


def _tilt(R: Array) -> float:
    return float(np.degrees(np.arccos(np.clip(R[:, 2, 2], -1.0, 1.0))).max())


class GuardViolation(NamedTuple):
    """A guard that is broken, since when, and by how much."""

    guard: Guard
    value: float


class GuardMonitor:
    """The guards over time; each tells once when it breaks and once when it holds again."""

    def __init__(self, guards: tuple[Guard, ...]) -> None:
        self._guards = guards
        self._since: dict[str, float] = {}
        self._reported: set[str] = set()

    def look(self, now: float, values: dict[str, float]) -> tuple[list[GuardViolation], list[Guard]]:
        """Guards that break now, and those that hold again."""
        broken, healed = [], []
        for g in self._guards:
            value = values[g.name]
            bad = value > g.limit if g.name in UPPER else value < g.limit
            if not bad:
                self._since.pop(g.name, None)
                if g.name in self._reported:
                    self._reported.discard(g.name)
                    healed.append(g)
            elif g.name not in self._reported and now - self._since.setdefault(g.name, now) >= g.lasts_s:
                self._reported.add(g.name)
                broken.append(GuardViolation(g, value))
        return broken, healed
