"""Where a load's cables end and what they weigh: what a mission needs to know of those that carry it."""

import math
from typing import NamedTuple

import numpy as np

from cablequad.control.control_step import Sample
from cablequad.control.design import Design
from cablequad.model.state import State
from cablequad.model.system import System
from cablequad.types import Array

STRONG = 0.8  # of its greatest thrust, that a vehicle may need at rest
CARRIES = 0.02  # of a vehicle's weight: the least that a cable must bear for a fleet that goes on


class CableGeometry(NamedTuple):
    """One crew's load and cables."""

    system: System
    length: Array  # (n,) m, of whole cables
    bears: Array  # (n,) N: what each vehicle bears of the load where it hangs at rest
    strong: bool  # every vehicle has thrust to spare at rest

    @classmethod
    def of(cls, design: Design) -> "CableGeometry":
        """The geometry of those for whom `design` is."""
        s = design.system
        used = np.arange(s.length.shape[1])[None, :] < s.n_links[:, None]
        lengths = np.asarray(np.where(used, s.length, 0.0).sum(axis=1))
        strong = bool((-design.u_star[:, 2] < STRONG * design.airframe.max_thrust).all())
        return cls(s, lengths, -design.u_star[:, 2] - s.M_iT * s.g, strong)

    def can_carry(self) -> bool:
        """Whether every cable is taut and every vehicle strong enough where the load hangs at rest."""
        return self.strong and bool((self.bears > CARRIES * self.system.m * self.system.g).all())

    def ends(self, s: State) -> Array:
        """(n, 3) m: where the cables are tied to the load."""
        return s.x0 + self.system.rho @ s.R0.T

    def above(self, s: State, share: float) -> Array:
        """(n, 3) m: above those ends by this share of a cable's length."""
        out = self.ends(s)
        out[:, 2] -= share * self.length
        return out

    def chains(self, share: float) -> Array:
        """(n,) N: the weight of this share of each cable."""
        return share * (self.system.M_iT - self.system.m) * self.system.g

    def pulled(self, sample: Sample) -> Array:
        """(n, 3) N: what was commanded of each vehicle beyond its own weight."""
        return np.asarray(sample.A + np.outer(self.system.m, [0.0, 0.0, self.system.g]))


def yaw_of(s: State, hangs: Array) -> float:
    """rad: how the load is turned about e3 from how it hangs at rest, (3, 3)."""
    turned = s.R0 @ hangs.T
    return math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])
