"""The time derivative of the accelerations along the motion: N Xdddot = P' - N' Xddot, from the dense form.

The paper's law needs it once: the commanded attitude's angular acceleration holds the second derivative of the ideal
force, which is a feedback of velocities.
"""

from typing import NamedTuple

import numpy as np

from cablequad.model import lie
from cablequad.model.dynamics import Accelerations, dense
from cablequad.model.state import State
from cablequad.model.system import System
from cablequad.types import Array


class Jerks(NamedTuple):
    """Third derivatives of the motion."""

    x0: Array  # (3,) m/s^3, W
    Omega0: Array  # (3,) rad/s^3, payload frame: second derivative of Omega_0
    omega: Array  # (n, L, 3) rad/s^3, W: second derivative of omega_ij; padding 0


def link_accelerations(state: State, acc: Accelerations) -> Array:
    """(n, L, 3) 1/s^2: qddot = omega_dot x q - |omega|^2 q."""
    out: Array = np.cross(acc.omega_dot, state.q) - np.sum(state.omega**2, axis=-1, keepdims=True) * state.q
    return out


def jerks(system: System, state: State, acc: Accelerations, force: Array, force_dot: Array) -> Jerks:
    """Jerks of `state` whose accelerations under `force` (n, 3) N are `acc`, while the force changes by `force_dot`."""
    n, L = system.length.shape
    R0, O, Od = state.R0, state.Omega0, acc.Omega0_dot
    O_hat, Od_hat = lie.hat(O), lie.hat(Od)
    R0_dot = R0 @ O_hat
    g3 = np.array([0.0, 0.0, system.g])
    q_dot = np.cross(state.omega, state.q)
    q_ddot = link_accelerations(state, acc)
    N, _ = dense(system, state, force)
    b = np.zeros(len(N))  # P' - N' Xddot
    b[3:6] = -np.cross(Od, system.Jbar0 @ O) - np.cross(O, system.Jbar0 @ Od)
    row = 6
    for i in range(n):
        M_i, rho_hat, u, u_dot = system.M_iT[i], lie.hat(system.rho[i]), force[i], force_dot[i]
        swing = R0 @ O_hat @ O_hat @ system.rho[i]
        swing_dot = R0 @ (O_hat @ O_hat @ O_hat + Od_hat @ O_hat + O_hat @ Od_hat) @ system.rho[i]
        b[0:3] += u_dot - M_i * swing_dot + M_i * R0_dot @ rho_hat @ Od
        b[3:6] += rho_hat @ (R0_dot.T @ (u + M_i * g3 - M_i * acc.x0_ddot) + R0.T @ u_dot)
        for j in range(system.n_links[i]):
            here = slice(row + 3 * j, row + 3 * j + 3)
            M_ij, l_ij = system.M_0[i, j], system.length[i, j]
            q, qd, qdd = state.q[i, j], q_dot[i, j], q_ddot[i, j]
            S = lie.hat(q) @ lie.hat(q)
            S_dot = lie.hat(qd) @ lie.hat(q) + lie.hat(q) @ lie.hat(qd)
            b[3:6] += M_ij * l_ij * rho_hat @ R0_dot.T @ qdd
            b[here] = -S_dot @ (u + M_ij * g3 - M_ij * swing) - S @ (u_dot - M_ij * swing_dot)
            b[here] += M_ij * l_ij * (2 * (qd @ qdd) * q + (qd @ qd) * qd)
            b[here] += M_ij * S_dot @ acc.x0_ddot - M_ij * (S_dot @ R0 + S @ R0_dot) @ rho_hat @ Od
            for k in range(system.n_links[i]):
                if k != j:
                    b[here] -= system.M_0[i, min(j, k)] * system.length[i, k] * S_dot @ q_ddot[i, k]
        row += 3 * int(system.n_links[i])
    x: Array = np.asarray(np.linalg.solve(N, b), dtype=float)
    q_dddot = np.zeros((n, L, 3))
    row = 6
    for i in range(n):
        k = int(system.n_links[i])
        q_dddot[i, :k] = x[row : row + 3 * k].reshape(k, 3)
        row += 3 * k
    omega = np.cross(q_dot, q_ddot) + np.cross(state.q, q_dddot)
    return Jerks(x[0:3], x[3:6], omega)
