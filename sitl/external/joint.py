"""Autopilots under one load, in joint lockstep: wait for all, step once, tell all.

The physics' clock begins when every autopilot has come. Held vehicles stand on stands that leave their attitudes free;
they are let go together once every one bears itself. Whoever stops answering or begins anew is left out, its rotors
still, and the others have `GRACE_S` to be brought down before the run ends.
"""

import math
import select
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bridge.wire.frames import Signer
from bridge.wire.link import Link
from bridge.wire.messages import encode
from bridge.wire.values import IN_AIR, ON_GROUND, LandedState, Timesync
from sitl import tracker
from sitl.addresses import CONTROLLER, tracker_endpoints
from sitl.batteries import Batteries
from sitl.external.ardupilot import ARDUPILOT_PORT, ArduPilotSeat
from sitl.external.px4 import PX4_PORT, SENSOR_US, Px4Seat
from sitl.external.seat import Own, Seat, SeatError
from sitl.failures import ActiveFailures
from sitl.firmware.telemetry import origin
from sitl.instruments import Grades, Instruments
from sitl.plant import Truth
from sitl.settings import Event, Report, Settings, Sink, own_generator, plant_of, sensors_of, unread_frames

FRAME_US = 1250  # the longest step: ArduCopter does not arm below 1.8 times its loop rate of 400 Hz
LONG_TICK_US = 5000  # of whole such steps
START_US = 1_000_000  # of the physics' clock: no firmware is told that it is 0
GRACE_S = 30.0  # of the physics' clock, for those that are left
CARRIED_S, STEADY = 0.5, 0.04  # what a vehicle gives must be more than its weight, and change by no more, for so long
LANDED_US = 200_000
LEAD_US = 5000  # of the physics before a controller that deals with every state
BOOT_S = 120.0  # wall clock, for autopilots that somebody else starts
PROBE_S = 0.5  # wall clock, between looks whether one that is silent still runs
ASK_AGAIN_S = 0.5  # wall clock, after which a controller without an answer is told the same state again
STALL_SAID_S = 3.0  # wall clock, after which a silence is told
BURST_S = 0.002  # wall clock: that answers of one step are apart, at most, for all to be heard together
REAL_TIME_S = 0.2  # behind the wall clock that is made up for


class AutopilotError(Exception):
    """An autopilot never came, ended or began anew; the message says which, and since when.

    `untested`: it runs and does not answer, which says nothing of the flight.
    """

    def __init__(self, text: str, untested: bool = False) -> None:
        super().__init__(text)
        self.untested = untested


class External(NamedTuple):
    """Who flies instead of the built-in vehicles."""

    kinds: tuple[str, ...]  # of each vehicle: arducopter or px4
    connect_s: float = BOOT_S  # wall clock, for the last to come
    stall_s: float = 600.0  # wall clock, that one which runs may leave a question unanswered


class Steps(NamedTuple):
    """How a flight's time goes on where autopilots are asked what they do."""

    frame_us: int  # from one question to the next
    physics_us: int
    tick_us: int
    truth_us: int


