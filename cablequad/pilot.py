"""One control decision: measurement in, setpoints and their reasons out."""

from typing import NamedTuple

import numpy as np

from cablequad import lie
from cablequad._jit import jit
from cablequad.design import Design
from cablequad.geometric import attitude_of_force
from cablequad.state import Error, State, local
from cablequad.types import Array, Counts


class Measurement(NamedTuple):
    """What the vehicles and the payload tracker said of one instant."""

    t: float  # s, vehicles' clock since release
    state: State


class Reference(NamedTuple):
    """Where the payload is to be."""

    x0: Array  # (3,) m, W
    v0: Array  # (3,) m/s, W


class Memory(NamedTuple):
    """What one decision leaves to the next; a value, never changed in place."""

    R_c: Array  # (n, 3, 3) the last commanded attitudes, kept where a force vanishes
    under_way: Array  # (d, n, 3) N, W: A_i - u_i* of the commands that do not act yet, newest first


class Sample(NamedTuple):
    """One control decision and its reasons."""

    t: float  # s, time of the measured state
    state: State  # what was measured
    reference: Reference
    memory: Memory  # what the decision started from
    error: Error  # x, x_dot in the chart around the target
    A: Array  # (n, 3) N, W: ideal forces, A_i = u_i* - K_x x - K_xdot x_dot - what acts and what is under way
    R_c: Array  # (n, 3, 3) B -> W: commanded attitudes
    f: Array  # (n,) N: commanded thrusts, f_i = -A_i . R_i e3 within the rotors' limits
    Psi_0: float  # 1/2 tr(I - R_0d'R_0)
    Psi: Array  # (n,) 1/2 tr(I - R_ic'R_i)
    e_q: float  # sum |q_ij - e3|
    e_omega: float  # rad/s, sum |omega_ij|


def first_memory(design: Design) -> Memory:
    """What the pilot knows before its first decision."""
    n = len(design.system.m)
    return Memory(design.hanging.R.copy(), np.zeros((design.K_way.shape[1] // (3 * n), n, 3)))


def tick(memory: Memory, measurement: Measurement, reference: Reference, design: Design) -> tuple[Memory, Sample]:
    """The setpoints that answer `measurement`. Non-finite measurements give non-finite commands: callers must check."""
    s = measurement.state
    d = _decide(memory, s, reference, design)
    sample = Sample(measurement.t, s, reference, memory, d.error, d.A, d.R_c, d.f, d.Psi_0, d.Psi, d.e_q, d.e_omega)
    return Memory(d.R_c, d.under_way), sample


class _Decision(NamedTuple):
    """What the compiled part of a tick gives; fields as in Sample and Memory."""

    error: Error
    A: Array
    R_c: Array
    f: Array
    Psi_0: float
    Psi: Array
    e_q: float
    e_omega: float
    under_way: Array


@jit
def _decide(memory: Memory, s: State, reference: Reference, design: Design) -> _Decision:
    hanging, system = design.hanging, design.system
    target = State(
        reference.x0, reference.v0, hanging.R0, hanging.Omega0, hanging.q, hanging.omega, hanging.R, hanging.Omega
    )
    error = local(system, target, s)
    phi, phi_dot = _horizontal_forces(s.R, s.Omega, design.u_star)
    a = design.K_x @ error.x + design.K_xdot @ error.x_dot + design.K_phi @ phi + design.K_phidot @ phi_dot
    a += design.K_way @ memory.under_way.ravel()
    A = design.u_star - a.reshape(design.u_star.shape)
    R_c, f, Psi = _commands(A, s.R, design.b1, memory.R_c, design.max_thrust)
    under_way = np.empty_like(memory.under_way)
    for k in range(len(under_way)):
        under_way[k] = memory.under_way[k - 1] if k > 0 else -a.reshape(design.u_star.shape)
    e_q, e_omega = _link_errors(system.n_links, s.q, s.omega)
    Psi_0 = 0.5 * (3.0 - np.sum(target.R0 * s.R0))
    return _Decision(error, A, R_c, f, Psi_0, Psi, e_q, e_omega, under_way)


@jit
def _horizontal_forces(R: Array, Omega: Array, u_star: Array) -> tuple[Array, Array]:
    """(2 n,) N and (2 n,) N/s: the horizontal part of -f_i* R_i e3 and its rate."""
    n = R.shape[0]
    phi, phi_dot = np.empty(2 * n), np.empty(2 * n)
    for i in range(n):
        f = -u_star[i, 2]
        for a in range(2):
            phi[2 * i + a] = -f * R[i, a, 2]
            phi_dot[2 * i + a] = -f * (R[i, a, 0] * Omega[i, 1] - R[i, a, 1] * Omega[i, 0])
    return phi, phi_dot


@jit
def _commands(A: Array, R: Array, b1: Array, R_before: Array, max_thrust: Array) -> tuple[Array, Array, Array]:
    n = A.shape[0]
    R_c, f, Psi = np.empty((n, 3, 3)), np.empty(n), np.empty(n)
    for i in range(n):
        b3 = R[i, :, 2]
        size = np.sqrt(A[i, 0] ** 2 + A[i, 1] ** 2 + A[i, 2] ** 2)
        vanishes = size < 1e-6 or np.sqrt(np.sum(lie.cross(A[i], b1[i]) ** 2)) < 1e-6 * size
        R_c[i] = R_before[i] if vanishes else attitude_of_force(A[i], b1[i])
        f[i] = min(max(-(A[i, 0] * b3[0] + A[i, 1] * b3[1] + A[i, 2] * b3[2]), 0.0), max_thrust[i])
        Psi[i] = 0.5 * (3.0 - np.sum(R_c[i] * R[i]))
    return R_c, f, Psi


@jit
def _link_errors(n_links: Counts, q: Array, omega: Array) -> tuple[float, float]:
    e_q, e_omega = 0.0, 0.0
    for i in range(n_links.shape[0]):
        for j in range(n_links[i]):
            x, y, z = q[i, j, 0], q[i, j, 1], q[i, j, 2] - 1.0
            e_q += np.sqrt(x * x + y * y + z * z)
            e_omega += np.sqrt(omega[i, j, 0] ** 2 + omega[i, j, 1] ** 2 + omega[i, j, 2] ** 2)
    return e_q, e_omega
