"""The estimator: what vehicles and a payload tracker say -> the whole state, with what nobody measures.

The nonlinear model carries the belief from one instant to the next under the setpoints that act; what is measured then
corrects it by the steady gain of a Kalman filter on the linear model (in the frame of the load's yaw). Forces that the
model does not know (wind, weak rotors, wrong masses) are part of the belief where the load is measured; from the
vehicles alone they could not be told from a load that hangs elsewhere.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy import linalg

from cablequad._jit import jit
from cablequad.control.design import state_space
from cablequad.control.riccati import discrete
from cablequad.control.yaw_frame import frames_in_yaw_frame, in_yaw_frame, state_in_yaw_frame
from cablequad.model import lie
from cablequad.model.attitude import Airframe, Setpoint, fly
from cablequad.model.controllability import Modes, observable
from cablequad.model.integrate import scratch
from cablequad.model.linear import equilibrium, linearize
from cablequad.model.noise import Noise
from cablequad.model.state import Error, State, positions, retract, velocities
from cablequad.model.system import System
from cablequad.types import Array

Sensing = Literal["full", "fleet", "vehicles"]

VEHICLE_FORCE = 2e-3  # N^2 s: what shakes a vehicle of USUAL_KG besides what is known, white; by its weight squared
LOAD_FORCE = 1e-3  # N^2 s, of a load of USUAL_LOAD_KG
LOAD_MOMENT = 1e-5  # N^2 m^2 s, of such a load with cables USUAL_ARM_M from its centre of mass
CONSTANT_FORCE = 2e-3  # N^2 / s: how fast unknown forces on such vehicles and on such a load change
USUAL_KG, USUAL_LOAD_KG, USUAL_ARM_M, USUAL_GRAVITY = 0.755, 0.5, 0.5, 9.81
SHAKEN = 1e-3  # share of the mean that every mode gets, so that none is believed to be known for ever
NO_MOTION = 1e-9  # of the largest acceleration that a force gives
TURN = 1.0  # rad^2 / s^3: what turns the vehicles besides their attitude loops


FLOOR = Noise(0.002, 0.01, 0.002, 0.01, 0.005, 0.05)  # nothing is trusted beyond this


class Belief(NamedTuple):
    """What is believed of one instant."""

    state: State
    force: Array  # (n + 1, 3) N, W: on the vehicles and, last, on the load, besides what the model knows


class Measured(NamedTuple):
    """What was measured of one instant; NaN where nothing was."""

    x: Array  # (n, 3) m, W: vehicles
    v: Array  # (n, 3) m/s, W
    R: Array  # (n, 3, 3) B -> W
    Omega: Array  # (n, 3) rad/s, B
    x0: Array  # (3,) m, W: load
    v0: Array  # (3,) m/s, W
    R0: Array  # (3, 3)
    Omega0: Array  # (3,) rad/s, payload frame
    q: Array  # (n, L, 3)
    omega: Array  # (n, L, 3) rad/s, W


class Filter(NamedTuple):
    """The estimator of one system."""

    system: System
    airframe: Airframe
    hanging: State
    gain: Array  # (2 D + 3 n + 3, m): corrections of x, x_dot and the unknown forces by what was measured
    turn_gain: Array  # (n, 2, 2): of a vehicle's attitude and rate by theirs


class Estimator(NamedTuple):
    """A filter and what it cannot see."""

    filter: Filter
    sensing: Sensing
    hidden: tuple[str, ...]  # motions that nothing measured shows, in words
    deviations: dict[str, float]  # of the belief, steady: worst link direction (deg), load position (m) ...


def nothing_measured(system: System) -> Measured:
    """All NaN."""
    n, L = system.length.shape
    shapes = ((n, 3), (n, 3), (n, 3, 3), (n, 3), (3,), (3,), (3, 3), (3,), (n, L, 3), (n, L, 3))
    return Measured(*(np.full(shape, np.nan) for shape in shapes))


def measured_rows(system: System, hanging: State, sensing: Sensing) -> Array:
    """(m, D): what positions-like measurements are of x, vehicles first, then load and links as `sensing` says."""
    n, D = len(system.m), 6 + 2 * int(system.n_links.sum())
    C = np.zeros((3 * n, D))
    k = 6
    for i in range(n):
        rows = slice(3 * i, 3 * i + 3)
        C[rows, 0:3] = np.eye(3)
        C[rows, 3:6] = -hanging.R0 @ lie.hat(system.rho[i])
        for j in range(int(system.n_links[i])):
            # x_i = .. - l q, dq = xi x e3
            C[rows, k : k + 2] = system.length[i, j] * lie.hat(np.array([0.0, 0.0, 1.0]))[:, :2]
            k += 2
    if sensing == "vehicles":
        return C
    if sensing == "fleet":
        return np.vstack([C, np.eye(D)[:6]])
    return np.vstack([C, np.eye(D)])


def estimator(system: System, airframe: Airframe, period: float, sensing: Sensing, noise: Noise) -> Estimator:
    """The estimator for what `sensing` measures every `period` s with `noise`."""
    n = len(system.m)
    hung = equilibrium(system)
    hanging = State.hanging(system)._replace(R0=hung.R0).copy()
    C = measured_rows(system, hanging, sensing)
    view = observable(system, C)
    sigma = Noise(*(max(a, b) for a, b in zip(noise, FLOOR, strict=True)))
    F, Q, forces = _shaken(system, view, period, with_forces=sensing != "vehicles")
    still, moving = C @ view.shapes, C @ view.shapes
    k = view.shapes.shape[1]
    H = np.zeros((2 * len(C), len(F)))
    H[: len(C), :k], H[len(C) :, k : 2 * k] = still, moving
    spread, rates = np.full(len(C), sigma.position), np.full(len(C), sigma.velocity)
    spread[3 * n + 3 : 3 * n + 6], rates[3 * n + 3 : 3 * n + 6] = sigma.attitude, sigma.rate
    spread[3 * n + 6 :], rates[3 * n + 6 :] = sigma.link_direction, sigma.link_rate
    S = np.diag(np.concatenate([spread, rates]) ** 2)
    P = _steady_covariance(F, H, Q, S)
    K = np.linalg.solve(H @ P @ H.T + S, H @ P).T
    onto = linalg.block_diag(view.shapes, view.shapes)
    gain = np.zeros((2 * len(view.shapes) + len(forces), len(K[0])))
    gain[: 2 * len(view.shapes)] = onto @ K[: 2 * k]
    gain[2 * len(view.shapes) :] = forces @ K[2 * k :]
    after = onto @ (P - K @ H @ P)[: 2 * k, : 2 * k] @ onto.T
    sd = np.sqrt(np.maximum(np.diag(after), 0.0))
    deviations = {
        "load position, m": float(sd[0:3].max()),
        "load attitude, deg": float(np.degrees(sd[3:6].max())),
        "link direction, deg": float(np.degrees(sd[6 : len(view.shapes)].max())),
    }
    turns = np.stack([_turn_gain(airframe, i, period, sigma) for i in range(n)])
    return Estimator(Filter(system, airframe, hanging, gain, turns), sensing, view.missing, deviations)


def _shaken(system: System, view: Modes, period: float, with_forces: bool) -> tuple[Array, Array, Array]:
    """The sampled model of what can be observed, the covariance that shaking adds to it in a period, and the unknown

    constant forces in it, (3 n + 3, k): those on vehicles and load that move anything, as some only share the load
    differently.
    """
    A, B = state_space(system)
    M, _, _ = linearize(system)
    D = len(M)
    on_load = np.vstack([np.zeros((D, 6)), np.linalg.solve(M, np.eye(D)[:, :6])])
    onto = linalg.block_diag(view.coordinates, view.coordinates)
    back = linalg.block_diag(view.shapes, view.shapes)
    A_v, B_v = onto @ A @ back, onto @ B
    gravity, arm = system.g / USUAL_GRAVITY, float(np.linalg.norm(system.rho, axis=1).mean()) / USUAL_ARM_M
    vehicles = np.repeat((gravity * system.m / USUAL_KG) ** 2, 3)
    load = np.full(3, (gravity * system.m0 / USUAL_LOAD_KG) ** 2)
    shake = VEHICLE_FORCE * B_v * vehicles @ B_v.T
    white = np.concatenate([LOAD_FORCE * load, LOAD_MOMENT * arm**2 * load])
    shake += onto @ (on_load * white) @ on_load.T @ onto.T
    moving = np.arange(len(A_v)) >= len(A_v) // 2
    shake += np.diag(np.where(moving, SHAKEN * float(np.diag(shake)[moving].mean()), 0.0))
    by_force, size = np.hstack([B_v, onto @ on_load[:, :3]]), np.sqrt(np.concatenate([vehicles, load]))
    forces = np.zeros((len(size), 0))
    if with_forces:
        forces = size[:, None] * linalg.orth((by_force * size).T, rcond=NO_MOTION)
    U = forces.shape[1]
    A_v = np.block([[A_v, by_force @ forces], [np.zeros((U, len(A_v) + U))]])
    shake = linalg.block_diag(shake, CONSTANT_FORCE * np.eye(U))
    N = len(A_v)
    # Van Loan: F and the covariance of what white noise adds over a period
    doubled = linalg.expm(period * np.block([[-A_v, shake], [np.zeros((N, N)), A_v.T]]))
    F = doubled[N:, N:].T
    Q = F @ doubled[:N, N:]
    return F, 0.5 * (Q + Q.T), forces


def _turn_gain(airframe: Airframe, i: int, period: float, sigma: Noise) -> Array:
    """(2, 2): how far a vehicle's attitude and rate go towards what it says of them."""
    w, damping = float(airframe.bandwidth[i]), float(airframe.damping[i])
    F = linalg.expm(period * np.array([[0.0, 1.0], [-w * w, -2.0 * damping * w]]))
    S = np.diag([sigma.attitude**2, sigma.rate**2])
    P = _steady_covariance(F, np.eye(2), period * np.diag([0.0, TURN]), S)
    return np.asarray(P @ np.linalg.inv(P + S))