def steps(physics_us: int, tick_us: int, truth_us: int, control_us: int, kinds: tuple[str, ...]) -> Steps:
    """The joint steps: whole physics steps in a frame, whole frames in a tick and in PX4's 4 ms.

    ArduPilots alone, at a control rate that lets them, are asked at 800 Hz: each question costs more than the physics
    between two, which is made in steps no longer than asked. Raises ValueError if nothing fits.
    """
    if "px4" not in kinds and control_us % LONG_TICK_US == 0 and truth_us == tick_us:
        finer = max(us for us in range(1, FRAME_US + 1) if FRAME_US % us == 0 and us <= physics_us)
        return Steps(FRAME_US, finer, LONG_TICK_US, LONG_TICK_US)
    for count in range(FRAME_US // physics_us, 0, -1):
        if SENSOR_US % (count * physics_us) == 0 and tick_us % (count * physics_us) == 0:
            return Steps(count * physics_us, physics_us, tick_us, truth_us)
    raise ValueError(
        f"physics.rate_hz, control.rate_hz: steps of {physics_us} us in ticks of {tick_us} us do not fit autopilots; "
        "1000 Hz (no less than 800) and 50, 100 or 250 Hz do"
    )


class JointServer:
    """The physics behind n autopilots; looks to its owner like `sitl.server.Server`."""

    def __init__(self, settings: Settings, sink: Sink) -> None:
        """Raises LinkError where a port is taken."""
        s, external = settings, settings.external
        assert external is not None
        self._external, self._sink = external, sink
        self.n = n = len(s.system.m)
        way = steps(s.physics_us, s.tick_us, s.truth_us, s.control_us, external.kinds)
        self._frame_us, self._substeps = way.frame_us, way.frame_us // way.physics_us
        self.settings = s = s._replace(physics_us=way.physics_us, tick_us=way.tick_us, truth_us=way.truth_us)
        self.plant = plant_of(s._replace(around=s.around._replace(driven=True)))
        self._sensors = sensors_of(s)
        self._batteries = Batteries(s.batteries, s.system.m * s.system.g)
        signer = Signer(s.signing_key, s.accept_unsigned_telemetry) if s.signing_key is not None else None
        self.link = Link(list(tracker_endpoints(s.port_offset, s.host)), signer)
        self._tracker = tracker.Tracker(self.link, (0, 1), s.system.n_links, s.control_us)
        self.seats: list[Seat] = []
        try:
            for i, kind in enumerate(external.kinds):
                self.seats.append(self._seat(i, kind))
        except BaseException:
            self.close()
            raise
        self._gone: dict[int, str] = {}
        self._ends_us: int | None = None
        self._broken = ActiveFailures(s.failures, n)
        self._released_us: int | None = None
        self._bears: list[tuple[int, float]] = [(0, 0.0)] * n  # since when a vehicle gives as much, N
        self._v = self.plant.kinematics()[1]
        self._force = np.tile(np.array([0.0, 0.0, -s.system.g]), (n, 1))
        self.now_us = START_US
        self._steps = 0
        self._pace_from: tuple[int, float] | None = None
        self._asked_us = 0  # of the last state that the controller was told, and asked the time after
        self._answered_us: int | None = None  # of the last such question that it answered; None: nobody does

    def _seat(self, i: int, kind: str) -> Seat:
        s = self.settings
        if kind == "arducopter":
            return ArduPilotSeat(i + 1, (s.host, ARDUPILOT_PORT + s.port_offset + 10 * i))
        instruments = Instruments(s.grades or Grades(), own_generator(s.seed, f"instruments {i + 1}"))
        return Px4Seat(i + 1, (s.host, PX4_PORT + s.port_offset + i), s.home, instruments)

    # -- the run -------------------------------------------------------------------------------------------------------

    def run(self, stop: Callable[[], bool]) -> Report:
        """Serve until `stop()`. Raises AutopilotError where one is missing, PhysicsError if the motion diverges."""
        if self._assemble(stop):
            self._tell()
            while not stop():
                self._gather(stop)
                self._step()
                self._await_controller(stop)
                self._tell()
                self._listen(0.0)
                self._end_after_grace()
        return self.report()

    def report(self) -> Report:
        """How it went so far."""
        tallies = [seat.tally for seat in self.seats]
        refused = unread_frames(self.link.counters)
        for word in ("refused", "repeated", "stale", "unanswered"):
            refused[f"physics packets {word}"] = sum(getattr(t, word) for t in tallies)
        sent = sum(self.link.counters.sent_on[:1])
        return Report(self._steps, 0, 0, (), sent, 0, 0, 0, 0, 0, refused, {})

    def close(self) -> None:
        """Release the sockets."""
        self.link.close()
        for seat in self.seats:
            seat.close()

    def _assemble(self, stop: Callable[[], bool]) -> bool:
        """Wait for everyone; whether all have come."""
        deadline = time.monotonic() + self._external.connect_s
        told: set[int] = set()
        while not stop():
            for i, seat in enumerate(self.seats):
                try:
                    seat.hear()
                except SeatError as error:
                    raise AutopilotError(f"{seat.who} {error}, before all had come") from None
                if seat.present and i not in told:
                    told.add(i)
                    self._sink(Event(0, "autopilot", f"vehicle {i + 1}", f"{seat.who} has come"))
            if len(told) == self.n:
                return True
            if time.monotonic() > deadline:
                missing = "; ".join(seat.who for seat in self.seats if not seat.present)
                raise AutopilotError(
                    f"{missing}: no autopilot came within {self._external.connect_s:g} s; is it running, and told to "
                    "use this address for its physics?"
                )
            self._wait(0.05, self.seats)
        return False

    def _gather(self, stop: Callable[[], bool]) -> None:
        """Until everybody has said what it does now, and the wall clock is no longer behind.

        Who runs is waited for: a busy machine stalls. Raises AutopilotError where that takes too long.
        """
        begun = time.monotonic()
        nudged, said = begun, False
        self._hear([seat for seat in self._left(self.seats) if not seat.engaged])
        missing = [seat for seat in self._left(self.seats) if not seat.settled]
        while missing and not stop():
            # who was told last answers last, mostly: being woken for every answer would cost more than the step
            self._wait(BURST_S, missing[-1:])
            self._hear(missing)
            missing = [seat for seat in self._left(missing) if not seat.settled]
            now = time.monotonic()
            if missing and now - nudged > PROBE_S:
                nudged = now
                self._nudge(missing)
            if missing and not said and now - begun > STALL_SAID_S:
                said = True
                for seat in missing:
                    vehicle = f"vehicle {self.seats.index(seat) + 1}"
                    self._sink(Event(self.now_us, "stall", vehicle, f"{seat.who} does not answer; it is waited for"))
            if missing and now - begun > self._external.stall_s:
                who = ", ".join(seat.who for seat in missing)
                raise AutopilotError(
                    f"not tested: {who} has not answered since t = {self.now_us * 1e-6:.3f} s, for "
                    f"{self._external.stall_s:g} s; it still runs",
                    untested=True,
                )
        self._pace(stop)

    def _nudge(self, seats: list[Seat]) -> None:
        for seat in seats:
            try:
                seat.nudge()
            except SeatError as error:
                self._lose(seat, str(error))

    def _left(self, seats: list[Seat]) -> list[Seat]:
        return [seat for seat in seats if self.seats.index(seat) not in self._gone] if self._gone else seats

    def _hear(self, seats: list[Seat]) -> None:
        for seat in seats:
            try:
                seat.hear()
            except SeatError as error:
                self._lose(seat, str(error))

    def _wait(self, seconds: float, seats: list[Seat]) -> None:
        sockets = [number for seat in seats for number in seat.sockets()]
        select.select(sockets, (), (), seconds)

    def _pace(self, stop: Callable[[], bool]) -> None:
        """Not ahead of the wall clock: autopilots that do not pace themselves go as fast as they are told."""
        speed = self.settings.speed
        if math.isinf(speed):
            if all(seat.engaged for seat in self.seats):
                self._pace_from = None
                return
            speed = 1.0
        if self._pace_from is None:
            self._pace_from = (self.now_us, time.monotonic())
        first, start = self._pace_from
        ahead = start + (self.now_us - first) * 1e-6 / speed - time.monotonic()
        if ahead < -REAL_TIME_S:
            self._pace_from = None
        while ahead > 0.0 and not stop():
            time.sleep(min(ahead, 0.1))
            ahead = start + (self.now_us - first) * 1e-6 / speed - time.monotonic()

    def _step(self) -> None:
        s = self.settings
        share = np.array([seat.share if i not in self._gone else (0.0,) * 4 for i, seat in enumerate(self.seats)])
        self.plant.drive(share * (s.airframe.max_thrust / 4.0)[:, None])
        self.plant.advance(self._substeps)
        self.now_us += self._frame_us
        self._steps += 1
        if self.plant.restrained:
            self._release()
        elif self._released_us is None:
            self._begin(share)
        self._batteries.use(self.plant, self._frame_us * 1e-6)
        for subject, text in self._broken.act(self.now_us, self._released_us, self.plant, []):
            self._sink(Event(self.now_us, "failure", subject, text))

    def _tell(self) -> None:
        """What everybody feels and where it is, to those who wait for it; the load to its tracker; all to the log."""
        s, now = self.settings, self.now_us
        x, v = self.plant.kinematics()
        R, Omega = self.plant.attitudes
        if self._steps:
            mean = (v - self._v) / (self._frame_us * 1e-6)
            mean[:, 2] -= s.system.g
            self._force = np.einsum("iba,ib->ia", R, mean)
        self._v = v
        for i, seat in enumerate(self.seats):
            if i in self._gone or not seat.due(now):
                continue
            try:
                seat.tell(Own(now, R[i], Omega[i], x[i], v[i], self._force[i]))
            except SeatError as error:
                self._lose(seat, str(error))
        told = now % s.truth_us == 0
        if told:
            truth = self.plant.truth(now)
            self._sink(truth)
            if now % s.tick_us == 0:
                self._track(truth)

    def _track(self, truth: Truth) -> None:
        s, now = self.settings, self.now_us
        self._tracker.tell(self._sensors.tracked(truth))
        if now % LANDED_US == 0 or now == self._released_us:
            landed = encode(LandedState(ON_GROUND if self.plant.restrained else IN_AIR))
            self.link.put(0, tracker.SYSTEM, tracker.COMPONENT, landed)
        if now % tracker.HEARTBEAT_US == 0:
            self.link.put(0, tracker.SYSTEM, tracker.COMPONENT, origin(s.home))
        if now % s.control_us == 0:
            self._asked_us = now
            self._ask()
        self.link.flush()

    def _ask(self) -> None:
        """Ask the controller the time, after all that it is told of a tick: who answers has dealt with that."""
        question = encode(Timesync(0, self._asked_us * 1000))
        self.link.put(0, tracker.SYSTEM, tracker.COMPONENT, question)

    def _await_controller(self, stop: Callable[[], bool]) -> None:
        """Until a controller that answers has dealt with what it was told last: a busy computer stalls it too."""
        begun = asked = time.monotonic()
        while self._unanswered() and not stop():
            now = time.monotonic()
            if now - begun > self.settings.answer_timeout_s:
                self._answered_us = None
                text = f"no answer to TIMESYNC for {self.settings.answer_timeout_s:g} s; it is not waited for any more"
                self._sink(Event(self.now_us, "answer-missing", "controller", text))
                return
            if now - asked > ASK_AGAIN_S:
                asked = now
                self._ask()
                self.link.flush()
            self._listen(ASK_AGAIN_S)

    def _unanswered(self) -> bool:
        if self._answered_us is None:
            return False
        return self._answered_us + self.settings.control_us <= min(self._asked_us, self.now_us - LEAD_US)

    def _listen(self, timeout: float) -> None:
        """Answer who asks the tracker for its time; hear the controller answer it."""
        for frame in self.link.poll(timeout):
            if not isinstance(frame.value, Timesync):
                continue
            tc1, ts1 = frame.value
            if (frame.system, frame.component) == CONTROLLER and tc1 != 0 and 0 < ts1 <= self.now_us * 1000:
                self._answered_us = max(self._answered_us or 0, ts1 // 1000)
            elif tc1 == 0:
                answer = encode(Timesync(self.now_us * 1000, frame.value.ts1))
                self.link.put(frame.port, tracker.SYSTEM, tracker.COMPONENT, answer)
                self.link.flush()

    # -- what happens --------------------------------------------------------------------------------------------------

    def _release(self) -> None:
        """Let go of everybody together once each bears itself: more than its weight, steadily, upwards."""
        up = self.plant.thrust * self.plant.attitudes[0][:, 2, 2]
        weight = self.settings.system.m * self.settings.system.g
        for i, (_, level) in enumerate(self._bears):
            if up[i] < weight[i] or abs(up[i] - level) > STEADY * level:
                self._bears[i] = (self.now_us, float(up[i]))
        if all(self.now_us - since >= CARRIED_S * 1e6 for since, _ in self._bears):
            self.plant.restrained = False
            self._released_us = self.now_us
            self._sink(Event(self.now_us, "release", "all", "every vehicle bears itself: let go"))

    def _begin(self, share: np.ndarray) -> None:
        """On the ground, time since the release begins when all motors turn."""
        if (share.sum(axis=1) > 0.0).all():
            self._released_us = self.now_us
            self._sink(Event(self.now_us, "release", "all", "all motors turn, on the ground"))

    def _lose(self, seat: Seat, why: str) -> None:
        i = self.seats.index(seat)
        self._gone[i] = f"{seat.who} {why}"
        self._sink(Event(self.now_us, "autopilot-lost", f"vehicle {i + 1}", f"{seat.who} {why}; its motors stop"))
        if self._ends_us is None:
            self._ends_us = self.now_us + round(GRACE_S * 1e6)
        if len(self._gone) == self.n:
            self._ends_us = self.now_us

    def _end_after_grace(self) -> None:
        if self._ends_us is not None and self.now_us >= self._ends_us:
            raise AutopilotError("; ".join(self._gone.values()))
