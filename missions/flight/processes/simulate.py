"""The simulator as a process of its own: vehicles on their ports, truth into a one-way channel to the log process."""

import contextlib
import gc
import math
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Literal, NamedTuple, get_args

import numpy as np

from bridge.loop.fly import STALL_S
from bridge.wire.link import LinkError
from cablequad.model.earth import Home
from cablequad.model.noise import Biases
from missions.flight.processes.child_process import begin, leave_to_parent
from missions.flight.recording.ipc import PortsOpen, SimulatorFailure, Status, put
from missions.scenario import flights, laws
from missions.scenario.flights import Flight, ScenarioError
from missions.scenario.tables import BarometerTable, FailureTable, GpsTable, ImuTable, MagnetometerTable, SensorsTable
from sitl.batteries import Battery
from sitl.external.joint import JointServer, Steps, steps
from sitl.external.seats import AutopilotError, External
from sitl.failures import Failure
from sitl.firmware.personas import PERSONAS
from sitl.instruments import Grades
from sitl.plant import PhysicsError
from sitl.server import Server
from sitl.settings import HOST, Event, Report, ServerOutput, Settings, Sink

TOLD_TOGETHER = 16  # ticks of truth in one write: a wake-up of the log process costs more than what it is told
LOOK_UP = 32  # questions whether to stop, for each look at whether the parent lives

Backend = Literal["builtin", "ardupilot", "px4", "mixed"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)
KINDS = {persona.backend: name for name, persona in PERSONAS.items()}  # by the word of --backend
BUILT_IN_ONLY = ("lands", "returns", "gps-loss")  # failures of what real autopilots decide or measure themselves


class Serving(NamedTuple):
    """How to serve a flight's vehicles."""

    lockstep: bool
    await_controller: bool = False
    speed: float = 1.0
    port_offset: int = 0
    host: str = HOST
    untethered: bool = False
    signing_key: bytes | None = None
    accept_unsigned_telemetry: bool = False
    faults_at_sender: bool = False
    backend: Backend = "builtin"
    stall_s: float = STALL_S  # wall clock, that autopilots which run may leave unanswered


def settings(flight: Flight, serving: Serving) -> Settings:
    """The server's settings for a flight. Raises ScenarioError where the backend cannot fly it."""
    s = flight.scenario
    battery = s.vehicle.battery
    ready = [
        v.estimator_ready_s if v.estimator_ready_s is not None else s.vehicle.estimator_ready_s for v in s.vehicles
    ]
    return Settings(
        system=flight.world.system,
        airframe=flight.world.airframe,
        initial=flight.initial,
        physics_us=flight.physics_us,
        tick_us=flight.tick_us,
        truth_us=flight.truth_us,
        control_us=flight.control_us,
        delay_us=flights.delays_us(flight),
        phase_us=flights.phases_us(flight),
        lockstep=serving.lockstep,
        await_controller=serving.await_controller,
        speed=serving.speed,
        # who started us is waited for as long as it lives
        answer_timeout_s=math.inf if serving.await_controller else s.link.answer_timeout_s,
        port_offset=serving.port_offset,
        host=serving.host,
        home=Home(epoch_s=s.epoch_s),
        firmware=flight.firmware,
        parameters=tuple(flights.parameters_of(s, i) for i in range(len(s.vehicles))),
        density_ratio=s.vehicle.air_density_ratio,
        ready_us=tuple(None if t is None else round(t * 1e6) for t in ready),
        untethered=serving.untethered,
        faults=flight.faults_up,
        faults_down=flight.faults_down[:-1] if serving.faults_at_sender else (),
        seed=s.seed,
        signing_key=serving.signing_key,
        accept_unsigned_telemetry=serving.accept_unsigned_telemetry,
        thrust_scale=flight.world.thrust_scale,
        around=flight.world.around,
        weather=flight.world.weather,
        noise=laws.noise(flight),
        biases=_biases(s.sensors),
        grades=_grades(s.sensors),
        batteries=() if battery is None else (Battery(battery.endurance_s, battery.sag),) * len(s.vehicles),
        failures=tuple(_failure(f) for f in s.failures),
        external=_external(flight, serving),
    )


def kinds(flight: Flight, backend: Backend) -> tuple[str, ...]:
    """The autopilot of every vehicle: arducopter or px4."""
    return flight.firmware if backend in ("mixed", "builtin") else (KINDS[backend],) * len(flight.firmware)


def joint_steps(flight: Flight, backend: Backend) -> Steps:
    """How time goes on where `backend` flies. Raises ValueError where autopilots cannot be asked in such steps."""
    return steps(flight.physics_us, flight.tick_us, flight.truth_us, flight.control_us, kinds(flight, backend))


def _external(flight: Flight, serving: Serving) -> External | None:
    backend = serving.backend
    if backend == "builtin":
        return None
    try:
        joint_steps(flight, backend)
    except ValueError as error:
        raise ScenarioError(f"scenario {flight.scenario.name}: {error}") from None
    for f in flight.scenario.failures:
        if f.kind in BUILT_IN_ONLY:
            raise ScenarioError(
                f"scenario {flight.scenario.name}: failures: {f.kind!r} is for built-in vehicles; leave it out with "
                f"--backend {backend}"
            )
    return External(kinds(flight, backend), stall_s=serving.stall_s)


def server_of(values: Settings, sink: Sink) -> Server | JointServer:
    """Whoever serves what the settings describe. Raises LinkError, ValueError."""
    return Server(values, sink) if values.external is None else JointServer(values, sink)


