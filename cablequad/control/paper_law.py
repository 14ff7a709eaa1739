"""Section IV as printed: the ideal forces with their first two derivatives, and from them f_i and M_i.

This is the paper's continuous loop, in which the controller commands moments itself. Over MAVLink a vehicle takes an
attitude instead (see `attitude`); `rollout.paper_flight` flies this one.
"""

import math
from typing import NamedTuple

import numpy as np

from cablequad.control.design import Design
from cablequad.control.geometric import AttitudeCommand, attitude_command, moment, thrust
from cablequad.control.jerk import jerks, link_accelerations
from cablequad.model import lie
from cablequad.model.dynamics import accelerations
from cablequad.model.integrate import RotorOutput
from cablequad.model.state import State, local
from cablequad.types import Array


class Gains(NamedTuple):
    """k_R and k_Omega of M_i."""

    k_R: Array  # (n,) N m
    k_Omega: Array  # (n,) N m s


class IdealForces(NamedTuple):
    """A_i and its derivatives along the motion."""

    A: Array  # (n, 3) N, W
    A_dot: Array  # (n, 3) N/s
    A_ddot: Array  # (n, 3) N/s^2


def ideal_forces(design: Design, x0_d: Array, state: State) -> IdealForces:
    """A_i = u_i* - K_x x - K_xdot x_dot around a load at rest at `x0_d` (3,) m, with f_i = -A_i . R_i e3 acting."""
    n = len(design.system.m)
    target = design.hanging._replace(x0=x0_d)
    error = local(design.system, target, state)
    A = design.u_star - (design.K_x @ error.x + design.K_xdot @ error.x_dot).reshape(n, 3)
    b = state.R[:, :, 2]
    b_dot = np.einsum("iab,ib->ia", state.R, np.cross(state.Omega, np.array([0.0, 0.0, 1.0])))
    along = np.sum(A * b, axis=1, keepdims=True)
    force = along * b
    acc = accelerations(design.system, state, force)
    x_1, v_1 = _chart_velocity(design, target, state), _rates(design, acc.x0_ddot, acc.Omega0_dot, acc.omega_dot)
    A_dot = -(design.K_x @ x_1 + design.K_xdot @ v_1).reshape(n, 3)
    along_dot = np.sum(A_dot * b + A * b_dot, axis=1, keepdims=True)
    third = jerks(design.system, state, acc, force, along_dot * b + along * b_dot)
    q_ddot = link_accelerations(state, acc)
    x_2 = _chart_acceleration(design, target, state, acc.x0_ddot, acc.Omega0_dot, q_ddot)
    v_2 = _rates(design, third.x0, third.Omega0, third.omega)
    A_ddot = -(design.K_x @ x_2 + design.K_xdot @ v_2).reshape(n, 3)
    return IdealForces(A, A_dot, A_ddot)


def commands(design: Design, gains: Gains, x0_d: Array, state: State) -> tuple[RotorOutput, list[AttitudeCommand]]:
    """f_i and M_i of the paper for `state`, with the commanded frames R_ic, Omega_ic, Omega_ic_dot behind them."""
    ideal = ideal_forces(design, x0_d, state)
    n = len(design.system.m)
    frames = [attitude_command(ideal.A[i], ideal.A_dot[i], ideal.A_ddot[i], design.b1[i]) for i in range(n)]
    f = np.array([thrust(ideal.A[i], state.R[i]) for i in range(n)])
    M = np.stack(
        [
            moment(design.system.J[i], state.R[i], state.Omega[i], frames[i], gains.k_R[i], gains.k_Omega[i])
            for i in range(n)
        ]
    )
    return RotorOutput(np.clip(f, 0.0, design.airframe.max_thrust), M), frames


def _pack(design: Design, x0: Array, attitude: Array, links: Array) -> Array:
    used = np.arange(links.shape[1])[None, :] < design.system.n_links[:, None]
    return np.concatenate([x0, attitude, links[used].ravel()])


def _rates(design: Design, x0: Array, Omega0: Array, omega: Array) -> Array:
    """[x0; Omega0; C'omega_ij] for derivatives of the velocities."""
    return _pack(design, x0, Omega0, omega[:, :, :2])