def _steady_covariance(F: Array, H: Array, Q: Array, S: Array) -> Array:
    """The covariance before a measurement once the filter has settled, P = F (P - P H'(H P H' + S)^-1 H P) F' + Q."""
    return discrete(F.T, H.T @ np.linalg.solve(S, H), Q)


def first_belief(filter: Filter, measured: Measured) -> Belief | None:
    """Everything at rest, cables straight towards their vehicles; None until all vehicles have told where they are."""
    system = filter.system
    n, L = system.length.shape
    if not np.all(np.isfinite(measured.x)) or not np.all(np.isfinite(measured.R)):
        return None
    s = filter.hanging.copy()
    if np.all(np.isfinite(measured.x0)) and np.all(np.isfinite(measured.R0)):
        s = s._replace(x0=measured.x0.copy(), R0=measured.R0.copy())
    else:  # hanging below its vehicles, turned as they stand around it
        form = positions(system, s)[:, 0]
        a, b = form - form.mean(axis=0), measured.x - measured.x.mean(axis=0)
        turn = float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a[:, :2] * b[:, :2])))
        s = state_in_yaw_frame(s, turn if n > 1 else 0.0)
        s = s._replace(x0=np.mean(measured.x - in_yaw_frame(form, turn if n > 1 else 0.0), axis=0))
    ends = positions(system, s)[:, L]
    for i in range(n):
        line = ends[i] - measured.x[i]
        size = float(np.linalg.norm(line))
        if size > 1e-3 and np.all(np.isfinite(measured.x0)):
            s.q[i, : system.n_links[i]] = line / size
    s = s._replace(R=measured.R.copy(), Omega=np.where(np.isfinite(measured.Omega), measured.Omega, 0.0))
    return Belief(s, np.zeros((n + 1, 3)))


