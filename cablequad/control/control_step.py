"""One control decision: measurement in, setpoints and their reasons out."""

from typing import NamedTuple

import numpy as np

from cablequad._jit import jit
from cablequad.boxed import Boxed, box
from cablequad.control.design import Authority, Design, SwingDamping
from cablequad.control.formation import Formation, formation
from cablequad.control.geometric import attitude_of_force
from cablequad.control.trajectory import Reference
from cablequad.control.yaw_frame import (
    about_down,
    frames_in_yaw_frame,
    in_yaw_frame,
    reference_in_yaw_frame,
    state_in_yaw_frame,
)
from cablequad.model import lie
from cablequad.model.attitude import Setpoint, fly
from cablequad.model.dynamics import Accelerations, evaluate, workspace
from cablequad.model.integrate import scratch
from cablequad.model.state import Error, State, local, positions, velocities
from cablequad.types import Array, Counts

INTEGRAND_LIMIT = 0.25  # m and rad: larger errors are not integrated faster, so that a long way leaves no overshoot
LITTLE = 0.2  # of the least vertical force, which is always left: a vehicle never turns over
UPRIGHT = 0.5  # cosine of a vehicle's tilt below which thrust no longer makes up for it


class Measurement(NamedTuple):
    """What the vehicles and the payload tracker said of one instant."""

    t: float  # s, vehicles' clock since release
    state: State
    restrained: bool = False  # the vehicles do not fly yet: integrals stand still


class Memory(NamedTuple):
    """What one decision leaves to the next; a value, never changed in place."""

    R_c: Array  # (d, n, 3, 3) commanded attitudes that do not act yet, newest first; d = 1 where there is no delay
    f: Array  # (d, n) N: their thrusts
    pending: Array  # (delay, n, 3) N, W: A_i less what the reference asks, of the commands that do not act yet
    integral: Array  # (6,) m s and rad s: integrals of the load's position and attitude errors, yawed frame
    damping_share: Array  # (1,) 0 .. 1: share of the damping law


class Sample(NamedTuple):
    """One control decision and its reasons."""

    t: float  # s, time of the measured state
    state: State  # what was measured
    reference: Reference
    memory: Memory  # what the decision started from
    error: Error  # x, x_dot in the chart around the formation that the reference asks, yawed frame
    A: Array  # (n, 3) N, W: ideal forces, within the authority
    R_c: Array  # (n, 3, 3) B -> W: commanded attitudes
    f: Array  # (n,) N: commanded thrusts, within the rotors' limits
    Psi_0: float  # 1/2 tr(I - R_0d'R_0)
    Psi: Array  # (n,) 1/2 tr(I - R_ic'R_i)
    e_q: float  # sum |q_ij - q_ijd|
    e_omega: float  # rad/s, sum |omega_ij|
    R_0d: Array  # (3, 3) the load's attitude along the reference
    q_d: Array  # (3,) the cables' direction along the reference, W

    def __repr__(self) -> str:
        if np.ndim(self.t) > 0:
            return f"Sample({len(self.f)} decisions)"
        return f"Sample(t = {self.t:.3f} s, {self.state}, e_q {self.e_q:.2g}, thrusts {np.round(self.f, 3).tolist()} N)"


def first_memory(design: Design) -> Memory:
    """What the controller knows before its first decision."""
    n, d = len(design.system.m), max(1, design.delay)
    return Memory(
        np.tile(design.hanging.R, (d, 1, 1, 1)), np.tile(-design.u_star[:, 2], (d, 1)),
        np.zeros((design.delay, n, 3)), np.zeros(6), np.zeros(1),
    )  # fmt: skip


def control_step(
    memory: Memory, measurement: Measurement, reference: Reference, design: Design
) -> tuple[Memory, Sample]:
    """The setpoints that answer `measurement`. Non-finite measurements give non-finite commands: callers must check."""
    s = measurement.state
    d = _decide(memory, s, measurement.restrained, reference, _boxed(design))
    sample = Sample(
        measurement.t, s, reference, memory, d.error, d.A, d.R_c, d.f, d.Psi_0, d.Psi, d.e_q, d.e_omega, d.R_0d, d.q_d
    )
    return d.memory, sample


_LAST: list[tuple[Design, Boxed[Design]]] = []  # the design that was asked for last, boxed


def _boxed(design: Design) -> Boxed[Design]:
    """The same design decides tick after tick: it is made a pointer once."""
    if not _LAST or _LAST[0][0] is not design:
        _LAST[:] = [(design, box(design))]
    return _LAST[0][1]


class _Decision(NamedTuple):
    """What the compiled part of a tick gives; fields as in Sample and Memory."""

    memory: Memory
    error: Error
    A: Array
    R_c: Array
    f: Array
    Psi_0: float
    Psi: Array
    e_q: float
    e_omega: float
    R_0d: Array
    q_d: Array