def _chart_velocity(design: Design, target: State, state: State) -> Array:
    """d/dt of the chart's x: [v_0; J_r^-1(eta) Omega_0; d/dt C'xi_ij]."""
    eta = lie.log(target.R0.T @ state.R0)
    q_dot = np.cross(state.omega, state.q)
    s, s_dot = _sideways(state.q), _sideways(q_dot)
    phi, phi_1, _ = _angle_over_sine(state.q[..., 2])
    links = (phi_1 * q_dot[..., 2])[..., None] * s + phi[..., None] * s_dot
    return _pack(design, state.v0, _eta_dot(eta, state.Omega0), links)


def _chart_acceleration(
    design: Design, target: State, state: State, x0_ddot: Array, Omega0_dot: Array, q_ddot: Array
) -> Array:
    """d^2/dt^2 of the chart's x."""
    eta, O = lie.log(target.R0.T @ state.R0), state.Omega0
    d = _eta_dot(eta, O)
    beta, beta_1 = _beta(float(eta @ eta))
    inner = np.cross(eta, O)
    eta_ddot = Omega0_dot + 0.5 * (np.cross(d, O) + np.cross(eta, Omega0_dot))
    eta_ddot += 2.0 * beta_1 * (eta @ d) * np.cross(eta, inner)
    eta_ddot += beta * (np.cross(d, inner) + np.cross(eta, np.cross(d, O)) + np.cross(eta, np.cross(eta, Omega0_dot)))
    q_dot = np.cross(state.omega, state.q)
    s, s_1, s_2 = _sideways(state.q), _sideways(q_dot), _sideways(q_ddot)
    phi, phi_1, phi_2 = _angle_over_sine(state.q[..., 2])
    c_1, c_2 = q_dot[..., 2], q_ddot[..., 2]
    links = (phi_2 * c_1**2 + phi_1 * c_2)[..., None] * s + (2 * phi_1 * c_1)[..., None] * s_1 + phi[..., None] * s_2
    return _pack(design, x0_ddot, eta_ddot, links)


def _sideways(q: Array) -> Array:
    """C'(e3 x q) for links that are to hang along e3, (n, L, 2)."""
    return np.stack([-q[..., 1], q[..., 0]], axis=-1)


def _angle_over_sine(c: Array) -> tuple[Array, Array, Array]:
    """phi = a / sin a of c = cos a, with its first two derivatives by c: xi = phi (e3 x q)."""
    small = 1.0 - c < 1e-2
    far = np.where(small, 0.0, c)
    phi = np.arccos(far) / np.sqrt(1 - far**2)
    phi_1 = (far * phi - 1) / (1 - far**2)
    phi_2 = (phi + 3 * far * phi_1) / (1 - far**2)
    e = np.where(small, 1.0 - c, 0.0)
    a = [1.0]  # a_k = k! / (2 k + 1)!!
    for k in range(1, 9):
        a.append(a[-1] * k / (2 * k + 1))
    near = sum(a[k] * e**k for k in range(9))
    near_1 = -sum(k * a[k] * e ** (k - 1) for k in range(1, 9))
    near_2 = sum(k * (k - 1) * a[k] * e ** (k - 2) for k in range(2, 9))
    return np.where(small, near, phi), np.where(small, near_1, phi_1), np.where(small, near_2, phi_2)


def _eta_dot(eta: Array, O: Array) -> Array:
    """J_r^-1(eta) O = O + eta x O / 2 + beta eta x (eta x O)."""
    beta, _ = _beta(float(eta @ eta))
    out: Array = O + 0.5 * np.cross(eta, O) + beta * np.cross(eta, np.cross(eta, O))
    return out


def _beta(s: float) -> tuple[float, float]:
    """1/a^2 - (1 + cos a)/(2 a sin a) and its derivative by s = a^2."""
    if s < 0.05:
        value = 1 / 12 + s / 720 + s**2 / 30240 + s**3 / 1209600 + s**4 / 47900160
        return value, 1 / 720 + s / 15120 + s**2 / 403200 + s**3 / 11975040
    a = math.sqrt(s)
    cot = 1 / math.tan(a / 2)
    by_a = -2 / a**3 + cot / (2 * s) + (1 + cot * cot) / (4 * a)
    return 1 / s - cot / (2 * a), by_a / (2 * a)
