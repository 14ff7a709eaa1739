"""n vehicles and a payload tracker on their ports; lockstep or paced. Truth goes to the sink that is handed in.

One tick: deliver what has come due, let every vehicle speak, advance the physics with the commands under way, then wait
for the answers (lockstep) or for the wall clock. A setpoint that answers the state of one tick acts `delay_us` later.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bridge.link import Endpoint, Link, Received
from bridge.ports import GROUND_PORT, LISTEN_PORT, TRACKER_PORTS, vehicle_ports
from bridge.wire.messages import encode
from bridge.wire.telemetry import BUILD, Home, Snapshot
from bridge.wire.values import IN_AIR, ON_GROUND, AttitudeTarget, Timesync
from cablequad.attitude import Airframe
from cablequad.state import State
from cablequad.system import System
from cablequad.types import Array
from sitl import tracker
from sitl.firmware import hold
from sitl.firmware.modes import Mode
from sitl.firmware.px4 import ATTITUDE_QUATERNION, HIGHRES_IMU, Px4
from sitl.plant import Plant, Truth

CONTROLLER = (250, 191)  # whose setpoints may hold the clock
HOST = "127.0.0.1"
ONBOARD, GCS, LISTEN = 0, 1, 2
CATCH_UP = 0.25  # s behind the wall clock that are made up for; more is let go


class Settings(NamedTuple):
    """Everything the server needs to know; times are microseconds of the vehicles' clock."""

    system: System
    airframe: Airframe
    initial: State
    physics_us: int
    tick_us: int
    control_us: int  # the tracker's rate, which is the controller's
    delay_us: int
    lockstep: bool
    await_controller: bool  # hold the clock at the first tick until a controller answers it
    speed: float  # wall-clock factor where nobody holds the clock
    answer_timeout_s: float  # wall clock: how long a tick waits for its answers
    port_offset: int = 0
    host: str = HOST
    home: Home = Home()


class Event(NamedTuple):
    """Something that happened among the vehicles."""

    boot_us: int
    kind: str
    subject: str
    text: str


class Report(NamedTuple):
    """How the server kept its time."""

    ticks: int
    missed_answers: int  # lockstep: ticks whose setpoint did not come in time
    missed_deadlines: int  # paced: ticks that began more than a tick late
    lateness_s: tuple[float, ...]  # paced: how late each tick began


Sink = Callable[[Truth | Event], None]


def endpoints(n: int, offset: int, host: str) -> list[Endpoint]:
    """Every port of n vehicles and their payload tracker.

    Onboard links and ground station links (PX4's 14580+i -> 14540+i and 18570+i -> 14550), 14555 for clients that speak
    first, the tracker (14640 -> 14600) and its ground station link.
    """

    def end(here: int, there: int | None) -> Endpoint:
        return Endpoint((host, here + offset), None if there is None else (host, there + offset))

    onboard = [end(vehicle_ports(i)[1], vehicle_ports(i)[0]) for i in range(n)]
    ground = [end(18570 + i, GROUND_PORT) for i in range(n)]
    return [*onboard, *ground, end(LISTEN_PORT, None), end(TRACKER_PORTS[1], TRACKER_PORTS[0]), end(18540, GROUND_PORT)]


