"""One flight: vehicles (ours, or what is there), bridge and log put together."""

import json
import math
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from types import FrameType

from bridge.fleet.fleet import TRACKER, Fleet
from bridge.loop.deciders import PART
from bridge.loop.fly import SILENT_S, FlightParts, Outcome, Patience, fly
from bridge.loop.tick_timing import TickStatistics
from bridge.loop.time_sync import TimeSync
from bridge.mission.mission import Mission
from bridge.mission.phases import CARRIED, FLY, Phase
from bridge.wire.link import LinkError, Received
from bridge.wire.link_faults import Channel, FaultCounts, generator
from cablequad._threads import in_one_thread
from cablequad.control.control_step import Sample
from cablequad.model.controllability import controllable
from logs.writing.recorder import RecorderError
from missions.flight.options import Options, Progress
from missions.flight.processes.launch import Launch, launches, started_with
from missions.flight.processes.participants import Participants, interpreter_restored, places
from missions.flight.processes.simulate import few_collections
from missions.flight.recording.header import header_of
from missions.flight.recording.log_process import Recording
from missions.flight.setup import FlightSetup, set_up
from missions.flight.summary import Asked, Known, Summary, Track, summarize
from missions.flight.warm_up import predict_once, warm_up
from missions.scenario import flights, laws
from missions.scenario.flights import Flight
from missions.scenario.mission_setup import reported_figures
from missions.scenario.tables import BREAKING
from sitl.external.seats import BOOT_S
from sitl.settings import HOST

__all__ = ["Options", "Progress", "run"]

CONNECT_S = 15.0  # wall clock, for our own vehicles to be heard
WAITS_S = 5.0  # wall clock, between lines that say what is waited for
COMING_DOWN = frozenset({Phase.RELEASE, Phase.LAND, Phase.DISARM})  # the load stands: nothing is left to give up
SHOWN = frozenset(
    {
        "script",
        "phase",
        "pause",
        "resume",
        "abort",
        "guard",
        "lost",
        "crew",
        "stranger",
        "mishandled",
        "stall",
        "not-taken",
        "fate",
    }
)  # kinds of events that the user is told of as they come
NO_TIME = TickStatistics(0, 0, [], 0.0, [], 0)


class _DecisionSink:
    """Passes everything on to the log and keeps the figures of what was decided."""

    def __init__(self, log: Recording, track: Track, say: Callable[[str], None]) -> None:
        self.log, self.say = log, say
        self.track = track
        self.ended = False
        self.tallies: list[FaultCounts] = []  # of the faulty links to the controller
        self.received, self.sent, self.perf = log.received, log.sent, log.perf

    def decided(self, boot_us: int, sample: Sample, tension: list[float], phase: str, age_s: float) -> None:
        self.log.decided(boot_us, sample, tension, phase, age_s)
        if phase in CARRIED and not self.ended:
            self.track.decided(sample)
            self.track.tension(min(tension))

    def event(self, boot_us: int, kind: str, subject: str, text: str) -> None:
        self.log.event(boot_us, kind, subject, text)
        if kind in SHOWN:
            self.say(f"t = {boot_us * 1e-6:7.2f} s  {kind}: {text}")
        self.ended = self.ended or kind == "end"


@in_one_thread
def run(flight: Flight, options: Options, progress: Progress) -> tuple[Summary, bool]:
    """Fly; the summary, and whether the user interrupted. What goes wrong is the summary's reason, no exception."""
    if options.backend != "builtin":
        flight = without_hooks(flight)
        _starts(flight, options)  # raises where they cannot be started, before anything is said of the flight
    for note in flight.notes:
        progress.say(f"note: {note}")
    for motion in controllable(flight.system).missing:
        progress.say(f"{motion} is out of reach of the vehicles' forces; it is left out, the rest is flown")
    try:
        return _run(flight, options, progress)
    except RecorderError as error:
        return _nothing(flight, str(error)), False
    except LinkError as error:  # nothing was flown: a port is in use
        return _nothing(flight, str(error), untested=True), False