@jit
def predicted(filter: Filter, belief: Belief, setpoint: Setpoint, h: float, steps: int) -> Belief:
    """The belief `steps` steps of `h` s later, under `setpoint`."""
    s = belief.state
    at = State(
        s.x0.copy(), s.v0.copy(), s.R0.copy(), s.Omega0.copy(), s.q.copy(), s.omega.copy(), s.R.copy(), s.Omega.copy()
    )
    work = scratch(filter.system, at)
    work.on_vehicles[:] = belief.force[:-1]
    work.work.loaded[0] = np.any(belief.force[-1] != 0.0)
    work.work.on_payload[:] = belief.force[-1]
    fly(filter.system, filter.airframe, setpoint, at, h, steps, work)
    return Belief(at, belief.force)


@jit
def corrected(filter: Filter, belief: Belief, measured: Measured) -> Belief:
    """The belief with what was measured of its instant."""
    system, n = filter.system, filter.system.m.shape[0]
    level = belief.state.R0 @ np.ascontiguousarray(filter.hanging.R0.T)
    yaw = np.arctan2(level[1, 0] - level[0, 1], level[0, 0] + level[1, 1])
    s = state_in_yaw_frame(belief.state, -yaw)
    y = _innovation(system, s, measured, yaw, filter.gain.shape[1])
    D = (filter.gain.shape[0] - 3 * n - 3) // 2
    d = filter.gain @ y
    moved = retract(system, s, Error(d[:D], d[D : 2 * D]))
    force = in_yaw_frame(belief.force, -yaw) + d[2 * D :].reshape(n + 1, 3)
    for i in range(n):
        if np.isfinite(measured.R[i, 0, 0]):
            off = lie.log(np.ascontiguousarray(belief.state.R[i].T) @ measured.R[i])
            slip = measured.Omega[i] - belief.state.Omega[i] if np.isfinite(measured.Omega[i, 0]) else np.zeros(3)
            g = filter.turn_gain[i]
            moved.R[i] = np.ascontiguousarray(s.R[i]) @ lie.exp(g[0, 0] * off + g[0, 1] * slip)
            moved.Omega[i] = s.Omega[i] + g[1, 0] * off + g[1, 1] * slip
    return Belief(state_in_yaw_frame(moved, yaw), in_yaw_frame(force, yaw))


