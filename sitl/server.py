"""n vehicles and a payload tracker on their ports; lockstep or paced. Truth goes to the sink that is handed in.

One tick: deliver what has come due, let every vehicle speak, advance the physics with the commands under way, then wait
for the answers (lockstep) or for the wall clock. A setpoint that answers the state of one tick acts `delay_us` later.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from bridge.wire.frames import Signer
from bridge.wire.link import Link, Received
from bridge.wire.memory import MemoryNetwork
from bridge.wire.messages import encode
from bridge.wire.values import AttitudeTarget, Timesync
from cablequad.model import lie
from cablequad.types import Array
from sitl import tracker
from sitl.addresses import CONTROLLER, places, tracker_endpoints
from sitl.condition import Condition
from sitl.firmware.autopilot import HIGHRES_IMU, Autopilot, Body
from sitl.firmware.navigate import attitude
from sitl.firmware.personas import PERSONAS
from sitl.firmware.telemetry import BUILD, Snapshot
from sitl.pacing import Pace
from sitl.plant import AIR_US, Plant, Truth
from sitl.release import Release
from sitl.settings import Event, Report, Settings, Sink, plant_of, sensors_of, unread_frames
from sitl.tick_answers import TickAnswers
from sitl.untethered_plant import UntetheredPlant
from sitl.vehicle_links import VehicleLinks

NO_FORCE = np.zeros(3)
LOOK_S, RESEND_LOOKS = 0.1, 10  # wall clock, of one look for answers; after so many the tick is said again
CATCH_UP = 0.25  # s behind the wall clock that are made up for; more is let go


class Server:
    """The running vehicles."""

    def __init__(self, settings: Settings, sink: Sink, network: MemoryNetwork | None = None) -> None:
        """`network`: instead of sockets, with a controller in the same thread; see `turns`."""
        self.settings = s = settings
        firmware = s.firmware or ("px4",) * self.n
        onboard = places(firmware, s.port_offset, s.host)
        trackers = () if s.untethered else tracker_endpoints(s.port_offset, s.host)
        ours = s.lockstep and s.await_controller  # nobody but our controller decides when time goes on
        signer = None
        if s.signing_key is not None:
            signer = Signer(s.signing_key, s.accept_unsigned_telemetry, s.home.epoch_s if ours else None)
        self.link = Link([*(place.endpoint for place in onboard), *trackers], signer, network)
        self.link.reliable = ours and network is None
        self.links = VehicleLinks(self.link, onboard, s)
        self._tracker_port = len(onboard)
        ports = (self._tracker_port, self._tracker_port + 1)
        self._tracker = tracker.Tracker(self.link, ports, s.system.n_links, s.control_us)
        self.plant = (
            UntetheredPlant(s.system, s.airframe, s.initial, s.physics_us * 1e-6) if s.untethered else plant_of(s)
        )
        self._sensors = sensors_of(s)
        self.vehicles = [self._vehicle(i, firmware[i]) for i in range(self.n)]
        self._sink = sink
        self._condition = Condition(s, lambda event: self._sink(event))
        self._release = Release(lambda event: self._sink(event), self.links.released)
        self._answers = TickAnswers(self.n, s.lockstep, s.await_controller, s.untethered)
        self._pace = Pace(s.speed, s.tick_us)
        self._tick = 0
        self._coming: tuple[Truth | None, list[Snapshot]] = (None, [])  # of the coming tick
        self._warm_up()
        self._compose(s.tick_us)

    @property
    def n(self) -> int:
        """How many vehicles there are."""
        return len(self.settings.system.m)

    @property
    def now_us(self) -> int:
        """The vehicles' clock."""
        return self._tick * self.settings.tick_us

    def run(self, stop: Callable[[], bool]) -> Report:
        """Serve until `stop()`; the report says how time was kept. Raises PhysicsError if the motion diverges."""
        for _ in self.turns(stop):
            pass
        return self.report()

    def turns(self, stop: Callable[[], bool]) -> Iterator[None]:
        """`run`, with a turn for others whenever answers are looked for; over sockets that took its time already."""
        while not stop():
            self._tick += 1
            self._one_tick()
            yield from self._wait(stop)
        self.link.flush()
        self._receive(0.0)

    def report(self) -> Report:
        """How time was kept so far."""
        counters, tallies, kept = self.link.counters, self.links.tallies, self._pace
        onboard = range(self.n)
        tracker_port = range(self._tracker_port, len(self.link.ports) - 1)
        unread = sum(len(inbox) for inbox in self.links.inbox)
        return Report(
            self._tick, self._answers.missed, kept.missed, tuple(kept.lateness_s),
            sum(counters.sent_on[k] for k in (*onboard, *tracker_port)), sum(counters.received_on[k] for k in onboard),
            sum(t.passed for t in tallies), sum(t.lost for t in tallies), sum(t.duplicated for t in tallies),
            sum(t.waiting for t in tallies) + unread, unread_frames(counters), self.links.mishandled.counts,
        )  # fmt: skip

    def close(self) -> None:
        """Send what waits and release the sockets."""
        self.link.close()

    def _vehicle(self, i: int, firmware: str) -> Autopilot:
        s = self.settings
        body = Body(float(s.system.m[i]), float(s.airframe.max_thrust[i]), s.system.g, s.density_ratio)
        links = self.links.kinds(i)
        ready = s.ready_us[i] if s.ready_us else None
        persona = PERSONAS[firmware].vehicle
        vehicle: Autopilot = (
            persona(i + 1, s.tick_us, links, body) if ready is None else persona(i + 1, s.tick_us, links, body, ready)
        )
        for streams in vehicle.streams:
            streams.phase_us = s.phase_us[i]
        for name, value in (s.parameters[i] if s.parameters else {}).items():
            vehicle.parameters.preset(name, value)
        return vehicle

    def _warm_up(self) -> None:
        """Build every message once, so that nothing is compiled while the clock runs."""
        (x, v), (R, Omega) = self.plant.kinematics(), self.plant.attitudes
        own = self.vehicles[0].snapshot(0, R[0], Omega[0], x[0], v[0], NO_FORCE, self.settings.home)
        for build in BUILD.values():
            build(own)
        self.links.warm_up(own)
        self.vehicles[0].navigator.begin(own, 10.0)
        attitude(own, self.vehicles[0].navigator.force(own))
        self.vehicles[0].navigator.end()
        lie.rotation_from_quat(np.array((1.0, 0.0, 0.0, 0.0)))  # what setpoints take
        lie.rotation_from_wxyz(1.0, 0.0, 0.0, 0.0)
        lie.exp(np.zeros(3))
        if isinstance(self.plant, Plant):
            self._tracker.warm_up(self.plant.truth(0))

    def _one_tick(self) -> None:
        """Speak, listen, move on. What is said at a tick was settled before it: what was commanded until then acted.

        So the controller hears the new state as soon as its answers to the one before are in, and thinks while the
        vehicles take those answers and the physics goes on.
        """
        s, now = self.settings, self.now_us
        truth, own = self._coming
        self.link.advance(now)
        self.link.flush()
        self._answers.begin()
        if truth is not None:
            self._sink(truth)
        for i, vehicle in enumerate(self.vehicles):
            self._deliver(i, vehicle, now)
            vehicle.tick(now)
        self._release.settle(now, self.plant, self.vehicles)
        self._condition.act(now, s.tick_us, self._release.at_us, self.plant, self.vehicles)
        if isinstance(self.plant, Plant) and now % AIR_US == 0 and (air := self.plant.air(now)) is not None:
            self._sink(air)
        self.plant.command([vehicle.actuation(image) for vehicle, image in zip(self.vehicles, own, strict=True)])
        for part in range(1, s.tick_us // s.truth_us + 1):
            if part > 1 and isinstance(self.plant, Plant):
                self._sink(self.plant.truth(now + (part - 1) * s.truth_us))
            self.plant.advance(s.truth_us // s.physics_us)
        self._compose(now + s.tick_us)

    def _deliver(self, i: int, vehicle: Autopilot, now: int) -> None:
        for text in self.links.deliver(i, vehicle, now):
            self._sink(Event(now, "mishandled", f"vehicle {i + 1}", text))

    def _compose(self, now: int) -> None:
        """Put together what is said at `now`: sensors tell what acted until then."""
        x, v = self.plant.kinematics()
        R, Omega = self.plant.attitudes
        truth = self.plant.truth(now) if isinstance(self.plant, Plant) else None
        with_imu = any(vehicle.out.will_tell(HIGHRES_IMU, now) for vehicle in self.vehicles)
        force: Sequence[Array] = [NO_FORCE] * self.n
        if with_imu and isinstance(self.plant, UntetheredPlant):
            force = list(self.plant.specific_force())
        elif with_imu:
            assert truth is not None
            assert isinstance(self.plant, Plant)
            force = list(self.plant.specific_force(truth))
        images = []
        for i, vehicle in enumerate(self.vehicles):
            own = vehicle.snapshot(now, R[i], Omega[i], x[i], v[i], force[i], self.settings.home)
            image = self._condition.self_image(i, own)
            images.append(image)
            self._answers.expect(i, self.links.speak(i, vehicle, self._sensors.vehicle(i, image, with_imu)))
        self.links.close(now)
        if truth is not None:
            self._tracker.tell(self._sensors.tracked(truth))
        self._coming = (truth, images)

    def _receive(self, timeout: float, closing: int | None = None) -> None:
        now = self.now_us
        for frame in self.link.poll(timeout, closing):
            value = frame.value
            if value is None or frame.port >= self._tracker_port:
                if isinstance(value, Timesync) and value.tc1 == now * 1000 and frame.system == CONTROLLER[0]:
                    self._answers.dealt_with(now)
                elif isinstance(value, Timesync) and value.tc1 == 0:
                    answer = encode(Timesync(now * 1000, value.ts1))
                    self.link.put(frame.port, tracker.SYSTEM, tracker.COMPONENT, answer)
                continue
            self.links.receive(frame, self._due(frame, now))

    def _due(self, frame: Received, now: int) -> int:
        """When (us) a frame reaches its vehicle: a setpoint that answers a state, the link's delay after that."""
        value, due = frame.value, now + self.settings.tick_us
        if isinstance(value, AttitudeTarget) and (frame.system, frame.component) == CONTROLLER:
            stamp_us = value.boot_ms * 1000
            if 0 < stamp_us <= now and 1 <= value.system <= self.n:
                due = max(due, stamp_us + self.settings.delay_us[value.system - 1])
                self._answers.take(value.system - 1, frame.port, value.boot_ms, now)
        return due

    def _wait(self, stop: Callable[[], bool]) -> Iterator[None]:
        """Until every engaged vehicle that spoke has its answer; where nobody is engaged, until the wall clock says."""
        if self._answers.engaged:
            self._pace.restart()
            yield from self._barrier(stop)
        else:
            self._keep_pace()
            yield

    def _barrier(self, stop: Callable[[], bool]) -> Iterator[None]:
        if self.now_us % self.settings.control_us != 0:
            self._receive(0.0)
            return
        deadline = self.link.now() + self.settings.answer_timeout_s
        closing: int | None = max(self._answers.controller_ports)  # the controller answers vehicle by vehicle
        read, looks = False, 0  # all that has come; in vain
        while not stop():
            missing = self._answers.missing(self.now_us)
            if missing is None:
                if not read:
                    self._receive(0.0)
                return
            left = deadline - self.link.now()
            if left <= 0:
                self._answers.give_up(missing)
                names = ", ".join(str(i + 1) for i in missing) or "any"
                self._sink(
                    Event(self.now_us, "answer-missing", names, f"no setpoint for this tick from vehicle {names}")
                )
                return
            if self.link.reliable and looks == RESEND_LOOKS:  # a datagram may be lost; who only is slow leaves it out
                self.link.resend({*self._answers.controller_ports, self._tracker_port})
                looks = 0
            looks += 1
            self._receive(min(left, LOOK_S), closing)
            closing, read = None, True
            yield

    def _keep_pace(self) -> None:
        deadline = self._pace.deadline(self.now_us, self.link.now(), self.settings.tick_us)
        self._receive(0.0)
        while (left := deadline - self.link.now()) > 0:
            self._receive(left)
        self._pace.begun(-left)
        if -left > CATCH_UP:
            self._pace.restart()
