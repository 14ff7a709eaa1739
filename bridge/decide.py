"""A mission's decisions from what is heard: the observer of those that carry, and what is made of its states."""

from typing import Any

import numpy as np

from bridge.crew import expanded
from bridge.mission import Mission
from bridge.observe import Instant, Loop, Observer
from bridge.wire.values import CableShape, VehiclePosition
from cablequad.attitude import Airframe
from cablequad.design import Design
from cablequad.pilot import Sample
from cablequad.state import positions

OLD_S = 0.2  # a vehicle's word of where it is


class Decider:
    """Feeds an observer of the vehicles that are not lost, and asks the mission."""

    def __init__(self, mission: Mission, loop: Loop, design: Design) -> None:
        self.mission = mission
        self._loop, self._whole = loop, design
        self.observer = Observer(loop)
        self._slack = not mission.plan.airborne
        if self._slack:
            self.observer.slack(True)
        self._begun = False
        self._members = list(mission.members)

    def feed(self, source: int, value: Any) -> None:
        """Take one value of a vehicle or the tracker."""
        number = source
        if 1 <= source <= len(self._whole.system.m):
            if source - 1 not in self._members:
                return
            if isinstance(value, VehiclePosition) and self._astray(source - 1):
                return
            number = self._members.index(source - 1) + 1
        elif isinstance(value, CableShape):
            if value.cable - 1 not in self._members:
                return
            value = value._replace(cable=self._members.index(value.cable - 1) + 1)
        self.observer.feed(number, value)

    def answer(self, t: float, now: float, instant: Instant) -> Sample:
        """The decision for `instant`, of the vehicles that were not lost before it."""
        old = instant.x_age_s > OLD_S
        astray = [own for own, k in enumerate(self._members) if self._astray(k) or (old[own] and not self._slack)]
        if astray:  # where its cable says it is
            x = instant.x.copy()
            x[astray] = positions(self.mission.design.system, instant.state)[astray, 0]
            instant = instant._replace(x=x)
        sample = self.mission.answer(t, now, instant)
        if self.mission.members != self._members:
            self._regroup()
        m = self.mission
        slack = not m.hanging
        if slack != self._slack or (m.released and not self._begun):
            self._slack, self._begun = slack, m.released
            self.observer.slack(slack)
        return sample

    def whole(self, sample: Sample) -> Sample:
        """A decision as one for all vehicles."""
        return expanded(sample, self._members, self._whole)

    def tension(self, instant: Instant) -> list[float]:
        """(n,) N at the load as it was told; 0 of those that are lost."""
        out = np.zeros(len(self._whole.system.m))
        kept = instant.tension if len(instant.tension) == len(self._members) else instant.tension[: len(self._members)]
        out[self._members] = kept
        return out.tolist()

    def events(self) -> list[tuple[str, str, str]]:
        """What happened since the last call: kind, subject, text."""
        out, self.mission.events = self.mission.events, []
        return out

    def _astray(self, k: int) -> bool:
        return self.mission.plan.protect and k in self.mission.fleet.astray

    def _regroup(self) -> None:
        """An observer for those that are left; it begins with what is heard next."""
        self._members = list(self.mission.members)
        design = self.mission.design
        loop, rest = self._loop, self._members
        air = Airframe(*(field[rest].copy() for field in loop.airframe))
        loop = loop._replace(
            system=design.system, airframe=air, filter=self.mission.filters.get(frozenset(self.mission.lost))
        )
        self.observer = Observer(loop)
        self.observer.slack(self._slack)