def _run(flight: Flight, options: Options, progress: Progress) -> tuple[Summary, bool]:
    with interpreter_restored(), closing(Participants(flight, options)) as p:
        progress.doing("getting ready")
        prepared = _prepare(flight, options, p, progress)
        if not options.in_process:
            progress.doing("waiting for the log's process")
        p.log.wait_ready()
        sink = _DecisionSink(p.log, _track(flight), progress.say)
        p.share_processors()
        if not options.in_process:
            progress.doing("waiting for the simulator")
        with _interrupts() as interrupted:
            if p.simulator is not None and not p.simulator.wait_ready(lambda: not interrupted()):
                reason = p.simulator.failure or "interrupted by the user"
                outcome, timing = Outcome(False, interrupted(), reason, p.simulator.untested), NO_TIME
            else:
                few_collections()
                if p.simulator is not None:
                    p.simulator.go()
                told = _Waits(progress, prepared.fleet, _patience(flight, options, p))
                outcome, timing = _fly(flight, options, p, prepared, sink, told=told, interrupted=interrupted)
        timing = timing._replace(unread=timing.unread + p.stop_simulator())
        return _summarized(flight, p, prepared.mission, sink, outcome, timing), outcome.interrupted


def _prepare(flight: Flight, options: Options, p: Participants, progress: Progress) -> FlightSetup:
    """What flies, and its log, while the others are on their way; before the vehicles' clock runs nothing compiles."""
    design = laws.design(flight)
    who = "connected" if options.connect else options.backend
    beginning = header_of(flight, design, options.out, p.lockstep, bool(options.connect), who)
    p.log.open(beginning)
    if options.live:
        p.show(beginning.path)
    warm_up(design, flight)
    predict_once(flight)
    waits = p.lockstep or p.external
    prepared = set_up(flight, design, options.configure, waits, _expected(flight, options), options.script)
    if p.external:
        folder = beginning.path.with_suffix("")
        p.start_autopilots(_starts(flight, options), folder, options.launch is not None, progress)
    return prepared


def _patience(flight: Flight, options: Options, p: Participants) -> Patience:
    connect_s = flight.scenario.link.connect_timeout_s
    if connect_s is None:  # autopilots that somebody else starts take their time
        connect_s = BOOT_S if p.asks else CONNECT_S
    stall_s = options.stall_timeout_s + p.external * 10.0  # whose physics says first who does not answer
    return Patience(connect_s, p.lockstep, p.external, p.simulator is not None, stall_s)


def _summarized(
    flight: Flight, p: Participants, mission: Mission | None, sink: "_DecisionSink", outcome: Outcome,
    timing: TickStatistics,
) -> Summary:  # fmt: skip
    """Judge the flight by its log, and close that with what came of it."""
    log, link, simulator = p.log, p.link, p.simulator
    in_order = simulator is not None and simulator.failure is None and not (outcome.interrupted or outcome.untested)
    judged = log.judged(outcome.completed or outcome.reason.startswith(PART) or (p.lockstep and in_order))
    if judged.followed is not None:  # the simulator knows every link's tension; the tracker told the load's end
        sink.track.min_tension_N = judged.smallest_tension_N
    missed = 0
    if simulator is not None and simulator.report is not None:
        missed = simulator.report.missed_deadlines + simulator.report.missed_answers
    lost = sum(link.counters.lost_from.get(place, 0) for place in timing.places)
    grounded, mark = judged.grounded, None
    if mission is not None:
        grounded, mark = grounded or reported_figures(mission), mission.figures.mark
    cut_short = mission is None and flight.trajectory.duration > flight.scenario.duration_s
    summary = summarize(
        Asked(
            flight.scenario.name, flight.scenario.acceptance, flight.script is not None, cut_short,
            len({f.vehicle for f in flight.scenario.failures if f.kind in BREAKING}),
        ),
        Known(
            sink.track, outcome, timing, sent=link.counters.sent, lost=lost, missed_deadlines=missed,
            n=len(flight.system.m), true=judged.followed, grounded=grounded, mark=mark,
        ),
    )  # fmt: skip
    wire = _wire(p, sink.tallies, timing.unread, timing.foreign)
    taken = wire["down_lost"] + wire.get("up_lost", 0)
    summary = summary._replace(wire=wire, messages_lost=summary.messages_lost + taken)
    path = log.finish({k: json.dumps(v) for k, v in summary._asdict().items() if k not in ("log", "replay")})
    if log.error is not None:
        summary = summary._replace(passed=False, reason=log.error)
    return summary._replace(log=str(path))


