"""Equilibrium and the linear model of Proposition 2, with the misprints corrected.

x = [dx_0, eta_0, C'xi_ij ...] as in `state.local`; M xddot + G x = B du with du = [u_i - u_i*] stacked, (3 n,).
"""

import numpy as np
from scipy import optimize

from cablequad import lie
from cablequad.system import System
from cablequad.types import Array


class EquilibriumError(ValueError):
    """The load cannot hang upright on vertical cables that all pull."""


def tension_split(system: System) -> Array:
    """(n,) N: the static tension T_i* of each cable below its last link, smallest in norm among those that all pull.

    sum T_i* = m_0 g and sum rho_i x T_i* e3 = 0; for a load whose attachments are centred this is m_0 g / n. Raises
    EquilibriumError naming the cable that would have to push, or the direction in which the load hangs off-centre.
    """
    weight = system.m0 * system.g
    balance = np.vstack([np.ones(len(system.m)), system.rho[:, 0], system.rho[:, 1]])
    wanted = np.array([weight, 0.0, 0.0])
    split: Array = np.linalg.lstsq(balance, wanted, rcond=None)[0]
    off_centre = balance @ split - wanted
    if np.abs(off_centre).max() > 1e-9 * weight:
        raise EquilibriumError(
            "payload.attachments: no vertical pulls balance the load, its centre of mass does not lie under the "
            f"attachments (remaining moment about x, y: {-off_centre[2]:.3g}, {off_centre[1]:.3g} N m)"
        )
    if split.min() > 1e-9 * weight:
        return split
    # the smallest-norm split pushes somewhere: take the one whose weakest cable pulls most
    n = len(system.m)
    result = optimize.linprog(
        c=np.append(np.zeros(n), -1.0),
        A_ub=np.hstack([-np.eye(n), np.ones((n, 1))]),
        b_ub=np.zeros(n),
        A_eq=np.hstack([balance, np.zeros((3, 1))]),
        b_eq=wanted,
        bounds=[(None, None)] * (n + 1),
    )
    if result.success and result.x[-1] > 1e-9 * weight:
        return np.array(result.x[:n], dtype=float)
    worst = int(np.argmin(split))
    raise EquilibriumError(
        f"cable {worst + 1} would have to push ({split[worst]:.3g} N) for the load to hang level on vertical cables; "
        "move its attachment or the centre of mass"
    )


def equilibrium_forces(system: System) -> Array:
    """(n, 3) N, W: u_i* = -(M_iT g + T_i*) e3."""
    u = np.zeros((len(system.m), 3))
    u[:, 2] = -(system.M_iT * system.g + tension_split(system))
    return u


def linearize(system: System) -> tuple[Array, Array, Array]:
    """(M, G, B) of shapes (D, D), (D, D), (D, 3 n), D = 6 + 2 sum n_i, around the upright equilibrium.

    Raises EquilibriumError where there is none.
    """
    n = len(system.m)
    D = 6 + 2 * int(system.n_links.sum())
    T = tension_split(system)
    C = np.eye(3)[:, :2]
    e3_hat = lie.hat(np.array([0.0, 0.0, 1.0]))
    M, G, B = np.zeros((D, D)), np.zeros((D, D)), np.zeros((D, 3 * n))
    M[0:3, 0:3] = system.M_T * np.eye(3)
    M[3:6, 3:6] = system.Jbar0
    row = 6
    for i in range(n):
        rho_hat = lie.hat(system.rho[i])
        u_i = slice(3 * i, 3 * i + 3)
        M[0:3, 3:6] -= system.M_iT[i] * rho_hat
        M[3:6, 0:3] += system.M_iT[i] * rho_hat
        G[3:6, 3:6] += T[i] * rho_hat @ e3_hat
        B[0:3, u_i] = np.eye(3)
        B[3:6, u_i] = rho_hat
        for j in range(system.n_links[i]):
            here = slice(row + 2 * j, row + 2 * j + 2)
            M_ij, l_ij = system.M_0[i, j], system.length[i, j]
            M[0:3, here] = M_ij * l_ij * e3_hat @ C
            M[3:6, here] = M_ij * l_ij * rho_hat @ e3_hat @ C
            M[here, 0:3] = -M_ij * C.T @ e3_hat
            M[here, 3:6] = M_ij * C.T @ e3_hat @ rho_hat
            for k in range(system.n_links[i]):
                there = slice(row + 2 * k, row + 2 * k + 2)
                M[here, there] = system.M_0[i, min(j, k)] * system.length[i, k] * np.eye(2)
            G[here, here] = (system.M_iT[i] + T[i] / system.g - M_ij) * system.g * np.eye(2)
            B[here, u_i] = -C.T @ e3_hat
        row += 2 * int(system.n_links[i])
    return M, G, B
