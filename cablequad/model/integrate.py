"""One step of the motion: Runge-Kutta-Munthe-Kaas of order 4 on R^3 x SO(3)^(n+1) x (S^2)^links and the velocities.

Each group element advances by the exponential of an increment in its Lie algebra, whose slope is corrected by the
inverse differential of the exponential; directions and frames therefore never leave their manifolds. Velocities advance
as in classical RK4.
"""

import math
from typing import NamedTuple

import numpy as np

from cablequad._jit import inlined, jit
from cablequad.model import lie
from cablequad.model.dynamics import Accelerations, Workspace, accelerate, evaluate, workspace
from cablequad.model.state import State, positions, velocities
from cablequad.model.system import System
from cablequad.types import Array, Triple

BODY, WORLD = 1.0, -1.0  # rates of frames are body rates, R' = R hat(w); rates of directions world rates, q' = w x q


class RotorOutput(NamedTuple):
    """What the rotors of every quadrotor do, held over a step."""

    thrust: Array  # (n,) N, f_i along -R_i e3
    moment: Array  # (n, 3) N m, M_i, body frames


class Tangent(NamedTuple):
    """A change of every field of a state: group elements as rotation vectors, the rest as differences."""

    x0: Array  # (3,)
    v0: Array  # (3,)
    R0: Array  # (3,), payload frame
    Omega0: Array  # (3,)
    q: Array  # (n, L, 3), W
    omega: Array  # (n, L, 3)
    R: Array  # (n, 3), body frames
    Omega: Array  # (n, 3)


class Scratch(NamedTuple):
    """Everything a step writes to besides its result, allocated once."""

    stage: State  # where the derivative is taken
    move: Tangent  # what leads from the step's start to the stage
    total: Tangent  # weighted sum of slopes
    acc: Accelerations
    Omega_dot: Array  # (n, 3) rad/s^2, quadrotors
    force: Array  # (n, 3) N, W
    on_vehicles: Array  # (n, 3) N, W: from outside, held over a step
    work: Workspace


def step(system: System, state: State, command: RotorOutput, h: float) -> State:
    """The state `h` seconds later under `command` held constant. Order 4; |q| = 1 and R'R = I to rounding."""
    out = state.copy()
    constant = RotorOutput(*(np.ascontiguousarray(a, dtype=float) for a in command))
    advance(system, out, constant, h, 1, scratch(system, out))
    return out


@jit
def scratch(system: System, state: State) -> Scratch:
    """Workspace of `advance` for systems and states of this shape."""
    n, L = system.length.shape
    acc = Accelerations(np.zeros(3), np.zeros(3), np.zeros((n, L, 3)), np.zeros((n, L)))
    s = state
    stage = State(
        s.x0.copy(), s.v0.copy(), s.R0.copy(), s.Omega0.copy(), s.q.copy(), s.omega.copy(), s.R.copy(), s.Omega.copy()
    )
    return Scratch(
        stage,
        _tangent(n, L),
        _tangent(n, L),
        acc,
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        workspace(system),
    )


@jit
def _tangent(n: int, L: int) -> Tangent:
    return Tangent(
        np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3),
        np.zeros((n, L, 3)), np.zeros((n, L, 3)), np.zeros((n, 3)), np.zeros((n, 3)),
    )  # fmt: skip


@jit
def advance(system: System, state: State, command: RotorOutput, h: float, steps: int, s: Scratch) -> None:
    """`steps` steps of length `h` in place, without allocation."""
    for _ in range(steps):
        clear(s)
        derive(system, state, command, s)
        stage(system, state, state, s, h / 6.0, 0.5 * h)
        derive(system, s.stage, command, s)
        stage(system, state, s.stage, s, h / 3.0, 0.5 * h)
        derive(system, s.stage, command, s)
        stage(system, state, s.stage, s, h / 3.0, h)
        derive(system, s.stage, command, s)
        stage(system, state, s.stage, s, h / 6.0, 0.0)
        finish(system, state, s)


@jit
def look(system: System, state: State, thrust: Array, s: Scratch) -> tuple[Array, Array, Array]:
    """What is to be seen of an instant.

    (n, 3) m and (n, 3) m/s, W: the quadrotors; (n, L) N: tensions under `thrust` (n,) N and what acts from outside in
    `s`, padding 0.
    """
    for i in range(system.m.shape[0]):
        for a in range(3):
            s.force[i, a] = s.on_vehicles[i, a] - thrust[i] * state.R[i, a, 2]
    evaluate(system, state, s.force, s.acc, s.work)
    x, v = positions(system, state)[:, 0].copy(), velocities(system, state)[:, 0].copy()
    return x, v, s.acc.tension.copy()


@inlined
def clear(s: Scratch) -> None:
    """A step begins at its start, with nothing summed."""
    for t in (s.move, s.total):
        t.x0[:], t.v0[:], t.R0[:], t.Omega0[:] = 0.0, 0.0, 0.0, 0.0
        t.q[:] = 0.0
        t.omega[:] = 0.0
        t.R[:] = 0.0
        t.Omega[:] = 0.0


