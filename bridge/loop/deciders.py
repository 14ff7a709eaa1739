"""Who decides in a flight: a plan that is flown from its release on, or a mission. The loop asks both the same."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from bridge.fleet.fleet import Fleet
from bridge.loop.state_assembly import Instant, LoopModel, StateAssembler
from bridge.mission.members.fleet_subset import expanded
from bridge.mission.mission import UNSUPPORTED, Mission
from bridge.mission.observation import Observation
from bridge.mission.phases import FLY, LOADED, PREPARE
from bridge.wire.values import CableShape, VehiclePosition
from cablequad.control.control_step import Measurement, Sample
from cablequad.control.design import Design
from cablequad.control.law import Controller
from cablequad.control.trajectory import Reference
from cablequad.model.attitude import Airframe
from cablequad.model.state import positions

PART = "flown for"  # how the reason begins where only a part of a plan was asked for
OLD_S = 0.2  # a vehicle's word of where it is


class Plan(NamedTuple):
    """What the load is to do, in time since the release."""

    reference: Callable[[float], Reference]
    duration: float  # s
    whole_s: float = 0.0  # what its way takes; longer than `duration` where only a part was asked for


class Decided(NamedTuple):
    """One decision."""

    sample: Sample  # of all vehicles
    tension: list[float]  # (n,) N at the load, as it was told
    gaps_m: list[float]  # of each vehicle, from where its cable puts it, where that is checked
    events: list[tuple[str, str, str]]  # what happened: kind, subject, text


class Decider(Protocol):
    """What the loop asks."""

    observer: StateAssembler

    @property
    def phase(self) -> str:
        """What the flight is about now."""

    @property
    def carrying(self) -> bool:
        """Whether all vehicles carry the load, so that what their rotors give can be told from what they feel."""

    def feed(self, source: int, value: Any) -> None:
        """Take one value of a vehicle or the tracker."""

    def released(self) -> str:
        """The time begins; what that means, in words."""

    def answer(self, t: float, now: float, instant: Instant) -> Decided:
        """The decision `t` s after the release, at `now` s of the vehicles' clock."""

    def command(self, command: int, params: Sequence[float]) -> int:
        """Obey an operator's MAVLink command; the MAV_RESULT."""

    def over(self, sample: Sample | None) -> tuple[bool, str] | None:
        """Whether it was flown to its end and how it ended; None while it goes on."""


class PlanDecider:
    """Flies a plan, and holds its start until the release."""

    def __init__(self, plan: Plan, fleet: Fleet, loop: LoopModel, law: Controller, design: Design) -> None:
        self.observer = StateAssembler(loop)
        self.carrying = True
        self._plan, self._fleet, self._design = plan, fleet, design
        self._law, self._memory = law, law.first(design)

    @property
    def phase(self) -> str:
        return FLY if self._fleet.flying else PREPARE

    def feed(self, source: int, value: Any) -> None:
        self.observer.feed(source, value)

    def released(self) -> str:
        self.observer.released()
        return "every vehicle carries itself"

    def answer(self, t: float, now: float, instant: Instant) -> Decided:
        del now
        measured = Measurement(t, instant.state, restrained=not self._fleet.flying)
        self._memory, sample = self._law.step(self._design, self._memory, measured, self._plan.reference(t))
        self.observer.commanded(instant.boot_ms, sample.R_c, sample.f)
        return Decided(sample, instant.tension.tolist(), instant.position_gap.tolist(), [])

    def command(self, command: int, params: Sequence[float]) -> int:
        del command, params
        return UNSUPPORTED

    def over(self, sample: Sample | None) -> tuple[bool, str] | None:
        plan = self._plan
        if sample is None or not self._fleet.flying or sample.t < plan.duration - 1e-9:
            return None
        if plan.whole_s > plan.duration:
            return False, f"{PART} {plan.duration:g} s of a plan of {plan.whole_s:.3g} s: not judged at its end"
        return True, "plan flown to its end"


class MissionDecider:
    """Flies a mission with those that are not lost: observes them alone, and makes their decisions ones for all."""

    def __init__(self, mission: Mission, loop: LoopModel, design: Design) -> None:
        self.mission = mission
        self._loop, self._whole = loop, design
        self.observer = StateAssembler(loop)
        self._slack = not mission.plan.airborne
        if self._slack:
            self.observer.slack(True)
        self._begun = False
        self._members = list(mission.members)

    @property
    def phase(self) -> str:
        return str(self.mission.phase or PREPARE)

    @property
    def carrying(self) -> bool:
        return not self.mission.lost and self.phase in LOADED

    def feed(self, source: int, value: Any) -> None:
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

    def released(self) -> str:
        return "every vehicle is armed"

    def answer(self, t: float, now: float, instant: Instant) -> Decided:
        x, v, age_s = self.observer.reported(instant.boot_ms)
        astray = [
            own for own, k in enumerate(self._members) if self._astray(k) or (age_s[own] > OLD_S and not self._slack)
        ]
        if astray:  # where its cable says it is
            x[astray] = positions(self.mission.design.system, instant.state)[astray, 0]
        tension = np.zeros(len(self._whole.system.m))
        tension[self._members] = instant.tension
        observation = Observation(instant.state, instant.tension, instant.age_ms * 1e-3, x, v, age_s)
        own = self.mission.answer(t, now, observation)
        self._follow()
        self.observer.commanded(instant.boot_ms, own.R_c, own.f)
        events, self.mission.events = self.mission.events, []
        unchecked = [0.0] * len(tension)
        return Decided(expanded(own, self._members, self._whole), tension.tolist(), unchecked, events)

    def command(self, command: int, params: Sequence[float]) -> int:
        return self.mission.command(command, params)

    def over(self, sample: Sample | None) -> tuple[bool, str] | None:
        del sample
        m = self.mission
        return (m.failure is None, m.failure or "mission flown to its end") if m.finished else None

    def _astray(self, k: int) -> bool:
        return self.mission.plan.protect and k in self.mission.fleet.astray

    def _follow(self) -> None:
        """Observe those that are left, as taut or as slack as things are now."""
        m = self.mission
        if m.members != self._members:
            rest, before = [self._members.index(k) for k in m.members], self.observer
            self._members = list(m.members)
            air = Airframe(*(field[self._members].copy() for field in self._loop.airframe))
            filter = m.filters.get(frozenset(m.lost))
            self.observer = StateAssembler(self._loop._replace(system=m.design.system, airframe=air, filter=filter))
            self.observer.inherit(before, rest)
            self.observer.slack(self._slack)
        slack = not m.hanging
        if slack != self._slack or (m.released and not self._begun):
            self._slack, self._begun = slack, m.released
            self.observer.slack(slack)