@jit
def _decide(memory: Memory, s: State, restrained: bool, reference: Reference, boxed_design: Boxed[Design]) -> _Decision:
    design = boxed_design.value
    system, u_star = design.system, design.u_star
    # everything is expressed in a frame turned with the reference's yaw, where the linear model holds
    yaw = reference.yaw[0]
    measured, wanted, pending = s, reference, memory.pending
    if yaw != 0.0:
        measured, wanted, pending = (
            state_in_yaw_frame(s, -yaw),
            reference_in_yaw_frame(reference, -yaw),
            in_yaw_frame(pending, -yaw),
        )
    lead = (design.delay + 0.5) * design.period
    form = formation(system, design.hanging, u_star, design.airframe, lead, wanted)
    error = local(system, form.target, measured)
    integral = (
        memory.integral if restrained else _integrated(memory.integral, error.x, design.integrated, design.period)
    )
    phi, phi_dot = _horizontal_forces(measured.R, measured.Omega, u_star)
    a = design.K_x @ error.x + design.K_xdot @ error.x_dot
    a += design.K_phi @ (phi - form.phi) + design.K_phidot @ (phi_dot - form.phi_dot)
    a += design.K_pending @ pending.ravel()
    integral_force = (design.K_integral @ memory.integral).reshape(u_star.shape)
    A = form.command - a.reshape(u_star.shape) - integral_force
    share = _damping_share(
        memory.damping_share[0], measured.q, form.target.q, system.n_links, design.swing_damping, design.period
    )
    if share > 0.0:
        A = (1.0 - share) * A + share * (_damping_forces(memory, measured, form, design, yaw) - integral_force)
    least, most = _limits_with_integrals(design.authority, integral_force)
    A = _within(A, design.authority.tilt, least, most)
    pending_now = np.empty_like(memory.pending)
    for k in range(len(pending_now)):
        pending_now[k] = pending[k - 1] if k > 0 else A - form.command
    if yaw != 0.0:
        A, pending_now = in_yaw_frame(A, yaw), in_yaw_frame(pending_now, yaw)
    R_c, f, Psi = commands(A, s.R, design.b1, design.authority, most, design.airframe.max_thrust, memory.R_c[0])
    next_memory = Memory(_shifted(memory.R_c, R_c), _shifted(memory.f, f), pending_now, integral, np.array([share]))
    e_q, e_omega = _link_errors(system.n_links, measured.q, measured.omega, form.target.q)
    Psi_0 = 0.5 * (3.0 - np.sum(form.target.R0 * measured.R0))
    spin = about_down(yaw)
    return _Decision(
        next_memory, error, A, R_c, f, Psi_0, Psi, e_q, e_omega, spin @ form.target.R0, spin @ form.target.q[0, 0]
    )


@jit
def _integrated(integral: Array, x: Array, integrated: Array, period: float) -> Array:
    """The integrals a period later."""
    out = integral.copy()
    for k in range(6):
        out[k] += integrated[k] * period * min(max(x[k], -INTEGRAND_LIMIT), INTEGRAND_LIMIT)
    return out


@jit
def _damping_share(
    before: float, q: Array, q_d: Array, n_links: Counts, swing_damping: SwingDamping, period: float
) -> float:
    """How much of the damping law acts: all above `swing_damping.begin` of the worst cable's link error.

    It gives way slowly.
    """
    if swing_damping.begin == np.inf:
        return 0.0
    worst = 0.0
    for i in range(n_links.shape[0]):
        squares = 0.0
        for j in range(n_links[i]):
            for b in range(3):
                squares += (q[i, j, b] - q_d[i, j, b]) ** 2
        worst = max(worst, np.sqrt(squares / n_links[i]))
    goal = min(max((worst - swing_damping.end) / (swing_damping.begin - swing_damping.end), 0.0), 1.0)
    return max(goal, before - period / swing_damping.return_s)


@jit
def _damping_forces(memory: Memory, measured: State, form: Formation, design: Design, yaw: float) -> Array:
    """(n, 3) N: m a_d + F - F_d - m (c (v - v_d) + k (x - x_d)) with F the cable's pull, yielding to what F exceeds.

    All of it is taken of the state that the model predicts for when a force commanded now has come about. Beyond what
    is under way the vehicles are taken to carry the formation: a pull that rose with the thrust commanded last would
    have the thrust answer itself, tick by tick.
    """
    system, swing_damping = design.system, design.swing_damping
    n, L = system.length.shape
    at = State(
        measured.x0.copy(), measured.v0.copy(), measured.R0.copy(), measured.Omega0.copy(), measured.q.copy(),
        measured.omega.copy(), measured.R.copy(), measured.Omega.copy(),
    )  # fmt: skip
    work = scratch(system, at)
    steps = round(design.period / swing_damping.step_s)
    for k in range(design.delay, -1, -1):
        ahead = steps if k > 0 else swing_damping.lead_steps
        newest = max(k - 1, 0)
        R_c = memory.R_c[newest] if yaw == 0.0 else frames_in_yaw_frame(memory.R_c[newest], -yaw)
        f = memory.f[newest] if k > 0 else _carrying(at, form)
        setpoint = Setpoint(R_c, np.zeros((n, 3)), f, np.zeros(n, dtype=np.bool_))
        fly(system, design.airframe, setpoint, at, swing_damping.step_s, ahead, work)
    force = np.empty((n, 3))
    f = _carrying(at, form)
    for i in range(n):
        force[i] = -f[i] * at.R[i, :, 2]
    acc = Accelerations(np.empty(3), np.empty(3), np.zeros((n, L, 3)), np.zeros((n, L)))
    evaluate(system, at, force, acc, workspace(system))
    x, v = positions(system, at), velocities(system, at)
    A = np.empty((n, 3))
    for i in range(n):
        m = system.m[i]
        for b in range(3):
            gravity = system.g if b == 2 else 0.0
            pull = acc.tension[i, 0] * at.q[i, 0, b]
            pull_d = m * (form.a[i, b] - gravity) - form.u[i, b]
            push = swing_damping.damping * (v[i, 0, b] - form.v[i, b]) + swing_damping.stiffness * (
                x[i, 0, b] - form.x[i, b]
            )
            answer = (1.0 + swing_damping.yielding) * ((pull - pull_d) / m - push)
            A[i, b] = m * (form.a[i, b] + answer - gravity) - pull
    return A


