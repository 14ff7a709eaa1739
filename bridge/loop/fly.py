"""The loop: one decision per measured state, on the vehicles' clock, until the plan is over or something ends it."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple, Protocol

from bridge.fleet.fleet import COMPONENT, SYSTEM, TRACKER, Fleet
from bridge.fleet.setpoint_batch import Setpoints, WireError
from bridge.fleet.sources import Sources
from bridge.fleet.thrust import ThrustScale
from bridge.fleet.vehicle import Request
from bridge.loop.deciders import Decider
from bridge.loop.state_assembly import Instant, LoopModel
from bridge.loop.thrust_comparison import ThrustComparison
from bridge.loop.tick_barrier import CLOSING, TickBarrier
from bridge.loop.time_sync import ClockOffset, TimeSync
from bridge.wire.link import Address, Link, Mishandled, Received
from bridge.wire.link_faults import Channel
from bridge.wire.messages import encode
from bridge.wire.values import Command, CommandAck, Heartbeat, Imu, Origin, PayloadState, Timesync
from cablequad.control.control_step import Sample

NAMED = 3  # parameters that a vehicle did not take, in the line that the user sees
PROCESS_ANYWAY_S = 0.5  # wall clock: frames that complete no state are acted on after this long all the same
SILENT_S = 3.0  # wall clock without a single frame
HOLD_S = 6.0  # for the vehicles to take over at the end
STALL_S = 600.0  # wall clock, that a simulator which is alive may stand still
SENDER = attrgetter("system")


class Outcome(NamedTuple):
    """How a flight ended."""

    completed: bool  # the plan was flown to its end
    interrupted: bool  # by the user
    reason: str
    untested: bool = False  # the computer, not the flight, ended it


class Patience(NamedTuple):
    """How long a flight waits for others, and by which clock."""

    connect_s: float  # until everybody has been heard
    lockstep: bool = False  # the vehicles' clock waits for us: nothing but it decides, however slow the computer is
    joint: bool = False  # it waits for autopilots, which may stall as long as they run
    simulated: bool = False  # the vehicles are a simulator's that is alive as long as nobody says otherwise
    stall_s: float = STALL_S  # wall clock without a frame, after which a simulator in lockstep is given up
    acknowledge: bool = False  # tell the tracker of every tick that was dealt with: physics behind autopilots waits


class TickStatistics(NamedTuple):
    """How the loop kept time, on the wall clock."""

    ticks: int
    missed_ticks: int  # states of the vehicles that were never answered
    intervals_s: Sequence[float]  # between the states that were answered, in flight
    flight_s: float  # wall clock from the first state answered in flight to the last
    thrust_scales: list[ThrustScale]  # of each vehicle: newtons made per newton asked
    predicted_ticks: int  # answered with a state that was not all measured
    mean_age_ms: float | None = None  # of the oldest measurement that decisions in flight rested on
    unread: int = 0  # frames that had come in when the flight ended and nobody looked at
    foreign: int = 0  # frames of others than the vehicles and the tracker, or under their ids from elsewhere
    places: frozenset[tuple[int, Address]] = frozenset()  # ports and addresses that vehicles and tracker spoke from


Channels = Mapping[int, Channel[Received]]  # by the system whose frames pass through


class Record(Protocol):
    """Where everything goes; times are microseconds of the vehicles' clock."""

    def received(self, boot_us: int, frames: list[Received]) -> None:
        """Frames that came in."""

    def sent(self, boot_us: int, to: Sequence[int], frames: list[bytes]) -> None:
        """Frames that went out, each with the system it went to."""

    def decided(self, boot_us: int, sample: Sample, tension: list[float], phase: str, age_s: float) -> None:
        """A control decision, and the age of the oldest measurement that its state rests on."""

    def event(self, boot_us: int, kind: str, subject: str, text: str) -> None:
        """Something worth a line."""

    def perf(self, boot_us: int, turnaround_s: float, ticks: int) -> None:
        """How the loop is doing."""


