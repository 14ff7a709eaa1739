"""What is commanded in a mission: the load along its reference, or every vehicle by itself."""

import math
from collections.abc import Callable

import numpy as np

from bridge.mission.members.per_vehicle import SingleVehicles
from bridge.mission.observation import Observation
from bridge.mission.plan_clock import PlanClock
from cablequad.control.control_step import Measurement, Sample
from cablequad.control.design import Design
from cablequad.control.law import Controller
from cablequad.control.single_vehicle import Goals
from cablequad.control.trajectory import Reference, Trajectory, at, still
from cablequad.model import lie
from cablequad.types import Array


class LoadControl:
    """The memory of the law, and of every vehicle by itself."""

    def __init__(self, law: Controller, design: Design, share_s: float, tell: Callable[[str, str, str], None]) -> None:
        """`share_s`: for what hangs on a vehicle to be taken or given. `tell`: kind, subject and text of an event."""
        n = len(design.system.m)
        self.singles = SingleVehicles(n, share_s)
        self.track: Trajectory = still([0.0, 0.0, 0.0, 0.0])
        self.last: Sample | None = None
        self._law, self._design = law, design
        self._memory = law.first(design)
        self._R_before = np.tile(np.eye(3), (n, 1, 1))
        self._tilt, self._tilted_until = np.eye(3), 0.0  # of every vehicle, beyond what it is commanded
        self._finite = True  # so far
        self._tell = tell

    def begin(self) -> None:
        """The load is taken up: nothing is remembered."""
        self._memory = self._law.first(self._design)

    def keep(self, rest: list[int], design: Design, x: Array) -> None:
        """Only some are left, at x (m, 3) m, for whom `design` is."""
        self._design = design
        self.singles.keep(x)
        self._R_before = self._R_before[rest].copy()
        self._memory, self.last = self._law.first(design), None

    def tilt(self, turn: list[float], until: float) -> None:
        """Turn every vehicle by a rotation vector (rad, of its body) beyond what it is commanded, until then (s)."""
        self._tilt, self._tilted_until = lie.exp(np.array(turn)), until

    def reference(self, clock: PlanClock) -> Reference:
        """Where the load is to be now, as fast as the plan's clock runs."""
        r, k = at(self.track, clock.time), clock.rate
        if k == 1.0:
            return r
        turn = np.array([r.yaw[0], k * r.yaw[1], k * k * r.yaw[2]])
        return Reference(r.x0, k * r.v0, k**2 * r.a0, k**3 * r.j0, k**4 * r.s0, turn)

    def fly_load(self, measured: Measurement, reference: Reference) -> Sample:
        """The decision of the law."""
        after, sample = self._law.step(self._design, self._memory, measured, reference)
        if not math.isfinite(float(sample.A.sum()) + float(sample.f.sum()) + float(sample.R_c.sum())):
            sample = self._as_before(sample)
            after = self._law.first(self._design)
        self._memory, self._R_before, self.last = after, sample.R_c, sample
        return sample

    def fly_vehicles(
        self, measured: Measurement, reference: Reference, i: Observation, goals: Goals, now: float
    ) -> Sample:
        """The decision for every vehicle by itself; errors of the load are still those of `reference`."""
        _, sample = self._law.step(self._design, self._memory, measured, reference)
        alone = self.singles.fly(self._design, i.x, i.v, i.state.R, goals, self._R_before)
        self._R_before = alone.R_c
        R_c = alone.R_c @ self._tilt if now < self._tilted_until - 1e-9 else alone.R_c
        self.last = sample._replace(A=alone.A, R_c=R_c, f=alone.f, Psi=alone.Psi)
        return self.last

    def _as_before(self, sample: Sample) -> Sample:
        """A decision that came to nothing finite, of a motion that no model knows, is not sent: the last stands.

        In the log it is that one; what it was decided from is NaN there.
        """
        if self._finite:
            self._finite = False
            self._tell("guard", "decision", "it came to nothing finite: the last one stands")
        before, system = self.last, self._design.system
        n = len(system.m)
        if before is None:
            hover = system.m * system.g
            A = np.column_stack([np.zeros((n, 2)), -hover])
            blank = sample._replace(A=A, R_c=np.tile(np.eye(3), (n, 1, 1)), f=hover, Psi=np.zeros(n))
        else:
            blank = sample._replace(A=before.A, R_c=before.R_c, f=before.f, Psi=before.Psi)
        return blank._replace(memory=self._law.first(self._design))
