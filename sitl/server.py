"""n vehicles and a payload tracker on their ports; lockstep or paced. Truth goes to the sink that is handed in.

One tick: deliver what has come due, let every vehicle speak, advance the physics with the commands under way, then wait
for the answers (lockstep) or for the wall clock. A setpoint that answers the state of one tick acts `delay_us` later.
"""

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from bridge.wire.frames import Packed, Signer
from bridge.wire.link import Address, Link, Mishandled, Received
from bridge.wire.link_faults import Channel, Faults, generator
from bridge.wire.memory import MemoryNetwork
from bridge.wire.messages import encode
from bridge.wire.values import IN_AIR, ON_GROUND, AttitudeTarget, Timesync
from cablequad.model import lie
from cablequad.types import Array
from sitl import tracker
from sitl.addresses import CONTROLLER, places, tracker_endpoints
from sitl.batteries import Batteries
from sitl.failures import ActiveFailures
from sitl.firmware.arducopter import ArduCopter
from sitl.firmware.attitude_batch import Attitudes
from sitl.firmware.autopilot import ATTITUDE_QUATERNION, HIGHRES_IMU, Autopilot, Body
from sitl.firmware.navigate import attitude
from sitl.firmware.px4 import Px4
from sitl.firmware.telemetry import BUILD, Snapshot
from sitl.plant import Plant, Truth, UntetheredPlant
from sitl.settings import Event, Report, Settings, Sink, plant_of, sensors_of, unread_frames

PERSONAS: dict[str, type[Px4] | type[ArduCopter]] = {"px4": Px4, "arducopter": ArduCopter}
NO_FORCE = np.zeros(3)
LOOK_S, RESEND_LOOKS = 0.1, 10  # wall clock, of one look for answers; after so many the tick is said again
CATCH_UP = 0.25  # s behind the wall clock that are made up for; more is let go


