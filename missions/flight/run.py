"""One flight: vehicles (ours, or what is there), bridge and log put together."""

import gc
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np

from bridge.fleet.fleet import TRACKER, Fleet
from bridge.fleet.setpoint_batch import Setpoints
from bridge.loop.deciders import PART
from bridge.loop.fly import SILENT_S, STALL_S, Outcome, Patience, TickStatistics, fly
from bridge.loop.time_sync import TimeSync
from bridge.mission.phases import CARRIED, FLY
from bridge.wire.frames import Signer
from bridge.wire.link import Address, Endpoint, Link, LinkError, Received
from bridge.wire.link_faults import Channel, FaultCounts, generator
from bridge.wire.memory import MemoryNetwork
from bridge.wire.messages import encode as encode_message
from bridge.wire.messages import reread
from bridge.wire.ports import TRACKER_PORTS, vehicle_ports
from bridge.wire.values import PayloadState, VehicleAttitude
from cablequad.control.control_step import Measurement, Sample
from cablequad.control.design import Design
from cablequad.control.estimator import Belief, corrected, first_belief, nothing_measured, predicted
from cablequad.control.single_vehicle import Goals, fly_each, integrated
from cablequad.control.trajectory import at
from cablequad.model import lie
from cablequad.model.attitude import Setpoint, flown
from cablequad.model.controllability import controllable
from cablequad.model.state import measured, positions
from logs.writing.recorder import RecorderError
from missions.flight.in_process import InProcessLog, InProcessSimulator
from missions.flight.launch import Autopilots, Launch, launches, start_lines, started_with
from missions.flight.live_viewer import Show
from missions.flight.recording.header import opening
from missions.flight.recording.log_process import LogProcess, Recording
from missions.flight.setup import FlightSetup, set_up
from missions.flight.simulate import Backend, Serving, Simulator, few_collections, pin, settings
from missions.flight.summary import Summary, Track, summarize
from missions.scenario import loading as scenarios
from missions.scenario.loading import Flight
from missions.scenario.mission_setup import felt
from sitl.external.joint import BOOT_S
from sitl.settings import HOST

SWITCH_S = 0.0005  # the writer thread gives the interpreter back to the control loop this often


CONNECT_S = 15.0  # wall clock, for our own vehicles to be heard
WAITS_S = 5.0  # wall clock, between lines that say what is waited for
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


@dataclass(frozen=True)
class Options:
    """How to fly."""

    connect: tuple[Endpoint, ...] = ()
    out: Path = Path("runs")
    speed: float = math.inf  # inf: lockstep, as fast as the machine allows
    port_offset: int = 0
    configure: bool = True  # set the parameters that a vehicle needs to be flown
    signing_key: bytes | None = None
    accept_unsigned_telemetry: bool = False
    live: bool = False  # shown in the viewer that is open
    backend: Backend = "builtin"  # who flies the vehicles
    launch: Path | None = None  # the autopilots' binary or build folder; None: somebody else starts them
    in_process: bool = False  # vehicles and log in this process and thread, joined in memory
    stall_timeout_s: float = STALL_S  # wall clock, that a simulator in lockstep may stand still