class _Flight:
    """The state of one call of `fly`."""

    def __init__(
        self, link: Link, fleet: Fleet, decider: Decider, loop: LoopModel, record: Record, channels: Channels,
        relation: TimeSync, places: Mapping[int, tuple[int, Address]], patience: Patience,
    ) -> None:  # fmt: skip
        self.link, self.fleet, self.decider, self.record = link, fleet, decider, record
        self.loop, self.relation, self.patience = loop, relation, patience
        self.barrier = TickBarrier(fleet.n, TRACKER, loop.period_ms, loop.sensing, loop.attitude_rate)
        self.channels = channels
        self.sources = Sources(fleet.n, places)
        self.routes = self.sources.routes
        self.mishandled = Mishandled()
        self.everyone = range(1, fleet.n + 1)
        self.pending: list[Received] = []
        self.heard: tuple[int, list[Received]] | None = None  # and when; not recorded yet, as nobody waits for that
        self.now_us = 0
        self.tracker_us = 0  # the tracker's clock, as far as it was heard
        self.quiet_s = 0.0  # listened for in vain since a frame came; what we do ourselves is nobody's silence
        self.last: tuple[int, float] | None = None
        self.started: float | None = None
        self.ticks = self.missed = self.predicted = self.ages_ms = self.aged = 0
        self.intervals = array("f")  # a long flight has millions
        self.thrust = ThrustComparison(loop, fleet.n)
        self.released = False
        self.offsets: list[ClockOffset] = []  # not yet told

    @property
    def flown(self) -> float:
        """Seconds since the release on the vehicles' clock; negative before."""
        released = self.fleet.released_at
        return -1.0 if released is None else self.now_us * 1e-6 - released

    def waited_s(self, begun: float) -> float:
        """Since the wall clock showed `begun`; in lockstep what the vehicles' clock shows."""
        return self.now_us * 1e-6 if self.patience.lockstep else self.link.now() - begun

    def step(self) -> Sample | None:
        """Take what has come in; answer the tick that it completes, if it does."""
        tracker = self.routes.get(TRACKER)
        begun = self.link.now()
        frames = self.link.poll(0.1, tracker[0] if tracker is not None and not self.pending else None)
        if self.link.repeated:  # the simulator waits for an answer that it has not got
            self.link.repeated = False
            self.link.resend(range(len(self.link.ports)))
        arrived = self.link.now()
        self.quiet_s = 0.0 if frames else self.quiet_s + arrived - begun  # a tick that is said again breaks no silence
        if frames and not self.pending:
            self.pending_since = arrived
        tracked: int | None = None
        heard = []
        answers = []
        for frame in frames:
            if self.routes.get(frame.system) != (frame.port, frame.address) and not self._known(frame):
                continue
            heard.append(frame)
            kind = type(frame.value)
            if kind in CLOSING and frame.component == (1 if frame.system != TRACKER else COMPONENT):
                self.barrier.feed(frame.system, self.relation.mapped(frame.system, frame.value))
            if kind is Heartbeat:
                self.sources.heard(frame)
            elif kind is Timesync:
                answers.append(frame)
            elif kind is PayloadState and frame.system == TRACKER:
                tracked = frame.value.boot_us
        self.pending += heard
        self.tracker_us = max(self.tracker_us, tracked or 0)
        for frame in answers:
            self.offsets += self.relation.answered(frame.system, frame.value, arrived, self.tracker_us)
        boot_ms = self.barrier.open()
        sample = None
        while boot_ms is not None:  # more than one where a tick was left open until the next began
            self.now_us = boot_ms * 1000
            self._process()
            instant = self.decider.observer.estimate(boot_ms)
            if instant is None:
                self.fleet.incomplete = self.decider.observer.incomplete()
                tracked = max(tracked or 0, self.now_us)
            else:
                sample = self._answer(instant, arrived)
                tracked = None if tracked == self.now_us and not self.patience.acknowledge else tracked
            boot_ms = self.barrier.open()
        self._ask_time(arrived)
        slow = not self.patience.lockstep and bool(self.pending)
        stale = slow and arrived - self.pending_since >= PROCESS_ANYWAY_S
        if tracked is None and (sample is not None or not stale):
            return sample
        self.now_us = max(self.now_us, tracked or 0)
        self._process()
        self._send(self.fleet.due(self.now_us * 1e-6))
        if tracked is not None:  # a simulator that waits for us may go on: nothing more will be said to this tick
            self._send([Request(TRACKER, Timesync(tracked * 1000, tracked * 1000))])
        return sample

    def _ask_time(self, now: float) -> None:
        """What time every vehicle and the tracker have, in one breath."""
        question = self.relation.due(now, self.tracker_us)
        if question is not None:
            self._send([Request(system, question) for system in sorted(self.routes)])

    def _known(self, frame: Received) -> bool:
        """Whether a frame from a new place is taken in; who speaks under a vehicle's id from elsewhere is not."""
        taken = self.sources.take(frame)
        if self.sources.rival and not self.fleet.flying:
            self.fleet.failure = self.fleet.failure or self.sources.rival
        if said := self.sources.said():
            self.event("stranger", f"system {frame.system}", said)
        return taken

    def _process(self) -> None:
        """Let the links' faults act, then feed everyone in an order that does not depend on which socket came first."""
        frames = sorted(self.pending, key=SENDER)
        self.pending = []
        for related in self.offsets:
            self.event("clock", f"vehicle {related.vehicle}", related.text())
        self.offsets = []
        if self.channels:
            for frame in frames:
                channel = self.channels.get(frame.system)
                if channel is not None:
                    channel.put(frame, len(frame.frame), self.now_us)
            kept = [frame for frame in frames if frame.system not in self.channels]
            frames = kept + [f for _, channel in sorted(self.channels.items()) for f in channel.take(self.now_us)]
        now = self.now_us * 1e-6
        for frame in frames:
            if frame.value is not None:
                try:
                    self._feed(frame, now)
                except Exception as error:
                    if text := self.mishandled.take(frame, error):
                        self.event("mishandled", "controller", text)
        if frames:
            self.record_heard()
            self.heard = (self.now_us, frames)
        if self.fleet.released_at is not None and not self.released:
            self.released = True
            what = self.decider.released()
            for channel in self.channels.values():
                channel.released_us = self.now_us
            self.event("release", "all", f"{what}: t = 0")
        for source, wrong in self.fleet.not_taken():
            for text in wrong:
                self.event("parameter", f"vehicle {source}", text)
            some = "; ".join(wrong[:NAMED]) + (f"; and {len(wrong) - NAMED} more, in the log" * (len(wrong) > NAMED))
            self.event("not-taken", f"vehicle {source}", f"vehicle {source} did not take what it was set to: {some}")
        for source, said in self.fleet.texts():
            self.event("statustext", f"vehicle {source}", said.text)

    def _feed(self, frame: Received, now: float) -> None:
        system, value = frame.system, frame.value
        kind = type(value)
        if kind is Command and (value.system, value.component) == (SYSTEM, COMPONENT):
            self._told(frame, value)
        if self.routes.get(system) != (frame.port, frame.address):
            return  # of nobody who flies here: what it measured is of something else
        self.fleet.feed(system, frame.component, value, now)
        if frame.component == (1 if system != TRACKER else COMPONENT):
            if kind is Origin:
                self.relation.learn(system, value)
            value = self.relation.mapped(system, value)
            self.decider.feed(system, value)
            if kind is Imu and value is not None and self.fleet.flying and system <= self.fleet.n:
                self.thrust.take(system - 1, value)

    def record_heard(self) -> None:
        """What came in stands in the log before anything that it led to."""
        if self.heard is not None:
            self.record.received(*self.heard)
            self.heard = None

    def event(self, kind: str, subject: str, text: str) -> None:
        """Something worth a line, now."""
        self.record_heard()
        self.record.event(self.now_us, kind, subject, text)

    def _told(self, frame: Received, value: Command) -> None:
        """An operator's command to this controller: a mission obeys some, a plan none."""
        result = self.decider.command(value.command, value.params)
        ack = encode(CommandAck(value.command, result, frame.system, frame.component))
        self.link.put(frame.port, SYSTEM, COMPONENT, ack, frame.address)
        self.link.flush()

    def _answer(self, instant: Instant, arrived: float) -> Sample:
        now = instant.boot_ms * 1e-3
        t = max(0.0, self.flown)
        decided = self.decider.answer(t, now, instant)
        sample = decided.sample
        for event in decided.events:
            self.event(*event)
        setpoints: Setpoints | None = None
        try:
            setpoints = self.fleet.setpoints(sample, instant.boot_ms)
        except WireError as error:  # nothing that is not finite goes out; the vehicles' own failsafes take over
            self.fleet.failure = self.fleet.failure or str(error)
        self.fleet.observed(now, decided.gaps_m)
        self._send(self.fleet.due(now), setpoints)
        done = self.link.now()
        self.thrust.settle(self.now_us, self.decider.observer, self.decider.carrying)  # nobody waits for this
        self.record.decided(self.now_us, sample, decided.tension, self.decider.phase, instant.age_ms * 1e-3)
        self.predicted += instant.age_ms > 0 and self.fleet.flying
        if self.fleet.flying:
            self.ages_ms += instant.age_ms
            self.aged += 1
        self._time(instant.boot_ms, arrived, done)
        return sample

    def _send(self, requests: list[Request], setpoints: Setpoints | None = None) -> None:
        to: list[int] = []
        frames: list[bytes] = []
        for system, value in requests:
            message = encode(value)
            for target in (system,) if system is not None else self.everyone:
                route = self.routes.get(target)
                if route is not None:
                    to.append(target)
                    frames.append(self.link.put(route[0], SYSTEM, COMPONENT, message, route[1])[1])
        if setpoints is not None and all(target in self.routes for target in self.everyone):
            routes = [self.routes[target] for target in self.everyone]
            to += self.everyone
            frames += self.link.put_all(routes, bytes([SYSTEM]) * len(routes), COMPONENT, setpoints)
        self.link.flush()
        self.record_heard()
        if frames:
            self.record.sent(self.now_us, to, frames)

    def _time(self, boot_ms: int, arrived: float, done: float) -> None:
        self.ticks += 1
        if self.fleet.flying and self.started is None:
            self.started = arrived
        elif self.fleet.flying and self.last is not None:
            self.missed += max(0, (boot_ms - self.last[0]) // self.loop.period_ms - 1)
            self.intervals.append(arrived - self.last[1])
        self.last = (boot_ms, arrived)
        if self.ticks % max(1, 1000 // self.loop.period_ms) == 0:
            self.record.perf(self.now_us, done - arrived, self.ticks)

    def timing(self) -> TickStatistics:
        """What the loop measured of itself."""
        flight = 0.0 if self.started is None or self.last is None else self.last[1] - self.started
        age = self.ages_ms / self.aged if self.aged else None
        return TickStatistics(self.ticks, self.missed, self.intervals, flight, self.thrust.scales, self.predicted, age)


def fly(
    link: Link,
    fleet: Fleet,
    decider: Decider,
    loop: LoopModel,
    record: Record,
    patience: Patience,
    watch: Callable[[str, Sample | None, float], str | None],
    channels: Channels,
    relation: TimeSync,
    places: Mapping[int, tuple[int, Address]] | None = None,
    alive: Callable[[], bool] = lambda: True,
) -> tuple[Outcome, TickStatistics]:
    """Bring the fleet up, fly what `decider` decides, leave every vehicle holding.

    Never raises for what vehicles or users do.
    `watch` is called after every decision with the phase, the sample (None while nothing is heard) and for how long
    nothing came (s of the wall clock); what it returns ends the run with that reason. `channels` fail the frames of the
    systems they are for, `relation` maps what vehicles say into the tracker's time and frame. `places` says on which
    port and from where each system speaks, where that is known beforehand. `alive` says whether there is still anybody
    to be let go of.
    """
    flight = _Flight(link, fleet, decider, loop, record, channels, relation, places or {}, patience)
    begun = link.now()
    interrupted, completed, untested, reason = False, False, False, ""
    try:
        while not reason:
            sample = flight.step()
            ended = decider.over(sample)
            waiting = fleet.unheard()
            if waiting and flight.waited_s(begun) > patience.connect_s:
                who = ", ".join(waiting)
                reason = f"{who}: nothing heard within {patience.connect_s:g} s; is it running and sending here?"
            elif fleet.failure is not None:
                reason = fleet.failure
            elif ended is not None:
                completed, reason = ended
            else:
                reason = watch(decider.phase, sample, flight.quiet_s) or ""
            if not reason and not waiting:
                untested, reason = _silence(flight)
    except KeyboardInterrupt:
        interrupted, reason = True, "interrupted by the user"
    timing = flight.timing()
    flight.event("end", "all", reason)
    _let_go(flight, alive)
    flight.record_heard()
    timing = timing._replace(
        unread=len(flight.pending), foreign=flight.sources.foreign, places=frozenset(flight.routes.values())
    )
    return Outcome(completed, interrupted, reason, untested), timing


def _silence(flight: _Flight) -> tuple[bool, str]:
    """Whether a silence of all ends the flight untested, and why it ends it; nothing where it does not."""
    patience, t = flight.patience, flight.now_us * 1e-6
    waits = patience.lockstep or patience.joint
    if flight.quiet_s <= (patience.stall_s if waits else SILENT_S):
        return False, ""
    if waits:
        where = f"at t = {t:.2f} s of the vehicles' clock"
        return True, f"not tested: the simulator stands still {where} for {patience.stall_s:g} s"
    if patience.simulated:
        return True, f"not tested: the computer was too slow at t = {t:.2f} s of the vehicles' clock"
    return False, f"every vehicle is silent since t = {t:.2f} s of their clock"


def _let_go(flight: _Flight, alive: Callable[[], bool]) -> None:
    """Keep answering until every vehicle holds by itself, for a bounded time."""
    fleet, link = flight.fleet, flight.link
    begun, started = link.now(), flight.now_us * 1e-6
    fleet.hold(flight.now_us * 1e-6)
    first = started if flight.patience.lockstep else 0.0
    try:
        while not fleet.at_rest and flight.waited_s(begun) < first + HOLD_S and not _silence(flight)[1] and alive():
            flight.step()
        if (
            not fleet.at_rest
        ):  # what half a tick said is kept where something went wrong; else a run ends on a whole one
            flight._process()
    except KeyboardInterrupt:
        return
    record_text = "every vehicle holds by itself" if fleet.at_rest else "not every vehicle confirmed that it holds"
    flight.event("hold", "all", record_text)