def _grades(s: SensorsTable) -> Grades | None:
    if s.imu is None and s.magnetometer is None and s.barometer is None and s.gps is None:
        return None
    imu, mag, baro, gps = s.imu or ImuTable(), s.magnetometer or MagnetometerTable(), s.barometer, s.gps or GpsTable()
    baro = baro or BarometerTable()
    tick = 1e6 / gps.rate_hz
    return Grades(
        imu.acceleration_m_s2, imu.rate_rad_s, mag.field_gauss, baro.pressure_hPa, gps.position_m, gps.velocity_m_s,
        imu.acceleration_bias_m_s2, imu.rate_bias_rad_s, mag.field_bias_gauss, baro.pressure_bias_hPa,
        gps.position_bias_m, max(4000, round(tick / 4000) * 4000), round(gps.delay_ms * 1000),
    )  # fmt: skip


def _biases(s: SensorsTable) -> Biases:
    roll, pitch, yaw = (math.radians(c) for c in s.attitude_offset_deg)
    x, y, z = s.position_offset_m
    return Biases(s.position_bias_m, math.radians(s.attitude_bias_deg), (x, y, z), (roll, pitch, yaw))


def _failure(f: FailureTable) -> Failure:
    lasts = round(f.lasts_s * 1e6)
    return Failure(
        round(f.at_s * 1e6), f.kind, f.vehicle - 1, f.rotor - 1, np.array(f.offset_m), np.array(f.wind_m_s), lasts,
        f.remaining, f.sag,
    )  # fmt: skip


def pin(which: int) -> None:
    """Stay on one processor, counted among those allowed.

    Loopback keeps the order of datagrams to different sockets only while their sender does not move; in lockstep a run
    is the same every time only if a tick's last datagram is the last to arrive.
    """
    if hasattr(os, "sched_setaffinity"):  # not on every system
        allowed = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {allowed[which % len(allowed)]})


def few_collections() -> None:
    """Leave out of garbage collection what is loaded by now, and collect the rest rarely: the loops make no cycles."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


def _ends(stopped: threading.Event, parent: int) -> Callable[[], bool]:
    """Whether to stop: told to, or left alone, which is looked at now and then, as it costs a system call."""
    asked = 0

    def ends() -> bool:
        nonlocal asked
        asked += 1
        return stopped.is_set() or (asked % LOOK_UP == 0 and os.getppid() != parent)

    return ends


def _child(values: Settings, status: Connection, truth: Connection) -> None:
    leave_to_parent()
    stopped = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopped.set())
    parent = os.getppid()

    waiting: list[ServerOutput] = []

    def sink(message: ServerOutput) -> None:
        waiting.append(message)
        if len(waiting) >= TOLD_TOGETHER or isinstance(message, Event):
            put(truth, waiting)
            waiting.clear()

    try:
        server = server_of(values, sink)
    except (LinkError, ValueError) as error:
        _tell(status, SimulatorFailure(str(error), isinstance(error, LinkError)))
        return
    try:
        few_collections()
        if values.lockstep and values.await_controller:
            pin(-1)
        status.send(PortsOpen())
        while not status.poll(0.1):
            if stopped.is_set() or os.getppid() != parent:
                return
        status.recv()  # go
        report = server.run(_ends(stopped, parent))
        status.send(report)
    except PhysicsError as error:
        _tell(status, SimulatorFailure(f"physics: {error} (t = {server.now_us * 1e-6:.2f} s of the vehicles' clock)"))
    except AutopilotError as error:
        _tell(status, SimulatorFailure(str(error), error.untested))
    except (ConnectionError, EOFError):
        return
    finally:
        server.close()
        with contextlib.suppress(ConnectionError):
            put(truth, waiting)
        truth.close()
        status.close()


def _tell(status: Connection, what: Status) -> None:
    with contextlib.suppress(ConnectionError):  # nobody is there any more
        status.send(what)


class Simulator:
    """The child process and the thread that hears how it fares."""

    def __init__(self, values: Settings, truth: Connection) -> None:
        """`truth` is where the child writes what it does; this process never reads it."""
        context = multiprocessing.get_context("spawn")
        self._status, other = context.Pipe()
        self.failure: str | None = None
        self.untested = False  # the failure is the computer's, not the flight's
        self.report: Report | None = None
        self._ready = threading.Event()
        self._process = context.Process(target=_child, args=(values, other, truth), name="cablequad-sitl", daemon=True)
        begin(self._process)
        other.close()
        self._thread = threading.Thread(target=self._drain, name="simulator", daemon=True)
        self._thread.start()

    def wait_ready(self, waiting: Callable[[], bool]) -> bool:
        """Whether the vehicles are up; asks `waiting` ten times a second whether to go on waiting.

        However long it takes: a first start compiles the model, and a simulator that has died is not waited for.
        """
        while not self._ready.wait(0.1):
            if not waiting():
                return False
        return self.failure is None

    def go(self) -> None:
        """Let the vehicles' clock run."""
        with contextlib.suppress(OSError):  # it ended by itself: `failure` says so
            self._status.send(None)

    def stop(self) -> None:
        """End the vehicles and take what they still had to say."""
        if self._process.is_alive():
            self._process.terminate()
        self._thread.join(5.0)
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()

    def _drain(self) -> None:
        while True:
            try:
                message: Status = self._status.recv()
            except (EOFError, OSError):
                break
            match message:
                case Report():
                    self.report = message
                case SimulatorFailure():
                    self.failure, self.untested = message.text, message.untested
                    self._ready.set()
                case PortsOpen():
                    self._ready.set()
        if self.report is None and self.failure is None:
            self._process.join(2.0)
            self.failure = f"the simulator ended by itself (exit code {self._process.exitcode})"
        self._ready.set()
