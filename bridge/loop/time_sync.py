"""Vehicles that keep their own time and their own origin, related to the tracker's.

Their clocks: TIMESYNC goes to a vehicle and to the tracker in one breath; what both answer was read within that round
trip, which bounds the difference of their clocks. Bounds of many round trips are intersected. A clock that cannot be
told from the tracker's is taken for it. Their origins: GPS_GLOBAL_ORIGIN of each against that of the tracker.
"""

import math
from typing import Any, NamedTuple

from bridge.wire.values import Imu, Origin, Timesync, VehicleAttitude, VehiclePosition
from cablequad.model.earth import Home, local
from cablequad.types import Array

ASK_S, ASK_LATER_S, SETTLED = 0.1, 1.0, 20  # wall clock; round trips until it is asked less often
ENOUGH = 5  # round trips
STEP_NS = 5_000_000  # simulated clocks go in steps: what one tells may be as old as its step
SLOW_NS = 200_000_000  # a round trip that tells nothing
ORIGIN_MS = 5_000  # that a vehicle's origin is waited for
BREATHS = 16  # questions that are remembered


class _Clock:
    """One vehicle's clock minus the tracker's, ns: bounds, and what is made of them."""

    def __init__(self) -> None:
        self.low, self.high = -math.inf, math.inf
        self.pairs = 0
        self.offset_ms: int | None = None

    def narrow(self, difference: int, within: int) -> bool:
        """One more round trip; whether what is made of them all changed."""
        self.low, self.high = max(self.low, difference - within), min(self.high, difference + within)
        if self.low > self.high:  # it was set, or drifted
            self.low, self.high, self.pairs = difference - within, difference + within, 0
        self.pairs += 1
        if self.pairs < ENOUGH:
            return False
        before = self.offset_ms
        if self.low <= 0 <= self.high:
            self.offset_ms = 0
        elif before is None or not self.low <= before * 1e6 <= self.high:
            self.offset_ms = round((self.low + self.high) / 2e6)
        return self.offset_ms != before


class ClockOffset(NamedTuple):
    """Something that became known of a vehicle's clock."""

    vehicle: int  # system id
    offset_ms: int  # its clock minus the tracker's

    def text(self) -> str:
        """As it stands in the log."""
        return f"offset_ms={self.offset_ms}"

    @classmethod
    def read(cls, subject: str, text: str) -> "ClockOffset":
        """What `text` says of a vehicle."""
        return cls(int(subject.split()[-1]), int(text.partition("=")[2]))


class TimeSync:
    """Maps what vehicles say into the tracker's time and frame."""

    def __init__(self, vehicles: int, tracker: int, asks: bool) -> None:
        """`asks`: whether clocks are to be found; else every vehicle's is the tracker's."""
        self._tracker = tracker
        self.asks = asks
        self._clocks = {k: _Clock() for k in range(1, vehicles + 1)}
        self._answers: dict[int, dict[int, tuple[int, int]]] = {}  # asked at -> system -> (answered, round trip), ns
        self._simulated: dict[int, int] = {}  # asked at -> the tracker's clock then, us
        self._next = 0.0
        self._origins: dict[int, Origin] = {}
        self._shifts: dict[int, Array] = {}
        self._positions_since: dict[int, int] = {}  # ms of the vehicle's clock
        if not asks:
            for clock in self._clocks.values():
                clock.offset_ms = 0

    def due(self, now: float, tracker_us: int) -> Timesync | None:
        """What to ask every vehicle and the tracker at `now`, s of the wall clock, `tracker_us` of the tracker's."""
        if not self.asks or now < self._next:
            return None
        settled = all(clock.pairs >= SETTLED for clock in self._clocks.values())
        self._next = now + (ASK_LATER_S if settled else ASK_S)
        asked = round(now * 1e9)
        self._answers[asked], self._simulated[asked] = {}, tracker_us
        while len(self._answers) > BREATHS:
            oldest = min(self._answers)
            del self._answers[oldest], self._simulated[oldest]
        return Timesync(0, asked)

    def answered(self, system: int, value: Timesync, now: float, tracker_us: int) -> list[ClockOffset]:
        """Take an answer that came at `now`, when the tracker's clock showed `tracker_us`; what it makes known.

        Simulated clocks may run faster than the wall clock, where they make up for a pause: both answers were given
        within the round trip, by whichever clock it took longer.
        """
        answers = self._answers.get(value.ts1)
        if value.tc1 == 0 or answers is None or system in answers:
            return []
        simulated_ns = (tracker_us - self._simulated[value.ts1]) * 1000 + STEP_NS
        answers[system] = (value.tc1, max(round(now * 1e9) - value.ts1, simulated_ns))
        if self._tracker not in answers:
            return []
        out = []
        for k in list(answers) if system == self._tracker else [system]:
            within = max(answers[k][1], answers[self._tracker][1]) + STEP_NS
            if (
                k in self._clocks
                and within < SLOW_NS
                and self._clocks[k].narrow(answers[k][0] - answers[self._tracker][0], within)
            ):
                out.append(ClockOffset(k, self._clocks[k].offset_ms or 0))
        return out

    def set(self, offset: ClockOffset) -> None:
        """What a log says was known."""
        self._clocks[offset.vehicle].offset_ms = offset.offset_ms

    def learn(self, system: int, value: Any) -> None:
        """Take what is told of origins."""
        if isinstance(value, Origin) and value != self._origins.get(system):
            self._origins[system] = value
            here = self._origins.get(self._tracker)
            for k in self._clocks:
                there = self._origins.get(k)
                if here is not None and there is not None and there != here:
                    self._shifts[k] = local(Home(*here), *there)
                else:
                    self._shifts.pop(k, None)

    def mapped(self, system: int, value: Any) -> Any:
        """`value` in the tracker's time and frame; None while the vehicle's clock is not known."""
        if not self.asks and not self._shifts:
            return value
        clock = self._clocks.get(system)
        if clock is None or not isinstance(value, VehicleAttitude | VehiclePosition | Imu):
            return value
        if clock.offset_ms is None:
            return None
        if clock.offset_ms:
            if isinstance(value, Imu):
                value = value._replace(boot_us=value.boot_us - 1000 * clock.offset_ms)
            else:
                value = value._replace(boot_ms=value.boot_ms - clock.offset_ms)
        if self.asks and isinstance(value, VehiclePosition) and system not in self._origins:
            since = self._positions_since.setdefault(system, value.boot_ms)
            if value.boot_ms - since < ORIGIN_MS:
                return None  # nobody knows yet from where; one that never says is taken to share ours
        if isinstance(value, VehiclePosition) and system in self._shifts:
            value = value._replace(x=value.x + self._shifts[system])
        return value
