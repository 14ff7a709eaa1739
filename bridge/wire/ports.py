"""Sockets: where a link listens or speaks, over UDP or TCP, and who is on the other side."""

import ipaddress
import socket
from collections import OrderedDict
from typing import NamedTuple

from bridge.wire.poller import Poller

Address = tuple[str, int]

PEERS_KEPT = 8  # learned addresses per port; the longest silent one is forgotten first
RECEIVE_BUFFER = 4 << 20  # bytes; the system's default holds 256 small datagrams
STREAM_KEPT = 4096  # bytes of an unfinished frame that are kept; more than any frame has
SEND_KEPT = 1 << 18  # bytes that a TCP peer may be behind before it is let go
LARGEST = 65536  # bytes of a datagram
RETRY_S = 0.5  # between attempts to reach a TCP peer

TRACKER_PORTS = (14600, 14640)  # where the controller listens, where the payload tracker does
GROUND_PORT, LISTEN_PORT = 14550, 14555


def vehicle_ports(i: int) -> tuple[int, int]:
    """Where the controller listens for vehicle i (from 0), and where that vehicle does: PX4's numbers.

    From the eleventh on they move up, as 14550 and 14600 are taken.
    """
    return (14540 + i, 14580 + i) if i < 10 else (15540 + i, 16580 + i)


def stream_port(i: int) -> int:
    """Where vehicle i (from 0) waits for TCP clients when it is an ArduCopter: 5760 + 10 i."""
    return 5760 + 10 * i


class LinkError(Exception):
    """An address that cannot be used; the message says which and what to do."""


class Endpoint(NamedTuple):
    """Where a port is, as a URL says it: udpin:, tcpin: listen at HOST:PORT, udpout:, tcp: speak to it."""

    bind: Address | None
    peer: Address | None
    stream: bool = False

    @classmethod
    def parse(cls, url: str) -> "Endpoint":
        """The endpoint of `url`. Raises LinkError naming what is wrong with it."""
        scheme, _, rest = url.partition(":")
        host, _, port = rest.removeprefix("//").rpartition(":")
        known = ("udpin", "udp", "udpout", "tcpin", "tcp", "tcpout")
        if scheme not in known or not host or not port.isdigit() or not 0 < int(port) < 65536:
            raise LinkError(
                f"address {url!r}: write it as udpin:HOST:PORT or tcpin:HOST:PORT (listen), "
                "udpout:HOST:PORT or tcp:HOST:PORT (speak to it)"
            )
        address = (host, int(port))
        listens = scheme in ("udpin", "udp", "tcpin")
        return cls(address if listens else None, None if listens else address, scheme.startswith("tcp"))

    @property
    def local(self) -> bool:
        """Whether nothing but this machine can be on the other side."""
        host = (self.bind or self.peer or ("", 0))[0]
        try:
            return ipaddress.ip_address(host).is_loopback
        except ValueError:
            return host == "localhost"


