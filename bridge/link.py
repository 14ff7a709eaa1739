"""Bytes <-> values on UDP: addresses, ids, sequence numbers, checksums. The only clock and the only wait.

Every datagram is split and checked by itself, so a bad one never disturbs the next. Frames are MAVLink 2 out, 1 or 2
in.
"""

import selectors
import socket
import time
from collections import OrderedDict
from typing import Any, NamedTuple

import fastcrc

from bridge.wire.dialect import Message, mavlink
from bridge.wire.messages import READABLE, decode

Address = tuple[str, int]

PEERS_KEPT = 8  # learned addresses per port; the longest silent one is forgotten first
RECEIVE_BUFFER = 4 << 20  # bytes; the system's default holds 256 small datagrams
_checksum = fastcrc.crc16.mcrf4xx


TRACKER_PORTS = (14600, 14640)  # where the controller listens, where the payload tracker does
GROUND_PORT, LISTEN_PORT = 14550, 14555


def vehicle_ports(i: int) -> tuple[int, int]:
    """Where the controller listens for vehicle i (from 0), and where that vehicle does: PX4's numbers.

    From the eleventh on they move up, as 14550 and 14600 are taken.
    """
    return (14540 + i, 14580 + i) if i < 10 else (15540 + i, 16580 + i)


class LinkError(Exception):
    """An address that cannot be used; the message says which and what to do."""


class Received(NamedTuple):
    """One frame that passed its checksum."""

    port: int  # index of the port it came in on
    address: Address
    system: int
    component: int
    seq: int
    msgid: int
    name: str
    frame: bytes
    value: Any  # from bridge.wire.values, or None for a message nobody here reads


class Sent(NamedTuple):
    """One frame that went out."""

    system: int
    component: int
    seq: int
    msgid: int
    name: str
    frame: bytes


class Endpoint(NamedTuple):
    """Where a port is, as a URL says it: `udpin:HOST:PORT` listens there, `udpout:HOST:PORT` speaks to it."""

    bind: Address | None
    peer: Address | None

    @classmethod
    def parse(cls, url: str) -> "Endpoint":
        """The endpoint of `url`. Raises LinkError naming what is wrong with it."""
        scheme, _, rest = url.partition(":")
        host, _, port = rest.removeprefix("//").rpartition(":")
        if scheme not in ("udpin", "udpout", "udp") or not host or not port.isdigit() or not 0 < int(port) < 65536:
            raise LinkError(f"address {url!r}: write it as udpin:HOST:PORT (listen) or udpout:HOST:PORT (speak to it)")
        address = (host, int(port))
        return cls(None, address) if scheme == "udpout" else cls(address, None)


