"""What the linear loop says of itself: controllability, poles, and margins at the vehicles' inputs."""

from typing import NamedTuple

import numpy as np
from scipy import linalg

from cablequad.attitude import Airframe
from cablequad.design import Design, loop_gains, sampled_loop, state_space
from cablequad.linear import linearize
from cablequad.reach import coordinate_names
from cablequad.system import System
from cablequad.types import Array

WEAK = 1e-3  # a mode whose PBH margin is below this share of the largest is called weakly controllable


class Mode(NamedTuple):
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


def modes(system: System) -> list[Mode]:
    """Open-loop poles with their PBH margins, the weakest first; conjugates and repeated poles are listed once.

    The motion is the one that the forces reach least at that pole: M^-1 times the velocity part of the left singular
    vector of the smallest singular value.
    """
    A, B = state_space(system)
    M, _, _ = linearize(system)
    D = len(M)
    names = coordinate_names(system)
    scale = max(1.0, float(np.abs(np.linalg.eigvals(A)).max()))
    out: list[Mode] = []
    for value in sorted(np.linalg.eigvals(A), key=lambda v: (abs(v), v.real)):
        pole = 0.0 if abs(value) < 1e-5 * scale else value  # rigid motion: defective poles come out as its root
        if value.imag < 0 or any(abs(pole - mode.pole) < 1e-5 * scale for mode in out):
            continue
        left, sizes, _ = np.linalg.svd(np.hstack([A - pole * np.eye(2 * D), B.astype(complex)]))
        reached_least = np.abs(np.linalg.solve(M, left[D:, -1]))
        out.append(Mode(complex(pole), float(sizes[-1]), names[int(np.argmax(reached_least))]))
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
