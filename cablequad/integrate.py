"""One step of the motion: Runge-Kutta-Munthe-Kaas of order 4 on R^3 x SO(3)^(n+1) x (S^2)^links and the velocities.

Each group element advances by the exponential of increments in its Lie algebra, corrected by the inverse differential
of the exponential; directions and frames therefore never leave their manifolds. Velocities advance as in classical RK4.
"""

from typing import NamedTuple

import numpy as np

from cablequad import lie
from cablequad._jit import jit
from cablequad.dynamics import Accelerations, Workspace, accelerate, workspace
from cablequad.state import State
from cablequad.system import System
from cablequad.types import Array


class Command(NamedTuple):
    """What the rotors of every quadrotor do, held over a step."""

    thrust: Array  # (n,) N, f_i along -R_i e3
    moment: Array  # (n, 3) N m, M_i, body frames


class Scratch(NamedTuple):
    """Everything a step writes to besides its result, allocated once."""

    stage: State  # where the derivative is taken
    slope: Accelerations
    Omega_dot: Array  # (n, 3) rad/s^2, quadrotors
    rates: State  # weighted sum of slopes, in the algebra: x0, v0, Omega0, omega, Omega; q and (R, R0)[:, 0] hold xi
    turn: State  # increments of the current stage, in the same places
    force: Array  # (n, 3) N, W
    work: Workspace


def step(system: System, state: State, command: Command, h: float) -> State:
    """The state `h` seconds later under `command` held constant. Order 4; |q| = 1 and R'R = I to rounding."""
    out = state.copy()
    advance(system, out, command, h, 1, scratch(system, out))
    return out


@jit
def scratch(system: System, state: State) -> Scratch:
    """Workspace of `advance` for systems and states of this shape."""
    n, L = system.length.shape
    slope = Accelerations(np.zeros(3), np.zeros(3), np.zeros((n, L, 3)), np.zeros((n, L)))
    return Scratch(
        _copy(state), slope, np.zeros((n, 3)), _copy(state), _copy(state), np.zeros((n, 3)), workspace(system)
    )


@jit
def _copy(s: State) -> State:
    return State(
        s.x0.copy(), s.v0.copy(), s.R0.copy(), s.Omega0.copy(), s.q.copy(), s.omega.copy(), s.R.copy(), s.Omega.copy()
    )


@jit
def advance(system: System, state: State, command: Command, h: float, steps: int, s: Scratch) -> None:
    """`steps` steps of length `h` in place, without allocation."""
    for _ in range(steps):
        _derive(system, state, command, s)
        _accumulate(system, state, s, h / 6.0, True)
        _place(system, state, s, 0.5 * h)
        _derive(system, s.stage, command, s)
        _accumulate(system, s.stage, s, h / 3.0, False)
        _place(system, state, s, 0.5 * h)
        _derive(system, s.stage, command, s)
        _accumulate(system, s.stage, s, h / 3.0, False)
        _place(system, state, s, h)
        _derive(system, s.stage, command, s)
        _accumulate(system, s.stage, s, h / 6.0, False)
        _finish(system, state, s)


@jit
def _derive(system: System, at: State, command: Command, s: Scratch) -> None:
    """Slopes at `at`: accelerations of payload and links, and J Omega_dot = M - Omega x J Omega of each quadrotor."""
    for i in range(system.m.shape[0]):
        R, O, J, Ji = at.R[i], at.Omega[i], system.J[i], system.J_inv[i]
        f = command.thrust[i]
        s.force[i, 0], s.force[i, 1], s.force[i, 2] = -f * R[0, 2], -f * R[1, 2], -f * R[2, 2]
        h0 = J[0, 0] * O[0] + J[0, 1] * O[1] + J[0, 2] * O[2]
        h1 = J[1, 0] * O[0] + J[1, 1] * O[1] + J[1, 2] * O[2]
        h2 = J[2, 0] * O[0] + J[2, 1] * O[1] + J[2, 2] * O[2]
        t0 = command.moment[i, 0] - (O[1] * h2 - O[2] * h1)
        t1 = command.moment[i, 1] - (O[2] * h0 - O[0] * h2)
        t2 = command.moment[i, 2] - (O[0] * h1 - O[1] * h0)
        for a in range(3):
            s.Omega_dot[i, a] = Ji[a, 0] * t0 + Ji[a, 1] * t1 + Ji[a, 2] * t2
    accelerate(system, at, s.force, s.slope, s.work)


@jit
def _turn(out: Array, xi: Array, w: Array, side: float) -> None:
    """out = dexp^-1_xi(w), to the order that RK4 needs; side +1 for body rates (R' = R hat w), -1 for world rates.

    out may not be xi: both products are taken before it is written.
    """
    c0, c1, c2 = xi[1] * w[2] - xi[2] * w[1], xi[2] * w[0] - xi[0] * w[2], xi[0] * w[1] - xi[1] * w[0]
    d0, d1, d2 = xi[1] * c2 - xi[2] * c1, xi[2] * c0 - xi[0] * c2, xi[0] * c1 - xi[1] * c0
    k = 0.5 * side
    out[0] = w[0] + k * c0 + d0 / 12.0
    out[1] = w[1] + k * c1 + d1 / 12.0
    out[2] = w[2] + k * c2 + d2 / 12.0