class Peers:
    """Who is on the other side of a port without connections."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self.peers: OrderedDict[Address, None] = OrderedDict()
        self.heard = endpoint.peer is not None  # whether somebody may be there
        self._newest: Address | None = None  # of the peers
        self._addresses = [] if endpoint.peer is None else [endpoint.peer]

    def learn(self, address: Address) -> None:
        """Remember who spoke to us."""
        if address in (self._newest, self.endpoint.peer):
            return
        if address not in self.peers:
            while len(self.peers) >= PEERS_KEPT:
                self.peers.popitem(last=False)
            self.peers[address] = None
        self.peers.move_to_end(address)
        self._newest, self.heard = address, True
        self._addresses = [*self._addresses[: self.endpoint.peer is not None], *self.peers]

    def addresses(self) -> list[Address]:
        """Everyone a broadcast on this port goes to."""
        return self._addresses


class DatagramPort(Peers):
    """One UDP socket."""

    def __init__(self, endpoint: Endpoint, poller: Poller, index: int) -> None:
        super().__init__(endpoint)
        self._datagram = memoryview(bytearray(LARGEST))
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self.socket.setblocking(False)
        peer = endpoint.peer
        here = endpoint.bind or ("127.0.0.1" if peer is not None and peer[0] == "127.0.0.1" else "", 0)
        bind(self.socket, here, "udp")
        poller.add(self.socket, index)

    def receive(self, ready: socket.socket) -> list[tuple[Address, bytes]]:
        """The datagram that waited longest, whole by itself."""
        del ready
        try:
            size, address = self.socket.recvfrom_into(self._datagram)
        except (BlockingIOError, ConnectionRefusedError):
            return []
        return [(address, bytes(self._datagram[:size]))]

    def send(self, data: bytes, address: Address) -> bool:
        """Whether the system took the datagram."""
        try:
            self.socket.sendto(data, address)
        except (BlockingIOError, ConnectionRefusedError):
            return False
        except OSError:  # an address without a route, or a datagram no interface takes
            return False
        return True

    def listening(self) -> list[socket.socket]:
        """The sockets that data comes in on."""
        return [self.socket]

    def close(self) -> None:
        """Release the socket."""
        self.socket.close()


class StreamPort:
    """TCP: a listener and its clients, or a client that reconnects by itself."""

    def __init__(self, endpoint: Endpoint, poller: Poller, index: int) -> None:
        self.endpoint = endpoint
        self._poller, self._index = poller, index
        self._listener: socket.socket | None = None
        self._clients: dict[Address, socket.socket] = {}
        self._rest: dict[Address, bytes] = {}
        self._unsent: dict[Address, bytes] = {}
        self._next_try = 0.0
        if endpoint.bind is not None:
            self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.setblocking(False)
            bind(self._listener, endpoint.bind, "tcp")
            self._listener.listen(PEERS_KEPT)
            poller.add(self._listener, index)

    def listening(self) -> list[socket.socket]:
        """The sockets that data comes in on."""
        return list(self._clients.values())

    def tend(self, now: float) -> None:
        """Reach for the peer again where nobody is connected."""
        if self.endpoint.peer is None or self._clients or now < self._next_try:
            return
        self._next_try = now + RETRY_S
        try:
            client = socket.create_connection(self.endpoint.peer, timeout=RETRY_S)
        except OSError:
            return
        self._take(client, self.endpoint.peer)

    def receive(self, ready: socket.socket) -> list[tuple[Address, bytes]]:
        """What has come in, cut at the end of the last whole frame; a client that left is forgotten."""
        if ready is self._listener:
            try:
                client, address = self._listener.accept()
            except OSError:
                return []
            if len(self._clients) >= PEERS_KEPT:
                client.close()
            else:
                self._take(client, address)
            return []
        address = next((a for a, c in self._clients.items() if c is ready), None)
        if address is None:
            return []
        try:
            data = ready.recv(LARGEST)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop(address)
            return []
        data = self._rest.pop(address, b"") + data
        whole = _whole_frames(data)
        self._rest[address] = data[whole:][-STREAM_KEPT:]
        return [(address, data[:whole])] if whole else []

    def learn(self, address: Address) -> None:
        """Who is connected is known."""

    @property
    def heard(self) -> bool:
        """Whether somebody is connected."""
        return bool(self._clients)

    def addresses(self) -> list[Address]:
        """Everyone who is connected."""
        return list(self._clients)

    def send(self, data: bytes, address: Address) -> bool:
        """Whether the peer is there and keeps up."""
        client = self._clients.get(address)
        if client is None:
            return False
        waiting = self._unsent.pop(address, b"") + data
        try:
            done = client.send(waiting)
        except BlockingIOError:
            done = 0
        except OSError:
            self._drop(address)
            return False
        if len(waiting) - done > SEND_KEPT:
            self._drop(address)
            return False
        if done < len(waiting):
            self._unsent[address] = waiting[done:]
        return True

    def close(self) -> None:
        """Release every socket."""
        for client in [*self._clients.values(), *([self._listener] if self._listener else [])]:
            client.close()

    def _take(self, client: socket.socket, address: Address) -> None:
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[address] = client
        self._poller.add(client, self._index)

    def _drop(self, address: Address) -> None:
        self._rest.pop(address, None)
        self._unsent.pop(address, None)
        client = self._clients.pop(address)
        self._poller.drop(client)
        client.close()


Port = DatagramPort | StreamPort


def open_port(endpoint: Endpoint, poller: Poller, index: int) -> Port:
    """The port of an endpoint, its sockets watched by `watch`. Raises LinkError for an address that is taken."""
    return (StreamPort if endpoint.stream else DatagramPort)(endpoint, poller, index)


def bind(new: socket.socket, address: Address, kind: str) -> None:
    """Give a socket its address. Raises LinkError, and closes the socket, where that is taken."""
    try:
        new.bind(address)
    except OSError as error:
        new.close()
        where = "{} {}:{}".format(kind, *address)
        raise LinkError(
            f"{where}: {error.strerror or error}; stop the program that has it or choose others (--port-offset)"
        ) from None


def _whole_frames(data: bytes) -> int:
    """How many bytes at the start of a stream are settled: whole frames and what can be none."""
    at, end = 0, len(data)
    while at < end:
        magic = data[at]
        if magic not in (0xFD, 0xFE):
            at += 1
            continue
        if end - at < 3:
            return at
        size = 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0) if magic == 0xFD else 8 + data[at + 1]
        if at + size > end:
            return at
        at += size
    return at
