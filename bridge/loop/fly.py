"""The loop: one decision per measured state, on the vehicles' clock, until the plan is over or something ends it."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

from bridge.fleet.fleet import COMPONENT, SYSTEM, TRACKER, Fleet
from bridge.fleet.setpoint_batch import Setpoints, WireError
from bridge.fleet.sources import Sources
from bridge.fleet.vehicle import Request
from bridge.loop.deciders import Decider
from bridge.loop.inbox import Arrival, Channels, Inbox
from bridge.loop.state_assembly import Instant, LoopModel
from bridge.loop.thrust_comparison import ThrustComparison
from bridge.loop.tick_barrier import TickBarrier
from bridge.loop.tick_timing import TickStatistics, TickTiming
from bridge.loop.time_sync import TimeSync
from bridge.wire.link import Address, Link, Mishandled, Received
from bridge.wire.messages import encode
from bridge.wire.values import Command, CommandAck, Imu, Origin, Timesync
from cablequad.control.control_step import Sample

NAMED = 3  # parameters that a vehicle did not take, in the line that the user sees
SILENT_S = 3.0  # wall clock without a single frame
HOLD_S = 6.0  # for the vehicles to take over at the end
STALL_S = 600.0  # wall clock, that a simulator which is alive may stand still


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


class FlightParts(NamedTuple):
    """Who takes part in a flight."""

    fleet: Fleet
    decider: Decider
    loop: LoopModel
    record: Record
    patience: Patience
    time_sync: TimeSync  # what vehicles say, in the tracker's time and frame


class Outbox:
    """What goes out."""

    def __init__(self, link: Link, routes: Mapping[int, tuple[int, Address]], everyone: range) -> None:
        """`routes`: on which port, and where, a system is; `everyone`: the vehicles."""
        self._link, self._routes, self._everyone = link, routes, everyone

    def send(self, requests: list[Request], setpoints: Setpoints | None = None) -> tuple[list[int], list[bytes]]:
        """Put it on the wire: to whom, and the frames. Setpoints go out once every vehicle has been heard."""
        to: list[int] = []
        frames: list[bytes] = []
        for system, value in requests:
            message = encode(value)
            for target in (system,) if system is not None else self._everyone:
                route = self._routes.get(target)
                if route is not None:
                    to.append(target)
                    frames.append(self._link.put(route[0], SYSTEM, COMPONENT, message, route[1])[1])
        if setpoints is not None and all(target in self._routes for target in self._everyone):
            routes = [self._routes[target] for target in self._everyone]
            to += self._everyone
            frames += self._link.put_all(routes, bytes([SYSTEM]) * len(routes), COMPONENT, setpoints)
        self._link.flush()
        return to, frames

    def acknowledge(self, frame: Received, command: int, result: int) -> None:
        """Answer an operator's command where it came from."""
        ack = encode(CommandAck(command, result, frame.system, frame.component))
        self._link.put(frame.port, SYSTEM, COMPONENT, ack, frame.address)
        self._link.flush()