class Server:
    """The running vehicles."""

    def __init__(self, settings: Settings, sink: Sink, network: MemoryNetwork | None = None) -> None:
        """`network`: instead of sockets, with a controller in the same thread; see `turns`."""
        s = settings
        self.n = n = len(s.system.m)
        self.settings = s
        firmware = s.firmware or ("px4",) * n
        self._places = places(firmware, s.port_offset, s.host)
        trackers = () if s.loose else tracker_endpoints(s.port_offset, s.host)
        signer = Signer(s.signing_key, s.accept_unsigned_telemetry) if s.signing_key is not None else None
        self.link = Link([*(place.endpoint for place in self._places), *trackers], signer, network)
        self.link.reliable = s.lockstep and s.await_controller and network is None
        ports = (len(self._places), len(self._places) + 1)
        self._tracker = tracker.Tracker(self.link, ports, s.system.n_links, s.control_us)
        self.plant = UntetheredPlant(s.system, s.airframe, s.initial, s.physics_us * 1e-6) if s.loose else plant_of(s)
        self._sensors = sensors_of(s)
        self._batteries = Batteries(s.batteries, s.system.m * s.system.g)
        self._ports = [[k for k, p in enumerate(self._places) if p.vehicle in (i, None)] for i in range(n)]
        self.vehicles = [self._vehicle(i, firmware[i]) for i in range(n)]
        self._channels: list[Channel[tuple[int, Received]]] = [
            Channel(s.faults[i] if s.faults else Faults(), generator(s.seed, i + 1, up=True)) for i in range(n)
        ]
        self._faulty = [not c.faults.none for c in self._channels]
        self._down: list[Channel[tuple[int, Packed]] | None] = [
            Channel(f, generator(s.seed, i + 1, up=False)) if not f.none else None
            for i, f in enumerate(s.faults_down[:n])
        ] or [None] * n
        self._sink = sink
        self._mishandled = Mishandled()
        self._broken = ActiveFailures(s.failures, n)
        self._tick = 0
        self._inbox: list[list[tuple[int, Received]]] = [[] for _ in range(self.n)]
        self._engaged = [s.lockstep and s.await_controller] * self.n
        self._controller_port = list(range(self.n))
        self._answered = [-1] * self.n
        self._expected = [False] * self.n  # of the coming tick: whose state goes to the controller
        self._awaited = [False] * self.n  # of this one
        self._awaits_controller = s.lockstep and s.await_controller and not s.loose
        self._seen_us = -1
        self._releasing = False
        self._released_us: int | None = None
        self._truth: Truth | None = None  # of the coming tick
        self._own: list[Snapshot] = []  # of the coming tick
        self._attitudes = Attitudes(sum(len(ports) for ports in self._ports))
        self._closing: list[tuple[int, int, Snapshot]] = []  # ports, and vehicles whose attitude closes the coming tick
        self._missed_answers = 0
        self._missed_deadlines = 0
        self._lateness: list[float] = []
        self._pace_from: tuple[int, float] | None = None
        self._warm_up()
        self._compose(s.tick_us)

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
        counters, tallies = self.link.counters, [c.tally for c in self._channels]
        onboard = range(self.n)
        tracker_port = range(len(self._places), len(self.link.ports) - 1)
        unread = sum(len(inbox) for inbox in self._inbox)
        return Report(
            self._tick, self._missed_answers, self._missed_deadlines, tuple(self._lateness),
            sum(counters.sent_on[k] for k in (*onboard, *tracker_port)), sum(counters.received_on[k] for k in onboard),
            sum(t.passed for t in tallies), sum(t.lost for t in tallies), sum(t.duplicated for t in tallies),
            sum(t.waiting for t in tallies) + unread, unread_frames(counters), self._mishandled.counts,
        )  # fmt: skip

    def close(self) -> None:
        """Send what waits and release the sockets."""
        self.link.close()

    def _vehicle(self, i: int, firmware: str) -> Autopilot:
        s = self.settings
        body = Body(float(s.system.m[i]), float(s.airframe.max_thrust[i]), s.system.g, s.density_ratio)
        links = tuple(self._places[k].kind for k in self._ports[i])
        ready = s.ready_us[i] if s.ready_us else None
        persona = PERSONAS[firmware]
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
        self._attitudes.tell(0, [own.R], [own.Omega])
        self._attitudes.framed(bytes(1), bytes(1), 1, 0)
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
        self.link.flush()
        self._awaited = list(self._expected)
        if self._truth is not None:
            self._sink(self._truth)
        for i, vehicle in enumerate(self.vehicles):
            self._deliver(i, vehicle, now)
            vehicle.tick(now)
        self._settle(now)
        if isinstance(self.plant, Plant):
            self._batteries.use(self.plant, s.tick_us * 1e-6)
        for subject, text in self._broken.act(now, self._released_us, self.plant, self.vehicles):
            self._sink(Event(now, "failure", subject, text))
        self.plant.command([vehicle.actuation(own) for vehicle, own in zip(self.vehicles, self._own, strict=True)])
        for part in range(1, s.tick_us // s.truth_us + 1):
            if part > 1 and isinstance(self.plant, Plant):
                self._sink(self.plant.truth(now + (part - 1) * s.truth_us))
            self.plant.advance(s.truth_us // s.physics_us)
        self._compose(now + s.tick_us)

    def _compose(self, now: int) -> None:
        """Put together what is said at `now`: sensors tell what acted until then."""
        x, v = self.plant.kinematics()
        R, Omega = self.plant.attitudes
        self._truth = self.plant.truth(now) if isinstance(self.plant, Plant) else None
        with_imu = any(vehicle.will_tell(HIGHRES_IMU, now) for vehicle in self.vehicles)
        force: Sequence[Array] = [NO_FORCE] * self.n
        if with_imu and isinstance(self.plant, UntetheredPlant):
            force = list(self.plant.specific_force())
        elif with_imu:
            assert self._truth is not None
            assert isinstance(self.plant, Plant)
            force = list(self.plant.specific_force(self._truth))
        home = self.settings.home
        self._own = []
        for i, vehicle in enumerate(self.vehicles):
            own = self._self_image(i, vehicle.snapshot(now, R[i], Omega[i], x[i], v[i], force[i], home))
            self._own.append(own)
            self._speak(i, vehicle, self._sensors.vehicle(i, own, with_imu))
        if self._closing:
            self._close(now)
        if self._truth is not None:
            self._tracker.tell(self._sensors.tracked(self._truth))

    def _self_image(self, i: int, own: Snapshot) -> Snapshot:
        """What vehicle i takes itself to be, with what is broken."""
        off, battery = self._broken.astray(i, own.boot_us), min(self._broken.battery[i], self._batteries.left[i])
        if off is not None:
            return own._replace(x=own.x + off, gps_fix=1, battery=battery)
        return own if battery == own.battery else own._replace(battery=battery)

    def _deliver(self, i: int, vehicle: Autopilot, now: int) -> None:
        waiting = []
        for due, frame in self._inbox[i]:
            if due > now:
                waiting.append((due, frame))
            elif self._faulty[i]:
                self._channels[i].put((frame.port, frame), len(frame.frame), now)
            else:
                self._hand(i, vehicle, frame, now)
        self._inbox[i] = waiting
        if self._faulty[i]:
            for _, frame in self._channels[i].take(now):
                self._hand(i, vehicle, frame, now)

    def _hand(self, i: int, vehicle: Autopilot, frame: Received, now: int) -> None:
        try:
            vehicle.handle(self._ports[i].index(frame.port), frame.system, frame.component, frame.value, now)
        except Exception as error:
            if text := self._mishandled.take(frame, error):
                self._sink(Event(now, "mishandled", f"vehicle {i + 1}", text))

    def _settle(self, now: int) -> None:
        """Release, land, go back to the start. A release is told with the state that it begins from."""
        plant = self.plant
        if plant.restrained and self._releasing:
            plant.restrained = self._releasing = False
            self._sink(Event(now, "release", "all", "every vehicle is armed and under command: released"))
            self._released(now)
        elif plant.restrained:
            self._releasing = all(v.carries(now) for v in self.vehicles)
        elif isinstance(plant, Plant) and plant.grounded:
            self._begin_on_ground(now)
        elif isinstance(plant, Plant) and not any(v.armed for v in self.vehicles):
            plant.reset()
            self._sink(Event(now, "reset", "all", "every vehicle is disarmed: back to the initial state, held"))
        for vehicle, stands in zip(self.vehicles, plant.standing(), strict=True):
            vehicle.set_landed(ON_GROUND if stands and not self._releasing else IN_AIR)

    def _begin_on_ground(self, now: int) -> None:
        """Where nothing is held the time of faults and failures begins once all are armed."""
        if self._released_us is None and all(v.armed for v in self.vehicles):
            self._sink(Event(now, "release", "all", "every vehicle is armed, on the ground"))
            self._released(now)

    def _released(self, now: int) -> None:
        self._released_us = now
        for channel in (*self._channels, *self._down):
            if channel is not None:
                channel.released_us = now

    def _speak(self, i: int, vehicle: Autopilot, snapshot: Snapshot) -> None:
        audible, ports, down = self._audible(i), self._ports[i], self._down[i]
        for message_of, message in vehicle.outgoing(snapshot, audible):
            for link, port in enumerate(ports):
                if (message_of is None or message_of == link) and audible[link]:
                    self._say(i, port, message, snapshot.boot_us)
        self._expected[i] = False
        for link in vehicle.closing:
            port = ports[link]
            if down is not None:
                self._say(i, port, BUILD[ATTITUDE_QUATERNION](snapshot), snapshot.boot_us)
            else:
                self._closing.append((port, vehicle.system_id, snapshot))
                self._expected[i] = self._expected[i] or port == self._controller_port[i]
        if down is not None:
            for port, message in down.take(snapshot.boot_us):
                self.link.put(port, vehicle.system_id, 1, message)

    def _say(self, i: int, port: int, message: Packed, now: int) -> None:
        down = self._down[i]
        if down is None:
            self.link.put(port, self.vehicles[i].system_id, 1, message)
        else:
            down.put((port, message), len(message.payload) + 12, now)

    def _close(self, now: int) -> None:
        """The attitudes of all, where links do not fail."""
        ports, systems, own = zip(*self._closing, strict=True)
        self._attitudes.tell(now // 1000, [s.R for s in own], [s.Omega for s in own])
        to: list[tuple[int, Address | None]] = [(port, None) for port in ports]
        self.link.put_all(to, bytes(systems), 1, self._attitudes)
        self._closing = []

    def _audible(self, i: int) -> tuple[bool, ...]:
        """On which of vehicle i's links somebody may listen."""
        return tuple([self.link.ports[p].heard for p in self._ports[i]])

    def _receive(self, timeout: float, closing: int | None = None) -> None:
        now = self.now_us
        for frame in self.link.poll(timeout, closing):
            value = frame.value
            if value is None or frame.port >= len(self._places):
                if isinstance(value, Timesync) and value.tc1 == now * 1000 and frame.system == CONTROLLER[0]:
                    self._seen_us = now  # the controller has seen this tick and has nothing more to say to it
                elif isinstance(value, Timesync) and value.tc1 == 0:
                    answer = encode(Timesync(now * 1000, value.ts1))
                    self.link.put(frame.port, tracker.SYSTEM, tracker.COMPONENT, answer)
                continue
            due = now + self.settings.tick_us
            if isinstance(value, AttitudeTarget) and (frame.system, frame.component) == CONTROLLER:
                stamp_us = value.boot_ms * 1000
                if 0 < stamp_us <= now and 1 <= value.system <= self.n:
                    due = max(due, stamp_us + self.settings.delay_us[value.system - 1])
                    self._answer(frame, value, now)
            place = self._places[frame.port].vehicle
            for i in range(self.n) if place is None else (place,):
                self._inbox[i].append((due, frame))

    def _answer(self, frame: Received, value: AttitudeTarget, now: int) -> None:
        i = value.system - 1
        if 0 <= i < self.n:
            self._answered[i] = value.boot_ms
            self._controller_port[i] = frame.port
            if self.settings.lockstep and value.boot_ms * 1000 == now:
                self._engaged[i] = True
                self._awaits_controller = not self.settings.loose

    def _wait(self, stop: Callable[[], bool]) -> Iterator[None]:
        """Until every engaged vehicle that spoke has its answer; where nobody is engaged, until the wall clock says."""
        if any(self._engaged):
            self._pace_from = None
            yield from self._barrier(stop)
        else:
            self._pace()
            yield

    def _barrier(self, stop: Callable[[], bool]) -> Iterator[None]:
        now_ms = self.now_us // 1000
        deadline = self.link.now() + self.settings.answer_timeout_s
        closing: int | None = max(self._controller_port)  # the controller answers vehicle by vehicle
        if self.now_us % self.settings.control_us != 0:
            self._receive(0.0)
            return
        read, looks = False, 0  # all that has come; in vain
        while not stop():
            missing = [
                i for i in range(self.n) if self._engaged[i] and self._awaited[i] and self._answered[i] != now_ms
            ]
            quiet = self._awaits_controller and not any(self._awaited)  # nobody told the controller its state
            answered = any(self._answered[i] == now_ms for i in range(self.n))
            awaited = bool(missing) or (quiet and not answered)
            if not awaited or self._seen_us == self.now_us:
                if not read:
                    self._receive(0.0)
                return
            left = deadline - self.link.now()
            if left <= 0:
                self._missed_answers += len(missing)
                for i in missing:
                    self._engaged[i] = False
                self._awaits_controller = False
                names = ", ".join(str(i + 1) for i in missing) or "any"
                self._sink(
                    Event(self.now_us, "answer-missing", names, f"no setpoint for this tick from vehicle {names}")
                )
                return
            if self.link.reliable and looks == RESEND_LOOKS:  # a datagram may be lost; who only is slow leaves it out
                self.link.resend({*self._controller_port, len(self._places)})  # and the tracker's
                looks = 0
            looks += 1
            self._receive(min(left, LOOK_S), closing)
            closing, read = None, True
            yield

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
