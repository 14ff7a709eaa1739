"""Section IV: from the ideal forces A_i to attitudes R_ic, their rates, thrusts f_i and moments M_i."""

from typing import NamedTuple

import numpy as np

from cablequad._jit import jit
from cablequad.model import lie
from cablequad.types import Array


class AttitudeCommand(NamedTuple):
    """A commanded frame and its motion."""

    R_c: Array  # (3, 3) B -> W
    Omega_c: Array  # (3,) rad/s, in the commanded frame
    Omega_c_dot: Array  # (3,) rad/s^2


@jit
def attitude_of_force(A: Array, b1: Array) -> Array:
    """R_ic (3, 3): third axis along -A (3,) N, first axis the projection of b1 (3,) on the plane normal to it."""
    b3 = -A / np.sqrt(A[0] ** 2 + A[1] ** 2 + A[2] ** 2)
    c2 = lie.cross(b3, b1)
    b2 = c2 / np.sqrt(c2[0] ** 2 + c2[1] ** 2 + c2[2] ** 2)
    b1_c = lie.cross(b2, b3)
    R_c = np.empty((3, 3))
    R_c[:, 0], R_c[:, 1], R_c[:, 2] = b1_c, b2, b3
    return R_c


def attitude_command(A: Array, A_dot: Array, A_ddot: Array, b1: Array) -> AttitudeCommand:
    """R_c, Omega_c and Omega_c_dot of a force that moves with A_dot N/s and A_ddot N/s^2, b1 fixed in the world."""
    b3, b3_dot, b3_ddot = _unit(-A, -A_dot, -A_ddot)
    b2, b2_dot, b2_ddot = _unit(np.cross(b3, b1), np.cross(b3_dot, b1), np.cross(b3_ddot, b1))
    b1_c = np.cross(b2, b3)
    b1_dot = np.cross(b2_dot, b3) + np.cross(b2, b3_dot)
    b1_ddot = np.cross(b2_ddot, b3) + 2 * np.cross(b2_dot, b3_dot) + np.cross(b2, b3_ddot)
    R_c = np.stack([b1_c, b2, b3], axis=1)
    R_dot = np.stack([b1_dot, b2_dot, b3_dot], axis=1)
    R_ddot = np.stack([b1_ddot, b2_ddot, b3_ddot], axis=1)
    Omega_c = lie.vee(R_c.T @ R_dot)
    Omega_c_dot = lie.vee(R_c.T @ R_ddot)  # R'Rddot = hat(Omega_dot) + hat(Omega)^2, whose second part is symmetric
    return AttitudeCommand(R_c, Omega_c, Omega_c_dot)


def _unit(a: Array, a_dot: Array, a_ddot: Array) -> tuple[Array, Array, Array]:
    """a / |a| and its first two derivatives."""
    r = float(np.sqrt(a @ a))
    u = a / r
    r_dot = u @ a_dot
    u_dot = (a_dot - r_dot * u) / r
    r_ddot = u_dot @ a_dot + u @ a_ddot
    u_ddot = (a_ddot - r_ddot * u - 2 * r_dot * u_dot) / r
    return u, u_dot, u_ddot


class AttitudeError(NamedTuple):
    """How far a quadrotor is from its commanded frame."""

    e_R: Array  # (3,) 1/2 (R_c'R - R'R_c)^vee
    e_Omega: Array  # (3,) rad/s, Omega - R'R_c Omega_c
    Psi: float  # 1/2 tr(I - R_c'R)


def attitude_error(R: Array, Omega: Array, command: AttitudeCommand) -> AttitudeError:
    """The paper's e_R, e_Omega and Psi."""
    relative = command.R_c.T @ R
    return AttitudeError(
        lie.vee(relative), Omega - relative.T @ command.Omega_c, 0.5 * float(np.trace(np.eye(3) - relative))
    )


def thrust(A: Array, R: Array) -> float:
    """f_i = -A_i . R_i e3, N."""
    return float(-A @ R[:, 2])


def moment(J: Array, R: Array, Omega: Array, command: AttitudeCommand, k_R: float, k_Omega: float) -> Array:
    """M_i (3,) N m, body frame: the tracking law on SO(3), with k_R in N m and k_Omega in N m s."""
    error = attitude_error(R, Omega, command)
    relative = R.T @ command.R_c
    rate = relative @ command.Omega_c
    M: Array = (
        -k_R * error.e_R - k_Omega * error.e_Omega + np.cross(rate, J @ rate) + J @ relative @ command.Omega_c_dot
    )
    return M
