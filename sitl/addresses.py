"""Where the vehicles and their tracker are: ports by the conventions of their firmware."""

from typing import NamedTuple

from bridge.wire.ports import GROUND_PORT, LISTEN_PORT, TRACKER_PORTS, Endpoint, stream_port, vehicle_ports
from sitl.firmware.autopilot import LinkKind
from sitl.firmware.personas import PERSONAS

CONTROLLER = (250, 191)  # system and component whose answers may hold the clock


class Place(NamedTuple):
    """What one of the server's ports is for."""

    endpoint: Endpoint
    vehicle: int | None  # None: all of them, or the tracker
    kind: LinkKind


def places(firmware: tuple[str, ...], offset: int, host: str) -> list[Place]:
    """Every port of the vehicles, by their firmware's conventions.

    Onboard links and ground station links (14580 + i -> 14540 + i and 18570 + i -> 14550), 14555 for clients that speak
    first, and where an ArduCopter waits for TCP clients (5760 + 10 i).
    """
    n = len(firmware)
    onboard = [Place(_end(host, offset, *reversed(vehicle_ports(i))), i, LinkKind.ONBOARD) for i in range(n)]
    ground = [Place(_end(host, offset, 18570 + i, GROUND_PORT), i, LinkKind.GROUND) for i in range(n)]
    shared = [Place(_end(host, offset, LISTEN_PORT, None), None, LinkKind.GROUND)]
    streams = [
        Place(_end(host, offset, stream_port(i), None)._replace(stream=True), i, LinkKind.GROUND)
        for i, name in enumerate(firmware)
        if PERSONAS[name].serves_tcp
    ]
    return [*onboard, *ground, *shared, *streams]


def tracker_endpoints(offset: int, host: str) -> tuple[Endpoint, Endpoint]:
    """The payload tracker's ports: to the controller and to ground stations."""
    return _end(host, offset, TRACKER_PORTS[1], TRACKER_PORTS[0]), _end(host, offset, 18540, GROUND_PORT)


def _end(host: str, offset: int, here: int, there: int | None) -> Endpoint:
    return Endpoint((host, here + offset), None if there is None else (host, there + offset))
