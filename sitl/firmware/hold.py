"""The position loop on board: what a vehicle does for itself when nobody commands its attitude."""

from typing import NamedTuple

import numpy as np

from bridge.wire.telemetry import Snapshot
from cablequad import lie
from cablequad.types import Array

STIFFNESS = 4.0  # N/m
DAMPING = 4.0  # N s/m
MAX_TILT = 0.35  # rad


class Anchor(NamedTuple):
    """Where and how a hold began."""

    x: Array  # (3,) m, W
    force: Array  # (3,) N, W: what the rotors gave just before, the load's share included
    since_us: int
    sink: float  # m/s downwards


def anchor(s: Snapshot, thrust_N: float, sink: float = 0.0) -> Anchor:
    """A hold that starts from this instant; the tilt of the moment is let go, its vertical pull kept."""
    force = np.array([0.0, 0.0, -thrust_N * float(s.R[2, 2])])
    return Anchor(s.x.copy(), force, s.boot_us, sink)


def hold(s: Snapshot, a: Anchor) -> tuple[Array, float]:
    """(R_c (3, 3), thrust N) that keep the vehicle at its anchor: a spring and a damper on the force it flew with."""
    drift = np.array([0.0, 0.0, a.sink])
    wanted = a.x + drift * (s.boot_us - a.since_us) * 1e-6
    force = a.force - STIFFNESS * (s.x - wanted) - DAMPING * (s.v - drift)
    force[2] = min(force[2], -0.1)
    sideways = float(np.hypot(force[0], force[1]))
    limit = -force[2] * np.tan(MAX_TILT)
    if sideways > limit:
        force[:2] *= limit / sideways
    b3 = -force / np.linalg.norm(force)
    nose = s.R[:, 0]
    side = lie.cross(b3, nose)
    side /= np.linalg.norm(side)
    R_c = np.stack([np.cross(side, b3), side, b3], axis=1)
    return R_c, float(np.linalg.norm(force))
