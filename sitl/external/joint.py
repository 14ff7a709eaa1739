"""Autopilots under one load, in joint lockstep: wait for all, step once, tell all.

The physics' clock begins when every autopilot has come. Held vehicles stand on stands that leave their attitudes free;
they are let go together once every one bears itself. Whoever stops answering or begins anew is left out, its rotors
still, and the others have `GRACE_S` to be brought down before the run ends.
"""

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bridge.wire.frames import Signer
from bridge.wire.link import Link
from bridge.wire.messages import encode
from bridge.wire.values import IN_AIR, ON_GROUND, LandedState
from cablequad.types import Array
from sitl import tracker
from sitl.addresses import tracker_endpoints
from sitl.condition import Condition
from sitl.external.ardupilot import ARDUPILOT_PORT, ArduPilotSeat
from sitl.external.controller_time import ControllerTime
from sitl.external.px4 import PX4_PORT, SENSOR_US, Px4Seat
from sitl.external.seat import Own, Seat
from sitl.external.seats import Seats
from sitl.external.stands import Stands
from sitl.firmware.telemetry import origin
from sitl.instruments import Grades, Instruments
from sitl.pacing import Pace
from sitl.plant import AIR_US, Truth
from sitl.settings import Report, Settings, Sink, own_generator, plant_of, sensors_of, unread_frames

FRAME_US = 1250  # the longest step: ArduCopter does not arm below 1.8 times its loop rate of 400 Hz
LONG_TICK_US = 5000  # of whole such steps
START_US = 1_000_000  # of the physics' clock: no firmware is told that it is 0
LANDED_US = 200_000
REAL_TIME_S = 0.2  # behind the wall clock that is made up for


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


class MeanForce:
    """What accelerometers read over a step: the mean specific force, by how velocities changed."""

    def __init__(self, v: Array, g: float) -> None:
        """`v` (n, 3) m/s."""
        self._v, self._g = v, g
        self.force = np.tile(np.array([0.0, 0.0, -g]), (len(v), 1))  # (n, 3) m/s^2, body frames

    def after(self, v: Array, R: Array, seconds: float) -> None:
        """A step of so many seconds ended with `v` (n, 3) m/s and `R` (n, 3, 3)."""
        mean = (v - self._v) / seconds
        mean[:, 2] -= self._g
        self.force = np.einsum("iba,ib->ia", R, mean)
        self._v = v


class JointServer:
    """The physics behind n autopilots; looks to its owner like `sitl.server.Server`."""

    def __init__(self, settings: Settings, sink: Sink) -> None:
        """Raises LinkError where a port is taken."""
        s, external = settings, settings.external
        assert external is not None
        self._sink = sink
        self._way = way = steps(s.physics_us, s.tick_us, s.truth_us, s.control_us, external.kinds)
        self.settings = s = s._replace(physics_us=way.physics_us, tick_us=way.tick_us, truth_us=way.truth_us)
        self.plant = plant_of(s._replace(around=s.around._replace(driven=True)))
        self._sensors = sensors_of(s)
        signer = Signer(s.signing_key, s.accept_unsigned_telemetry) if s.signing_key is not None else None
        self.link = Link(list(tracker_endpoints(s.port_offset, s.host)), signer)
        self._tracker = tracker.Tracker(self.link, (0, 1), s.system.n_links, s.control_us)
        seats: list[Seat] = []
        self.seats = Seats(seats, external, sink)
        try:
            for i, kind in enumerate(external.kinds):
                seats.append(self._seat(i, kind))
        except BaseException:
            self.close()
            raise
        self._condition = Condition(s, sink)
        self._stands = Stands(s.system.m * s.system.g, sink)
        self._controller = ControllerTime(self.link, s.control_us, s.answer_timeout_s, sink)
        self._mean = MeanForce(self.plant.kinematics()[1], s.system.g)
        self._pace = Pace(s.speed, s.tick_us)
        self._steps = 0

    @property
    def n(self) -> int:
        """How many vehicles there are."""
        return len(self.settings.system.m)

    @property
    def now_us(self) -> int:
        """The physics' clock."""
        return START_US + self._steps * self._way.frame_us

    def _seat(self, i: int, kind: str) -> Seat:
        s = self.settings
        if kind == "arducopter":
            return ArduPilotSeat(i + 1, (s.host, ARDUPILOT_PORT + s.port_offset + 10 * i))
        instruments = Instruments(s.grades or Grades(), own_generator(s.seed, f"instruments {i + 1}"))
        return Px4Seat(i + 1, (s.host, PX4_PORT + s.port_offset + i), s.home, instruments)

    # -- the run -------------------------------------------------------------------------------------------------------

    def run(self, stop: Callable[[], bool]) -> Report:
        """Serve until `stop()`. Raises AutopilotError where one is missing, PhysicsError if the motion diverges."""
        if self.seats.assemble(stop):
            self._tell()
            while not stop():
                self.seats.gather(stop, self.now_us)
                self._keep_pace(stop)
                self._step()
                self._controller.wait(self.now_us, stop)
                self._tell()
                self._controller.listen(self.now_us, 0.0)
                self.seats.end_after_grace(self.now_us)
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
        self.seats.close()

    def _keep_pace(self, stop: Callable[[], bool]) -> None:
        """Not ahead of the wall clock: autopilots that do not pace themselves go as fast as they are told."""
        if math.isinf(self.settings.speed) and self.seats.engaged:
            self._pace.restart()
            return
        deadline = self._pace.deadline(self.now_us, time.monotonic())
        ahead = deadline - time.monotonic()
        if ahead < -REAL_TIME_S:
            self._pace.restart()
        while ahead > 0.0 and not stop():
            time.sleep(min(ahead, 0.1))
            ahead = deadline - time.monotonic()

    def _step(self) -> None:
        s = self.settings
        share = np.array(self.seats.shares)
        self.plant.drive(share * (s.airframe.max_thrust / 4.0)[:, None])
        self.plant.advance(self._way.frame_us // self._way.physics_us)
        self._steps += 1
        self._stands.settle(self.now_us, self.plant, share)
        self._condition.act(self.now_us, self._way.frame_us, self._stands.released_us, self.plant, [])

    def _tell(self) -> None:
        """What everybody feels and where it is, to those who wait for it; the load to its tracker; all to the log."""
        s, now = self.settings, self.now_us
        x, v = self.plant.kinematics()
        R, Omega = self.plant.attitudes
        if self._steps:
            self._mean.after(v, R, self._way.frame_us * 1e-6)
        force = self._mean.force
        self.seats.tell(now, lambda i: Own(now, R[i], Omega[i], x[i], v[i], force[i]))
        if now % s.truth_us == 0:
            truth = self.plant.truth(now)
            self._sink(truth)
            if now % AIR_US == 0 and (air := self.plant.air(now)) is not None:
                self._sink(air)
            if now % s.tick_us == 0:
                self._track(truth)

    def _track(self, truth: Truth) -> None:
        s, now = self.settings, self.now_us
        self._tracker.tell(self._sensors.tracked(truth))
        if now % LANDED_US == 0 or now == self._stands.released_us:
            landed = encode(LandedState(ON_GROUND if self.plant.restrained else IN_AIR))
            self.link.put(0, tracker.SYSTEM, tracker.COMPONENT, landed)
        if now % tracker.HEARTBEAT_US == 0:
            self.link.put(0, tracker.SYSTEM, tracker.COMPONENT, origin(s.home))
        if now % s.control_us == 0:
            self._controller.ask(now)
        self.link.flush()
