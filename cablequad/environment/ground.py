"""Level ground under a load: compliant contact with friction at the load's corners, cables' nodes and vehicles' feet.

A point at depth d is pushed up by N = max(0, k d + c d' min(1, d / d_s)), d_s where its share of the weight rests.
Coulomb friction with sticking: a spring k and a damper hold a point where it came to stand, up to mu N; beyond that it
slides, and takes the place that holds it along. What stands does not creep. A cable does not stand on itself: the
friction of its nodes follows no more than their own weight, so that a link which is pushed down slips away. Springs
give back what they took, everything else only takes: contact adds no energy. Evaluated at every stage of the
Runge-Kutta step; places move after it.
"""

import math
from typing import NamedTuple

import numpy as np

from cablequad._jit import inlined, jit
from cablequad.model import lie
from cablequad.model.integrate import RotorOutput, Scratch, clear, derive, finish, stage
from cablequad.model.state import State, positions, velocities
from cablequad.model.system import System
from cablequad.types import Array, Triple

NONE = np.inf  # where there is no ground
NODES, PAYLOAD, VEHICLES = 200.0, 120.0, 100.0  # rad/s: how a body on all its contacts bounces
DAMPING = 0.5  # damping ratio of that
FRICTION = 0.6


class Contact(NamedTuple):
    """How one point meets the ground."""

    stiffness: float  # N/m
    damping: float  # N s/m
    sag: float  # m: where its share of the weight rests
    grip: float  # N s/m, most that a step can take of a point's slip
    rubs: float = np.inf  # m: no more depth than this counts for its friction


class Ground(NamedTuple):
    """Where the ground is, and what of a system meets it."""

    z: float  # m, W, down positive; inf: none
    friction: float
    corners: Array  # (c, 3) m, payload frame
    feet: Array  # (4, 3) m, vehicles' body frames
    corner: Array  # (5,), as Contact
    foot: Array  # (n, 5)
    node: Array  # (n, L, 5): the payload-side end of each link but the last
    corner_held: Array  # (c, 3) m, W: x and y where each stuck, and 1 where it does; these change with every step
    foot_held: Array  # (n, 4, 3)
    node_held: Array  # (n, L, 3)


