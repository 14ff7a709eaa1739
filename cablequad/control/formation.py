"""The motion that a reference asks of everything else: load, cables and vehicles swing together as one rigid formation.

In the frame that moves with the load, gravity is g e3 - a. A formation turned by S with S e3 along it is in equilibrium
there, with every force scaled by its size: no cable pulls across another, for any number of vehicles. What the turning
itself asks of the vehicles is added; the cables' and the load's own inertia against it (a few percent) is left to
feedback.
"""

from typing import NamedTuple

import numpy as np

from cablequad._jit import jit
from cablequad.control.trajectory import Reference
from cablequad.model import lie
from cablequad.model.attitude import Airframe
from cablequad.model.state import State
from cablequad.model.system import System
from cablequad.types import Array


class Formation(NamedTuple):
    """What all parts do along the reference, seen from a frame turned about e3 by its yaw."""

    target: State  # load and cables; vehicles' attitudes as in `hanging`
    u: Array  # (n, 3) N: forces that hold the formation now
    command: Array  # (n, 3) N: what is to be commanded now, ahead of u by the loop's lag
    phi: Array  # (2 n,) N: horizontal forces as attitudes show them, -f_i* R_i e3
    phi_dot: Array  # (2 n,) N/s
    x: Array  # (n, 3) m: quadrotors
    v: Array  # (n, 3) m/s
    a: Array  # (n, 3) m/s^2


@jit
def formation(
    system: System, hanging: State, u_star: Array, airframe: Airframe, lead: float, reference: Reference
) -> Formation:
    """The formation of `reference`, in the yawed frame; commands are for `lead` s later, through attitude loops."""
    n, L = system.length.shape
    r = reference
    d = np.array([-r.a0[0], -r.a0[1], system.g - r.a0[2]])
    size = np.sqrt(np.sum(d * d))
    s3 = d / size
    S = lie.exp(lie.direction_to(np.array([0.0, 0.0, 1.0]), s3))
    # s3' = W x s3, and W' without the products of rates, which are of second order in the reference
    W = lie.cross(s3, -r.j0) / size
    W_dot = lie.cross(s3, -r.s0) / size
    turn = W + np.array([0.0, 0.0, r.yaw[1]])
    turn_dot = W_dot + np.array([0.0, 0.0, r.yaw[2]])
    R0 = S @ hanging.R0
    Omega0 = np.ascontiguousarray(R0.T) @ turn
    q, omega = np.empty((n, L, 3)), np.zeros((n, L, 3))
    u, command = np.empty((n, 3)), np.empty((n, 3))
    x, v, a = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    phi, phi_dot = np.empty(2 * n), np.empty(2 * n)
    for i in range(n):
        long = 0.0
        for j in range(L):
            q[i, j] = s3 if j < system.n_links[i] else np.array([0.0, 0.0, 1.0])
            if j < system.n_links[i]:
                omega[i, j] = W
                long += system.length[i, j]
        at = R0 @ system.rho[i]
        x[i] = r.x0 + at - long * s3
        v[i] = r.v0 + lie.cross(turn, at) - long * lie.cross(W, s3)
        spun = lie.cross(turn_dot, at) + lie.cross(turn, lie.cross(turn, at))
        swung = lie.cross(W_dot, s3) + lie.cross(W, lie.cross(W, s3))
        a[i] = r.a0 + spun - long * swung
        M, T = system.M_iT[i], -u_star[i, 2] - system.M_iT[i] * system.g
        u[i] = M * (a[i] - np.array([0.0, 0.0, system.g])) - T / system.g * d
        rate, bend = (M + T / system.g) * r.j0, (M + T / system.g) * r.s0
        w, damping = airframe.bandwidth[i], airframe.damping[i]
        f = -u_star[i, 2]
        f_d = np.sqrt(np.sum(u[i] * u[i]))
        for b in range(3):
            ahead, ahead_rate = u[i, b] + lead * rate[b] + 0.5 * lead * lead * bend[b], rate[b] + lead * bend[b]
            command[i, b] = ahead
            if b < 2:  # the horizontal part follows the tilt
                command[i, b] += 2.0 * damping / w * ahead_rate + bend[b] / (w * w)
                phi[2 * i + b] = f * u[i, b] / f_d
                phi_dot[2 * i + b] = f * rate[b] / f_d
    target = State(r.x0, r.v0, R0, Omega0, q, omega, hanging.R, hanging.Omega)
    return Formation(target, u, command, phi, phi_dot, x, v, a)
