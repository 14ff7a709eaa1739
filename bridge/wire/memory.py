"""Links joined in memory: the bytes that sockets would carry, between two sides of one process and one thread."""

from collections import deque

from bridge.wire.ports import Address, Endpoint, LinkError, Peers

Arrived = deque[tuple[int, Address, bytes]]  # datagrams: the port that they came to, from where, and what
EPHEMERAL = 49152  # the first port of those that nobody asked for


class MemoryPort(Peers):
    """What a DatagramPort is, without a socket."""

    def __init__(
        self, endpoint: Endpoint, network: "MemoryNetwork", arrived: deque[tuple[int, Address, bytes]]
    ) -> None:
        super().__init__(endpoint)
        self._network = network
        self.arrived = arrived  # of the link that the port belongs to
        self.index = -1
        self.here = network.name(endpoint.bind)

    def send(self, data: bytes, address: Address) -> bool:
        """Into the other side's queue; what goes to nobody is gone, as a datagram would be."""
        port = self._network.ports.get(address)
        if port is not None:
            port.arrived.append((port.index, self.here, data))
        return True

    def close(self) -> None:
        """Leave the network."""
        self._network.ports.pop(self.here, None)


class MemoryNetwork:
    """Every address that somebody listens on."""

    def __init__(self) -> None:
        self.ports: dict[Address, MemoryPort] = {}
        self._next = EPHEMERAL

    def open(self, endpoint: Endpoint, index: int, arrived: Arrived) -> MemoryPort:
        """The port of an endpoint, as number `index` of the link that reads from `arrived`.

        Raises LinkError where its address is taken.
        """
        port = MemoryPort(endpoint, self, arrived)
        port.index = index
        if port.here in self.ports:
            raise LinkError("memory {}:{}: it is taken".format(*port.here))
        self.ports[port.here] = port
        return port

    def name(self, bind: Address | None) -> Address:
        """Where a port is that binds there, or anywhere."""
        if bind is not None:
            return bind
        self._next += 1
        return ("127.0.0.1", self._next)