def ground(system: System, z: float, corners: Array, feet: Array, h: float, friction: float = FRICTION) -> Ground:
    """The ground at `z` for a load with these `corners` and vehicles with these `feet`, for steps of `h` s."""
    n, L = system.length.shape
    carried = system.m0 + float(system.m_tied.sum())
    lightest = min(system.m0, float(np.min(np.diag(system.J0))) / max(float(np.max(np.sum(corners**2, axis=1))), 1e-9))
    node = np.zeros((n, L, 5))
    for i in range(n):
        for j in range(int(system.n_links[i])):
            m = float(system.m_link[i, j])
            touches = contact(m, NODES, 1, m, system.g, h)
            node[i, j] = touches._replace(rubs=touches.sag)
    foot = np.array([contact(float(m), VEHICLES, len(feet), float(m) / 4, system.g, h) for m in system.m])
    corner = np.array(contact(carried, PAYLOAD, max(1, len(corners) // 2), lightest / 2, system.g, h))
    return Ground(
        z, friction, np.ascontiguousarray(corners, dtype=float), np.array(feet, dtype=float), corner, foot, node,
        np.zeros((len(corners), 3)), np.zeros((n, len(feet), 3)), np.zeros((n, L, 3)),
    )  # fmt: skip


def contact(mass: float, bounce: float, points: int, noticed: float, g: float, h: float) -> Contact:
    """One of the `points` that a body of `mass` kg stands on, where it feels like `noticed` kg; `bounce` in rad/s."""
    stiffness = mass * bounce**2 / points
    return Contact(stiffness, 2.0 * DAMPING * mass * bounce / points, g / bounce**2, noticed / (2.0 * h))


def box_corners(box: tuple[float, float, float]) -> Array:
    """(8, 3) m: corners of a box with these edges about its centre."""
    signs = np.array([(a, b, c) for a in (-0.5, 0.5) for b in (-0.5, 0.5) for c in (-0.5, 0.5)])
    return signs * np.asarray(box)


@inlined
def _push(c: Array, friction: float, depth: float, x: float, y: float, v: Triple, held: Array) -> Triple:
    """N, W: on a point at x, y, `depth` m below the surface, that moves with `v` and is `held` (3,) somewhere."""
    if depth <= 0.0:
        return (0.0, 0.0, 0.0)
    normal = c[0] * depth + c[1] * v[2] * min(1.0, depth / c[2])
    if normal <= 0.0:
        return (0.0, 0.0, 0.0)
    drag = min(c[1], c[3])
    stretch = c[0] * held[2]
    fx, fy = -stretch * (x - held[0]) - drag * v[0], -stretch * (y - held[1]) - drag * v[1]
    share = friction * min(normal, c[0] * c[4]) / max(math.sqrt(fx * fx + fy * fy), 1e-12)
    if share < 1.0:  # it slides
        fx, fy = share * fx, share * fy
    return (fx, fy, -normal)


@inlined
def _stick(c: Array, friction: float, depth: float, x: float, y: float, held: Array) -> None:
    """Where a point at x, y is held from now on, in place: where it came to the ground, or as far behind as it slid."""
    if depth <= 0.0:
        held[2] = 0.0
    elif held[2] == 0.0:
        held[0], held[1], held[2] = x, y, 1.0
    else:
        sx, sy = x - held[0], y - held[1]
        share = friction * min(depth, c[4]) / max(math.sqrt(sx * sx + sy * sy), 1e-12)
        if share < 1.0:
            held[0], held[1] = x - share * sx, y - share * sy


@inlined
def _corner(
    g: Ground, c: Array, x: Triple, v: Triple, R: Array, O: Array, r: Array, held: Array
) -> tuple[Triple, Triple]:
    """Force (N, W) and moment (N m, body frame) on a body at x, v whose point r touches the ground, else zero.

    The point is `held` as in `_push`.
    """
    depth = x[2] + R[2, 0] * r[0] + R[2, 1] * r[1] + R[2, 2] * r[2] - g.z
    if depth <= 0.0:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    spin = lie.cross_triple((O[0], O[1], O[2]), (r[0], r[1], r[2]))
    moving = (
        v[0] + R[0, 0] * spin[0] + R[0, 1] * spin[1] + R[0, 2] * spin[2],
        v[1] + R[1, 0] * spin[0] + R[1, 1] * spin[1] + R[1, 2] * spin[2],
        v[2] + R[2, 0] * spin[0] + R[2, 1] * spin[1] + R[2, 2] * spin[2],
    )
    px = x[0] + R[0, 0] * r[0] + R[0, 1] * r[1] + R[0, 2] * r[2]
    py = x[1] + R[1, 0] * r[0] + R[1, 1] * r[1] + R[1, 2] * r[2]
    f = _push(c, g.friction, depth, px, py, moving, held)
    own = (
        R[0, 0] * f[0] + R[1, 0] * f[1] + R[2, 0] * f[2],
        R[0, 1] * f[0] + R[1, 1] * f[1] + R[2, 1] * f[2],
        R[0, 2] * f[0] + R[1, 2] * f[1] + R[2, 2] * f[2],
    )
    return f, lie.cross_triple((r[0], r[1], r[2]), own)


@inlined
def press(system: System, at: State, g: Ground, commanded: RotorOutput, command: RotorOutput, s: Scratch) -> None:
    """Add the ground's forces in state `at` to s.on_vehicles and s.work; `command` gets moments beyond `commanded`."""
    work = s.work
    x, v = positions(system, at), velocities(system, at)
    for k in range(g.corners.shape[0]):
        here, moving = (at.x0[0], at.x0[1], at.x0[2]), (at.v0[0], at.v0[1], at.v0[2])
        f, turn = _corner(g, g.corner, here, moving, at.R0, at.Omega0, g.corners[k], g.corner_held[k])
        for a in range(3):
            work.on_payload[a] += f[a]
            work.turning[a] += turn[a]
    for i in range(system.m.shape[0]):
        for j in range(system.n_links[i] - 1):
            moving = (v[i, j + 1, 0], v[i, j + 1, 1], v[i, j + 1, 2])
            p = x[i, j + 1]
            f = _push(g.node[i, j], g.friction, p[2] - g.z, p[0], p[1], moving, g.node_held[i, j])
            for a in range(3):
                work.on_nodes[i, j, a] += f[a]
        for a in range(3):
            command.moment[i, a] = commanded.moment[i, a]
        for k in range(g.feet.shape[0]):
            here, moving = (x[i, 0, 0], x[i, 0, 1], x[i, 0, 2]), (v[i, 0, 0], v[i, 0, 1], v[i, 0, 2])
            f, turn = _corner(g, g.foot[i], here, moving, at.R[i], at.Omega[i], g.feet[k], g.foot_held[i, k])
            for a in range(3):
                s.on_vehicles[i, a] += f[a]
                command.moment[i, a] += turn[a]


class ExternalForces(NamedTuple):
    """What acts from outside besides the ground, kept while stages add the ground's part."""

    on_vehicles: Array  # (n, 3) N, W
    on_payload: Array  # (3,) N, W
    on_nodes: Array  # (n, L, 3) N, W


@jit
def no_external_forces(system: System) -> ExternalForces:
    """Nothing acts besides the ground."""
    n, L = system.length.shape
    return ExternalForces(np.zeros((n, 3)), np.zeros(3), np.zeros((n, L, 3)))


@jit
def external_forces(s: Scratch) -> ExternalForces:
    """Copies of what acts from outside now."""
    return ExternalForces(s.on_vehicles.copy(), s.work.on_payload.copy(), s.work.on_nodes.copy())


@inlined
def _outside(external: ExternalForces, s: Scratch) -> None:
    """Back to what acts besides the ground."""
    s.on_vehicles[:] = external.on_vehicles
    s.work.on_payload[:] = external.on_payload
    s.work.turning[:] = 0.0
    s.work.on_nodes[:] = external.on_nodes


@jit
def advance_on(
    system: System, state: State, command: RotorOutput, h: float, g: Ground, external: ExternalForces, s: Scratch
) -> None:
    """One step of `h` s in place, as `integrate.advance`, over the ground and under `external`.

    `s` is left with `external` and the forces of the ground as they were last.
    """
    pressed = RotorOutput(command.thrust, command.moment.copy())
    s.work.loaded[0] = True
    clear(s)
    for k in range(4):
        at = state if k == 0 else s.stage
        _outside(external, s)
        press(system, at, g, command, pressed, s)
        derive(system, at, pressed, s)
        weight = h / 6.0 if k in (0, 3) else h / 3.0
        reach = (0.5 * h, 0.5 * h, h, 0.0)[k]
        stage(system, state, at, s, weight, reach)
    finish(system, state, s)
    stick(system, state, g)


@inlined
def _place(x: Array, R: Array, r: Array) -> Triple:
    """m, W: a point r of a body at x, R."""
    return (
        x[0] + R[0, 0] * r[0] + R[0, 1] * r[1] + R[0, 2] * r[2],
        x[1] + R[1, 0] * r[0] + R[1, 1] * r[1] + R[1, 2] * r[2],
        x[2] + R[2, 0] * r[0] + R[2, 1] * r[1] + R[2, 2] * r[2],
    )


@inlined
def stick(system: System, state: State, g: Ground) -> None:
    """Where every point that touches the ground is held from now on, in place in `g`."""
    x = positions(system, state)
    for k in range(g.corners.shape[0]):
        p = _place(state.x0, state.R0, g.corners[k])
        _stick(g.corner, g.friction, p[2] - g.z, p[0], p[1], g.corner_held[k])
    for i in range(system.m.shape[0]):
        for j in range(system.n_links[i] - 1):
            q = x[i, j + 1]
            _stick(g.node[i, j], g.friction, q[2] - g.z, q[0], q[1], g.node_held[i, j])
        for k in range(g.feet.shape[0]):
            p = _place(x[i, 0], state.R[i], g.feet[k])
            _stick(g.foot[i], g.friction, p[2] - g.z, p[0], p[1], g.foot_held[i, k])


@jit
def stored(system: System, state: State, g: Ground) -> float:
    """J: what the ground's springs hold."""
    x = positions(system, state)
    total = 0.0
    for k in range(g.corners.shape[0]):
        total += _spring(g, g.corner, _place(state.x0, state.R0, g.corners[k]), g.corner_held[k])
    for i in range(system.m.shape[0]):
        for j in range(system.n_links[i] - 1):
            total += _spring(g, g.node[i, j], (x[i, j + 1, 0], x[i, j + 1, 1], x[i, j + 1, 2]), g.node_held[i, j])
        for k in range(g.feet.shape[0]):
            total += _spring(g, g.foot[i], _place(x[i, 0], state.R[i], g.feet[k]), g.foot_held[i, k])
    return total


@inlined
def _spring(g: Ground, c: Array, p: Triple, held: Array) -> float:
    """J: in the springs of one point at p, m."""
    depth = max(0.0, p[2] - g.z)
    aside = (p[0] - held[0]) ** 2 + (p[1] - held[1]) ** 2 if depth > 0.0 and held[2] > 0.0 else 0.0
    return 0.5 * c[0] * (depth * depth + aside)


@jit
def deepest(system: System, state: State, g: Ground) -> float:
    """m: how far the deepest point is below the surface; negative while nothing touches."""
    x = positions(system, state)
    worst = -np.inf
    for r in g.corners:
        worst = max(worst, state.x0[2] + np.sum(state.R0[2] * r) - g.z)
    for i in range(system.m.shape[0]):
        for j in range(system.n_links[i] - 1):
            worst = max(worst, x[i, j + 1, 2] - g.z)
        for r in g.feet:
            worst = max(worst, x[i, 0, 2] + np.sum(state.R[i, 2] * r) - g.z)
    return worst


@jit
def standing(system: System, state: State, g: Ground) -> Array:
    """(n,) how many feet of each vehicle touch the ground."""
    out = np.zeros(system.m.shape[0])
    x = positions(system, state)
    for i in range(system.m.shape[0]):
        for r in g.feet:
            out[i] += x[i, 0, 2] + np.sum(state.R[i, 2] * r) > g.z
    return out