def without_hooks(flight: Flight) -> Flight:
    """The flight with cables that nobody can let go of: a gripper is not part of an autopilot's physics."""
    s = flight.scenario
    if s.mission is None or not s.mission.hooks:
        return flight
    return flight._replace(scenario=s.model_copy(update={"mission": s.mission.model_copy(update={"hooks": False})}))


def _starts(flight: Flight, options: Options) -> list[Launch]:
    return launches(flight, options.backend, options.launch, options.port_offset, HOST, options.speed)


def _expected(flight: Flight, options: Options) -> tuple[Mapping[str, float], ...]:
    """Parameters that each vehicle was started with, which are read back; nobody's where ours fly."""
    n = len(flight.system.m)
    if options.backend != "builtin":
        return tuple(started_with(flight, options.backend, i) for i in range(n))
    return tuple(flights.parameters_of(flight.scenario, i) for i in range(n)) if options.connect else ()


def _track(flight: Flight) -> Track:
    target, ends_there = tuple(flight.scenario.target.position_m), flight.scenario.mission is None
    return Track(target, ends_there, flight.system.n_links.tolist())


def _wire(p: Participants, tallies: list[FaultCounts], unread: int, foreign: int) -> dict[str, int]:
    """Frames on the wire, counted on both sides: down from the vehicles, up to them.

    sent = received; and with what [faults] doubled, that is what passed, was lost or still waits to be read.
    """
    link, simulator = p.link, p.simulator
    down = {
        "down_received": link.counters.received - foreign,
        "down_passed": sum(t.passed for t in tallies),
        "down_lost": sum(t.lost for t in tallies),
        "down_duplicated": sum(t.duplicated for t in tallies),
        "down_waiting": sum(t.waiting for t in tallies) + unread,
    }
    up = {"up_sent": sum(link.counters.sent_on[:-1])}  # the last port is the tracker's
    if simulator is None or simulator.report is None:
        return {**down, **up}
    r = simulator.report
    physics = {key.replace(" ", "_"): count for key, count in r.refused.items() if key.startswith("physics")}
    if physics:
        return {"down_sent": r.sent, **down, **up, **physics}
    return {
        "down_sent": r.sent, **down, **up, "up_received": r.received, "up_passed": r.passed, "up_lost": r.lost,
        "up_duplicated": r.duplicated, "up_waiting": r.waiting,
    }  # fmt: skip


def _fly(
    flight: Flight,
    options: Options,
    p: Participants,
    prepared: FlightSetup,
    sink: _DecisionSink,
    told: "_Waits",
    interrupted: Callable[[], bool],
) -> tuple[Outcome, TickStatistics]:
    fleet, mission = prepared.fleet, prepared.mission
    channels = {
        (TRACKER if i == len(flight.firmware) else i + 1): Channel[Received](
            faults, generator(flight.scenario.seed, i + 1, up=False)
        )
        for i, faults in enumerate(flight.faults_down)
        if not faults.none
    }
    watch = _Watch(flight, p, prepared, sink, told, interrupted)
    parts = FlightParts(fleet, prepared.decider, prepared.loop, sink, told.patience, TimeSync(fleet.n, TRACKER, p.asks))
    known = {} if p.asks else places(fleet.n, options.port_offset)
    outcome, timing = fly(p.link, parts, watch, channels, known, p.alive)
    if mission is not None:
        mission.close()
    sink.tallies = [channel.tally for channel in channels.values()]
    untested = outcome.untested or (p.simulator is not None and p.simulator.untested)
    return outcome._replace(interrupted=outcome.interrupted or interrupted(), untested=untested), timing