class _Flight:
    """The state of one call of `fly`."""

    def __init__(self, link: Link, parts: FlightParts, inbox: Inbox, outbox: Outbox) -> None:
        self.link, self.parts, self.inbox, self.outbox = link, parts, inbox, outbox
        self.timing = TickTiming(parts.loop.period_ms)
        self.thrust = ThrustComparison(parts.loop, parts.fleet.n)
        self.mishandled = Mishandled()
        self.heard: tuple[int, list[Received]] | None = None  # and when; not recorded yet, as nobody waits for that
        self.now_us = 0
        self.released = False

    @property
    def flown(self) -> float:
        """Seconds since the release on the vehicles' clock; negative before."""
        released = self.parts.fleet.released_at
        return -1.0 if released is None else self.now_us * 1e-6 - released

    def waited_s(self, begun: float) -> float:
        """Since the wall clock showed `begun`; in lockstep what the vehicles' clock shows."""
        return self.now_us * 1e-6 if self.parts.patience.lockstep else self.link.now() - begun

    def step(self) -> Sample | None:
        """Take what has come in; answer the tick that it completes, if it does."""
        arrival = self.inbox.look(self._known)
        sample, tracked = self._answer_ticks(arrival)
        self._answer_time()
        self._ask_time(arrival.at)
        stale = not self.parts.patience.lockstep and self.inbox.stale(arrival.at)
        if tracked is None and (sample is not None or not stale):
            return sample
        self.now_us = max(self.now_us, tracked or 0)
        self.process()
        self._send(self.parts.fleet.due(self.now_us * 1e-6))
        if tracked is not None:  # a simulator that waits for us may go on: nothing more will be said to this tick
            self._send([Request(TRACKER, Timesync(tracked * 1000, tracked * 1000))])
        return sample

    def _answer_ticks(self, arrival: Arrival) -> tuple[Sample | None, int | None]:
        """The last decision, and the tracker's time (us) where no decision answers it."""
        sample, tracked, decider = None, arrival.tracked_us, self.parts.decider
        boot_ms = self.inbox.barrier.open()
        while boot_ms is not None:  # more than one where a tick was left open until the next began
            self.now_us = boot_ms * 1000
            self.process()
            instant = decider.observer.estimate(boot_ms)
            if instant is None:
                self.parts.fleet.incomplete = decider.observer.incomplete()
                tracked = max(tracked or 0, self.now_us)
            else:
                sample = self._answer(instant, arrival.at)
                tracked = None if tracked == self.now_us else tracked
            boot_ms = self.inbox.barrier.open()
        return sample, tracked

    def _answer_time(self) -> None:
        """Tell the tracker what time it is here, once all that came before its question has been dealt with."""
        questions, self.inbox.questions = self.inbox.questions, []
        if questions:
            self.process()
            here_ns = max(1, self.now_us * 1000)
            self._send([Request(TRACKER, Timesync(here_ns, question.ts1)) for question in questions])

    def _ask_time(self, now: float) -> None:
        """What time every vehicle and the tracker have, in one breath."""
        question = self.parts.time_sync.due(now, self.inbox.tracker_us)
        if question is not None:
            self._send([Request(system, question) for system in sorted(self.inbox.sources.routes)])

    def _known(self, frame: Received) -> bool:
        """Whether a frame from a new place is taken in; who speaks under a vehicle's id from elsewhere is not."""
        sources, fleet = self.inbox.sources, self.parts.fleet
        taken = sources.take(frame)
        if sources.rival and not fleet.flying:
            fleet.failure = fleet.failure or sources.rival
        if said := sources.said():
            self.event("stranger", f"system {frame.system}", said)
        return taken

    def process(self) -> None:
        """Let the links' faults act, then feed everyone in an order that does not depend on which socket came first."""
        for offset in self.inbox.offsets:
            self.event("clock", f"vehicle {offset.vehicle}", offset.text())
        self.inbox.offsets = []
        frames = self.inbox.take(self.now_us)
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
        if self.parts.fleet.released_at is not None and not self.released:
            self.released = True
            what = self.parts.decider.released()
            self.inbox.released(self.now_us)
            self.event("release", "all", f"{what}: t = 0")
        self._tell_fleet()

    def _tell_fleet(self) -> None:
        """What vehicles did not take, and what they said."""
        for source, wrong in self.parts.fleet.not_taken():
            for text in wrong:
                self.event("parameter", f"vehicle {source}", text)
            some = "; ".join(wrong[:NAMED]) + (f"; and {len(wrong) - NAMED} more, in the log" * (len(wrong) > NAMED))
            self.event("not-taken", f"vehicle {source}", f"vehicle {source} did not take what it was set to: {some}")
        for source, said in self.parts.fleet.texts():
            self.event("statustext", f"vehicle {source}", said.text)

    def _feed(self, frame: Received, now: float) -> None:
        system, value, fleet = frame.system, frame.value, self.parts.fleet
        kind = type(value)
        if kind is Command and (value.system, value.component) == (SYSTEM, COMPONENT):
            self.outbox.acknowledge(frame, value.command, self.parts.decider.command(value.command, value.params))
        if self.inbox.sources.routes.get(system) != (frame.port, frame.address):
            return  # of nobody who flies here: what it measured is of something else
        fleet.feed(system, frame.component, value, now)
        if frame.component == (1 if system != TRACKER else COMPONENT):
            if kind is Origin:
                self.parts.time_sync.learn(system, value)
            value = self.parts.time_sync.mapped(system, value)
            self.parts.decider.feed(system, value)
            if kind is Imu and value is not None and fleet.flying and system <= fleet.n:
                self.thrust.take(system - 1, value)

    def record_heard(self) -> None:
        """What came in stands in the log before anything that it led to."""
        if self.heard is not None:
            self.parts.record.received(*self.heard)
            self.heard = None

    def event(self, kind: str, subject: str, text: str) -> None:
        """Something worth a line, now."""
        self.record_heard()
        self.parts.record.event(self.now_us, kind, subject, text)

    def _answer(self, instant: Instant, arrived: float) -> Sample:
        fleet, decider, record, now = self.parts.fleet, self.parts.decider, self.parts.record, instant.boot_ms * 1e-3
        decided = decider.answer(max(0.0, self.flown), now, instant)
        sample = decided.sample
        for event in decided.events:
            self.event(*event)
        setpoints: Setpoints | None = None
        try:
            setpoints = fleet.setpoints(sample, instant.boot_ms)
        except WireError as error:  # nothing that is not finite goes out; the vehicles' own failsafes take over
            fleet.failure = fleet.failure or str(error)
        fleet.observed(now, decided.gaps_m)
        self._send(fleet.due(now), setpoints)
        done = self.link.now()
        self.thrust.settle(self.now_us, decider.observer, decider.carrying)  # nobody waits for this
        record.decided(self.now_us, sample, decided.tension, decider.phase, instant.age_ms * 1e-3)
        if self.timing.answered(instant.boot_ms, instant.age_ms, arrived, fleet.flying):
            record.perf(self.now_us, done - arrived, self.timing.ticks)
        return sample

    def _send(self, requests: list[Request], setpoints: Setpoints | None = None) -> None:
        self.link.advance(self.now_us)
        to, frames = self.outbox.send(requests, setpoints)
        self.record_heard()
        if frames:
            self.parts.record.sent(self.now_us, to, frames)

    def statistics(self) -> TickStatistics:
        """What the loop measured of itself."""
        return self.timing.statistics(self.thrust.scales)


