"""When a tick has come: every source that lives has spoken of it, or has let a later one begin."""

from bridge.wire.values import PayloadState, VehicleAttitude, VehiclePosition
from cablequad.control.estimator import Sensing

AWAITED = 5  # periods that a silent source is waited for
REBOOT_MS = 1000  # a clock that goes back by more has begun anew
CLOSING = frozenset({VehicleAttitude, VehiclePosition, PayloadState})  # what may close a source's part of a tick


class TickBarrier:
    """Says when a tick has come: every source that lives has spoken of it, or has let a later one begin."""

    def __init__(
        self, vehicles: int, tracker: int, period_ms: int, sensing: Sensing = "full", attitude_rate: int = 1
    ) -> None:
        """With `sensing` "vehicles" a tracker is waited for only once it has spoken.

        `attitude_rate`: how often a vehicle speaks in a period.
        """
        self._beside = dict.fromkeys(range(1, vehicles + 1), 0)  # stamps in a row that are not of a tick
        self._attitude_rate = attitude_rate
        self._newest = dict.fromkeys(range(1, vehicles + 1), -1)
        if sensing != "vehicles":
            self._newest[tracker] = -1
        self._closing = VehiclePosition if sensing == "vehicles" else VehicleAttitude
        self._tracker = tracker
        self._period_ms = period_ms
        self._announced_ms = -1
        self._own_time: set[int] = set()  # sources whose stamps are not the tracker's; nobody waits for them
        self._moved = False  # whether there may be something to tell

    def feed(self, source: int, value: object) -> None:
        """Take a value that closes what `source` says of a tick."""
        if isinstance(value, self._closing) and source != self._tracker:
            stamp = value.boot_ms
        elif isinstance(value, PayloadState) and source == self._tracker:
            stamp = value.boot_us // 1000
        else:
            return
        known = source in self._newest
        if (source == self._tracker and not known) or (
            known and (stamp > self._newest[source] or stamp < self._newest[source] - REBOOT_MS)
        ):
            if source != self._tracker and self._between_ticks(source, stamp):
                return
            self._newest[source], self._moved = stamp, True

    def _between_ticks(self, source: int, stamp: int) -> bool:
        """Whether a vehicle that keeps to ticks speaks between two; who never speaks of a tick keeps its own time."""
        tracker = self._newest.get(self._tracker, -1)
        beside = tracker >= 0 and (stamp - tracker) % self._period_ms != 0
        self._beside[source] = self._beside[source] + 1 if beside else 0
        own = self._beside[source] >= self._attitude_rate
        (self._own_time.add if own else self._own_time.discard)(source)
        return beside and not own

    def open(self) -> int | None:
        """The tick (ms) that has come and was not told yet."""
        if not self._moved:
            return None
        tick = self._come()
        self._moved = tick is not None
        return tick

    def _come(self) -> int | None:
        stamps = [stamp for source, stamp in self._newest.items() if source not in self._own_time]
        if not stamps or min(self._newest.values()) < 0:
            return None
        newest = max(stamps)
        if newest <= self._announced_ms and newest > self._announced_ms - REBOOT_MS:
            return None
        late = newest - AWAITED * self._period_ms
        if all(stamp == newest for stamp in stamps if stamp > late):
            self._announced_ms = newest
            return newest
        spoken = self._newest.get(self._tracker, -1)
        gone_on = max(spoken, newest - self._period_ms)  # the tracker speaks last in a tick
        earlier = gone_on - self._period_ms
        if earlier > self._announced_ms >= 0:  # what is missing of the tick before is not coming
            self._announced_ms = earlier
            return earlier
        return None