@jit
def _carrying(s: State, form: Formation) -> Array:
    """(n,) N: thrusts that give the formation's vertical forces at the attitudes of `s`."""
    n = s.R.shape[0]
    f = np.empty(n)
    for i in range(n):
        f[i] = -form.u[i, 2] / max(s.R[i, 2, 2], UPRIGHT)
    return f


@jit
def _limits_with_integrals(limits: Authority, integral_force: Array) -> tuple[Array, Array]:
    """(n,) N: the least and the most upwards, moved by the vertical part of what integrals hold."""
    least, most = limits.least.copy(), limits.most.copy()
    for i in range(len(least)):
        up = integral_force[i, 2]
        least[i] = max(least[i] + min(up, 0.0), LITTLE * least[i])
        most[i] += max(up, 0.0)
    return least, most


@jit
def _within(A: Array, tilt: float, least: Array, most: Array) -> Array:
    """A (n, 3) N with its vertical part between `least` and `most` (n,) N upwards, and its tilt within the tangent."""
    out = A.copy()
    for i in range(A.shape[0]):
        up = min(max(-A[i, 2], least[i]), most[i])
        out[i, 2] = -up
        side = np.sqrt(A[i, 0] ** 2 + A[i, 1] ** 2)
        if side > tilt * up:
            out[i, 0] *= tilt * up / side
            out[i, 1] *= tilt * up / side
    return out


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
def commands(
    A: Array, R: Array, b1: Array, limits: Authority, most: Array, max_thrust: Array, R_before: Array
) -> tuple[Array, Array, Array]:
    """R_c (n, 3, 3), f (n,) N and Psi (n,) that give A (n, 3) N as far as attitudes R (n, 3, 3) allow."""
    n = A.shape[0]
    R_c, f, Psi = np.empty((n, 3, 3)), np.empty(n), np.empty(n)
    for i in range(n):
        size = np.sqrt(A[i, 0] ** 2 + A[i, 1] ** 2 + A[i, 2] ** 2)
        vanishes = size < 1e-6 or np.sqrt(np.sum(lie.cross(A[i], b1[i]) ** 2)) < 1e-6 * size
        R_c[i] = R_before[i] if vanishes else attitude_of_force(A[i], b1[i])
        R_c[i] = _no_further(R[i], R_c[i], limits.furthest)
        if limits.vertical:
            thrust = min(-A[i, 2] / max(R[i, 2, 2], UPRIGHT), most[i])
        else:
            thrust = -(A[i, 0] * R[i, 0, 2] + A[i, 1] * R[i, 1, 2] + A[i, 2] * R[i, 2, 2])
        f[i] = min(max(thrust, 0.0), max_thrust[i])
        Psi[i] = 0.5 * (3.0 - np.sum(R_c[i] * R[i]))
    return R_c, f, Psi


@jit
def _no_further(R: Array, R_c: Array, furthest: float) -> Array:
    """R_c, or what lies `furthest` rad from R on the way there."""
    if furthest == np.inf:
        return R_c
    turn = lie.log(np.ascontiguousarray(R.T) @ R_c)
    angle = np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    return R_c if angle <= furthest else R @ lie.exp(furthest / angle * turn)


@jit
def _link_errors(n_links: Counts, q: Array, omega: Array, q_d: Array) -> tuple[float, float]:
    e_q, e_omega = 0.0, 0.0
    for i in range(n_links.shape[0]):
        for j in range(n_links[i]):
            x, y, z = q[i, j, 0] - q_d[i, j, 0], q[i, j, 1] - q_d[i, j, 1], q[i, j, 2] - q_d[i, j, 2]
            e_q += np.sqrt(x * x + y * y + z * z)
            e_omega += np.sqrt(omega[i, j, 0] ** 2 + omega[i, j, 1] ** 2 + omega[i, j, 2] ** 2)
    return e_q, e_omega


@jit
def _shifted(kept: Array, newest: Array) -> Array:
    """What was kept, with `newest` before it and the oldest gone."""
    out = np.empty_like(kept)
    out[1:] = kept[:-1]
    out[0] = newest
    return out
