"""A place among the ports for a simulated flight."""

import socket

from bridge.wire.ports import TRACKER_PORTS, Endpoint, LinkError, bind, vehicle_ports
from missions.scenario.flights import Flight
from sitl.addresses import places, tracker_endpoints
from sitl.settings import HOST

APART, HIGHEST = 200, 3600  # offsets so far apart share no port, up to where the ground stations' ports begin


def free_offset(flight: Flight) -> int:
    """The lowest offset, in steps of 200, at which all ports of a flight are free; 0 where none is."""
    return next((offset for offset in range(0, HIGHEST + 1, APART) if _free(flight, offset)), 0)


def _free(flight: Flight, offset: int) -> bool:
    own = [*(vehicle_ports(i)[0] for i in range(len(flight.firmware))), TRACKER_PORTS[0]]
    ours = [Endpoint((HOST, port + offset), None) for port in own]
    theirs = [place.endpoint for place in places(flight.firmware, offset, HOST)]
    for end in (*ours, *theirs, *tracker_endpoints(offset, HOST)):
        if end.bind is None:
            continue
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM if end.stream else socket.SOCK_DGRAM) as tried:
            try:
                bind(tried, end.bind, "")
            except LinkError:
                return False
    return True
