"""Gains from `control`, on the linear model: the paper's continuous law, and one for the loop as it is flown.

The sampled law's model also holds what stands between a commanded force and the force that acts: the vehicle's
second-order attitude response (the horizontal part follows the tilt) and the commands that are under way. Its states
are [x, x_dot, phi, phi_dot, a_{k-1}, .. a_{k-d}] with phi_i (2) N the horizontal force of vehicle i.
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg

from cablequad.attitude import Airframe
from cablequad.linear import equilibrium, equilibrium_forces, linearize
from cablequad.state import State
from cablequad.system import System
from cablequad.types import Array


class Weights(NamedTuple):
    """Diagonal weights of the quadratic cost, per squared unit."""

    position: float = 4.0  # 1/m^2
    velocity: float = 6.0  # s^2/m^2
    attitude: float = 6.0  # 1/rad^2, payload
    body_rate: float = 3.0  # s^2/rad^2, payload
    link_direction: float = 0.3  # 1/rad^2
    link_rate: float = 0.1  # s^2/rad^2
    force: float = 1.0  # 1/N^2


class Design(NamedTuple):
    """A controller for one system: everything that `tick` needs and nothing that changes."""

    system: System
    hanging: State  # the equilibrium at the origin, around which errors are taken
    u_star: Array  # (n, 3) N, W: equilibrium forces
    K_x: Array  # (3 n, D) N per unit of x
    K_xdot: Array  # (3 n, D) N per unit of x_dot
    K_phi: Array  # (3 n, 2 n) per N of horizontal force that acts
    K_phidot: Array  # (3 n, 2 n) s, per N/s of it
    K_way: Array  # (3 n, 3 n d) per N of the d commands under way, newest first
    b1: Array  # (n, 3) W: where each vehicle's nose points
    max_thrust: Array  # (n,) N: commands are limited to what the rotors have


class DesignError(ValueError):
    """No stabilising gains exist for this system and these weights."""


def state_space(system: System) -> tuple[Array, Array]:
    """(A, B) of the first-order linear model in [x; x_dot], shapes (2 D, 2 D) and (2 D, 3 n)."""
    M, G, B = linearize(system)
    D = len(M)
    A = np.block([[np.zeros((D, D)), np.eye(D)], [-np.linalg.solve(M, G), np.zeros((D, D))]])
    return A, np.vstack([np.zeros_like(B), np.linalg.solve(M, B)])


def cost(system: System, weights: Weights) -> tuple[Array, Array]:
    """(Q, R) diagonal matrices of the quadratic cost on [x; x_dot] and the forces."""
    links = 2 * int(system.n_links.sum())
    w = weights
    x = [w.position] * 3 + [w.attitude] * 3 + [w.link_direction] * links
    x_dot = [w.velocity] * 3 + [w.body_rate] * 3 + [w.link_rate] * links
    return np.diag(np.array(x + x_dot)), w.force * np.eye(3 * len(system.m))


def flown_model(system: System, airframe: Airframe, period: float, delay: int) -> tuple[Array, Array]:
    """(A_d, B_d) of the sampled loop over one `period` s: link dynamics, attitude responses, `delay` ticks under way.

    phi'' = -w^2 (phi - a_xy) - 2 zeta w phi' per vehicle; the vertical force acts at once. Commands are held.
    """
    n = len(system.m)
    A, B = state_space(system)
    X = len(A)
    flat = np.kron(np.eye(n), np.eye(3)[:, :2])  # (3 n, 2 n): horizontal forces among all
    upright = np.kron(np.eye(n), np.diag([0.0, 0.0, 1.0]))
    w_sq = np.repeat(airframe.bandwidth**2, 2)
    damping = np.repeat(2.0 * airframe.damping * airframe.bandwidth, 2)
    zero = np.zeros((2 * n, 2 * n))
    none = np.zeros((2 * n, X))
    F = np.block(
        [[A, B @ flat, np.zeros((X, 2 * n))], [none, zero, np.eye(2 * n)], [none, np.diag(-w_sq), np.diag(-damping)]]
    )
    H = np.vstack([B @ upright, np.zeros((2 * n, 3 * n)), w_sq[:, None] * flat.T])
    held = linalg.expm(period * np.block([[F, H], [np.zeros((3 * n, F.shape[0] + 3 * n))]]))
    F_d, H_d = held[: len(F), : len(F)], held[: len(F), len(F) :]
    if delay == 0:
        return F_d, H_d
    S, U = len(F), 3 * n
    A_d, B_d = np.zeros((S + U * delay, S + U * delay)), np.zeros((S + U * delay, U))
    A_d[:S, :S] = F_d
    A_d[:S, S + U * (delay - 1) :] = H_d  # the oldest command under way acts
    A_d[S + U :, S : S + U * (delay - 1)] = np.eye(U * (delay - 1))
    B_d[S : S + U] = np.eye(U)
    return A_d, B_d


def continuous_law(system: System, weights: Weights, max_thrust: Array) -> Design:
    """The paper's law with gains of a continuous LQR on the linear model; b_1i = e1.

    Raises DesignError where the linear model cannot be stabilised, EquilibriumError where there is no equilibrium.
    """
    import control  # here, as it brings matplotlib along

    n = len(system.m)
    A, B = state_space(system)
    Q, R = cost(system, weights)
    try:
        K = np.asarray(control.lqr(A, B, Q, R)[0], dtype=float)
    except (np.linalg.LinAlgError, ValueError, control.ControlDimension) as error:
        raise DesignError(_none(n, str(error))) from None
    if np.linalg.eigvals(A - B @ K).real.max() >= 0:
        raise DesignError(_none(n, "a mode stays undamped"))
    return _design(system, K, 0, max_thrust)


def sampled_law(system: System, airframe: Airframe, weights: Weights, period: float, delay: int) -> Design:
    """The law for a loop sampled every `period` s whose commands act `delay` ticks later through the attitude loops.

    Raises DesignError where that loop cannot be stabilised, EquilibriumError where there is no equilibrium.
    """
    import control  # here, as it brings matplotlib along

    n = len(system.m)
    A, B = flown_model(system, airframe, period, delay)
    Q_x, R = cost(system, weights)
    Q = np.zeros_like(A)
    Q[: len(Q_x), : len(Q_x)] = Q_x
    try:
        K = np.asarray(control.dlqr(A, B, Q, R)[0], dtype=float)
    except (np.linalg.LinAlgError, ValueError, control.ControlDimension) as error:
        raise DesignError(_none(n, str(error))) from None
    if np.abs(np.linalg.eigvals(A - B @ K)).max() >= 1:
        raise DesignError(_none(n, "a mode stays undamped"))
    return _design(system, K, delay, airframe.max_thrust)


def _none(n: int, why: str) -> str:
    return (
        f"control: no stabilising gains for {n} vehicle{'s' if n > 1 else ''} ({why}); some motion of the load is out "
        "of reach of the vehicles' forces or the weights are out of proportion"
    )


def _design(system: System, K: Array, delay: int, max_thrust: Array) -> Design:
    n = len(system.m)
    D = 6 + 2 * int(system.n_links.sum())
    U = 3 * n
    full = np.zeros((U, 2 * D + 4 * n + U * delay))
    full[:, : K.shape[1]] = K
    ends = np.cumsum([D, D, 2 * n, 2 * n, U * delay])
    K_x, K_xdot, K_phi, K_phidot, K_way = (np.ascontiguousarray(part) for part in np.split(full, ends[:-1], axis=1))
    hung = equilibrium(system)
    return Design(
        system=system,
        hanging=State.hanging(system)._replace(R0=hung.R0),
        u_star=equilibrium_forces(system, hung),
        K_x=K_x,
        K_xdot=K_xdot,
        K_phi=K_phi,
        K_phidot=K_phidot,
        K_way=K_way,
        b1=np.tile(np.array([1.0, 0.0, 0.0]), (n, 1)),
        max_thrust=np.asarray(max_thrust, dtype=float),
    )
