"""What each vehicle sends and receives, over links that may lose, delay and repeat."""

from collections.abc import Sequence

from bridge.wire.frames import Packed
from bridge.wire.link import Address, Link, Mishandled, Received
from bridge.wire.link_faults import Channel, FaultCounts, Faults, generator
from sitl.addresses import Place
from sitl.firmware.attitude_batch import Attitudes
from sitl.firmware.autopilot import Autopilot, LinkKind
from sitl.firmware.outbox import ATTITUDE_QUATERNION
from sitl.firmware.telemetry import BUILD, Snapshot
from sitl.settings import Settings


class VehicleLinks:
    """The links of n vehicles, each on its ports of one `Link`."""

    def __init__(self, link: Link, places: Sequence[Place], s: Settings) -> None:
        n = len(s.system.m)
        self._link, self._places = link, places
        self.ports = [[k for k, p in enumerate(places) if p.vehicle in (i, None)] for i in range(n)]
        self._up: list[Channel[tuple[int, Received]]] = [
            Channel(s.faults[i] if s.faults else Faults(), generator(s.seed, i + 1, up=True)) for i in range(n)
        ]
        self._faulty = [not c.faults.none for c in self._up]
        self._down: list[Channel[tuple[int, Packed]] | None] = [
            Channel(f, generator(s.seed, i + 1, up=False)) if not f.none else None
            for i, f in enumerate(s.faults_down[:n])
        ] or [None] * n
        self.mishandled = Mishandled()
        self.inbox: list[list[tuple[int, Received]]] = [[] for _ in range(n)]  # each with when it is due
        self._attitudes = Attitudes(sum(len(ports) for ports in self.ports))
        self._closing: list[tuple[int, int, Snapshot]] = []  # ports, and vehicles whose attitude closes the coming tick

    @property
    def tallies(self) -> list[FaultCounts]:
        """What became of the frames that each vehicle was sent."""
        return [channel.tally for channel in self._up]

    def kinds(self, i: int) -> tuple[LinkKind, ...]:
        """What each link of vehicle i is for."""
        return tuple(self._places[k].kind for k in self.ports[i])

    def released(self, now: int) -> None:
        """The time of links that fail begins."""
        for channel in (*self._up, *self._down):
            if channel is not None:
                channel.released_us = now

    def warm_up(self, own: Snapshot) -> None:
        """Make the attitudes once, so that nothing is compiled while the clock runs."""
        self._attitudes.tell(0, [own.R], [own.Omega])
        self._attitudes.framed(bytes(1), bytes(1), 1, 0)

    # -- what comes in -------------------------------------------------------------------------------------------------

    def receive(self, frame: Received, due: int) -> None:
        """Keep a frame for whoever is on its port until `due` (us)."""
        place = self._places[frame.port].vehicle
        for i in range(len(self.inbox)) if place is None else (place,):
            self.inbox[i].append((due, frame))

    def deliver(self, i: int, vehicle: Autopilot, now: int) -> list[str]:
        """Hand over what is due; what could not be handled, in words."""
        waiting, handed = [], []
        for due, frame in self.inbox[i]:
            if due > now:
                waiting.append((due, frame))
            elif self._faulty[i]:
                self._up[i].put((frame.port, frame), len(frame.frame), now)
            else:
                handed.append(frame)
        self.inbox[i] = waiting
        if self._faulty[i]:
            handed += [frame for _, frame in self._up[i].take(now)]
        texts = []
        for frame in handed:
            try:
                vehicle.handle(self.ports[i].index(frame.port), frame.system, frame.component, frame.value, now)
            except Exception as error:
                if text := self.mishandled.take(frame, error):
                    texts.append(text)
        return texts

    # -- what goes out -------------------------------------------------------------------------------------------------

    def speak(self, i: int, vehicle: Autopilot, own: Snapshot) -> list[int]:
        """Send what vehicle i says of itself; on which ports its attitude will close the tick (`close`)."""
        ports, down, now = self.ports[i], self._down[i], own.boot_us
        audible = [self._link.ports[p].heard for p in ports]  # where somebody may listen
        for message_of, message in vehicle.outgoing(own, audible):
            for k, port in enumerate(ports):
                if (message_of is None or message_of == k) and audible[k]:
                    self._say(i, port, vehicle.system_id, message, now)
        closing = [ports[k] for k in vehicle.out.closing]
        if down is None:
            self._closing += [(port, vehicle.system_id, own) for port in closing]
            return closing
        for port in closing:
            self._say(i, port, vehicle.system_id, BUILD[ATTITUDE_QUATERNION](own), now)
        for port, message in down.take(now):
            self._link.put(port, vehicle.system_id, 1, message)
        return []

    def _say(self, i: int, port: int, system: int, message: Packed, now: int) -> None:
        down = self._down[i]
        if down is None:
            self._link.put(port, system, 1, message)
        else:
            down.put((port, message), len(message.payload) + 12, now)

    def close(self, now: int) -> None:
        """Send the attitudes of all, where links do not fail."""
        if not self._closing:
            return
        ports, systems, own = zip(*self._closing, strict=True)
        self._attitudes.tell(now // 1000, [s.R for s in own], [s.Omega for s in own])
        to: list[tuple[int, Address | None]] = [(port, None) for port in ports]
        self._link.put_all(to, bytes(systems), 1, self._attitudes)
        self._closing = []
