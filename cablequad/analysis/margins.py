"""What the linear loop says of itself: controllability, poles, and margins at the vehicles' inputs."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import linalg

from cablequad.control.design import Design, loop_gains, sampled_loop, state_space, undelayed
from cablequad.model.attitude import Airframe
from cablequad.model.controllability import coordinate_names
from cablequad.model.linear import linearize
from cablequad.model.system import System
from cablequad.types import Array

LOSS_BISECTIONS, MOMENT_STEPS = 7, 300
WEAK = 1e-3  # a mode whose PBH margin is below this share of the largest is called weakly controllable


class LinearMode(NamedTuple):
    """An open-loop mode and how far the vehicles' forces can move it."""

    pole: complex  # 1/s
    pbh: float  # smallest singular value of [A - pole I, B]
    motion: str  # where the mode lives


class Margins(NamedTuple):
    """Margins of the sampled loop, each broken at one input with the others closed, and of all inputs together."""

    gain_up: float  # factor, worst input
    gain_down: float
    phase_deg: float
    delay_ms: float  # from the phase margin of the worst input
    worst_input: str
    disk: float  # balanced disk margin of all inputs at once, 1 / max |S - I/2|: full-block, so a lower bound
    disk_gain: tuple[float, float]  # factors allowed on every input independently
    disk_phase_deg: float
    delay_ticks_all: int  # whole ticks of extra delay on every input that the loop survives


def modes(system: System) -> list[LinearMode]:
    """Open-loop poles with their PBH margins, the weakest first; conjugates and repeated poles are listed once.

    The motion is the one that the forces reach least at that pole: M^-1 times the velocity part of the left singular
    vector of the smallest singular value.
    """
    A, B = state_space(system)
    M, _, _ = linearize(system)
    D = len(M)
    names = coordinate_names(system)
    scale = max(1.0, float(np.abs(np.linalg.eigvals(A)).max()))
    out: list[LinearMode] = []
    for value in sorted(np.linalg.eigvals(A), key=lambda v: (abs(v), v.real)):
        pole = 0.0 if abs(value) < 1e-5 * scale else value  # rigid motion: defective poles come out as its root
        if value.imag < 0 or any(abs(pole - mode.pole) < 1e-5 * scale for mode in out):
            continue
        left, sizes, _ = np.linalg.svd(np.hstack([A - pole * np.eye(2 * D), B.astype(complex)]))
        reached_least = np.abs(np.linalg.solve(M, left[D:, -1]))
        out.append(LinearMode(complex(pole), float(sizes[-1]), names[int(np.argmax(reached_least))]))
    return sorted(out, key=lambda mode: mode.pbh)


def closed_loop_poles(design: Design, airframe: Airframe, period: float, delay: int) -> Array:
    """Poles of the sampled loop as flown (in z). A design without a model of delay flies with it all the same."""
    loop = sampled_loop(design.system, airframe, period, delay)
    return np.asarray(np.linalg.eigvals(loop.A - loop.B @ loop_gains(design, loop)))


