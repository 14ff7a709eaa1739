"""Equilibrium and the linear model of Proposition 2, with the misprints corrected.

x = [dx_0, eta_0, C'xi_ij ...] as in `state.local`; M xddot + G x = B du with du = [u_i - u_i*] stacked, (3 n,).
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cablequad.model import lie
from cablequad.model.system import System
from cablequad.types import Array

WEAKEST_SHARE = 0.05  # a tilted load is turned until its weakest cable pulls this share of an equal split
TILT_STEP = np.radians(0.5)


class EquilibriumError(ValueError):
    """The load cannot hang still on vertical cables that all pull."""


class Equilibrium(NamedTuple):
    """How the load hangs at rest: cables vertical, the load level where it can be."""

    R0: Array  # (3, 3) payload -> W
    tension: Array  # (n,) N: T_i*, the pull on the load below the last link's mass


def equilibrium(system: System) -> Equilibrium:
    """The equilibrium with the smallest tilt of the load whose cables all pull.

    Where the level load would need a cable to push, the load is tilted until its centre of mass comes to hang under the
    attachments. Raises EquilibriumError, naming the cable, where no tilt does. Found once for each system: design,
    reach and observer all ask for it, and a tilt is found by search.
    """
    found = _found(_Same(system))
    return Equilibrium(found.R0.copy(), found.tension.copy())


class _Same:
    """A system that equals another when all its numbers do."""

    def __init__(self, system: System) -> None:
        self.system = system
        self._bytes = repr(system.length.shape).encode() + b"".join(np.asarray(a).tobytes() for a in system)

    def __hash__(self) -> int:
        return hash(self._bytes)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self._bytes == other._bytes


@lru_cache(maxsize=64)
def _found(same: _Same) -> Equilibrium:
    system = same.system
    try:
        return Equilibrium(np.eye(3), tension_split(system))
    except EquilibriumError as error:
        refusal = error
    enough = WEAKEST_SHARE * system.m0 * system.g / len(system.m)
    if len(system.m) == 1 and np.linalg.norm(system.rho[0]) > 0:
        up = system.rho[0] / np.linalg.norm(system.rho[0])
        R0 = lie.exp(lie.direction_to(up, np.array([0.0, 0.0, -1.0])))
        return Equilibrium(R0, tension_split(_seen_from(system, R0)))
    if len(system.m) == 2:
        return _hung_on_a_line(system, refusal)
    for tilt in np.arange(TILT_STEP, np.pi, TILT_STEP):
        best: Equilibrium | None = None
        for towards in np.radians(np.arange(0.0, 360.0, 5.0)):
            R0 = lie.exp(tilt * np.array([np.cos(towards), np.sin(towards), 0.0]))
            try:
                found = Equilibrium(R0, tension_split(_seen_from(system, R0)))
            except EquilibriumError:
                continue
            if found.tension.min() >= enough and (best is None or found.tension.min() > best.tension.min()):
                best = found
        if best is not None:
            return best
    raise refusal


def _hung_on_a_line(system: System, refusal: EquilibriumError) -> Equilibrium:
    """Two cables: the centre of mass must come to hang under the line between the attachments."""
    a, b = system.rho
    along = (b - a) / np.linalg.norm(b - a)
    share = float(-(a @ along) / np.linalg.norm(b - a))  # foot of the centre of mass on the line
    foot = a + share * (b - a)
    if not 0.0 < share < 1.0:
        raise EquilibriumError(
            f"cable {1 if share >= 1.0 else 2} would have to push for the load to hang on vertical cables: its centre "
            "of mass lies beyond the other cable's attachment"
        )
    if np.linalg.norm(foot) < 1e-9:
        raise refusal
    R0 = lie.exp(lie.direction_to(foot / np.linalg.norm(foot), np.array([0.0, 0.0, -1.0])))
    return Equilibrium(R0, tension_split(_seen_from(system, R0)))


def _seen_from(system: System, R0: Array) -> System:
    """The same system with the payload's frame turned so that attitude `R0` is level in it."""
    rho = np.ascontiguousarray(system.rho @ R0.T)
    return system._replace(rho=rho, J0=R0 @ system.J0 @ R0.T, Jbar0=R0 @ system.Jbar0 @ R0.T)


def tension_split(system: System) -> Array:
    """(n,) N: the static tension T_i* of each cable of a level load, smallest in norm among those that all pull.

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
    from scipy import optimize  # here, as few systems need it

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
        f"cable {worst + 1} would have to push ({split[worst]:.3g} N) for the load to hang on vertical cables; "
        "move its attachment or the centre of mass"
    )


def equilibrium_forces(system: System, hung: Equilibrium) -> Array:
    """(n, 3) N, W: u_i* = -(M_iT g + T_i*) e3."""
    u = np.zeros((len(system.m), 3))
    u[:, 2] = -(system.M_iT * system.g + hung.tension)
    return u


def linearize(system: System) -> tuple[Array, Array, Array]:
    """(M, G, B) of shapes (D, D), (D, D), (D, 3 n), D = 6 + 2 sum n_i, around `equilibrium(system)`.

    eta_0 are rotations in the payload's own frame, also where the load hangs tilted. Raises EquilibriumError where
    there is no equilibrium.
    """
    hung = equilibrium(system)
    M, G, B = _level(_seen_from(system, hung.R0), hung.tension)
    for rows in (M, G, B):
        rows[3:6] = hung.R0.T @ rows[3:6]
    for columns in (M, G):
        columns[:, 3:6] = columns[:, 3:6] @ hung.R0
    return M, G, B


def _level(system: System, T: Array) -> tuple[Array, Array, Array]:
    """The matrices of Proposition 2 for a level load whose cables pull with T (n,) N."""
    n = len(system.m)
    D = 6 + 2 * int(system.n_links.sum())
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