class Server:
    """The running vehicles."""

    def __init__(self, settings: Settings, sink: Sink) -> None:
        s = settings
        self.n = len(s.system.m)
        self.settings = s
        self.link = Link(endpoints(self.n, s.port_offset, s.host))
        self.plant = Plant(s.system, s.airframe, s.initial, s.physics_us * 1e-6)
        self.vehicles = [
            Px4(i + 1, s.tick_us, (False, True, True), float(s.airframe.max_thrust[i])) for i in range(self.n)
        ]
        self._sink = sink
        self._tick = 0
        self._inbox: list[list[tuple[int, Received]]] = [[] for _ in range(self.n)]
        self._engaged = [s.lockstep and s.await_controller] * self.n
        self._controller_port = list(range(self.n))
        self._answered = [-1] * self.n
        self._expected = [False] * self.n
        self._ahead: tuple[tuple[Array, Array], list[Snapshot]] | None = None
        self._missed_answers = 0
        self._missed_deadlines = 0
        self._lateness: list[float] = []
        self._pace_from: tuple[int, float] | None = None
        self._warm_up()

    @property
    def now_us(self) -> int:
        """The vehicles' clock."""
        return self._tick * self.settings.tick_us

    def run(self, stop: Callable[[], bool]) -> Report:
        """Serve until `stop()`; the report says how time was kept. Raises PhysicsError if the motion diverges."""
        while not stop():
            self._tick += 1
            self._one_tick()
            self._wait(stop)
        return self.report()

    def report(self) -> Report:
        """How time was kept so far."""
        return Report(self._tick, self._missed_answers, self._missed_deadlines, tuple(self._lateness))

    def close(self) -> None:
        """Release the sockets."""
        self.link.close()

    def _warm_up(self) -> None:
        """Build every message once, so that nothing is compiled while the clock runs."""
        truth = self.plant.truth(0, *self.plant.kinematics())
        own = self._snapshots(0, truth.x, truth.v)[0]
        for build in BUILD.values():
            build(own)
        tracker.high_rate(truth, self.settings.system.n_links)
        tracker.low_rate(truth, self.settings.system.n_links)
        hold.hold(own, hold.anchor(own, 10.0))

    def _snapshots(self, now: int, x: Array, v: Array) -> list[Snapshot]:
        """What every vehicle knows of itself, before its flight controller and its accelerometer add to it."""
        R, Omega = self.plant.state.R, self.plant.state.Omega
        none = np.zeros(3)
        return [
            Snapshot(
                now, R[i], Omega[i], x[i], v[i], none, 0.0, False, ON_GROUND, (R[i], Omega[i], 0.0), self.settings.home
            )
            for i in range(self.n)
        ]

    def _one_tick(self) -> None:
        s, now = self.settings, self.now_us
        for i, vehicle in enumerate(self.vehicles):
            self._deliver(i, vehicle, now)
            vehicle.tick(now)
        if self._release_or_reset(now) or self._ahead is None:
            self._look_ahead(now)
        assert self._ahead is not None
        (x, v), own = self._ahead
        self.plant.command([vehicle.actuation(own[i]) for i, vehicle in enumerate(self.vehicles)])
        truth = self.plant.truth(now, x, v)
        force = self.plant.specific_force(truth) if any(v.will_tell(HIGHRES_IMU, now) for v in self.vehicles) else None
        for i, vehicle in enumerate(self.vehicles):
            felt = own[i] if force is None else own[i]._replace(specific_force=force[i])
            self._speak(i, vehicle, vehicle.snapshot(felt))
        self._track(truth)
        self.link.flush()  # the controller thinks while the physics goes on
        self._sink(truth)
        self.plant.advance(s.tick_us // s.physics_us)
        self._look_ahead(now + s.tick_us)
        assert self._ahead is not None
        for i, vehicle in enumerate(self.vehicles):
            vehicle.prepare(self._ahead[1][i], self._audible(i))

    def _look_ahead(self, now: int) -> None:
        """What is known of the tick at `now` before its answers are in: the motion is decided a tick ahead."""
        x, v = self.plant.kinematics()
        self._ahead = (x, v), self._snapshots(now, x, v)

    def _deliver(self, i: int, vehicle: Px4, now: int) -> None:
        waiting = []
        for due, frame in self._inbox[i]:
            if due <= now:
                link = ONBOARD if frame.port < self.n else GCS if frame.port < 2 * self.n else LISTEN
                vehicle.handle(link, frame.system, frame.component, frame.value, now)
            else:
                waiting.append((due, frame))
        self._inbox[i] = waiting

    def _release_or_reset(self, now: int) -> bool:
        """Whether the motion was changed by hand."""
        if self.plant.held:
            if all(v.armed and v.mode is Mode.OFFBOARD and v.fresh_setpoint(now) for v in self.vehicles):
                self.plant.held = False
                self._sink(Event(now, "release", "all", "every vehicle is armed and under command: released"))
                for vehicle in self.vehicles:
                    vehicle.set_landed(IN_AIR)
        elif not any(v.armed for v in self.vehicles):
            self.plant.reset()
            self._sink(Event(now, "reset", "all", "every vehicle is disarmed: back to the initial state, held"))
            for vehicle in self.vehicles:
                vehicle.set_landed(ON_GROUND)
                vehicle.forget_prepared()
            return True
        return False

    def _speak(self, i: int, vehicle: Px4, snapshot: Snapshot) -> None:
        ports = (i, self.n + i, 2 * self.n)
        audible = self._audible(i)
        self._expected[i] = False
        for out in vehicle.outgoing(snapshot, audible):
            for link, port in enumerate(ports):
                if out.link in (None, link) and audible[link]:
                    self.link.send(port, vehicle.system_id, 1, out.message)
                    if out.message.msgid == ATTITUDE_QUATERNION and port == self._controller_port[i]:
                        self._expected[i] = True

    def _audible(self, i: int) -> tuple[bool, ...]:
        """On which of vehicle i's links somebody may listen."""
        return tuple(bool(self.link.ports[p].addresses()) for p in (i, self.n + i, 2 * self.n))

    def _track(self, truth: Truth) -> None:
        n_links = self.settings.system.n_links
        ground = 2 * self.n + 2
        for message in tracker.low_rate(truth, n_links):
            self.link.send(ground, tracker.SYSTEM, tracker.COMPONENT, message)
            self.link.send(ground - 1, tracker.SYSTEM, tracker.COMPONENT, message)
        if truth.boot_us % self.settings.control_us == 0:
            for message in tracker.high_rate(truth, n_links):
                self.link.send(ground - 1, tracker.SYSTEM, tracker.COMPONENT, message)

    def _receive(self, timeout: float, closing: int | None = None) -> None:
        now = self.now_us
        for frame in self.link.poll(timeout, closing):
            value = frame.value
            if value is None or frame.port > 2 * self.n:
                if isinstance(value, Timesync) and value.tc1 == 0:
                    answer = encode(Timesync(now * 1000, value.ts1))
                    self.link.send(frame.port, tracker.SYSTEM, tracker.COMPONENT, answer, frame.address)
                continue
            due = now + self.settings.tick_us
            if isinstance(value, AttitudeTarget) and (frame.system, frame.component) == CONTROLLER:
                stamp_us = value.boot_ms * 1000
                if 0 < stamp_us <= now:
                    due = max(due, stamp_us + self.settings.delay_us)
                    self._answer(frame, value, now)
            here = range(self.n) if frame.port == 2 * self.n else (frame.port % self.n,)
            for i in here:
                self._inbox[i].append((due, frame))

    def _answer(self, frame: Received, value: AttitudeTarget, now: int) -> None:
        i = value.system - 1
        if 0 <= i < self.n:
            self._answered[i] = value.boot_ms
            self._controller_port[i] = frame.port
            if self.settings.lockstep and value.boot_ms * 1000 == now:
                self._engaged[i] = True

    def _wait(self, stop: Callable[[], bool]) -> None:
        """Until every engaged vehicle that spoke has its answer; where nobody is engaged, until the wall clock says."""
        if any(self._engaged):
            self._pace_from = None
            self._barrier(stop)
        else:
            self._pace()

    def _barrier(self, stop: Callable[[], bool]) -> None:
        now_ms = self.now_us // 1000
        deadline = self.link.now() + self.settings.answer_timeout_s
        closing: int | None = max(self._controller_port)  # the controller answers vehicle by vehicle
        while not stop():
            missing = [
                i for i in range(self.n) if self._engaged[i] and self._expected[i] and self._answered[i] != now_ms
            ]
            if not missing:
                self._receive(0.0)
                return
            left = deadline - self.link.now()
            if left <= 0:
                self._missed_answers += len(missing)
                for i in missing:
                    self._engaged[i] = False
                names = ", ".join(str(i + 1) for i in missing)
                self._sink(
                    Event(self.now_us, "answer-missing", names, f"no setpoint for this tick from vehicle {names}")
                )
                return
            self._receive(min(left, 0.1), closing)
            closing = None

    def _pace(self) -> None:
        s = self.settings
        if self._pace_from is None:
            self._pace_from = (self._tick, self.link.now())
        first, start = self._pace_from
        speed = 1.0 if math.isinf(s.speed) else s.speed
        deadline = start + (self._tick + 1 - first) * s.tick_us * 1e-6 / speed
        self._receive(0.0)
        while (left := deadline - self.link.now()) > 0:
            self._receive(left)
        self._lateness.append(-left)
        if -left > s.tick_us * 1e-6 / speed:
            self._missed_deadlines += 1
        if -left > CATCH_UP:
            self._pace_from = None