class Progress:
    """What a flight tells while it goes on; the base class is silent."""

    def say(self, text: str) -> None:
        """A line for the user."""

    def doing(self, text: str) -> None:
        """What is being done, or waited for, until something else is."""

    def flown(self, t: float, duration: float, error_m: float, factor: float) -> None:
        """How far the flight is."""


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
    n = len(flight.system.m)
    key = options.signing_key
    signer = Signer(key, options.accept_unsigned_telemetry) if key is not None else None
    network = MemoryNetwork() if options.in_process else None
    link = Link(endpoints(n, options), signer, network)
    simulator: Simulator | InProcessSimulator | None = None
    log: Recording | None = None
    processors = os.sched_getaffinity(0) if sys.platform == "linux" else set()
    before, thresholds = sys.getswitchinterval(), gc.get_threshold()
    show: Show | None = None
    autopilots: Autopilots | None = None
    try:
        external = options.backend != "builtin"
        lockstep = math.isinf(options.speed) and not options.connect and not external
        link.reliable = lockstep and network is None
        connect_s = flight.scenario.link.connect_timeout_s
        if connect_s is None:  # autopilots that somebody else starts take their time
            connect_s = BOOT_S if external or options.connect else CONNECT_S
        who = "connected" if options.connect else options.backend
        log = LogProcess() if network is None else InProcessLog()
        starts = _starts(flight, options) if external else []
        if not options.connect:
            serving = Serving(
                lockstep=lockstep, await_controller=True, speed=options.speed, backend=options.backend,
                port_offset=options.port_offset, signing_key=key,
                accept_unsigned_telemetry=options.accept_unsigned_telemetry, stall_s=options.stall_timeout_s,
            )  # fmt: skip
            if isinstance(log, LogProcess):
                simulator = Simulator(settings(flight, serving), log.truth_end)
            elif network is not None and isinstance(log, InProcessLog):
                simulator = InProcessSimulator(settings(flight, serving), log.truth_end, network)
                link.go_on = simulator.go_on
        progress.doing("getting ready (a first start compiles the model: minutes)")
        design = scenarios.design(flight)  # while the others are on their way
        beginning = opening(flight, design, options.out, lockstep, bool(options.connect), who)
        log.open(beginning)
        if options.live:
            show = Show(beginning.path)
        _warm_up(design, flight)  # before the vehicles' clock runs: it does not wait for a compiler
        predict_once(flight)
        prepared = set_up(flight, design, options.configure, lockstep or external, _expected(flight, options))
        if external and options.launch is not None:
            autopilots = Autopilots(starts, beginning.path.with_suffix(""))
        elif external:
            progress.say("start the autopilots:")
            for line in start_lines(starts, beginning.path.with_suffix("")):
                progress.say(f"  {line}")
        if network is None:
            progress.doing("waiting for the log's process")
        log.wait_ready()
        sink = _DecisionSink(log, _track(flight), progress.say)
        if isinstance(simulator, Simulator):
            sys.setswitchinterval(SWITCH_S)
            if lockstep:
                pin(-2)
        if network is None:
            progress.doing("waiting for the simulator (a first start compiles the model)")
        with _interrupts() as interrupted:
            if simulator is not None and not simulator.wait_ready(lambda: not interrupted()):
                reason = simulator.failure or "interrupted by the user"
                outcome = Outcome(False, interrupted(), reason, simulator.untested)
                timing = NO_TIME
            else:
                few_collections()
                if simulator is not None:
                    simulator.go()
                stall_s = options.stall_timeout_s + external * 10.0  # whose physics says first who does not answer
                patience = Patience(
                    connect_s, lockstep, external, simulator is not None, stall_s, external or bool(options.connect)
                )
                outcome, timing = _fly(
                    flight, prepared, link, sink, simulator, interrupted, progress,
                    patience,
                    external or bool(options.connect), lambda: None if autopilots is None else autopilots.ended(),
                    options.port_offset,
                )  # fmt: skip
        if simulator is not None:
            simulator.stop()
            while after := link.poll(0.0):  # what was still on its way is counted too
                timing = timing._replace(unread=timing.unread + len(after))
        judged = log.judged(outcome.completed or outcome.reason.startswith(PART))
        if judged.followed is not None:  # the simulator knows every link's tension; the tracker told the load's end
            sink.track.min_tension_N = judged.smallest_tension_N
        missed = 0
        if simulator is not None and simulator.report is not None:
            missed = simulator.report.missed_deadlines + simulator.report.missed_answers
        lost = sum(link.counters.lost_from.get(place, 0) for place in timing.places)
        mission = prepared.mission
        grounded, mark = judged.grounded, None
        if mission is not None:
            grounded, mark = grounded or felt(mission), mission.figures.mark
        summary = summarize(
            flight.scenario.name, flight.scenario.acceptance, sink.track, outcome, timing,
            link.counters.sent, lost, missed, n, judged.followed, grounded, mark,
            flight.script is not None, mission is None and flight.trajectory.duration > flight.scenario.duration_s,
        )  # fmt: skip
        wire = _wire(link, simulator, sink.tallies, timing.unread, timing.foreign)
        taken = wire["down_lost"] + wire.get("up_lost", 0)
        summary = summary._replace(wire=wire, messages_lost=summary.messages_lost + taken)
        path = log.finish({k: json.dumps(v) for k, v in summary._asdict().items() if k not in ("log", "replay")})
        if log.error is not None:
            summary = summary._replace(passed=False, reason=log.error)
        return summary._replace(log=str(path)), outcome.interrupted
    finally:
        sys.setswitchinterval(before)
        if sys.platform == "linux":
            os.sched_setaffinity(0, processors)
        gc.set_threshold(*thresholds)
        gc.unfreeze()
        if simulator is not None:
            simulator.stop()
        if log is not None:
            log.close()
        if show is not None:
            show.close()
        if autopilots is not None:
            autopilots.stop()
        link.close()


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
    return tuple(scenarios.parameters_of(flight.scenario, i) for i in range(n)) if options.connect else ()