class _Watch:
    """Looks after every decision whether something ends the flight, and says how far it is."""

    def __init__(
        self, flight: Flight, p: Participants, prepared: FlightSetup, sink: _DecisionSink, told: "_Waits",
        interrupted: Callable[[], bool],
    ) -> None:  # fmt: skip
        self._duration_s, self._p, self._prepared, self._sink = flight.scenario.duration_s, p, prepared, sink
        self._told, self._interrupted = told, interrupted
        self._started: float | None = None

    def __call__(self, phase: str, sample: Sample | None, quiet_s: float) -> str | None:
        """What ends it; None while it goes on."""
        if self._interrupted():
            return "interrupted by the user"
        self._told.look(quiet_s)
        released = self._prepared.fleet.released_at is not None
        simulator = self._p.simulator
        if self._sink.log.error is not None:
            return self._sink.log.error
        if simulator is not None and simulator.failure is not None:
            return simulator.failure
        if not released and (gone := self._p.autopilot_ended()) is not None:
            return gone
        if sample is not None and (phase == FLY or (self._prepared.mission is not None and released)):
            return self._flown(phase, sample)
        return None

    def _flown(self, phase: str, sample: Sample) -> str | None:
        now = time.monotonic()
        self._started = now if self._started is None else self._started
        error, mission = math.hypot(*sample.error.x[:3].tolist()), self._prepared.mission
        self._told.progress.flown(sample.t, self._duration_s, error, sample.t / max(1e-9, now - self._started))
        if mission is None or sample.t <= self._duration_s or mission.phase in COMING_DOWN:
            return None
        late = f"the mission is not over after {self._duration_s:g} s (duration_s), in phase {phase}"
        if not mission.plan.protect:
            return late
        mission.abort(late)
        return None


class _Waits:
    """Says what is waited for before the flight begins, and when the simulator stands still."""

    def __init__(self, progress: Progress, fleet: Fleet, patience: Patience) -> None:
        self.progress, self.patience, self._fleet = progress, patience, fleet
        self._next = time.monotonic() + WAITS_S
        self._still = False

    def look(self, quiet_s: float) -> None:
        """`quiet_s`: for how long nothing came, wall clock."""
        may_stall = self.patience.lockstep or self.patience.joint
        if quiet_s > SILENT_S and not self._still and may_stall:
            self._still = True
            until = f" up to {self.patience.stall_s:g} s (--stall-timeout)"
            self.progress.say(
                f"stall: nothing from the simulator for {SILENT_S:g} s; it is alive, and waited for{until}"
            )
        elif self._still and quiet_s == 0.0:
            self._still = False
            self.progress.say("stall: the simulator goes on")
        if self._fleet.released_at is not None or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + WAITS_S
        unheard = [f"{who}: its first word" for who in self._fleet.unheard()]
        waits = unheard or self._fleet.not_ready()
        if waits:
            self.progress.doing("waiting for " + "; ".join(waits[:4]) + (" ..." if len(waits) > 4 else ""))


@contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """While inside, Ctrl-C, SIGTERM and a terminal that closes only raise a flag: a flight ends in order.

    A second Ctrl-C is a stop.
    """
    flag: list[int] = []

    def raised(number: int, _: FrameType | None) -> None:
        flag.append(number)
        if len(flag) > 1:
            raise KeyboardInterrupt

    try:
        old = {s: signal.signal(s, raised) for s in (signal.SIGINT, signal.SIGTERM)}
        if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # not under nohup
            old[signal.SIGHUP] = signal.signal(signal.SIGHUP, raised)
    except ValueError:  # not in the main thread: whoever runs us handles signals
        yield lambda: False
        return
    try:
        yield lambda: bool(flag)
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def _nothing(flight: Flight, reason: str, untested: bool = False) -> Summary:
    none = Outcome(False, False, reason, untested)
    return summarize(Asked(flight.scenario.name, flight.scenario.acceptance), Known(_track(flight), none, NO_TIME))