def margins(design: Design, airframe: Airframe, period: float, delay: int) -> Margins:
    """Margins of the sampled loop; zero margins where the loop is not stable to begin with."""
    loop = sampled_loop(design.system, airframe, period, delay)
    A, B, K = loop.A, loop.B, loop_gains(design, loop)
    m = B.shape[1]
    if np.abs(np.linalg.eigvals(A - B @ K)).max() >= 1:
        return Margins(1.0, 1.0, 0.0, 0.0, "the loop itself is unstable", 0.0, (1.0, 1.0), 0.0, -1)
    w = _frequencies(design.system, period)
    T, Z = linalg.schur(A, output="complex")  # one triangular solve a frequency
    B_T, K_T, I = Z.conj().T @ B, K @ Z, np.eye(len(A))
    S = np.empty((len(w), m, m), dtype=complex)
    for k, z in enumerate(np.exp(1j * w * period)):
        S[k] = np.linalg.inv(np.eye(m) + K_T @ linalg.solve_triangular(z * I - T, B_T, check_finite=False))
    names = [f"vehicle {i + 1} {axis}" for i in range(m // 3) for axis in "xyz"]
    per_input = [_siso(1.0 / S[:, i, i] - 1.0, w) for i in range(m)]
    worst = int(np.argmin([p[2] for p in per_input]))
    disk = min(2.0 * (1 - 1e-9), 1.0 / max(float(np.linalg.norm(S_w - 0.5 * np.eye(m), 2)) for S_w in S))
    factor, phase = (2.0 + disk) / (2.0 - disk), 2.0 * np.degrees(np.arctan(0.5 * disk))
    up = min(p[0] for p in per_input)
    down = max(p[1] for p in per_input)
    delay_ms = 1e3 * min(p[3] for p in per_input)
    extra = _extra_ticks(design, airframe, period, delay)
    return Margins(
        up, down, per_input[worst][2], delay_ms, names[worst], float(disk), (1 / factor, factor), float(phase), extra
    )


def largest_loss(design: Design, airframe: Airframe, period: float, delay: int) -> float:
    """The share of ticks whose setpoints may all be lost, each tick by itself, before the loop's mean square grows.

    A vehicle goes by its last setpoint; the controller takes what it sent for what is under way. A jump linear system
    with A_1 (arrived) and A_0 (lost): stable in the mean square iff X -> (1 - p) A_1 X A_1' + p A_0 X A_0' has a
    spectral radius below one (Costa, Fragoso and Marques). 0 where the loop itself is unstable, at most 0.99.
    """
    loop = sampled_loop(design.system, airframe, period, delay)
    K = loop_gains(design, loop)
    if np.abs(np.linalg.eigvals(loop.A - loop.B @ K)).max() >= 1:
        return 0.0
    F, H = undelayed(loop, delay)
    try:
        arrived, lost = _shrinking(*_jumps(F, H, K, delay))
    except np.linalg.LinAlgError:  # it does not shrink even where everything arrives
        return 0.0
    low, high = 0.0, 0.99
    if not _grows(arrived, lost, high):
        return high
    for _ in range(LOSS_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _grows(arrived, lost, middle) else (middle, high)
    return low


def _jumps(F: Array, H: Array, K: Array, delay: int) -> tuple[Array, Array]:
    """The loop where a tick's setpoints arrive and where they do not.

    States [z, what acts of the last `delay` ticks, newest first, what was sent in them].
    """
    S, U = H.shape
    way = U * delay
    both = []
    for arrives in (True, False):
        A, B = np.zeros((S + 2 * way, S + 2 * way)), np.zeros((S + 2 * way, U))
        A[:S, :S] = F
        acts, newest, sent = slice(S + way - U, S + way), slice(S, S + U), slice(S + way, S + way + U)
        A[:S, acts] = H
        A[S + U : S + way, S : S + way - U] = np.eye(way - U)
        A[S + way + U :, S + way : S + 2 * way - U] = np.eye(way - U)
        B[sent] = np.eye(U)
        if arrives:
            B[newest] = np.eye(U)
        else:
            A[newest, newest] = np.eye(U)
        gain = np.zeros((U, S + 2 * way))
        gain[:, :S], gain[:, S + way :] = K[:, :S], K[:, S:]
        both.append(A - B @ gain)
    return both[0], both[1]


def _shrinking(arrived: Array, lost: Array) -> tuple[Array, Array]:
    """Both in coordinates in which `arrived` makes every state smaller: growth is seen as soon as it sets in."""
    L = linalg.cholesky(linalg.solve_discrete_lyapunov(arrived.T, np.eye(len(arrived))), lower=False)
    back = linalg.solve_triangular(L, np.eye(len(L)))
    return L @ arrived @ back, L @ lost @ back


def _grows(arrived: Array, lost: Array, p: float) -> bool:
    """Whether second moments grow at a share p of losses, by following them for long enough to see."""
    X = np.eye(len(arrived))
    size = 0.0
    for k in range(MOMENT_STEPS):
        X = (1.0 - p) * (arrived @ X @ arrived.T) + p * (lost @ X @ lost.T)
        trace = float(np.trace(X))
        X /= trace
        if k >= MOMENT_STEPS // 2:
            size += np.log(trace)
    return size > 0.0


def unstable_from(loop_at: Callable[[float], Array], good: float, far: float, steps: int = 30) -> float:
    """The parameter between `good` and `far` from which `loop_at(parameter)` has a pole outside, or `far`."""

    def holds(value: float) -> bool:
        return bool(np.abs(np.linalg.eigvals(loop_at(value))).max() < 1)

    for share in np.linspace(0.0, 1.0, 13)[1:]:  # first coarsely, as a loop may come back to life further out
        at = good + share * (far - good)
        if not holds(at):
            inside, outside = good + (share - 1 / 12) * (far - good), at
            break
    else:
        return far
    for _ in range(steps):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return float(inside)


def mismatched(design: Design, airframe: Airframe, period: float, delay: int, scale: float, system: System) -> Array:
    """The closed loop's matrix where rotors give `scale` times what is asked and `system` is what flies."""
    loop = sampled_loop(system, airframe, period, delay, scale)
    return loop.A - loop.B @ loop_gains(design, loop)


def _frequencies(system: System, period: float) -> Array:
    """rad/s up to Nyquist, crowded around the undamped modes, where the loop gain changes fastest."""
    A, _ = state_space(system)
    own = np.abs(np.linalg.eigvals(A).imag)
    own = np.unique(np.round(own[own > 1e-3], 3))
    near = np.concatenate([-np.logspace(-1, -5, 12), np.logspace(-5, -1, 12)])
    nyquist = np.pi / period
    w = np.concatenate([np.logspace(-2, np.log10(nyquist), 250), np.outer(own, 1.0 + near).ravel()])
    return np.unique(w[w <= nyquist])


def _siso(L: Array, w: Array) -> tuple[float, float, float, float]:
    """Gain margins up and down (factors), phase margin (deg) and delay margin (s) of one loop."""
    up, down = np.inf, 0.0
    crossing = np.flatnonzero(np.diff(np.sign(L.imag)) != 0)
    for k in crossing:
        share = L.imag[k] / (L.imag[k] - L.imag[k + 1])
        real = L.real[k] + share * (L.real[k + 1] - L.real[k])
        if real < -1.0:
            down = max(down, -1.0 / real)
        elif real < 0.0:
            up = min(up, -1.0 / real)
    phase, delay = 180.0, np.inf
    size = np.abs(L) - 1.0
    for k in np.flatnonzero(np.diff(np.sign(size)) != 0):
        share = size[k] / (size[k] - size[k + 1])
        at = L[k] + share * (L[k + 1] - L[k])
        angle = float(np.angle(-at))  # 0 at -1; positive: delay turns it towards -1
        phase = min(phase, abs(np.degrees(angle)))
        delay = min(delay, (angle % (2 * np.pi)) / (w[k] + share * (w[k + 1] - w[k])))
    return float(up), float(down), float(phase), float(delay)


def _extra_ticks(design: Design, airframe: Airframe, period: float, delay: int) -> int:
    """How many ticks more of delay, unknown to the design, the loop survives (up to 25)."""
    for extra in range(1, 26):
        if np.abs(closed_loop_poles(design, airframe, period, delay + extra)).max() >= 1:
            return extra - 1
    return 25
