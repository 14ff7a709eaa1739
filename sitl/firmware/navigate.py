"""The position loop on board: what a vehicle does for itself when nobody commands its attitude.

A spring, a damper and an integral on the force it flew with before, towards a point that moves to its goal with limited
speed and acceleration: hold, take off, land and return differ in their goals alone.
"""

import math
from typing import NamedTuple

import numpy as np

from bridge.wire.telemetry import Snapshot
from cablequad import lie
from cablequad.types import Array

STIFFNESS = 5.3  # 1/s^2, times the vehicle's mass
DAMPING = 5.3  # 1/s
INTEGRAL = 1.5  # 1/s^3
MAX_INTEGRAL = 10.0  # m/s^2
MAX_TILT = 0.35  # rad
LEAD_M = 1.0  # how far the moving point may be ahead of the vehicle
ACCELERATION = 1.5  # m/s^2 of the moving point
ARRIVED_M = 0.3
FAR_M = 1e6


class Goal(NamedTuple):
    """Where to go and how fast."""

    x: Array  # (3,) m, W
    speed: float  # m/s


class Navigator:
    """The position loop of one vehicle; `begin` it where the vehicle is, then ask it every tick."""

    def __init__(self, mass_kg: float, g: float, tick_us: int) -> None:
        self._mass, self._weight, self._dt = mass_kg, mass_kg * g, tick_us * 1e-6
        self.active = False
        self.goal = Goal(np.zeros(3), 0.0)
        self._wanted, self._wanted_v = np.zeros(3), np.zeros(3)
        self._force, self._integral = np.zeros(3), np.zeros(3)

    def begin(self, s: Snapshot, thrust_N: float, sinks_m_s2: float = 0.0) -> None:
        """Hold here from now on, with the lift that would not have accelerated it; its weight where it was idle."""
        lift = thrust_N * float(s.R[2, 2]) + self._mass * sinks_m_s2
        up = max(lift, 0.0) if thrust_N > 0.0 else self._weight
        self._force = np.array([0.0, 0.0, -up])
        self._wanted, self._wanted_v, self._integral = s.x.copy(), s.v * 0.0, np.zeros(3)
        self.goal = Goal(s.x.copy(), 1.0)
        self.active = True

    def end(self) -> None:
        """Somebody else commands the attitude."""
        self.active = False

    def arrived(self, s: Snapshot) -> bool:
        """Whether the vehicle is at its goal."""
        return math.dist(s.x.tolist(), self.goal.x.tolist()) < ARRIVED_M

    def force(self, s: Snapshot) -> Array:
        """(3,) N, W: what the rotors are to give in this tick."""
        self._advance(s)
        drift, speed = s.x - self._wanted, s.v - self._wanted_v
        self._integral = np.clip(self._integral - INTEGRAL * drift * self._dt, -MAX_INTEGRAL, MAX_INTEGRAL)
        out = self._force + self._mass * (self._integral - STIFFNESS * drift - DAMPING * speed)
        out[2] = min(out[2], -0.1)
        sideways = math.hypot(out[0], out[1])
        limit = -out[2] * math.tan(MAX_TILT)
        if sideways > limit:
            out[:2] *= limit / sideways
        return out

    def _advance(self, s: Snapshot) -> None:
        """Move the wanted point towards the goal, no faster than speed and acceleration allow, nor out of reach."""
        if math.dist(self._wanted.tolist(), s.x.tolist()) > LEAD_M:
            self._wanted_v *= 0.0
            if math.dist((self._wanted + 0.01 * (self.goal.x - self._wanted)).tolist(), s.x.tolist()) > LEAD_M:
                return
        way = self.goal.x - self._wanted
        left = float(np.linalg.norm(way))
        if left < 1e-9:
            self._wanted_v = np.zeros(3)
            return
        wished = way / left * min(self.goal.speed, math.sqrt(2 * ACCELERATION * left), left / self._dt)
        change = wished - self._wanted_v
        size = float(np.linalg.norm(change))
        most = ACCELERATION * self._dt
        self._wanted_v = wished if size <= most else self._wanted_v + change * (most / size)
        self._wanted = self._wanted + self._wanted_v * self._dt


def attitude(s: Snapshot, force: Array) -> Array:
    """(3, 3): the attitude that gives `force` with the nose kept where it points."""
    b3 = -force / np.linalg.norm(force)
    side = lie.cross(b3, s.R[:, 0])
    side = side / np.linalg.norm(side)
    return np.stack([lie.cross(side, b3), side, b3], axis=1)