@jit
def _accumulate(system: System, at: State, s: Scratch, weight: float, first: bool) -> None:
    """Add weight x slope to `rates`, and leave the group slopes of this stage in `turn`.

    On entry `turn` holds the stage's own increments xi (zero at the first stage).
    """
    rates, turn = s.rates, s.turn
    if first:
        for a in (rates.x0, rates.v0, rates.Omega0, turn.x0, turn.v0, turn.Omega0):
            a[:] = 0.0
        rates.R0[:] = 0.0
        turn.R0[:] = 0.0
        for b in (rates.q, rates.omega, rates.R, turn.q, turn.omega, turn.R):
            b[:] = 0.0
        rates.Omega[:] = 0.0
        turn.Omega[:] = 0.0
    _turn(turn.R0[1], turn.R0[0], at.Omega0, 1.0)
    for a in range(3):
        turn.x0[a], turn.v0[a], turn.Omega0[a] = at.v0[a], s.slope.x0_ddot[a], s.slope.Omega0_dot[a]
        turn.R0[0, a] = turn.R0[1, a]
        rates.x0[a] += weight * turn.x0[a]
        rates.v0[a] += weight * turn.v0[a]
        rates.Omega0[a] += weight * turn.Omega0[a]
        rates.R0[0, a] += weight * turn.R0[0, a]
    for i in range(system.m.shape[0]):
        _turn(turn.R[i, 1], turn.R[i, 0], at.Omega[i], 1.0)
        for a in range(3):
            turn.R[i, 0, a] = turn.R[i, 1, a]
            turn.Omega[i, a] = s.Omega_dot[i, a]
            rates.R[i, 0, a] += weight * turn.R[i, 0, a]
            rates.Omega[i, a] += weight * turn.Omega[i, a]
        for j in range(system.n_links[i]):
            _turn(turn.R0[2], turn.q[i, j], at.omega[i, j], -1.0)
            for a in range(3):
                turn.q[i, j, a] = turn.R0[2, a]
                turn.omega[i, j, a] = s.slope.omega_dot[i, j, a]
                rates.q[i, j, a] += weight * turn.q[i, j, a]
                rates.omega[i, j, a] += weight * turn.omega[i, j, a]


@jit
def _place(system: System, base: State, s: Scratch, weight: float) -> None:
    """stage = base moved by weight x turn; `turn` then holds the increments xi = weight x slope of that stage."""
    stage, turn = s.stage, s.turn
    for a in range(3):
        stage.x0[a] = base.x0[a] + weight * turn.x0[a]
        stage.v0[a] = base.v0[a] + weight * turn.v0[a]
        stage.Omega0[a] = base.Omega0[a] + weight * turn.Omega0[a]
        turn.R0[0, a] *= weight
    lie.rotate_frame(stage.R0, base.R0, turn.R0[0])
    for i in range(system.m.shape[0]):
        for a in range(3):
            turn.R[i, 0, a] *= weight
            stage.Omega[i, a] = base.Omega[i, a] + weight * turn.Omega[i, a]
        lie.rotate_frame(stage.R[i], base.R[i], turn.R[i, 0])
        for j in range(system.n_links[i]):
            for a in range(3):
                turn.q[i, j, a] *= weight
                stage.omega[i, j, a] = base.omega[i, j, a] + weight * turn.omega[i, j, a]
            lie.rotate_direction(stage.q[i, j], turn.q[i, j], base.q[i, j])


@jit
def _finish(system: System, state: State, s: Scratch) -> None:
    """state moved by the weighted slopes; rounding drift and the order-5 part of omega along q are taken off."""
    rates, keep = s.rates, s.turn
    for a in range(3):
        state.x0[a] += rates.x0[a]
        state.v0[a] += rates.v0[a]
        state.Omega0[a] += rates.Omega0[a]
    keep.R0[:] = state.R0
    lie.rotate_frame(state.R0, keep.R0, rates.R0[0])
    lie.orthonormalize(state.R0)
    for i in range(system.m.shape[0]):
        for a in range(3):
            state.Omega[i, a] += rates.Omega[i, a]
        keep.R[i][:] = state.R[i]
        lie.rotate_frame(state.R[i], keep.R[i], rates.R[i, 0])
        lie.orthonormalize(state.R[i])
        for j in range(system.n_links[i]):
            q, w = state.q[i, j], state.omega[i, j]
            lie.rotate_direction(q, rates.q[i, j], q)
            for a in range(3):
                w[a] += rates.omega[i, j, a]
            along = w[0] * q[0] + w[1] * q[1] + w[2] * q[2]
            for a in range(3):
                w[a] -= along * q[a]
