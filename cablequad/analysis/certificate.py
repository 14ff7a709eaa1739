"""Proposition 3 evaluated for one design: its matrices, its conditions, and what they allow.

The paper's law is meant: forces A_i = u_i* - K_x x - K_xdot x_dot and moments with k_R, k_Omega. The printed bound on
c_2i and the printed higher-order term are misprints; both are corrected here.

Of the conditions, only alpha < lambda_min(Q) / (2 c_3 K_max) ties the gains: c_3 grows with Q, so Q's scale drops out
of it, and a small scale always satisfies the condition on lambda_m(W_2i). What the scale and c_2i decide is gamma, the
slope that the higher-order terms may have; `curve` searches both.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import linalg

from cablequad.control.design import Design, Weights, cost
from cablequad.model.attitude import Airframe
from cablequad.model.dynamics import accelerations
from cablequad.model.linear import linearize
from cablequad.model.state import Error, retract
from cablequad.model.system import System
from cablequad.types import Array


class AttitudeGains(NamedTuple):
    """k_R and k_Omega of each quadrotor, and the bound on its commanded rate that B_2i needs."""

    k_R: Array  # (n,) N m
    k_Omega: Array  # (n,) N m s
    rate_bound: float  # rad/s, |Omega_ic| is assumed below it


class TranslationalLoop(NamedTuple):
    """The translational part: A z + B_d (B X + g)."""

    A: Array  # (2 D, 2 D)
    B_d: Array  # (2 D, D) [0; M^-1]
    B: Array  # (D, 3 n)
    K_max: float  # max(|K_x|, |K_xdot|)
    B_1: float  # N, bound on |u_i*|


class Lyapunov(NamedTuple):
    """P for one Q, and the constants that follow."""

    name: str
    lambda_Q: float
    P: Array
    c_3: float  # 2 |P B_d B|
    higher_order: float  # |P B_d|
    alpha_max: float  # lambda_min(Q) / (2 c_3 K_max): sum of the alpha_i must stay below


class Attitude(NamedTuple):
    """The rotational part of one quadrotor."""

    lambda_m: float  # kg m^2
    lambda_M: float
    B_2: float  # N m s, |2 J - tr J| |Omega_c|
    c_2_bound: float
    c_2: float  # the value that makes lambda_m(W_2i) largest
    W_2: Array  # (2, 2)
    lambda_W_2: float


class Point(NamedTuple):
    """One point of the gamma - psi_1 curve, with the choices that reach it."""

    psi_1: float
    gamma: float
    Q: str
    scale: float
    W: Array  # (2, 2), W_i of the quadrotor that binds
    condition: float  # lambda_m(W_2i) over what it must exceed, of that quadrotor


class Certificate(NamedTuple):
    """Everything of Proposition 3 for one design."""

    hurwitz: bool
    spectral_abscissa: float  # 1/s
    loop: TranslationalLoop
    choices: list[Lyapunov]
    attitude: list[Attitude]
    psi_1_max: float
    curve: list[Point]


def attitude_gains(system: System, airframe: Airframe, rate_bound: float) -> AttitudeGains:
    """The gains that give a vehicle's attitude response: k_R = w^2 J, k_Omega = 2 zeta w J about its weakest axis."""
    J = np.array([np.linalg.eigvalsh(J_i)[0] for J_i in system.J])
    return AttitudeGains(airframe.bandwidth**2 * J, 2 * airframe.damping * airframe.bandwidth * J, rate_bound)


def certify(design: Design, weights: Weights, gains: AttitudeGains) -> Certificate:
    """Proposition 3 for `design`, whose gains came from `weights`: conditions, constants, the gamma - psi_1 curve."""
    loop = _loop(design)
    abscissa = float(np.linalg.eigvals(loop.A).real.max())
    attitude = [_attitude(design.system.J[i], gains, i) for i in range(len(design.system.m))]
    if abscissa >= 0:
        return Certificate(False, abscissa, loop, [], attitude, 0.0, [])
    solved = _lyapunov_equation(loop.A)
    choices = [_lyapunov(name, loop, Q, solved(Q)) for name, Q in _shapes(design, weights)]
    n = len(attitude)
    psi_1_max = max(_psi(choice.alpha_max / n) for choice in choices)
    curve = [_best(psi_1_max * share, choices, attitude, loop) for share in (0.01, 0.1, 0.25, 0.5, 0.75, 0.9)]
    return Certificate(True, abscissa, loop, choices, attitude, psi_1_max, curve)


def _loop(design: Design) -> TranslationalLoop:
    M, G, B = linearize(design.system)
    D = len(M)
    M_inv = np.linalg.inv(M)
    A = np.block([[np.zeros((D, D)), np.eye(D)], [-M_inv @ (G + B @ design.K_x), -M_inv @ B @ design.K_xdot]])
    K_max = max(float(np.linalg.norm(design.K_x, 2)), float(np.linalg.norm(design.K_xdot, 2)))
    return TranslationalLoop(
        A, np.vstack([np.zeros((D, D)), M_inv]), B, K_max, float(np.linalg.norm(design.u_star, axis=1).max())
    )


def _shapes(design: Design, weights: Weights) -> list[tuple[str, Array]]:
    """The Q that are tried: identity, the LQR's own, and identities with the velocities weighed differently."""
    Q, R = cost(design.system, weights)
    K = np.hstack([design.K_x, design.K_xdot])
    D = len(Q) // 2
    graded = [(f"I, velocities x {w:g}", np.diag([1.0] * D + [w] * D)) for w in (0.01, 0.1, 10.0, 100.0)]
    return [("I", np.eye(2 * D)), ("LQR cost", Q + K.T @ R @ K), ("LQR state cost", Q), *graded]


