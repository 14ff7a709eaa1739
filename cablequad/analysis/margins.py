"""What the linear loop says of itself: controllability, poles, and margins at the vehicles' inputs."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import linalg

from cablequad.control.design import Design, SampledLoop, loop_gains, sampled_loop, undelayed
from cablequad.control.riccati import discrete
from cablequad.model.attitude import Airframe
from cablequad.model.controllability import coordinate_names, squared_frequencies
from cablequad.model.linear import linearize
from cablequad.model.system import System
from cablequad.types import Array

LOSS_BISECTIONS = 7
FIRST_STEPS, MORE_STEPS = 240, 80  # that second moments are followed, from rest and from a share of losses nearby
SAME = 1e-5  # of the fastest: poles this close are one
AT_ONCE = 64  # frequencies
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
    M, G, B = linearize(system)
    N, reach = (np.asarray(np.linalg.solve(M, right), dtype=float) for right in (G, B))
    names = coordinate_names(system)
    roots = np.emath.sqrt(-squared_frequencies(system).astype(complex))
    scale = max(1.0, float(np.abs(roots).max()))
    poles: list[complex] = []
    for root in sorted(np.concatenate([roots, -roots[roots.real > 0.0]]), key=lambda v: (abs(v), v.real)):
        pole = 0.0 if abs(root) < SAME * scale else complex(root.real, abs(root.imag))
        if not poles or min(abs(pole - known) for known in poles) >= SAME * scale:
            poles.append(pole)
    out = []
    for pole in poles:
        pbh, r = _least_reached(N, reach, pole)
        out.append(LinearMode(complex(pole), pbh, names[int(np.argmax(np.abs(np.linalg.solve(M, r))))]))
    return sorted(out, key=lambda mode: mode.pbh)


def _least_reached(N: Array, reach: Array, pole: complex) -> tuple[float, Array]:
    """The smallest singular value of [A - pole I, B], and the velocity part of its left singular vector.

    A = [0 I; -N 0], B = [0; reach], and a real or an imaginary pole. For a velocity part r the position part that
    makes x* [A - pole I, B] smallest, but for the square of the result, leaves D real rows to look at:
    |(N' + pole^2) r|^2 / (1 + |pole|^2) + |reach' r|^2 against |r|^2 and that part's square.
    """
    D, square = len(N), (pole * pole).real
    size = 1.0 + abs(pole) ** 2
    beside = abs(pole) * (N.T - np.sign(square) * np.eye(D)) / size
    rows = np.vstack([(N.T + square * np.eye(D)) / np.sqrt(size), reach.T])
    L = np.linalg.cholesky(np.eye(D) + beside.T @ beside)
    _, sizes, directions = np.linalg.svd(linalg.solve_triangular(L, rows.T, lower=True).T, full_matrices=False)
    pbh = float(sizes[-1])
    if pbh * pbh > 1e-4 * size:
        A = np.block([[-pole * np.eye(D), np.eye(D)], [-N, -pole * np.eye(D)]])
        left, sizes, _ = np.linalg.svd(np.hstack([A, np.vstack([np.zeros_like(reach), reach])]))
        return float(sizes[-1]), left[D:, -1]
    return pbh, linalg.solve_triangular(L, directions[-1], lower=True, trans="T")


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
    z = np.exp(1j * w * period)
    S = np.concatenate(
        [np.linalg.inv(np.eye(m) + _loop_gain(loop, K, z[k : k + AT_ONCE])) for k in range(0, len(z), AT_ONCE)]
    )
    names = [f"vehicle {i + 1} {axis}" for i in range(m // 3) for axis in "xyz"]
    per_input = [_siso(1.0 / S[:, i, i] - 1.0, w) for i in range(m)]
    worst = int(np.argmin([p[2] for p in per_input]))
    disk = min(2.0 * (1 - 1e-9), 1.0 / float(np.linalg.norm(S - 0.5 * np.eye(m), 2, axis=(1, 2)).max()))
    factor, phase = (2.0 + disk) / (2.0 - disk), 2.0 * np.degrees(np.arctan(0.5 * disk))
    up = min(p[0] for p in per_input)
    down = max(p[1] for p in per_input)
    delay_ms = 1e3 * min(p[3] for p in per_input)
    extra = _extra_ticks(design, airframe, period, delay)
    return Margins(
        up, down, per_input[worst][2], delay_ms, names[worst], float(disk), (1 / factor, factor), float(phase), extra
    )


def _loop_gain(loop: SampledLoop, K: Array, z: Array) -> Array:
    """(w, m, m): K (z I - A)^-1 B at each z (w,), by the loop's parts.

    What is under way and the attitudes move by themselves, each mode by those, and the integrals by the modes.
    """
    A, B = loop.A, loop.B
    m = B.shape[1]
    attitudes = 4 * m // 3
    S, r = len(loop.onto), len(loop.rows)
    k = (S - attitudes) // 2
    driving = np.concatenate([np.arange(2 * k, S), np.arange(S + r, len(A))])
    eye = np.eye(len(driving))
    given = np.linalg.solve(z[:, None, None] * eye - A[np.ix_(driving, driving)], B[driving])
    pushed = A[: 2 * k, driving] @ given + B[: 2 * k]
    x, v, d = pushed[:, :k], pushed[:, k:], np.arange(k)
    a, b, c, e = (entry[:, None] for entry in (A[d, d], A[d, k + d], A[k + d, d], A[k + d, k + d]))
    at = z[:, None, None]
    moved = np.concatenate([(at - e) * x + b * v, c * x + (at - a) * v], axis=1)
    moved /= np.concatenate([(at - a) * (at - e) - b * c] * 2, axis=1)
    summed = (A[S : S + r, : 2 * k] @ moved + A[S : S + r, driving] @ given + B[S : S + r]) / (at - 1.0)
    return np.asarray(K[:, : 2 * k] @ moved + K[:, driving] @ given + K[:, S : S + r] @ summed)


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
        jumps = _shrinking(*_jumps(F, H, K, delay), slice(len(F), len(F) + H.shape[1]))
    except np.linalg.LinAlgError:  # it does not shrink even where everything arrives
        return 0.0
    low, high = 0.0, 0.99
    X = np.eye(len(jumps[0]))
    X, growth = _followed(*jumps, high, X, FIRST_STEPS)
    if growth <= 0.0:
        return high
    for _ in range(LOSS_BISECTIONS):
        middle = 0.5 * (low + high)
        X, growth = _followed(*jumps, middle, X, MORE_STEPS)
        low, high = (low, middle) if growth > 0.0 else (middle, high)
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


def _shrinking(arrived: Array, lost: Array, differ: slice) -> tuple[Array, Array, Array]:
    """`arrived` in coordinates in which it makes every state smaller: growth is seen as soon as it sets in.

    Then the two factors of what `lost` is more, in the rows `differ`.
    """
    everything = np.eye(len(arrived))  # P = arrived' P arrived + I, a Riccati equation without an input
    L = linalg.cholesky(discrete(arrived, np.zeros_like(arrived), everything), lower=False)
    back = linalg.solve_triangular(L, everything)
    return L @ arrived @ back, L[:, differ], (lost - arrived)[differ] @ back


def _followed(arrived: Array, left: Array, right: Array, p: float, X: Array, steps: int) -> tuple[Array, float]:
    """The second moments X at a share p of losses some steps later, of trace 1, and the logarithm of their growth

    in the second half of these. `lost` is `arrived` + left right.
    """
    size = 0.0
    for k in range(steps):
        on = arrived @ X
        more, across = right @ X, p * (on @ right.T)
        X = on @ arrived.T + across @ left.T + left @ (across.T + p * (more @ right.T) @ left.T)
        trace = float(np.trace(X))
        X /= trace
        if k >= steps // 2:
            size += np.log(trace)
    return 0.5 * (X + X.T), size


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
    own = np.sqrt(np.maximum(squared_frequencies(system), 0.0))
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
