"""What comes in: from whom it is taken, which ticks it completes, and in which order it is acted on."""

from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import NamedTuple

from bridge.fleet.fleet import COMPONENT, TRACKER
from bridge.fleet.sources import Sources
from bridge.loop.tick_barrier import CLOSING, TickBarrier
from bridge.loop.time_sync import ClockOffset, TimeSync
from bridge.wire.link import Link, Received
from bridge.wire.link_faults import Channel
from bridge.wire.values import Heartbeat, PayloadState, Timesync

LISTEN_S = 0.1  # wall clock, of one look
PROCESS_ANYWAY_S = 0.5  # wall clock: frames that complete no state are acted on after this long all the same
SENDER = attrgetter("system")

Channels = Mapping[int, Channel[Received]]  # by the system whose frames pass through


class Arrival(NamedTuple):
    """What one look at the link brought."""

    at: float  # s, wall clock
    tracked_us: int | None  # of the tracker's newest state, where there is one


class Inbox:
    """Frames that have come in and were not acted on yet."""

    def __init__(
        self, link: Link, sources: Sources, barrier: TickBarrier, time_sync: TimeSync, channels: Channels
    ) -> None:
        self.sources, self.barrier = sources, barrier
        self.pending: list[Received] = []
        self.tracker_us = 0  # the tracker's clock, as far as it was heard
        self.quiet_s = 0.0  # listened for in vain since a frame came; what we do ourselves is nobody's silence
        self.offsets: list[ClockOffset] = []  # found, and not told yet
        self.questions: list[Timesync] = []  # of the tracker, what time it is here; not answered yet
        self._link, self._time_sync, self._channels = link, time_sync, channels
        self._pending_since = 0.0

    def look(self, known: Callable[[Received], bool]) -> Arrival:
        """Take what has come, waiting a little for the first; `known` says whether a frame from a new place counts."""
        routes = self.sources.routes
        tracker = routes.get(TRACKER)
        begun = self._link.now()
        frames = self._link.poll(LISTEN_S, tracker[0] if tracker is not None and not self.pending else None)
        if self._link.repeated:  # the simulator waits for an answer that it has not got
            self._link.repeated = False
            self._link.resend(range(len(self._link.ports)))
        arrived = self._link.now()
        self.quiet_s = 0.0 if frames else self.quiet_s + arrived - begun  # a tick that is said again breaks no silence
        if frames and not self.pending:
            self._pending_since = arrived
        tracked: int | None = None
        heard, answers = [], []
        for frame in frames:
            if routes.get(frame.system) != (frame.port, frame.address) and not known(frame):
                continue
            heard.append(frame)
            kind = type(frame.value)
            if kind in CLOSING and frame.component == (1 if frame.system != TRACKER else COMPONENT):
                self.barrier.feed(frame.system, self._time_sync.mapped(frame.system, frame.value))
            if kind is Heartbeat:
                self.sources.heard(frame)
            elif kind is Timesync and frame.value.tc1 != 0:
                answers.append(frame)
            elif kind is Timesync and frame.system == TRACKER and frame.component == COMPONENT:
                self.questions.append(frame.value)
            elif kind is PayloadState and frame.system == TRACKER:
                tracked = frame.value.boot_us
        self.pending += heard
        self.tracker_us = max(self.tracker_us, tracked or 0)
        for frame in answers:
            self.offsets += self._time_sync.answered(frame.system, frame.value, arrived, self.tracker_us)
        return Arrival(arrived, tracked)

    def stale(self, now: float) -> bool:
        """Whether something has waited for its tick for too long, at `now` of the wall clock."""
        return bool(self.pending) and now - self._pending_since >= PROCESS_ANYWAY_S

    def take(self, now_us: int) -> list[Received]:
        """All that is to be acted on at `now_us`, once links have failed, in an order that no socket decides."""
        frames = sorted(self.pending, key=SENDER)
        self.pending = []
        if not self._channels:
            return frames
        for frame in frames:
            channel = self._channels.get(frame.system)
            if channel is not None:
                channel.put(frame, len(frame.frame), now_us)
        kept = [frame for frame in frames if frame.system not in self._channels]
        return kept + [f for _, channel in sorted(self._channels.items()) for f in channel.take(now_us)]

    def released(self, now_us: int) -> None:
        """The time of links that fail begins."""
        for channel in self._channels.values():
            channel.released_us = now_us
