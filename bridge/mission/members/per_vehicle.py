"""Vehicles that fly each by itself, one goal a vehicle: their routes, and what hangs on them meanwhile."""

import numpy as np

from bridge.mission.scale import USUAL, Scale
from cablequad.control.design import Design
from cablequad.control.single_vehicle import Flown, Goals, fly_each, integrated
from cablequad.control.trajectory import Limits, Trajectory, at, leg
from cablequad.types import Array

AROUND = np.radians([0.0, 10.0, -10.0, 20.0, -20.0, 30.0, -30.0, 40.0, -40.0, 50.0, -50.0])
FURTHER = (1.0, 1.15, 1.3)  # as far from the load


def clear_of(wrecks: list[Array], spots: Array, middle: Array, scale: Scale = USUAL) -> Array:
    """Where to land, (n, 3) m, near `spots` about `middle` (3,) m, with no wreck (3,) m and nobody else too near.

    A spot moves around the load, and a little outwards; where nothing is clear, to what is clearest of the wrecks.
    """
    out = spots.copy()
    near = [i for i, spot in enumerate(spots) if _room(wrecks, spot) < scale.off_wreck_m]
    for i in near:
        others = [out[k] for k in range(len(out)) if k != i]
        arm = spots[i] - middle
        tried = []
        for further in FURTHER:
            for turn in AROUND:
                c, s = np.cos(turn), np.sin(turn)
                spot = middle + further * np.array([c * arm[0] - s * arm[1], s * arm[0] + c * arm[1], 0.0])
                spot[2] = spots[i, 2]
                if _room(others, spot) >= scale.off_others_m:
                    tried.append(spot)
        clear = [spot for spot in tried if _room(wrecks, spot) >= scale.off_wreck_m]
        if clear:
            out[i] = min(clear, key=lambda spot: float(np.linalg.norm(spot - spots[i])))
        elif tried:
            out[i] = max(tried, key=lambda spot: _room(wrecks, spot))
    return out


def _room(things: list[Array], spot: Array) -> float:
    """m: on the ground plan, to the nearest."""
    return min((float(np.hypot(*(thing - spot)[:2])) for thing in things), default=float("inf"))


class SingleVehicles:
    """The routes, integrals and shares of n vehicles."""

    def __init__(self, n: int, share_s: float) -> None:
        """`share_s`: for what hangs on a vehicle to be taken or given."""
        self._share_s = share_s
        self.aim = np.zeros((n, 3))  # m: where they were to be last
        self._routes: list[Trajectory] = []
        self._integral = np.zeros((n, 3))
        self._before = self._after = np.zeros(n)
        self._since = 0.0

    def keep(self, x: Array) -> None:
        """Only those that are at x (m, 3) m are left."""
        self.aim, self._integral, self._routes = x.copy(), np.zeros_like(x), []

    @property
    def duration(self) -> float:
        """s until the last has come to the end of its way."""
        return max((route.duration for route in self._routes), default=0.0)

    def go(self, routes: list[Trajectory]) -> None:
        """Along these."""
        self._routes = routes

    def straight_to(self, x: Array, limits: Limits) -> None:
        """From where they were to be straight to `x` (n, 3) m."""
        self._routes = [leg([*a, 0.0], [*b, 0.0], limits) for a, b in zip(self.aim.tolist(), x.tolist(), strict=True)]

    def forget(self) -> None:
        """What integrals held is of a flight that is over."""
        self._integral[:] = 0.0

    def hang(self, before: Array, after: Array, now: float) -> None:
        """What hangs on them, (n,) N, goes from one to the other."""
        self._before, self._after, self._since = before, after, now

    def hung(self, now: float) -> Array:
        """(n,) N: what hangs on them."""
        share = min(1.0, max(0.0, (now - self._since) / self._share_s))
        return self._before + share * (self._after - self._before)

    def handed_over(self, now: float) -> bool:
        """Whether everything has been taken or given."""
        return now - self._since >= self._share_s

    def goals(self, x: Array, now: float, tau: float, rate: float, power: float) -> Goals:
        """Where each is to be at `tau` s of its way, whose clock runs at `rate`; below full `power` it stands at x."""
        n = len(x)
        out = Goals(x.copy(), np.zeros((n, 3)), np.zeros((n, 3)), self.hung(now), np.full(n, power))
        if power >= 1.0:
            for k, route in enumerate(self._routes):
                r = at(route, tau)
                out.x[k], out.v[k], out.a[k] = r.x0, rate * r.v0, rate * rate * r.a0
        return out

    def fly(self, design: Design, x: Array, v: Array, R: Array, goals: Goals, R_before: Array) -> Flown:
        """What is commanded of vehicles at x, v (n, 3), R (n, 3, 3)."""
        self.aim = goals.x
        self._integral = integrated(design, self._integral, x, goals)
        return fly_each(design, x, v, R, self._integral, goals, R_before)