def _track(flight: Flight) -> Track:
    return Track(tuple(flight.scenario.target.position_m), flight.scenario.mission is None)


def _wire(
    link: Link, simulator: Simulator | InProcessSimulator | None, tallies: list[FaultCounts], unread: int, foreign: int
) -> dict[str, int]:
    """Frames on the wire, counted on both sides: down from the vehicles, up to them.

    sent = received; and with what [faults] doubled, that is what passed, was lost or still waits to be read.
    """
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
    prepared: FlightSetup,
    link: Link,
    sink: _DecisionSink,
    simulator: Simulator | InProcessSimulator | None,
    interrupted: Callable[[], bool],
    progress: Progress,
    patience: Patience,
    asks: bool,
    ended: Callable[[], str | None],
    port_offset: int,
) -> tuple[Outcome, TickStatistics]:
    """`asks`: vehicles may have clocks of their own. `ended` says which autopilot of ours has ended by itself."""
    s = flight.scenario
    fleet, mission = prepared.fleet, prepared.mission
    channels = {
        (TRACKER if i == len(flight.firmware) else i + 1): Channel[Received](faults, generator(s.seed, i + 1, up=False))
        for i, faults in enumerate(flight.faults_down)
        if not faults.none
    }
    started: list[float] = []

    told = _Waits(progress, fleet, patience)

    def look(phase: str, sample: Sample | None, quiet_s: float) -> str | None:
        if interrupted():
            return "interrupted by the user"
        told.look(quiet_s)
        if sink.log.error is not None:
            return sink.log.error
        if simulator is not None and simulator.failure is not None:
            return simulator.failure
        if fleet.released_at is None and (gone := ended()) is not None:
            return gone
        if sample is not None and (phase == FLY or (mission is not None and fleet.released_at is not None)):
            now = time.monotonic()
            if not started:
                started.append(now)
            error = math.hypot(*sample.error.x[:3].tolist())
            progress.flown(sample.t, s.duration_s, error, sample.t / max(1e-9, now - started[0]))
            if mission is not None and sample.t > s.duration_s:
                late = f"the mission is not over after {s.duration_s:g} s (duration_s), in phase {phase}"
                if not mission.plan.protect:
                    return late
                mission.abort(late)
        return None

    relation = TimeSync(fleet.n, TRACKER, asks)
    outcome, timing = fly(
        link, fleet, prepared.decider, prepared.loop, sink, patience, look, channels, relation,
        {} if asks else _places(fleet.n, port_offset), lambda: simulator is None or simulator.failure is None,
    )  # fmt: skip
    if mission is not None:
        mission.close()
    sink.tallies = [channel.tally for channel in channels.values()]
    untested = outcome.untested or (simulator is not None and simulator.untested)
    return outcome._replace(interrupted=outcome.interrupted or interrupted(), untested=untested), timing