@inlined
def derive(system: System, at: State, command: RotorOutput, s: Scratch) -> None:
    """Accelerations at `at`: payload and links, and J Omega_dot = M - Omega x J Omega of each quadrotor."""
    for i in range(system.m.shape[0]):
        O = (at.Omega[i, 0], at.Omega[i, 1], at.Omega[i, 2])
        f, J, Ji = command.thrust[i], system.J, system.J_inv
        for a in range(3):
            s.force[i, a] = s.on_vehicles[i, a] - f * at.R[i, a, 2]
        h0 = J[i, 0, 0] * O[0] + J[i, 0, 1] * O[1] + J[i, 0, 2] * O[2]
        h1 = J[i, 1, 0] * O[0] + J[i, 1, 1] * O[1] + J[i, 1, 2] * O[2]
        h2 = J[i, 2, 0] * O[0] + J[i, 2, 1] * O[1] + J[i, 2, 2] * O[2]
        t0 = command.moment[i, 0] - (O[1] * h2 - O[2] * h1)
        t1 = command.moment[i, 1] - (O[2] * h0 - O[0] * h2)
        t2 = command.moment[i, 2] - (O[0] * h1 - O[1] * h0)
        for a in range(3):
            s.Omega_dot[i, a] = Ji[i, a, 0] * t0 + Ji[i, a, 1] * t1 + Ji[i, a, 2] * t2
    accelerate(system, at, s.force, s.acc, s.work)


@inlined
def stage(system: System, base: State, at: State, s: Scratch, weight: float, reach: float) -> None:
    """Sum the slopes at `at` with `weight`, then move the stage to `base` + `reach` x slope (reach 0: no next stage).

    `at` may be the stage itself: what is read of it is read before it is written. Triples are tuples here, as views of
    arrays would cost more than the arithmetic.
    """
    stage, move, total, acc = s.stage, s.move, s.total, s.acc
    for a in range(3):
        x, v, O = at.v0[a], acc.x0_ddot[a], acc.Omega0_dot[a]
        total.x0[a] += weight * x
        total.v0[a] += weight * v
        total.Omega0[a] += weight * O
        stage.x0[a] = base.x0[a] + reach * x
        stage.v0[a] = base.v0[a] + reach * v
    k = _slope(_triple(move.R0), _triple(at.Omega0), BODY)
    for a in range(3):
        total.R0[a] += weight * k[a]
        move.R0[a] = reach * k[a]
        stage.Omega0[a] = base.Omega0[a] + reach * acc.Omega0_dot[a]
    if reach != 0.0:
        lie.rotate_frame(stage.R0, base.R0, move.R0)
    for i in range(system.m.shape[0]):
        k = _slope((move.R[i, 0], move.R[i, 1], move.R[i, 2]), (at.Omega[i, 0], at.Omega[i, 1], at.Omega[i, 2]), BODY)
        for a in range(3):
            total.R[i, a] += weight * k[a]
            move.R[i, a] = reach * k[a]
            total.Omega[i, a] += weight * s.Omega_dot[i, a]
            stage.Omega[i, a] = base.Omega[i, a] + reach * s.Omega_dot[i, a]
        if reach != 0.0:
            lie.rotate_frame(stage.R[i], base.R[i], move.R[i])
        for j in range(system.n_links[i]):
            k = _slope(
                (move.q[i, j, 0], move.q[i, j, 1], move.q[i, j, 2]),
                (at.omega[i, j, 0], at.omega[i, j, 1], at.omega[i, j, 2]),
                WORLD,
            )
            d = (acc.omega_dot[i, j, 0], acc.omega_dot[i, j, 1], acc.omega_dot[i, j, 2])
            xi = (reach * k[0], reach * k[1], reach * k[2])
            q = lie.rotated(xi, (base.q[i, j, 0], base.q[i, j, 1], base.q[i, j, 2]))
            for a in range(3):
                total.q[i, j, a] += weight * k[a]
                total.omega[i, j, a] += weight * d[a]
                move.q[i, j, a] = xi[a]
                stage.q[i, j, a] = q[a]
                stage.omega[i, j, a] = base.omega[i, j, a] + reach * d[a]


@inlined
def _triple(v: Array) -> Triple:
    return v[0], v[1], v[2]


@inlined
def _slope(xi: Triple, w: Triple, side: float) -> Triple:
    """dexp^-1_xi(w) = w + side/2 xi x w + 1/12 xi x (xi x w), to the order that RK4 needs."""
    c = lie.cross_triple(xi, w)
    d = lie.cross_triple(xi, c)
    half = 0.5 * side
    return (
        w[0] + half * c[0] + d[0] * (1 / 12),
        w[1] + half * c[1] + d[1] * (1 / 12),
        w[2] + half * c[2] + d[2] * (1 / 12),
    )


@inlined
def finish(system: System, state: State, s: Scratch) -> None:
    """state moved by the summed slopes; rounding drift and the order-5 part of omega along q are taken off."""
    total, keep = s.total, s.stage
    for a in range(3):
        state.x0[a] += total.x0[a]
        state.v0[a] += total.v0[a]
        state.Omega0[a] += total.Omega0[a]
    keep.R0[:] = state.R0
    lie.rotate_frame(state.R0, keep.R0, total.R0)
    lie.orthonormalize(state.R0)
    for i in range(system.m.shape[0]):
        for a in range(3):
            state.Omega[i, a] += total.Omega[i, a]
        keep.R[i][:] = state.R[i]
        lie.rotate_frame(state.R[i], keep.R[i], total.R[i])
        lie.orthonormalize(state.R[i])
        for j in range(system.n_links[i]):
            xi = (total.q[i, j, 0], total.q[i, j, 1], total.q[i, j, 2])
            q = lie.rotated(xi, (state.q[i, j, 0], state.q[i, j, 1], state.q[i, j, 2]))
            scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
            q = (q[0] * scale, q[1] * scale, q[2] * scale)
            along = 0.0
            for a in range(3):
                state.q[i, j, a] = q[a]
                state.omega[i, j, a] += total.omega[i, j, a]
                along += q[a] * state.omega[i, j, a]
            for a in range(3):
                state.omega[i, j, a] -= along * q[a]
