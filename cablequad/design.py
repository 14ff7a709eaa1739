"""Gains from `control`, on the linear model."""

from typing import NamedTuple

import control
import numpy as np

from cablequad.linear import equilibrium_forces, linearize
from cablequad.state import State
from cablequad.system import System
from cablequad.types import Array


class Weights(NamedTuple):
    """Diagonal weights of the quadratic cost, per squared unit."""

    position: float = 1.0  # 1/m^2
    velocity: float = 2.0  # s^2/m^2
    attitude: float = 2.0  # 1/rad^2, payload
    body_rate: float = 1.0  # s^2/rad^2, payload
    link_direction: float = 1.0  # 1/rad^2
    link_rate: float = 0.1  # s^2/rad^2
    force: float = 1.0  # 1/N^2


class Design(NamedTuple):
    """A controller for one system: everything that `tick` needs and nothing that changes."""

    system: System
    hanging: State  # the equilibrium at the origin, around which errors are taken
    u_star: Array  # (n, 3) N, W: equilibrium forces
    K_x: Array  # (3 n, D) N per unit of x
    K_xdot: Array  # (3 n, D) N per unit of x_dot
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
    """(Q, R) diagonal matrices of the quadratic cost."""
    links = 2 * int(system.n_links.sum())
    w = weights
    x = [w.position] * 3 + [w.attitude] * 3 + [w.link_direction] * links
    x_dot = [w.velocity] * 3 + [w.body_rate] * 3 + [w.link_rate] * links
    return np.diag(np.array(x + x_dot)), w.force * np.eye(3 * len(system.m))


def paper_law(system: System, weights: Weights, max_thrust: Array) -> Design:
    """The paper's law with gains of a continuous LQR on the linear model; b_1i = e1.

    Raises DesignError where the linear model cannot be stabilised, EquilibriumError where there is no equilibrium.
    """
    n = len(system.m)
    A, B = state_space(system)
    Q, R = cost(system, weights)
    try:
        K = np.asarray(control.lqr(A, B, Q, R)[0], dtype=float)
    except (np.linalg.LinAlgError, ValueError, control.ControlDimension) as error:
        raise DesignError(f"control: no stabilising gains for {n} vehicles with these weights ({error})") from None
    if np.linalg.eigvals(A - B @ K).real.max() >= 0:
        raise DesignError(f"control: a mode of the {n}-vehicle system cannot be stabilised by the vehicles' forces")
    D = A.shape[0] // 2
    return Design(
        system=system,
        hanging=State.hanging(system),
        u_star=equilibrium_forces(system),
        K_x=np.ascontiguousarray(K[:, :D]),
        K_xdot=np.ascontiguousarray(K[:, D:]),
        b1=np.tile(np.array([1.0, 0.0, 0.0]), (n, 1)),
        max_thrust=np.asarray(max_thrust, dtype=float),
    )