@jit
def _innovation(system: System, s: State, measured: Measured, yaw: float, size: int) -> Array:
    """What was measured less what `s` says of it, ordered as the gain's columns; 0 where nothing was measured."""
    n = system.m.shape[0]
    m = size // 2
    y = np.zeros(size)
    x, v = positions(system, s), velocities(system, s)
    measured_x, measured_v = in_yaw_frame(measured.x, -yaw), in_yaw_frame(measured.v, -yaw)
    for i in range(n):
        for b in range(3):
            y[3 * i + b] = measured_x[i, b] - x[i, 0, b]
            y[m + 3 * i + b] = measured_v[i, b] - v[i, 0, b]
    if m > 3 * n:
        at = 3 * n
        measured_R0 = frames_in_yaw_frame(measured.R0.copy().reshape(1, 3, 3), -yaw)[0]
        y[at : at + 3] = in_yaw_frame(measured.x0, -yaw) - s.x0
        y[m + at : m + at + 3] = in_yaw_frame(measured.v0, -yaw) - s.v0
        if np.isfinite(measured_R0[0, 0]):
            y[at + 3 : at + 6] = lie.log(np.ascontiguousarray(s.R0.T) @ measured_R0)
        y[m + at + 3 : m + at + 6] = measured.Omega0 - s.Omega0
    if m > 3 * n + 6:
        at = 3 * n + 6
        measured_q, measured_omega = in_yaw_frame(measured.q, -yaw), in_yaw_frame(measured.omega, -yaw)
        for i in range(n):
            for j in range(system.n_links[i]):
                if np.isfinite(measured_q[i, j, 0]):
                    C = lie.tangent_basis(s.q[i, j])
                    xi = lie.direction_to(s.q[i, j], measured_q[i, j])
                    w = measured_omega[i, j] - s.omega[i, j]
                    for b in range(2):
                        y[at + b] = xi[0] * C[0, b] + xi[1] * C[1, b] + xi[2] * C[2, b]
                        y[m + at + b] = w[0] * C[0, b] + w[1] * C[1, b] + w[2] * C[2, b]
                at += 2
    for k in range(size):
        if not np.isfinite(y[k]):
            y[k] = 0.0
    return y
