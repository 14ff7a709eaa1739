"""Who still flies: the vehicles that are left, and the design, filter and cables of just those."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from bridge.mission.members.cable_geometry import CableGeometry
from bridge.mission.members.fleet_subset import bare, blind
from cablequad.control.design import Design
from cablequad.control.estimator import Filter
from cablequad.control.law import Controller


class Contingencies(NamedTuple):
    """The law, and its designs and filters by the vehicles that are lost; those of nobody lost are always there.

    No filters: everything is measured exactly. Who is lost without a design for it is flown without one.
    """

    law: Controller
    designs: Mapping[frozenset[int], Design]
    filters: Mapping[frozenset[int], Filter]


class Members:
    """The vehicles of a mission that are not lost, by their numbers from 0."""

    def __init__(self, planned: Contingencies) -> None:
        self._designs, self.filters = planned.designs, dict(planned.filters)
        self.design = self.whole = planned.designs[frozenset()]
        self.left = list(range(len(self.whole.system.m)))
        self.lost: dict[int, str] = {}  # why
        self._fates: dict[int, str] = {}  # what became of those that are lost
        self.geometry = CableGeometry.of(self.design)

    def lose(self, k: int, why: str, fate: str) -> list[int]:
        """Vehicle k is lost: where those that stay stood among the members before. The last one stays a member."""
        self.lost[k], self._fates[k] = why, fate
        member = self.left.index(k)
        rest = [j for j in range(len(self.left)) if j != member]
        if not rest:
            return rest
        self.left.remove(k)
        gone = frozenset(self.lost)
        planned = self._designs.get(gone)
        self.design = planned if planned is not None else bare(self.whole, self.left)
        if planned is None and self.filters:
            self.filters[gone] = blind(self.design)
        self.geometry = CableGeometry.of(self.design)
        return rest

    def fates(self) -> Iterator[tuple[int, str]]:
        """What became of each vehicle, in a mission that lost some; told once."""
        for k in range(len(self.whole.system.m)) if self._fates else ():
            yield k, self._fates.get(k, "flew to the end; it stands on the ground, disarmed")
        self._fates = {}
