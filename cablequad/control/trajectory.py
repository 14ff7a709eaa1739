"""Where the payload is to be, and how fast: position and yaw as piecewise polynomials, smooth to the fourth derivative.

Legs begin and end at rest and are as quick as the limits on speed, acceleration and jerk allow; paths are flown at one
speed along their arc, with the same smooth start and stop. Evaluated in the loop by compiled code.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cablequad._jit import jit
from cablequad.types import Array

_NONE = np.zeros(3)

# rest to rest, s(r) for r in 0 .. 1 with four derivatives zero at both ends: highest power first
REST = np.array([70.0, -315.0, 540.0, -420.0, 126.0, 0.0, 0.0, 0.0, 0.0, 0.0])
DEGREE = 9
SAMPLED_S = 0.05  # paths are splines through points this far apart in time


class Reference(NamedTuple):
    """Where the payload is to be at one instant, and how it moves there."""

    x0: Array  # (3,) m, W
    v0: Array  # (3,) m/s, W
    a0: Array = _NONE  # (3,) m/s^2, W
    j0: Array = _NONE  # (3,) m/s^3, W
    s0: Array = _NONE  # (3,) m/s^4, W
    yaw: Array = _NONE  # rad, rad/s, rad/s^2: of the load about e3, from how it hangs at rest


class Limits(NamedTuple):
    """How fast a load is carried."""

    speed: float = 2.0  # m/s
    acceleration: float = 1.5  # m/s^2
    jerk: float = 5.0  # m/s^3
    yaw_rate: float = 0.5  # rad/s


class Trajectory(NamedTuple):
    """Pieces between `breaks`; before the first the load waits at the start, after the last it stays at the end."""

    breaks: Array  # (m + 1,) s, from 0
    coefficients: Array  # (m, 4, 10) of x, y, z (m) and yaw (rad), in the time since the piece began

    @property
    def duration(self) -> float:
        """s until it ends."""
        return float(self.breaks[-1])


Point = npt.ArrayLike  # x, y, z (m) and, where it is given, yaw (rad)


def still(point: Point) -> Trajectory:
    """Stay at `point`."""
    coefficients = np.zeros((1, 4, DEGREE + 1))
    coefficients[0, :, -1] = _four(point)
    return Trajectory(np.array([0.0, 1e-3]), coefficients)


def leg(start: Point, end: Point, limits: Limits) -> Trajectory:
    """From rest at `start` to rest at `end`, straight, as quickly as `limits` allow."""
    a, b = _four(start), _four(end)
    distance, turn = float(np.linalg.norm(b[:3] - a[:3])), abs(float(b[3] - a[3]))
    if distance < 1e-9 and turn < 1e-9:
        return still(start)
    peak_v, peak_a, peak_j = _PEAKS
    T = max(
        peak_v * distance / limits.speed, (peak_a * distance / limits.acceleration) ** 0.5,
        (peak_j * distance / limits.jerk) ** (1 / 3), peak_v * turn / limits.yaw_rate,
    )  # fmt: skip
    coefficients = np.outer(b - a, REST / T ** np.arange(DEGREE, -1, -1))
    coefficients[:, -1] = a
    return Trajectory(np.array([0.0, T]), coefficients[None])


def joined(parts: Sequence[Trajectory]) -> Trajectory:
    """One after the other."""
    breaks, end = [np.zeros(1)], 0.0
    for part in parts:
        breaks.append(end + part.breaks[1:])
        end += part.duration
    return Trajectory(np.concatenate(breaks), np.concatenate([part.coefficients for part in parts]))


def wait(point: Point, seconds: float) -> Trajectory:
    """Stay at `point` for a while."""
    return still(point)._replace(breaks=np.array([0.0, max(seconds, 1e-3)]))


def sink(start: Point, depth: float, speed: float) -> Trajectory:
    """Straight down by `depth` m at a steady `speed` m/s, after a second of gathering it."""
    gathered = 0.5 * speed
    rest = max(depth - gathered, 1e-3) / speed
    coefficients = np.zeros((2, 4, DEGREE + 1))
    coefficients[:, :, -1] = _four(start)
    coefficients[0, 2, -3] = 0.5 * speed
    coefficients[1, 2, -1] += gathered
    coefficients[1, 2, -2] = speed
    return Trajectory(np.array([0.0, 1.0, 1.0 + rest]), coefficients)


def waypoints(points: Sequence[Point], limits: Limits, hold_s: float = 0.0) -> Trajectory:
    """From point to point, at rest for `hold_s` at each."""
    parts: list[Trajectory] = []
    for a, b in itertools.pairwise(points):
        parts += [leg(a, b, limits)] + ([wait(b, hold_s)] if hold_s > 0 else [])
    return joined(parts) if parts else still(points[0])


def along(curve: Callable[[Array], Array], laps: float, speed: float, limits: Limits) -> Trajectory:
    """`laps` times around `curve`, which maps phases (k,) in rad to points (k, 4), at `speed` m/s along its arc.

    The speed rises and falls as in a leg, within the limits on acceleration.
    """
    from scipy import interpolate  # here, as it takes longer to load than to use

    phase = np.linspace(0.0, 2 * np.pi * laps, max(200, int(2000 * laps)) + 1)
    points = curve(phase)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1))])
    ramp = _PEAKS[0] * speed / limits.acceleration  # s; the speed follows s(r), whose slope peaks at _PEAKS[0]
    cruise = arc[-1] / speed - ramp  # each ramp covers half of what cruising would
    if cruise < 0:
        speed, ramp, cruise = (arc[-1] * limits.acceleration / _PEAKS[0]) ** 0.5, 0.0, 0.0
        ramp = arc[-1] / speed
    T = 2 * ramp + cruise
    t = np.linspace(0.0, T, max(40, int(np.ceil(T / SAMPLED_S))) + 1)
    covered = np.polyint(REST)
    up = speed * ramp * np.polyval(covered, np.clip(t / ramp, 0, 1))
    down = speed * ramp * np.polyval(covered, np.clip((T - t) / ramp, 0, 1))
    level = speed * np.clip(t - ramp, 0, cruise)
    s = up + level + (speed * ramp * np.polyval(covered, 1.0) - down)
    where = interpolate.make_interp_spline(arc, phase, k=5)(np.clip(s * (arc[-1] / s[-1]), 0.0, arc[-1]))
    rest = [(1, np.zeros(4)), (2, np.zeros(4)), (3, np.zeros(4))]
    spline = interpolate.make_interp_spline(t, curve(where), k=7, bc_type=(rest, rest))
    breaks = np.unique(spline.t)
    coefficients = np.zeros((len(breaks) - 1, 4, DEGREE + 1))
    for power in range(8):
        coefficients[:, :, DEGREE - power] = spline(breaks[:-1], nu=power) / math.factorial(power)
    return Trajectory(breaks, coefficients)


def circle(centre: Point, radius: float) -> Callable[[Array], Array]:
    """A level circle, from its +x side towards +y."""
    c = _four(centre)
    return lambda p: c + np.stack([radius * np.cos(p), radius * np.sin(p), 0 * p, 0 * p], axis=1)


def lemniscate(centre: Point, length: float, width: float) -> Callable[[Array], Array]:
    """A level figure of eight (Gerono's), `length` along x and `width` along y, from its crossing."""
    c = _four(centre)
    return lambda p: c + np.stack([0.5 * length * np.sin(p), 0.5 * width * np.sin(2 * p), 0 * p, 0 * p], axis=1)


@jit
def at(trajectory: Trajectory, t: float) -> Reference:
    """The reference at `t` s."""
    breaks, coefficients = trajectory.breaks, trajectory.coefficients
    last = len(breaks) - 2
    k = min(max(int(np.searchsorted(breaks, t, side="right")) - 1, 0), last)
    ended = t >= breaks[-1] or t < breaks[0]
    r = min(max(t, breaks[0]), breaks[-1]) - breaks[k]
    d = np.zeros((5, 4))
    for a in range(4):
        for c in coefficients[k, a]:  # Horner's rule for the value and its derivatives at once
            for order in range(4, 0, -1):
                d[order, a] = d[order, a] * r + d[order - 1, a]
            d[0, a] = d[0, a] * r + c
    scale = 1.0
    for order in range(1, 5):
        scale = 0.0 if ended else scale * order
        for a in range(4):
            d[order, a] *= scale
    return Reference(
        d[0, :3].copy(), d[1, :3].copy(), d[2, :3].copy(), d[3, :3].copy(), d[4, :3].copy(), d[0:3, 3].copy()
    )


def _four(point: Point) -> Array:
    values = np.asarray(point, dtype=float)
    return values if len(values) == 4 else np.append(values, 0.0)


def _peaks() -> tuple[float, float, float]:
    r = np.linspace(0.0, 1.0, 20001)
    first, second, third = (float(np.abs(np.polyval(np.polyder(REST, k), r)).max()) for k in (1, 2, 3))
    return first, second, third


_PEAKS = _peaks()  # of s', s'' and s''' of a leg of length 1 in 1 s