class _Waits:
    """Says what is waited for before the flight begins, and when the simulator stands still."""

    def __init__(self, progress: Progress, fleet: Fleet, patience: Patience) -> None:
        self._progress, self._fleet, self._patience = progress, fleet, patience
        self._next = time.monotonic() + WAITS_S
        self._still = False

    def look(self, quiet_s: float) -> None:
        """`quiet_s`: for how long nothing came, wall clock."""
        may_stall = self._patience.lockstep or self._patience.joint
        if quiet_s > SILENT_S and not self._still and may_stall:
            self._still = True
            until = f" up to {self._patience.stall_s:g} s (--stall-timeout)"
            self._progress.say(
                f"stall: nothing from the simulator for {SILENT_S:g} s; it is alive, and waited for{until}"
            )
        elif self._still and quiet_s == 0.0:
            self._still = False
            self._progress.say("stall: the simulator goes on")
        if self._fleet.released_at is not None or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + WAITS_S
        unheard = [f"{who}: its first word" for who in self._fleet.unheard()]
        waits = unheard or self._fleet.not_ready()
        if waits:
            self._progress.doing("waiting for " + "; ".join(waits[:4]) + (" ..." if len(waits) > 4 else ""))


def endpoints(n: int, options: Options) -> list[Endpoint]:
    """Where the controller listens for n vehicles and the tracker."""
    if options.connect:
        return list(options.connect)
    ports = [*(vehicle_ports(i)[0] for i in range(n)), TRACKER_PORTS[0]]
    return [Endpoint((HOST, port + options.port_offset), None) for port in ports]


def _places(n: int, port_offset: int) -> dict[int, tuple[int, Address]]:
    """On which of our ports, and from where, our own vehicles and their tracker speak."""
    ports = [*(vehicle_ports(i)[1] for i in range(n)), TRACKER_PORTS[1]]
    systems = [*range(1, n + 1), TRACKER]
    return {who: (k, (HOST, port + port_offset)) for k, (who, port) in enumerate(zip(systems, ports, strict=True))}


def _warm_up(design: Design, flight: Flight) -> None:
    """Compile what the loop calls before a clock runs: one decision and the messages it takes."""
    here = at(flight.trajectory, 0.0)
    law = scenarios.law_of(flight)
    _, sample = law.step(design, law.first(design), Measurement(0.0, flight.initial), here)
    still = sample.state
    reread(encode_message(PayloadState(0, still.x0, still.v0, still.R0, still.Omega0)))
    _ = reread(encode_message(VehicleAttitude.of(0, still.R[0], still.Omega[0]))).R
    if flight.scenario.mission is not None:
        n = len(flight.system.m)
        goals = Goals(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.ones(n))
        integrated(np.zeros((n, 3)), goals.x, goals, 1.0)
        fly_each(design, goals.x, goals.v, flight.initial.R, goals.a, goals, flight.initial.R)
    lie.normalize(flight.initial.q.copy())
    n, L = flight.system.length.shape
    measured(np.ones((n, L, 6)), np.ones((n, 7)))
    setpoints = Setpoints(len(sample.f))
    setpoints.tell(0, sample.R_c, [0.5] * len(setpoints))
    setpoints.framed(bytes(len(setpoints)), bytes(len(setpoints)), 1, 0)
    positions(flight.system, flight.initial)
    filter = scenarios.filter(flight)
    if filter is not None:
        belief = Belief(flight.initial.copy(), np.zeros((len(flight.system.m), 3)))
        level = Setpoint.attitude(flight.initial.R, np.zeros(len(flight.system.m)))
        belief = predicted(filter, belief, level, flight.physics_us * 1e-6, 1)
        nothing = nothing_measured(flight.system)
        corrected(filter, belief, nothing)
        first_belief(filter, nothing._replace(x=positions(flight.system, still)[:, 0], R=still.R))


def predict_once(flight: Flight) -> None:
    """Load what carries a state on by the model, which is first needed in mid-flight, when something is lost."""
    level = Setpoint.attitude(flight.initial.R, np.zeros(len(flight.system.m)))
    flown(flight.system, flight.airframe, level, flight.initial, flight.physics_us * 1e-6, 1)


@contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """While inside, Ctrl-C and SIGTERM only raise a flag, so that a flight ends in order; a second Ctrl-C is a stop."""
    flag: list[int] = []

    def raised(number: int, _: FrameType | None) -> None:
        flag.append(number)
        if len(flag) > 1:
            raise KeyboardInterrupt

    try:
        old = {s: signal.signal(s, raised) for s in (signal.SIGINT, signal.SIGTERM)}
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
    return summarize(flight.scenario.name, flight.scenario.acceptance, _track(flight), none, NO_TIME, 0, 0, 0, 0)
