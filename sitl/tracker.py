"""The payload tracker: a system of its own that reports the load's pose and twist and every cable's shape."""

import numpy as np

from bridge.link import Link
from bridge.wire.cables import Cables
from bridge.wire.dialect import mavlink
from bridge.wire.frames import Packed, pack
from bridge.wire.messages import encode
from bridge.wire.values import Heartbeat, PayloadState, VehicleAttitude, VehiclePosition
from cablequad.types import Counts
from sitl.plant import Truth

SYSTEM, COMPONENT = 200, 191
MAP_US = 100_000
HEARTBEAT_US = 1_000_000
ARRAY_US = 500_000
ARRAY_FLOATS = 58


class Tracker:
    """What it says, to the controller and to ground stations, on their two `ports` of `link`."""

    def __init__(self, link: Link, ports: tuple[int, int], n_links: Counts, control_us: int) -> None:
        self._link, self._ports, self._n_links, self._control_us = link, ports, n_links, control_us
        self._cables = Cables(n_links)

    def tell(self, truth: Truth) -> None:
        """Say what is due."""
        to_controller, to_ground = self._ports
        for message in self.low_rate(truth):
            self._link.put(to_ground, SYSTEM, COMPONENT, message)
            self._link.put(to_controller, SYSTEM, COMPONENT, message)
        if truth.boot_us % self._control_us == 0:
            for message in self.high_rate(truth):
                self._link.put(to_controller, SYSTEM, COMPONENT, message)

    def high_rate(self, truth: Truth) -> list[Packed]:
        """CABLE_STATE of every cable, then ODOMETRY of the payload, which closes the tick."""
        s, us = truth.state, truth.boot_us
        out = self._cables.packed(us, truth.tension, s.q, s.omega)
        out.append(encode(PayloadState(us, s.x0, s.v0, s.R0, s.Omega0)))
        return out

    def low_rate(self, truth: Truth) -> list[Packed]:
        """What is due at this tick for maps and stock tools.

        Heartbeat 1 Hz, pose 10 Hz, cables as plain arrays 2 Hz.
        """
        s, us = truth.state, truth.boot_us
        out: list[Packed] = []
        if us % HEARTBEAT_US == 0:
            beat = Heartbeat(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
            )
            out.append(encode(beat))
        if us % MAP_US == 0:
            out.append(encode(VehiclePosition(us // 1000, s.x0, s.v0)))
            out.append(encode(VehicleAttitude(us // 1000, s.R0, s.Omega0)))
        if us % ARRAY_US == 0:
            for i, k in enumerate(self._n_links.tolist()):
                links = np.concatenate([s.q[i, :k], s.omega[i, :k]], axis=1).ravel()[:ARRAY_FLOATS]
                data = links.tolist() + [0.0] * (ARRAY_FLOATS - len(links))
                out.append(pack(mavlink.MAVLink_debug_float_array_message, us, i + 1, b"cable", *data))
        return out