def fly(
    link: Link,
    parts: FlightParts,
    watch: Callable[[str, Sample | None, float], str | None],
    channels: Channels,
    places: Mapping[int, tuple[int, Address]] | None = None,
    alive: Callable[[], bool] = lambda: True,
) -> tuple[Outcome, TickStatistics]:
    """Bring the fleet up, fly what `decider` decides, leave every vehicle holding.

    Never raises for what vehicles or users do.
    `watch` is called after every decision with the phase, the sample (None while nothing is heard) and for how long
    nothing came (s of the wall clock); what it returns ends the run with that reason. `channels` fail the frames of the
    systems they are for. `places` says on which port and from where each system speaks, where that is known
    beforehand. `alive` says whether there is still anybody to be let go of.
    """
    fleet, decider, patience, loop = parts.fleet, parts.decider, parts.patience, parts.loop
    sources = Sources(fleet.n, places or {})
    barrier = TickBarrier(fleet.n, TRACKER, loop.period_ms, loop.sensing, loop.attitude_rate)
    inbox = Inbox(link, sources, barrier, parts.time_sync, channels)
    flight = _Flight(link, parts, inbox, Outbox(link, sources.routes, range(1, fleet.n + 1)))
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
                reason = watch(decider.phase, sample, flight.inbox.quiet_s) or ""
            if not reason and not waiting:
                untested, reason = _silence(flight)
    except KeyboardInterrupt:
        interrupted, reason = True, "interrupted by the user"
    timing = flight.statistics()
    flight.event("end", "all", reason)
    _let_go(flight, alive)
    flight.record_heard()
    timing = timing._replace(
        unread=len(inbox.pending), foreign=sources.foreign, places=frozenset(sources.routes.values())
    )
    return Outcome(completed, interrupted, reason, untested), timing


def _silence(flight: _Flight) -> tuple[bool, str]:
    """Whether a silence of all ends the flight untested, and why it ends it; nothing where it does not."""
    patience, t = flight.parts.patience, flight.now_us * 1e-6
    waits = patience.lockstep or patience.joint
    if flight.inbox.quiet_s <= (patience.stall_s if waits else SILENT_S):
        return False, ""
    if waits:
        where = f"at t = {t:.2f} s of the vehicles' clock"
        return True, f"not tested: the simulator stands still {where} for {patience.stall_s:g} s"
    if patience.simulated:
        return True, f"not tested: the computer was too slow at t = {t:.2f} s of the vehicles' clock"
    return False, f"every vehicle is silent since t = {t:.2f} s of their clock"


def _let_go(flight: _Flight, alive: Callable[[], bool]) -> None:
    """Keep answering until every vehicle holds by itself, for a bounded time."""
    fleet, link = flight.parts.fleet, flight.link
    begun, started = link.now(), flight.now_us * 1e-6
    fleet.hold(flight.now_us * 1e-6)
    first = started if flight.parts.patience.lockstep else 0.0
    try:
        while not fleet.at_rest and flight.waited_s(begun) < first + HOLD_S and not _silence(flight)[1] and alive():
            flight.step()
        if (
            not fleet.at_rest
        ):  # what half a tick said is kept where something went wrong; else a run ends on a whole one
            flight.process()
    except KeyboardInterrupt:
        return
    record_text = "every vehicle holds by itself" if fleet.at_rest else "not every vehicle confirmed that it holds"
    flight.event("hold", "all", record_text)
