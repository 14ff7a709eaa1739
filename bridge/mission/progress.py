"""How far a mission has come: the phase, how long it has lasted, and what was seen in it so far."""

import math

import numpy as np

from bridge.mission.phases import Phase
from bridge.mission.plan_clock import PlanClock
from bridge.mission.scale import USUAL, Scale
from bridge.mission.touch_down import TouchDown
from cablequad.types import Array

STILL_S = 0.5


class Progress:
    """The phase of a mission and its clocks."""

    def __init__(self, period_s: float, scale: Scale = USUAL) -> None:
        self._scale = scale
        self.phase: Phase | None = None
        self.done = False
        self.now = 0.0  # s of the vehicles' clock
        self.clock = PlanClock(period_s)
        self.entered = 0.0  # s, when the phase began, later by as long as the plan's clock stood
        self.touch_down = TouchDown(scale.pushed_m)  # of those that land
        self.touched_at: float | None = None  # s, when all stood that land
        self.overdue = False  # the phase has lasted too long once
        self.taking = False  # what hangs on the vehicles is on its way from one to the other
        self._still_since: float | None = None

    def enter(self, phase: Phase) -> None:
        """A phase begins."""
        self.phase, self.done, self.entered, self.clock.time, self._still_since = phase, False, self.now, 0.0, None
        self.overdue = False

    def restart(self) -> None:
        """The phase goes on, and its time begins anew."""
        self.entered, self.done = self.now, False

    def tick(self, now: float) -> None:
        """A period passes."""
        self.now = now
        self.entered += self.clock.tick()

    @property
    def lasted_s(self) -> float:
        """Since the phase began, less what the plan's clock stood."""
        return self.now - self.entered

    def at_rest(self, off_m: float, v: Array) -> bool:
        """Whether everything has been near and slow for a while."""
        far = off_m > self._scale.near_m or float(np.linalg.norm(v, axis=-1).max()) > self._scale.slow_m_s
        return self.lasting(not far, STILL_S)

    def lasting(self, holds: bool, seconds: float) -> bool:
        """Whether something has held for so long."""
        if not holds:
            self._still_since = None
            return False
        self._still_since = self.now if self._still_since is None else self._still_since
        return self.now - self._still_since >= seconds


class Figures:
    """What a mission is judged by."""

    def __init__(self) -> None:
        self.largest_tension_N = 0.0
        self.smallest_separation_m = math.inf
        self.touch_down_m_s: float | None = None
        self.mark: tuple[float, float] | None = None  # m: where the load was to be set down last
