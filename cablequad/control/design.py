"""Gains from `control`, on the linear model: the paper's continuous law, and one for the loop as it is flown.

The sampled law's model also holds what stands between a commanded force and the force that acts: the vehicle's
second-order attitude response (the horizontal part follows the tilt) and the commands that are under way. Its states
are [x, x_dot, phi, phi_dot, a_{k-1}, .. a_{k-d}] with phi_i (2) N the horizontal force of vehicle i.
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg

from cablequad.control.riccati import continuous, discrete
from cablequad.model.attitude import Airframe
from cablequad.model.controllability import OUTPUT_AT, controllable, integrable_outputs
from cablequad.model.linear import equilibrium, equilibrium_forces, linearize
from cablequad.model.state import State
from cablequad.model.stiffness import stable_substep
from cablequad.model.system import System
from cablequad.types import Array


class Weights(NamedTuple):
    """Diagonal weights of the quadratic cost, per squared unit. One set flies every scenario that ships.

    Two of them are adapted to the system: the force's belongs to a vehicle that hovers with `HOVER_N`, so that heavier
    vehicles get stiffer gains, and the links' to vehicles that turn faster than their cables swing.
    """

    position: float = 40.0  # 1/m^2
    velocity: float = 40.0  # s^2/m^2
    attitude: float = 10.0  # 1/rad^2, payload
    body_rate: float = 6.0  # s^2/rad^2, payload
    link_direction: float = 2.0  # 1/rad^2
    link_rate: float = 0.6  # s^2/rad^2
    force: float = 2.0  # 1/N^2
    integral: float = 30.0  # 1/(m s)^2 and 1/(rad s)^2: of the integrals of position and attitude


HOVER_N = 10.0
TILT_DEG = 30.0
LIGHTEST, HEAVIEST = 0.5, 1.2  # of the vertical force at rest, for a while; what lasts comes on top
FURTHEST = 0.6  # rad
RESERVE = 0.9  # of the rotors' limit, left for the tilt
DAMPING_BEGIN, DAMPING_END, RETURN_S = 0.25, 0.1, 0.5
YIELDING, DAMPING, STIFFNESS, LEAD = 3.0, 5.0, 5.0, 0.58
PREDICTION_US = 2000  # a step of the prediction that damping rests on, where the stiffest mode allows it


class Authority(NamedTuple):
    """How far a commanded force may go."""

    tilt: float  # tangent of the largest tilt
    least: Array  # (n,) N, of its vertical part, upwards
    most: Array  # (n,) N, of the thrust too, beyond what the integrals have found to last
    furthest: float  # rad from a vehicle's attitude to the one it is commanded
    vertical: bool  # thrust makes the vertical part good, f = A_z / (R e3)_z; else the paper's f = -A . R e3


class SwingDamping(NamedTuple):
    """How vehicles take the swing out of cables that are far from straight, where the linear law does harm.

    Each vehicle answers its own cable's pull as if it had a mass of m / (1 + yielding), with a damper and a spring to
    its place in the formation: passive, so that it takes energy out at any amplitude.
    """

    begin: float  # rad of link error: only this law above, inf: never
    end: float  # rad: only the linear law below
    return_s: float  # s, for the linear law to take over again
    yielding: float  # 0 .. 3: what vehicles slower than their cables cannot do
    damping: float  # 1/s, per mass
    stiffness: float  # 1/s^2, per mass
    lead_steps: int  # model steps beyond the delay that the state is predicted
    step_s: float  # of the model


class Design(NamedTuple):
    """A controller for one system: everything that `control_step` needs and nothing that changes."""

    system: System
    airframe: Airframe
    period: float  # s
    delay: int  # ticks from the state that a command answers to when it acts
    hanging: State  # the equilibrium at the origin, around which errors are taken
    u_star: Array  # (n, 3) N, W: equilibrium forces
    K_x: Array  # (3 n, D) N per unit of x
    K_xdot: Array  # (3 n, D) N per unit of x_dot
    K_phi: Array  # (3 n, 2 n) per N of horizontal force that acts
    K_phidot: Array  # (3 n, 2 n) s, per N/s of it
    K_pending: Array  # (3 n, 3 n d) per N of the d commands under way, newest first
    K_integral: Array  # (3 n, 6) N per m s and rad s of the integrals of the load's position and attitude
    integrated: Array  # (6,) 1 where there is such an integral
    b1: Array  # (n, 3) W: where each vehicle's nose points
    authority: Authority
    swing_damping: SwingDamping

    def __repr__(self) -> str:
        return f"Design({self.system}, every {1e3 * self.period:g} ms, {self.delay} ticks of delay)"


class DesignError(ValueError):
    """No stabilising gains exist for this system and these weights."""


def state_space(system: System) -> tuple[Array, Array]:
    """(A, B) of the first-order linear model in [x; x_dot], shapes (2 D, 2 D) and (2 D, 3 n)."""
    M, G, B = linearize(system)
    D = len(M)
    A = np.block([[np.zeros((D, D)), np.eye(D)], [-np.linalg.solve(M, G), np.zeros((D, D))]])
    return A, np.vstack([np.zeros_like(B), np.linalg.solve(M, B)])


def cost(system: System, weights: Weights) -> tuple[Array, Array]:
    """(Q, R) diagonal matrices of the quadratic cost on [x; x_dot] and the forces."""
    links = 2 * int(system.n_links.sum())
    w = weights
    x = [w.position] * 3 + [w.attitude] * 3 + [w.link_direction] * links
    x_dot = [w.velocity] * 3 + [w.body_rate] * 3 + [w.link_rate] * links
    hover = -equilibrium_forces(system, equilibrium(system))[:, 2]
    return np.diag(np.array(x + x_dot)), np.diag(np.repeat(w.force * (HOVER_N / hover) ** 2, 3))


def flown_model(
    system: System, airframe: Airframe, period: float, delay: int, thrust_scale: float = 1.0
) -> tuple[Array, Array]:
    """(A_d, B_d) of the sampled loop over one `period` s: link dynamics, attitude responses, `delay` ticks under way.

    phi'' = -w^2 (phi - a_xy) - 2 zeta w phi' per vehicle; the vertical force acts at once. Commands are held. Rotors
    make `thrust_scale` N of one that is asked.
    """
    n = len(system.m)
    A, B = state_space(system)
    B = thrust_scale * B
    X = len(A)
    flat = np.kron(np.eye(n), np.eye(3)[:, :2])  # (3 n, 2 n): horizontal forces among all
    upright = np.kron(np.eye(n), np.diag([0.0, 0.0, 1.0]))
    w_sq = np.repeat(airframe.bandwidth**2, 2)
    damping = np.repeat(2.0 * airframe.damping * airframe.bandwidth, 2)
    zero = np.zeros((2 * n, 2 * n))
    none = np.zeros((2 * n, X))
    F = np.block(
        [[A, B @ flat, np.zeros((X, 2 * n))], [none, zero, np.eye(2 * n)], [none, np.diag(-w_sq), np.diag(-damping)]]
    )
    H = np.vstack([B @ upright, np.zeros((2 * n, 3 * n)), w_sq[:, None] * flat.T])
    sampled = linalg.expm(period * np.block([[F, H], [np.zeros((3 * n, F.shape[0] + 3 * n))]]))
    return delayed(sampled[: len(F), : len(F)], sampled[: len(F), len(F) :], delay)


def delayed(F: Array, H: Array, delay: int) -> tuple[Array, Array]:
    """The model z+ = F z + H a with `delay` ticks before a acts: [z, a_{k-1} .. a_{k-d}]."""
    if delay == 0:
        return F, H
    S, U = H.shape
    A_d, B_d = np.zeros((S + U * delay, S + U * delay)), np.zeros((S + U * delay, U))
    A_d[:S, :S] = F
    A_d[:S, S + U * (delay - 1) :] = H  # the oldest command under way acts
    A_d[S + U :, S : S + U * (delay - 1)] = np.eye(U * (delay - 1))
    B_d[S : S + U] = np.eye(U)
    return A_d, B_d


class SampledLoop(NamedTuple):
    """The sampled loop in the coordinates of what can be reached: [xi, xi_dot, phi, phi_dot, integrals, under way]."""

    A: Array
    B: Array
    onto: Array  # from x, x_dot, phi, phi_dot to the first four
    back: Array
    rows: list[int]  # of x: what is integrated


def sampled_loop(
    system: System, airframe: Airframe, period: float, delay: int, thrust_scale: float = 1.0
) -> SampledLoop:
    """`flown_model` without what forces cannot reach, with the integrals of what constant forces can hold."""
    reached = controllable(system)
    F, H = flown_model(system, airframe, period, 0, thrust_scale)
    rest = np.eye(4 * len(system.m))
    onto = linalg.block_diag(reached.coordinates, reached.coordinates, rest)
    back = linalg.block_diag(reached.shapes, reached.shapes, rest)
    rows = [OUTPUT_AT[k] for k in integrable_outputs(system, reached)]
    k, S = len(rows), len(onto)
    A = np.zeros((S + k, S + k))
    A[:S, :S], A[S:, :S], A[S:, S:] = onto @ F @ back, period * back[rows], np.eye(k)
    return SampledLoop(*delayed(A, np.vstack([onto @ H, np.zeros((k, H.shape[1]))]), delay), onto, back, rows)


def undelayed(loop: SampledLoop, delay: int) -> tuple[Array, Array]:
    """The (F, H) that `delayed` made (A, B) of, for a delay of at least one tick."""
    U = loop.B.shape[1]
    S = len(loop.A) - U * delay
    return loop.A[:S, :S], loop.A[:S, len(loop.A) - U :]


def continuous_law(system: System, airframe: Airframe, weights: Weights, period: float, delay: int) -> Design:
    """The paper's law with gains of a continuous LQR on the linear model; b_1i = e1. It knows nothing of the loop.

    Raises DesignError where the linear model cannot be stabilised, EquilibriumError where there is no equilibrium.
    """
    reached = controllable(system)
    A, B = state_space(system)
    Q, R = cost(system, weights)
    onto = linalg.block_diag(reached.coordinates, reached.coordinates)
    back = linalg.block_diag(reached.shapes, reached.shapes)
    Q = back.T @ Q @ back
    A_r, B_r = onto @ A @ back, onto @ B
    try:
        X = continuous(A_r, B_r @ np.linalg.solve(R, B_r.T), 0.5 * (Q + Q.T))
    except np.linalg.LinAlgError as error:
        raise DesignError(_none(len(system.m), str(error))) from None
    K = np.linalg.solve(R, B_r.T @ X)
    if np.linalg.eigvals(A_r - B_r @ K).real.max() >= 0:
        raise DesignError(_none(len(system.m), "a mode stays undamped"))
    n = len(system.m)
    U, D = 3 * n, len(A) // 2
    K = K @ onto
    gains = [K[:, :D], K[:, D:], *(np.zeros((U, width)) for width in (2 * n, 2 * n, U * delay, 6))]
    no_limit = Authority(np.inf, np.full(n, -np.inf), np.full(n, np.inf), np.inf, False)
    never = SwingDamping(np.inf, np.inf, 1.0, 0.0, 0.0, 0.0, 0, period)
    return _design(
        system, airframe, period, delay, gains, integrated=np.zeros(6), authority=no_limit, swing_damping=never
    )


def sampled_cost(system: System, airframe: Airframe, weights: Weights, loop: SampledLoop) -> tuple[Array, Array]:
    """(Q, R) of the quadratic cost on the states of `loop` and the forces."""
    n, S, k = len(system.m), len(loop.onto), len(loop.rows)
    share = quick_share(system, airframe)
    adapted = weights._replace(link_direction=share * weights.link_direction, link_rate=share * weights.link_rate)
    Q_x, R = cost(system, adapted)
    Q = np.zeros_like(loop.A)
    Q[:S, :S] = loop.back.T @ linalg.block_diag(Q_x, np.zeros((4 * n, 4 * n))) @ loop.back
    Q[S : S + k, S : S + k] = weights.integral * np.eye(k)
    return 0.5 * (Q + Q.T), R


def sampled_law(system: System, airframe: Airframe, weights: Weights, period: float, delay: int) -> Design:
    """The law for a loop sampled every `period` s whose commands act `delay` ticks later through the attitude loops.

    Its state is that of `sampled_loop`. Raises DesignError where that loop cannot be stabilised, EquilibriumError where
    there is no equilibrium.
    """
    n = len(system.m)
    loop = sampled_loop(system, airframe, period, delay)
    Q, R = sampled_cost(system, airframe, weights, loop)
    S, k = len(loop.onto), len(loop.rows)
    try:
        X = discrete(loop.A, loop.B @ np.linalg.solve(R, loop.B.T), Q)
    except np.linalg.LinAlgError as error:
        raise DesignError(_none(n, str(error))) from None
    K = np.asarray(np.linalg.solve(R + loop.B.T @ X @ loop.B, loop.B.T @ X @ loop.A), dtype=float)
    if np.abs(np.linalg.eigvals(loop.A - loop.B @ K)).max() >= 1:
        raise DesignError(_none(n, "a mode stays undamped"))
    K_integral, integrated = np.zeros((3 * n, 6)), np.zeros(6)
    K_integral[:, loop.rows], integrated[loop.rows] = K[:, S : S + k], 1.0
    D = loop.onto.shape[1] // 2 - 2 * n
    gains = [*np.split(K[:, :S] @ loop.onto, np.cumsum([D, D, 2 * n]), axis=1), K[:, S + k :], K_integral]
    swing_damping = _swing_damping(system, airframe, quick_share(system, airframe), period)
    authority = _authority(system, airframe)
    return _design(
        system, airframe, period, delay, gains, integrated=integrated, authority=authority, swing_damping=swing_damping
    )


def loop_gains(design: Design, loop: SampledLoop) -> Array:
    """All gains side by side in the coordinates of `loop`; none for commands under way that the design ignores."""
    state = np.hstack([design.K_x, design.K_xdot, design.K_phi, design.K_phidot]) @ loop.back
    known = np.hstack([state, design.K_integral[:, loop.rows], design.K_pending])
    out = np.zeros((len(known), len(loop.A)))
    width = min(known.shape[1], len(loop.A))
    out[:, :width] = known[:, :width]
    return out


def quick_share(system: System, airframe: Airframe) -> float:
    """0 .. 1: how much of the swing inside a cable its vehicle is quick enough to take out.

    1 / (1 + (w_1 / w_a)^4) with w_a the bandwidth of the slowest attitude loop and w_1 = pi sqrt(T / (m l)) a taut
    cable's first mode, T its mean tension, m and l its mass and length.
    """
    hung = equilibrium(system)
    least = 1.0
    for i in range(len(system.m)):
        k = int(system.n_links[i])
        mass, length = float(system.m_link[i, :k].sum()), float(system.length[i, :k].sum())
        tension = float(hung.tension[i]) + 0.5 * mass * system.g
        first = np.pi * np.sqrt(tension / (mass * length))
        least = min(least, 1.0 / (1.0 + (first / float(airframe.bandwidth[i])) ** 4))
    return least


def _authority(system: System, airframe: Airframe) -> Authority:
    hover = -equilibrium_forces(system, equilibrium(system))[:, 2]
    most = np.minimum(HEAVIEST * hover, np.maximum(RESERVE * airframe.max_thrust, hover))
    return Authority(float(np.tan(np.radians(TILT_DEG))), LIGHTEST * hover, most, FURTHEST, True)


def _swing_damping(system: System, airframe: Airframe, share: float, period: float) -> SwingDamping:
    step = 1e-6 * stable_substep(system, PREDICTION_US, round(period * 1e6))
    lag = float((2.0 * airframe.damping / airframe.bandwidth).max())
    return SwingDamping(
        DAMPING_BEGIN,
        DAMPING_END,
        RETURN_S,
        YIELDING * share,
        DAMPING,
        STIFFNESS,
        round(LEAD * share * lag / step),
        step,
    )


def _none(n: int, why: str) -> str:
    who = f"{n} vehicle{'s' if n > 1 else ''}"
    return f"control: no stabilising gains for {who} ({why}); the weights are out of proportion"


def _design(
    system: System, airframe: Airframe, period: float, delay: int, gains: list[Array], integrated: Array,
    authority: Authority, swing_damping: SwingDamping,
) -> Design:  # fmt: skip
    K_x, K_xdot, K_phi, K_phidot, K_pending, K_integral = (np.ascontiguousarray(part) for part in gains)
    hung = equilibrium(system)
    return Design(
        system=system,
        airframe=airframe,
        period=period,
        delay=delay,
        hanging=State.hanging(system)._replace(R0=hung.R0).copy(),
        u_star=equilibrium_forces(system, hung),
        K_x=K_x,
        K_xdot=K_xdot,
        K_phi=K_phi,
        K_phidot=K_phidot,
        K_pending=K_pending,
        K_integral=K_integral,
        integrated=integrated,
        b1=np.tile(np.array([1.0, 0.0, 0.0]), (len(system.m), 1)),
        authority=authority,
        swing_damping=swing_damping,
    )
