"""Equations of motion (Proposition 1, with the misprints corrected): tensions first, and the paper's dense form.

`accelerations` is what runs: cost linear in the number of links. `dense` writes the paper's N Xddot = P and serves as
its judge. Forces are the quadrotors' u_i = -f_i R_i e3 in the world frame, N.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cablequad._jit import inlined, jit
from cablequad.model import lie
from cablequad.model.state import State, positions, velocities
from cablequad.model.system import System
from cablequad.types import Array


class Accelerations(NamedTuple):
    """What the equations of motion give, with the tensions that the dense form hides."""

    x0_ddot: Array  # (3,) m/s^2, W
    Omega0_dot: Array  # (3,) rad/s^2, payload frame
    omega_dot: Array  # (n, L, 3) rad/s^2, W; padding 0
    tension: Array  # (n, L) N, positive pulls; padding 0


class Workspace(NamedTuple):
    """Scratch of one evaluation, so that the loop allocates nothing."""

    pivot: Array  # (n, L) 1/kg
    rhs: Array  # (n, L) m/s^2
    coupling: Array  # (n, L) 1/kg: q_{j-1} . q_j / (mass between), of link j
    S: Array  # (6, 7): the payload's system, augmented
    b: Array  # (n, 3) m/s^2, payload frame: Omega0 x (Omega0 x rho_i)
    p: Array  # (n, 3), payload frame: direction of the last link
    loaded: npt.NDArray[np.bool_]  # (1,) whether forces from outside act; they are what follows, 0 otherwise
    on_payload: Array  # (3,) N, W, at the centre of mass
    turning: Array  # (3,) N m, payload frame
    on_nodes: Array  # (n, L, 3) N, W, at the payload-side end of each link


def accelerations(
    system: System,
    state: State,
    force: Array,
    on_payload: Array | None = None,
    on_nodes: Array | None = None,
    turning: Array | None = None,
) -> Accelerations:
    """Accelerations and tensions of `state` under `force` (n, 3) N, W, at the vehicles.

    From outside may act: (3,) N, W, at the payload's centre of mass, (n, L, 3) at the payload-side ends of links, and
    `turning` (3,) N m on the payload, in its frame.
    """
    n, L = system.length.shape
    work = workspace(system)
    if on_payload is not None or on_nodes is not None or turning is not None:
        work.loaded[0] = True
        work.turning[:] = 0.0 if turning is None else turning
        work.on_payload[:] = 0.0 if on_payload is None else on_payload
        work.on_nodes[:] = 0.0 if on_nodes is None else on_nodes
    out = Accelerations(np.empty(3), np.empty(3), np.zeros((n, L, 3)), np.zeros((n, L)))
    at = State(*(np.ascontiguousarray(a, dtype=float) for a in state))
    evaluate(system, at, np.ascontiguousarray(force, dtype=float), out, work)
    return out


@jit
def workspace(system: System) -> Workspace:
    """Scratch arrays for `accelerate`."""
    n, L = system.length.shape
    return Workspace(
        np.zeros((n, L)), np.zeros((n, L)), np.zeros((n, L)), np.zeros((6, 7)), np.zeros((n, 3)), np.zeros((n, 3)),
        np.zeros(1, dtype=np.bool_), np.zeros(3), np.zeros(3), np.zeros((n, L, 3)),
    )  # fmt: skip


@inlined
def accelerate(system: System, state: State, force: Array, out: Accelerations, work: Workspace) -> None:
    """`accelerations` into `out`, without allocation.

    Per cable, the length constraints q_j . (a_j - a_{j-1}) = -l_j |w_j|^2 are tridiagonal in the tensions; a sweep from
    the quadrotor leaves T_n = k (beta + s) with s = q_n . (a_i - g e3) the attachment's acceleration along the last
    link. Each cable then enters the payload's 6 x 6 system as a rank-one term and the tied mass m_{i,n_i}.
    """
    _sweep_down(system, state, force, work)
    _solve_payload(system, state, out, work)
    _sweep_up(system, state, force, out, work)


@jit
def evaluate(system: System, state: State, force: Array, out: Accelerations, work: Workspace) -> None:
    """`accelerate` as a function of its own: where it is called once, merging it in would only cost compile time."""
    accelerate(system, state, force, out, work)


@inlined
def _sweep_down(system: System, state: State, force: Array, work: Workspace) -> None:
    """Eliminate T_1 .. T_{n-1} of every cable: `pivot` and `rhs` then hold 1/k and beta in their last entries.

    Here and below vectors are tuples: a view of an array, even unused, costs two atomic counts of its references.
    """
    for i in range(system.m.shape[0]):
        N = system.n_links[i]
        for j in range(N):
            q = (state.q[i, j, 0], state.q[i, j, 1], state.q[i, j, 2])
            w = (state.omega[i, j, 0], state.omega[i, j, 1], state.omega[i, j, 2])
            diagonal = system.inv_node[i, j] + (system.inv_node[i, j + 1] if j + 1 < N else 0.0)
            rhs = system.length[i, j] * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
            if j == 0:
                rhs -= system.inv_node[i, 0] * (q[0] * force[i, 0] + q[1] * force[i, 1] + q[2] * force[i, 2])
            else:
                above = (state.q[i, j - 1, 0], state.q[i, j - 1, 1], state.q[i, j - 1, 2])
                e = system.inv_node[i, j] * (q[0] * above[0] + q[1] * above[1] + q[2] * above[2])
                factor = e / work.pivot[i, j - 1]
                diagonal -= factor * e
                rhs += factor * work.rhs[i, j - 1]
                work.coupling[i, j] = e
            if work.loaded[0]:
                if j > 0:
                    F = work.on_nodes[i, j - 1]
                    rhs -= system.inv_node[i, j] * (q[0] * F[0] + q[1] * F[1] + q[2] * F[2])
                if j + 1 < N:
                    F = work.on_nodes[i, j]
                    rhs += system.inv_node[i, j + 1] * (q[0] * F[0] + q[1] * F[1] + q[2] * F[2])
            work.pivot[i, j] = diagonal
            work.rhs[i, j] = rhs


@inlined
def _solve_payload(system: System, state: State, out: Accelerations, work: Workspace) -> None:
    """Newton and Euler for the payload in its own frame: z = [R0'(xddot - g e3); Omega0_dot]."""
    R0, S = state.R0, work.S
    O = (state.Omega0[0], state.Omega0[1], state.Omega0[2])
    S[:] = 0.0
    for a in range(3):
        S[a, a] = system.m0
        for c in range(3):
            S[3 + a, 3 + c] = system.J0[a, c]
    JO = (
        system.J0[0, 0] * O[0] + system.J0[0, 1] * O[1] + system.J0[0, 2] * O[2],
        system.J0[1, 0] * O[0] + system.J0[1, 1] * O[1] + system.J0[1, 2] * O[2],
        system.J0[2, 0] * O[0] + system.J0[2, 1] * O[1] + system.J0[2, 2] * O[2],
    )
    S[3, 6], S[4, 6], S[5, 6] = O[2] * JO[1] - O[1] * JO[2], O[0] * JO[2] - O[2] * JO[0], O[1] * JO[0] - O[0] * JO[1]
    OO = O[0] * O[0] + O[1] * O[1] + O[2] * O[2]
    for i in range(system.m.shape[0]):
        last = system.n_links[i] - 1
        q = (state.q[i, last, 0], state.q[i, last, 1], state.q[i, last, 2])
        r = (system.rho[i, 0], system.rho[i, 1], system.rho[i, 2])
        k, beta, m = 1.0 / work.pivot[i, last], work.rhs[i, last], system.m_tied[i]
        Or = O[0] * r[0] + O[1] * r[1] + O[2] * r[2]
        p = (
            R0[0, 0] * q[0] + R0[1, 0] * q[1] + R0[2, 0] * q[2],
            R0[0, 1] * q[0] + R0[1, 1] * q[1] + R0[2, 1] * q[2],
            R0[0, 2] * q[0] + R0[1, 2] * q[1] + R0[2, 2] * q[2],
        )
        b = (O[0] * Or - OO * r[0], O[1] * Or - OO * r[1], O[2] * Or - OO * r[2])
        for a in range(3):
            work.p[i, a], work.b[i, a] = p[a], b[a]
        # the cable's pull on the payload is F = -k (beta + p . b_i) p - m b_i, with b_i = Y - hat(rho) Omega0_dot + b
        tension = k * (beta + p[0] * b[0] + p[1] * b[1] + p[2] * b[2])
        l0, l1, l2 = r[1] * p[2] - r[2] * p[1], r[2] * p[0] - r[0] * p[2], r[0] * p[1] - r[1] * p[0]
        line = (p[0], p[1], p[2], l0, l1, l2)
        f0, f1, f2 = -tension * p[0] - m * b[0], -tension * p[1] - m * b[1], -tension * p[2] - m * b[2]
        if work.loaded[0]:
            F = work.on_nodes[i, last]
            f0 += R0[0, 0] * F[0] + R0[1, 0] * F[1] + R0[2, 0] * F[2]
            f1 += R0[0, 1] * F[0] + R0[1, 1] * F[1] + R0[2, 1] * F[2]
            f2 += R0[0, 2] * F[0] + R0[1, 2] * F[1] + R0[2, 2] * F[2]
        S[0, 6] += f0
        S[1, 6] += f1
        S[2, 6] += f2
        S[3, 6] += r[1] * f2 - r[2] * f1
        S[4, 6] += r[2] * f0 - r[0] * f2
        S[5, 6] += r[0] * f1 - r[1] * f0
        for a in range(6):
            ka = k * line[a]
            for c in range(a + 1):
                S[a, c] += ka * line[c]
        for a in range(3):
            S[a, a] += m
        S[3, 3] += m * (r[1] * r[1] + r[2] * r[2])
        S[4, 4] += m * (r[0] * r[0] + r[2] * r[2])
        S[5, 5] += m * (r[0] * r[0] + r[1] * r[1])
        S[4, 3] -= m * r[0] * r[1]
        S[5, 3] -= m * r[0] * r[2]
        S[5, 4] -= m * r[1] * r[2]
        S[3, 1] -= m * r[2]
        S[3, 2] += m * r[1]
        S[4, 0] += m * r[2]
        S[4, 2] -= m * r[0]
        S[5, 0] -= m * r[1]
        S[5, 1] += m * r[0]
    if work.loaded[0]:
        F = work.on_payload
        for a in range(3):
            S[a, 6] += R0[0, a] * F[0] + R0[1, a] * F[1] + R0[2, a] * F[2]
            S[3 + a, 6] += work.turning[a]
    _solve_spd(S)
    for a in range(3):
        out.x0_ddot[a] = R0[a, 0] * S[0, 6] + R0[a, 1] * S[1, 6] + R0[a, 2] * S[2, 6]
        out.Omega0_dot[a] = S[3 + a, 6]
    out.x0_ddot[2] += system.g


@inlined
def _solve_spd(S: Array) -> None:
    """Replace the last column of S (6, 7) by the solution: Cholesky of the lower triangle, in place."""
    for a in range(6):
        for c in range(a + 1):
            total = S[a, c]
            for e in range(c):
                total -= S[a, e] * S[c, e]
            S[a, c] = total / S[c, c] if c < a else np.sqrt(total)
    for a in range(6):
        total = S[a, 6]
        for e in range(a):
            total -= S[a, e] * S[e, 6]
        S[a, 6] = total / S[a, a]
    for a in range(5, -1, -1):
        total = S[a, 6]
        for e in range(a + 1, 6):
            total -= S[e, a] * S[e, 6]
        S[a, 6] = total / S[a, a]


@inlined
def _sweep_up(system: System, state: State, force: Array, out: Accelerations, work: Workspace) -> None:
    """Tensions from the payload upward, then omega_dot_j = q_j x (a_j - a_{j-1}) / l_j."""
    Y, Od = (work.S[0, 6], work.S[1, 6], work.S[2, 6]), (out.Omega0_dot[0], out.Omega0_dot[1], out.Omega0_dot[2])
    R0 = state.R0
    for i in range(system.m.shape[0]):
        last = system.n_links[i] - 1
        r = (system.rho[i, 0], system.rho[i, 1], system.rho[i, 2])
        b, p = (work.b[i, 0], work.b[i, 1], work.b[i, 2]), (work.p[i, 0], work.p[i, 1], work.p[i, 2])
        # a_i - g e3 in the payload frame
        y0 = Y[0] + Od[1] * r[2] - Od[2] * r[1] + b[0]
        y1 = Y[1] + Od[2] * r[0] - Od[0] * r[2] + b[1]
        y2 = Y[2] + Od[0] * r[1] - Od[1] * r[0] + b[2]
        T = (work.rhs[i, last] + p[0] * y0 + p[1] * y1 + p[2] * y2) / work.pivot[i, last]
        # acceleration (less gravity) of the node at the payload-side end of the link
        a0 = R0[0, 0] * y0 + R0[0, 1] * y1 + R0[0, 2] * y2
        a1 = R0[1, 0] * y0 + R0[1, 1] * y1 + R0[1, 2] * y2
        a2 = R0[2, 0] * y0 + R0[2, 1] * y1 + R0[2, 2] * y2
        for j in range(last, -1, -1):
            q = (state.q[i, j, 0], state.q[i, j, 1], state.q[i, j, 2])
            out.tension[i, j] = T
            inv_m, inv_l = system.inv_node[i, j], 1.0 / system.length[i, j]
            c0, c1, c2 = T * q[0], T * q[1], T * q[2]
            if j > 0:
                u = (state.q[i, j - 1, 0], state.q[i, j - 1, 1], state.q[i, j - 1, 2])
                T = (work.rhs[i, j - 1] + work.coupling[i, j] * T) / work.pivot[i, j - 1]
                c0, c1, c2 = c0 - T * u[0], c1 - T * u[1], c2 - T * u[2]
                if work.loaded[0]:
                    F = work.on_nodes[i, j - 1]
                    c0, c1, c2 = c0 + F[0], c1 + F[1], c2 + F[2]
            else:
                c0, c1, c2 = c0 + force[i, 0], c1 + force[i, 1], c2 + force[i, 2]
            c0, c1, c2 = c0 * inv_m, c1 * inv_m, c2 * inv_m
            d0, d1, d2 = (a0 - c0) * inv_l, (a1 - c1) * inv_l, (a2 - c2) * inv_l
            out.omega_dot[i, j, 0] = q[1] * d2 - q[2] * d1
            out.omega_dot[i, j, 1] = q[2] * d0 - q[0] * d2
            out.omega_dot[i, j, 2] = q[0] * d1 - q[1] * d0
            a0, a1, a2 = c0, c1, c2


def dense(system: System, state: State, force: Array) -> tuple[Array, Array]:
    """The paper's N (D, D) and P (D,), D = 6 + 3 sum n_i, with Xddot = [xddot_0, Omegadot_0, qddot_ij ...].

    M_0i,min(j,k) stands in N_qqi where M_0ij is printed, and M_0ij l_ij |qdot|^2 q in P_ij where l_ij is missing.
    """
    n = len(system.m)
    D = 6 + 3 * int(system.n_links.sum())
    N, P = np.zeros((D, D)), np.zeros(D)
    R0, O0 = state.R0, state.Omega0
    g3 = np.array([0.0, 0.0, system.g])
    N[0:3, 0:3] = system.M_T * np.eye(3)
    N[3:6, 3:6] = system.Jbar0
    P[0:3] = system.M_T * g3 + force.sum(axis=0)
    P[3:6] = -np.cross(O0, system.Jbar0 @ O0)
    row = 6
    for i in range(n):
        rho_hat = lie.hat(system.rho[i])
        centripetal = R0 @ lie.hat(O0) @ lie.hat(O0) @ system.rho[i]
        N[0:3, 3:6] -= system.M_iT[i] * R0 @ rho_hat
        N[3:6, 0:3] += system.M_iT[i] * rho_hat @ R0.T
        P[0:3] -= system.M_iT[i] * centripetal
        P[3:6] += rho_hat @ R0.T @ (force[i] + system.M_iT[i] * g3)
        for j in range(system.n_links[i]):
            here = slice(row + 3 * j, row + 3 * j + 3)
            M_ij, l_ij = system.M_0[i, j], system.length[i, j]
            q = state.q[i, j]
            q_hat_sq = lie.hat(q) @ lie.hat(q)
            q_dot = np.cross(state.omega[i, j], q)
            N[0:3, here] = -M_ij * l_ij * np.eye(3)
            N[3:6, here] = -M_ij * l_ij * rho_hat @ R0.T
            N[here, 0:3] = -M_ij * q_hat_sq
            N[here, 3:6] = M_ij * q_hat_sq @ R0 @ rho_hat
            for k in range(system.n_links[i]):
                there = slice(row + 3 * k, row + 3 * k + 3)
                block = -np.eye(3) if k == j else q_hat_sq
                N[here, there] = system.M_0[i, min(j, k)] * system.length[i, k] * block
            P[here] = -q_hat_sq @ (force[i] + M_ij * g3 - M_ij * centripetal) + M_ij * l_ij * (q_dot @ q_dot) * q
        row += 3 * int(system.n_links[i])
    return N, P


def kinetic_energy(system: System, state: State) -> float:
    """T in J: payload, tied masses, nodes, quadrotors (the paper's first form)."""
    n = len(system.m)
    v = velocities(system, state)
    T = 0.5 * system.m0 * state.v0 @ state.v0 + 0.5 * state.Omega0 @ system.J0 @ state.Omega0
    for i in range(n):
        k = int(system.n_links[i])
        T += 0.5 * system.m[i] * v[i, 0] @ v[i, 0]
        T += 0.5 * np.sum(system.m_link[i, :k] * np.sum(v[i, 1 : k + 1] ** 2, axis=1))
        T += 0.5 * state.Omega[i] @ system.J[i] @ state.Omega[i]
    return float(T)


def potential_energy(system: System, state: State) -> float:
    """V in J, zero at z = 0 (z points down, so height is negative z)."""
    z = positions(system, state)[..., 2]
    used = np.arange(system.length.shape[1])[None, :] < system.n_links[:, None]
    moment = system.m0 * state.x0[2] + system.m @ z[:, 0] + np.sum(np.where(used, system.m_link * z[:, 1:], 0.0))
    return float(-system.g * moment)


def energy(system: System, state: State) -> float:
    """T + V in J."""
    return kinetic_energy(system, state) + potential_energy(system, state)


def momentum(system: System, state: State) -> tuple[Array, Array]:
    """Linear (3,) kg m/s and angular (3,) kg m^2/s momentum, W, the latter about the world origin."""
    x, v = positions(system, state), velocities(system, state)
    used = np.arange(system.length.shape[1])[None, :] < system.n_links[:, None]
    mass = np.concatenate([system.m[:, None], np.where(used, system.m_link, 0.0)], axis=1)[..., None]
    linear = system.m0 * state.v0 + np.sum(mass * v, axis=(0, 1))
    angular = system.m0 * np.cross(state.x0, state.v0) + np.sum(mass * np.cross(x, v), axis=(0, 1))
    angular += state.R0 @ (system.J0 @ state.Omega0)
    angular += np.einsum("iab,ibc,ic->a", state.R, system.J, state.Omega)
    return linear, angular