class Port:
    """One UDP socket and who is on the other side."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self.peers: OrderedDict[Address, None] = OrderedDict()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self.socket.setblocking(False)
        try:
            self.socket.bind(endpoint.bind or ("127.0.0.1" if endpoint.peer[0] == "127.0.0.1" else "", 0))  # type: ignore[index]
        except OSError as error:
            self.socket.close()
            where = "udp {}:{}".format(*(endpoint.bind or ("", 0)))
            raise LinkError(
                f"{where}: {error.strerror or error}; stop the program that has it or choose others (--port-offset)"
            ) from None

    def learn(self, address: Address) -> None:
        """Remember who spoke to us."""
        if address == self.endpoint.peer:
            return
        if address not in self.peers:
            while len(self.peers) >= PEERS_KEPT:
                self.peers.popitem(last=False)
        self.peers[address] = None
        self.peers.move_to_end(address)

    def addresses(self) -> list[Address]:
        """Everyone a broadcast on this port goes to."""
        fixed = [] if self.endpoint.peer is None else [self.endpoint.peer]
        return [*fixed, *self.peers]


class Counters:
    """What a link has seen."""

    def __init__(self) -> None:
        self.sent = 0
        self.received = 0
        self.lost = 0  # by gaps in sequence numbers
        self.bad = 0  # frames that did not parse or failed their checksum


class Link:
    """Ports that are waited on together, and the clock."""

    def __init__(self, endpoints: list[Endpoint]) -> None:
        self.ports: list[Port] = []
        self.counters = Counters()
        self._selector = (
            selectors.SelectSelector()
        )  # select() waits with microsecond resolution, epoll with milliseconds
        self._codec = mavlink.MAVLink(None)
        self._next_seq: dict[tuple[int, int, int], int] = {}
        self._last_seq: dict[tuple[int, int, int], int] = {}
        try:
            for index, endpoint in enumerate(endpoints):
                port = Port(endpoint)
                self.ports.append(port)
                self._selector.register(port.socket, selectors.EVENT_READ, index)
        except BaseException:
            self.close()
            raise

    def now(self) -> float:
        """Wall-clock seconds, monotonic."""
        return time.monotonic()

    def sleep_until(self, deadline: float) -> None:
        """Wait for a wall-clock time of `now`, doing nothing."""
        time.sleep(max(0.0, deadline - time.monotonic()))

    def poll(self, timeout: float) -> list[Received]:
        """Frames that have arrived, waiting up to `timeout` s for the first."""
        out: list[Received] = []
        for key, _ in self._selector.select(max(0.0, timeout)):
            index = int(key.data)
            port = self.ports[index]
            while True:
                try:
                    datagram, address = port.socket.recvfrom(65536)
                except (BlockingIOError, ConnectionRefusedError):
                    break
                frames = self._split(index, address, datagram)
                if frames:
                    port.learn(address)
                    out += frames
        return out

    def send(self, port: int, system: int, component: int, message: Message, to: Address | None = None) -> Sent:
        """Put one message on the wire as (system, component): to one address, or to everyone on the port."""
        key = (port, system, component)
        seq = self._next_seq.get(key, 0)
        self._next_seq[key] = (seq + 1) & 255
        codec = self._codec
        codec.seq, codec.srcSystem, codec.srcComponent = seq, system, component
        frame = bytes(message.pack(codec))
        here = self.ports[port]
        for address in [to] if to is not None else here.addresses():
            try:
                here.socket.sendto(frame, address)
            except (BlockingIOError, ConnectionRefusedError):
                self.counters.lost += 1
        self.counters.sent += 1
        return Sent(system, component, seq, message.get_msgId(), message.get_type(), frame)

    def close(self) -> None:
        """Release the sockets."""
        self._selector.close()
        for port in self.ports:
            port.socket.close()

    def _split(self, port: int, address: Address, data: bytes) -> list[Received]:
        out: list[Received] = []
        at, end = 0, len(data)
        while at < end:
            magic = data[at]
            if magic == 0xFD and at + 12 <= end:
                size = 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
                supported = not data[at + 2] & ~1
                seq, system, component = data[at + 4], data[at + 5], data[at + 6]
                msgid = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
                body = 10
            elif magic == 0xFE and at + 8 <= end:
                size, supported, body = 8 + data[at + 1], True, 6
                seq, system, component, msgid = data[at + 2], data[at + 3], data[at + 4], data[at + 5]
            else:
                at += 1
                self.counters.bad += 1
                continue
            frame = data[at : at + size]
            kind = mavlink.mavlink_map.get(msgid)
            if len(frame) < size or not supported or kind is None:
                self.counters.bad += 1
                at += size if len(frame) == size else 1
                continue
            tail = body + frame[1]
            if _checksum(frame[1:tail] + bytes((kind.crc_extra,))) != frame[tail] | frame[tail + 1] << 8:
                self.counters.bad += 1
                at += 1
                continue
            at += size
            value = None
            if msgid in READABLE:
                try:
                    value = decode(self._codec.decode(bytearray(frame)))
                except (mavlink.MAVError, ValueError, OverflowError, ZeroDivisionError):
                    self.counters.bad += 1
                    continue
            self._count(port, system, component, seq)
            out.append(Received(port, address, system, component, seq, msgid, kind.msgname, frame, value))
        return out

    def _count(self, port: int, system: int, component: int, seq: int) -> None:
        key = (port, system, component)
        last = self._last_seq.get(key)
        if last is not None:
            gap = (seq - last - 1) & 255
            if gap < 128:  # more means an old frame that came late
                self.counters.lost += gap
        self._last_seq[key] = seq
        self.counters.received += 1
