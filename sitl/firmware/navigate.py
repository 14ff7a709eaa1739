"""The position loop on board: what a vehicle does for itself when nobody commands its attitude.

A spring, a damper and an integral on the force it flew with before, towards a point that moves to its goal with limited
speed and acceleration: hold, take off, land and return differ in their goals alone.
"""

import math
from typing import NamedTuple

import numpy as np

from bridge.wire.values import PositionTarget
from cablequad.model import lie
from cablequad.types import Array
from sitl.firmware.telemetry import Snapshot

STIFFNESS = 5.3  # 1/s^2, times the vehicle's mass
DAMPING = 5.3  # 1/s
INTEGRAL = 1.5  # 1/s^3
MAX_INTEGRAL = 10.0  # m/s^2
MAX_TILT = 0.35  # rad
LEAD_M = 1.0  # how far the moving point may be ahead of the vehicle
ACCELERATION = 1.5  # m/s^2 of the moving point
ARRIVED_M = 0.3
FAR_M = 1e6
TURN_RAD_S = 1.05  # of the nose towards where it is to point: 60 deg/s, as both firmwares do by default
X_IGNORED, V_IGNORED, A_IGNORED = 0o7, 0o70, 0o700  # of POSITION_TARGET_TYPEMASK
FORCE_SET, YAW_IGNORE = 512, 1024


class Goal(NamedTuple):
    """Where to go and how fast."""

    x: Array  # (3,) m, W; with `v` NaN on axes on which no place is asked for
    speed: float  # m/s
    v: Array | None = None  # (3,) m/s, W: velocity asked for on the axes where x is NaN
    yaw: float | None = None  # rad: where the nose is to point; None: where it does


def goal_of(p: PositionTarget, here: Array, R: Array, speed: float, offset: bool, body: bool) -> Goal:
    """What SET_POSITION_TARGET_LOCAL_NED asks for: its ignored axes are NaN, velocity where no place is given.

    `offset`: places count from `here` (3,) m; `body`: both count in the axes of R (3, 3), turned by its yaw alone.
    """
    yaw = math.atan2(R[1, 0], R[0, 0])
    turn = lie.exp(np.array([0.0, 0.0, yaw])) if body else np.eye(3)
    mask = p.type_mask
    kept = np.array([[not mask >> 3 * row + axis & 1 for axis in range(3)] for row in range(3)])
    asked = np.array([p.x, p.v])
    kept = kept[:2] & np.isfinite(asked)
    x, v = np.clip(np.where(kept, asked, 0.0), -FAR_M, FAR_M)
    x = np.where(kept[0], np.clip(here + turn @ x if offset else x, -FAR_M, FAR_M), np.nan)
    v = np.clip(turn @ v, -speed, speed)
    nose = None if mask & YAW_IGNORE or not math.isfinite(p.yaw) else p.yaw + (yaw if body else 0.0)
    return Goal(x, speed, v, nose)


class Navigator:
    """The position loop of one vehicle; `begin` it where the vehicle is, then ask it every tick."""

    def __init__(self, mass_kg: float, g: float, tick_us: int) -> None:
        self._mass, self._weight, self._dt = mass_kg, mass_kg * g, tick_us * 1e-6
        self.active = False
        self.goal = Goal(np.zeros(3), 0.0)
        self._wanted, self._wanted_v = np.zeros(3), np.zeros(3)
        self._force, self._integral = np.zeros(3), np.zeros(3)
        self._yaw = 0.0

    def begin(self, s: Snapshot, thrust_N: float, sinks_m_s2: float = 0.0) -> None:
        """Hold here from now on, with the lift that would not have accelerated it; its weight where it was idle."""
        lift = thrust_N * float(s.R[2, 2]) + self._mass * sinks_m_s2
        up = max(lift, 0.0) if thrust_N > 0.0 else self._weight
        self._force = np.array([0.0, 0.0, -up])
        self._wanted, self._wanted_v, self._integral = s.x.copy(), s.v * 0.0, np.zeros(3)
        self.goal = Goal(s.x.copy(), 1.0)
        self._yaw = math.atan2(s.R[1, 0], s.R[0, 0])
        self.active = True

    def end(self) -> None:
        """Somebody else commands the attitude."""
        self.active = False

    def arrived(self, s: Snapshot) -> bool:
        """Whether the vehicle is at its goal."""
        return math.dist(s.x.tolist(), self.goal.x.tolist()) < ARRIVED_M

    def yaw(self, s: Snapshot) -> float | None:
        """rad: where the nose is to point in this tick; None: where it does."""
        if self.goal.yaw is None:
            self._yaw = math.atan2(s.R[1, 0], s.R[0, 0])
            return None
        most = TURN_RAD_S * self._dt
        self._yaw += min(max(math.remainder(self.goal.yaw - self._yaw, math.tau), -most), most)
        return self._yaw

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
        if self.goal.v is not None:
            self._follow(s, self.goal.v)
            return
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
        self._towards(wished)

    def _follow(self, s: Snapshot, v: Array) -> None:
        """The same where a place is asked for on some axes alone, and a velocity `v` on the others."""
        fixed = np.isfinite(self.goal.x)
        way = np.where(fixed, self.goal.x - self._wanted, 0.0)
        left = float(np.linalg.norm(way))
        wished = np.where(fixed, 0.0, v)
        if left > 1e-9:
            wished = wished + way / left * min(self.goal.speed, math.sqrt(2 * ACCELERATION * left), left / self._dt)
        ahead = self._wanted - s.x
        if math.hypot(*ahead.tolist()) > LEAD_M and float(ahead @ wished) > 0.0:
            wished = np.zeros(3)
        self._towards(wished)

    def _towards(self, wished: Array) -> None:
        """Let the wanted point change its velocity to `wished`, as fast as it may, and move."""
        change = wished - self._wanted_v
        size = float(np.linalg.norm(change))
        most = ACCELERATION * self._dt
        self._wanted_v = wished if size <= most else self._wanted_v + change * (most / size)
        self._wanted = self._wanted + self._wanted_v * self._dt


def attitude(s: Snapshot, force: Array, yaw: float | None = None) -> Array:
    """(3, 3): the attitude that gives `force` with the nose at `yaw` (rad), or kept where it points."""
    b3 = -force / np.linalg.norm(force)
    nose = s.R[:, 0] if yaw is None else np.array([math.cos(yaw), math.sin(yaw), 0.0])
    side = lie.cross(b3, nose)
    side = side / np.linalg.norm(side)
    return np.stack([lie.cross(side, b3), side, b3], axis=1)
