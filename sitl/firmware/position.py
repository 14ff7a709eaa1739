"""Where a vehicle is as its flight controller notes it, and its home."""

import math

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.messages import GLOBAL_FRAMES
from bridge.wire.values import Command
from cablequad.model.earth import Home, local
from cablequad.types import Array
from sitl.firmware.navigate import FAR_M
from sitl.firmware.telemetry import Snapshot

RELATIVE_FRAMES = frozenset({mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})


class Position:
    """The last snapshot's place and attitude, the home and the origin of the local frame."""

    def __init__(self) -> None:
        self.x, self.R = np.zeros(3), np.eye(3)  # (3,) m, W; (3, 3)
        self.home = np.zeros(3)  # (3,) m, W
        self.origin = Home()
        self.sinks_m_s2 = 0.0  # how it accelerates downwards
        self._v_down, self._noted_us = 0.0, -1

    def note(self, s: Snapshot) -> None:
        """Keep track of where it is and how it accelerates downwards."""
        dt = (s.boot_us - self._noted_us) * 1e-6
        if 0 < dt < 0.1:
            self.sinks_m_s2 = (float(s.v[2]) - self._v_down) / dt
        self.x, self.R, self._v_down, self._noted_us = s.x, s.R, float(s.v[2]), s.boot_us

    def set_home(self) -> None:
        """Home is here."""
        self.home = self.x.copy()

    def asked(self, c: Command) -> Array | None:
        """(3,) m, W: the place in a command's parameters 5 to 7, NaN for where it is; None for none on earth."""
        lat, lon, altitude = c.params[4:]
        x = self.x.copy()
        if c.frame is not None and c.frame not in GLOBAL_FRAMES:
            return None
        if math.isfinite(lat) and math.isfinite(lon):
            if abs(lat) > 90.0 or abs(lon) > 180.0:
                return None
            x[:2] = local(self.origin, lat, lon, 0.0)[:2]
        if math.isfinite(altitude):
            above_home = c.frame in RELATIVE_FRAMES
            x[2] = self.home[2] - altitude if above_home else self.origin.altitude_m - altitude
        return x if float(np.abs(x).max()) < FAR_M else None
