"""The payload tracker: a system of its own that reports the load's pose and twist and every cable's shape."""

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.frames import Packed, pack
from bridge.wire.link import Address, Link
from bridge.wire.messages import encode
from bridge.wire.values import Heartbeat, VehicleAttitude, VehiclePosition
from cablequad.types import Counts
from sitl.plant import Truth
from sitl.tracker_batch import LoadReport

SYSTEM, COMPONENT = 200, 191
MAP_US = 100_000
HEARTBEAT_US = 1_000_000
ARRAY_US = 5 * MAP_US
ARRAY_FLOATS = 58


class Tracker:
    """What it says, to the controller and to ground stations, on their two `ports` of `link`."""

    def __init__(self, link: Link, ports: tuple[int, int], n_links: Counts, control_us: int) -> None:
        self._link, self._ports, self._n_links, self._control_us = link, ports, n_links, control_us
        self._report = LoadReport(n_links)
        self._to: list[tuple[int, Address | None]] = [(ports[0], None)] * len(self._report)
        self._from = bytes([SYSTEM]) * len(self._report)

    def tell(self, truth: Truth) -> None:
        """Say what is due: to the controller CABLE_STATE of every cable, then ODOMETRY, which closes the tick."""
        to_controller, to_ground = self._ports
        for message in self.low_rate(truth):
            self._link.put(to_ground, SYSTEM, COMPONENT, message)
            self._link.put(to_controller, SYSTEM, COMPONENT, message)
        if truth.boot_us % self._control_us == 0:
            self._report.tell(truth.boot_us, truth.row)
            self._link.put_all(self._to, self._from, COMPONENT, self._report)

    def warm_up(self, truth: Truth) -> None:
        """Make every message once, so that nothing is compiled while the clock runs."""
        self.low_rate(truth._replace(boot_us=0))
        self._report.tell(truth.boot_us, truth.row)
        self._report.framed(bytes(len(self._report)), self._from, COMPONENT, 0)

    def low_rate(self, truth: Truth) -> list[Packed]:
        """What is due at this tick for maps and stock tools.

        Heartbeat 1 Hz, pose 10 Hz, cables as plain arrays 2 Hz.
        """
        us = truth.boot_us
        out: list[Packed] = []
        if us % HEARTBEAT_US == 0:
            beat = Heartbeat(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
            )
            out.append(encode(beat))
        if us % MAP_US != 0:
            return out
        s = truth.motion.state
        out.append(encode(VehiclePosition(us // 1000, s.x0, s.v0)))
        out.append(encode(VehicleAttitude.of(us // 1000, s.R0, s.Omega0)))
        if us % ARRAY_US == 0:
            for i, k in enumerate(self._n_links.tolist()):
                links = np.concatenate([s.q[i, :k], s.omega[i, :k]], axis=1).ravel()[:ARRAY_FLOATS]
                data = links.tolist() + [0.0] * (ARRAY_FLOATS - len(links))
                out.append(pack(mavlink.MAVLink_debug_float_array_message, us, i + 1, b"cable", *data))
        return out