def _lyapunov_equation(A: Array) -> Callable[[Array], Array]:
    """What gives the P of A' P + P A = -Q for a Q; by Bartels and Stewart, A's Schur form once for all of them."""
    T, U = linalg.schur(A.T, output="real")

    def solution(Q: Array) -> Array:
        y, scale, info = linalg.lapack.dtrsyl(T, T, -U.T @ Q @ U, tranb="T")
        if info < 0:
            raise np.linalg.LinAlgError("the Lyapunov equation has no solution")
        return np.asarray(scale * (U @ y @ U.T))

    return solution


def _lyapunov(name: str, loop: TranslationalLoop, Q: Array, P: Array) -> Lyapunov:
    lambda_Q = float(np.linalg.eigvalsh(Q)[0])
    c_3 = 2.0 * float(np.linalg.norm(P @ loop.B_d @ loop.B, 2))
    return Lyapunov(name, lambda_Q, P, c_3, float(np.linalg.norm(P @ loop.B_d, 2)), lambda_Q / (2.0 * c_3 * loop.K_max))


def _attitude(J: Array, gains: AttitudeGains, i: int) -> Attitude:
    k_R, k_O = float(gains.k_R[i]), float(gains.k_Omega[i])
    values = np.linalg.eigvalsh(J)
    low, high = float(values[0]), float(values[-1])
    B_2 = float(np.linalg.norm(2 * J - np.trace(J) * np.eye(3), 2)) * gains.rate_bound
    bound = min(np.sqrt(k_R * low) / high, 4 * k_R * k_O / (8 * k_R * high + (k_O + B_2) ** 2))
    best = max((_W_2(share * bound, k_R, k_O, high, B_2) for share in np.linspace(0.01, 0.99, 99)), key=lambda w: w[1])
    c_2, lowest, W_2 = best
    return Attitude(low, high, B_2, float(bound), c_2, W_2, lowest)


def _W_2(c_2: float, k_R: float, k_O: float, high: float, B_2: float) -> tuple[float, float, Array]:
    off = -0.5 * c_2 * (k_O + B_2)
    W = np.array([[c_2 * k_R, off], [off, k_O - 2 * c_2 * high]])
    return float(c_2), float(np.linalg.eigvalsh(W)[0]), W


def _psi(alpha: float) -> float:
    """psi_1 with sqrt(psi_1 (2 - psi_1)) = alpha."""
    a = min(alpha, 1.0)
    return float(a * a / (1.0 + np.sqrt(1.0 - a * a)))


def _best(psi_1: float, choices: list[Lyapunov], attitude: list[Attitude], loop: TranslationalLoop) -> Point:
    """The largest gamma for a given psi_1, over the shapes and scales of Q."""
    n = len(attitude)
    alpha = n * np.sqrt(psi_1 * (2.0 - psi_1))
    best = Point(psi_1, 0.0, "none", 0.0, np.zeros((2, 2)), 0.0)
    for choice in choices:
        room = choice.lambda_Q - 2.0 * choice.c_3 * loop.K_max * alpha
        if room <= 0:
            continue
        for scale in np.logspace(2, -12, 113):  # from above: the largest scale that does nearly as well is kept
            off = -0.5 * scale * choice.c_3 * loop.B_1
            first = scale * room / n
            lowest = [0.5 * (first + a.lambda_W_2 - np.hypot(first - a.lambda_W_2, 2 * off)) for a in attitude]
            i = int(np.argmin(lowest))
            gamma = n * lowest[i] / (2.0 * scale * choice.higher_order)
            if gamma > 1.01 * best.gamma:
                condition = attitude[i].lambda_W_2 * scale * room / (n * off * off)
                W = np.array([[first, off], [off, attitude[i].lambda_W_2]])
                best = Point(psi_1, float(gamma), choice.name, float(scale), W, float(condition))
    return best


def higher_order_slope(design: Design, radius: float, rng: np.random.Generator, samples: int = 400) -> float:
    """The largest |g| / |z_1| found on the sphere |z_1| = `radius`, per unit of radius (1/s^2, g grows quadratically).

    g = M xddot + G x - B (u - u*) with the nonlinear accelerations; random directions, the worst then improved by a
    random walk. A lower bound on the true supremum.
    """
    system = design.system
    M, G, _ = linearize(system)
    D = len(M)

    def slope(z: Array) -> float:
        z = radius * z / np.linalg.norm(z)
        state = retract(system, design.hanging, Error(z[:D].copy(), z[D:].copy()))
        acc = accelerations(system, state, design.u_star)
        links = [acc.omega_dot[i, : system.n_links[i], :2].ravel() for i in range(len(system.m))]
        g = M @ np.concatenate([acc.x0_ddot, acc.Omega0_dot, *links]) + G @ z[:D]
        return float(np.linalg.norm(g)) / radius

    found = [(slope(z), z) for z in rng.normal(size=(samples, 2 * D))]
    worst, z = max(found, key=lambda pair: pair[0])
    size = 0.5
    for _ in range(2 * samples):
        z = z / np.linalg.norm(z)
        trial = z + size * rng.normal(size=2 * D) / np.sqrt(2 * D)
        value = slope(trial)
        if value > worst:
            worst, z = value, trial
        else:
            size = max(0.02, 0.995 * size)
    return worst / radius
