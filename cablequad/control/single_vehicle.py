"""Every vehicle by itself, on the ground and with a slack or just tight cable: it flies to its own goal.

The law of a point mass under a thrust: gravity and what is hung on it are carried, the rest is a spring, a damper and
an integral towards the goal. No model of load or cables is in it, so that it holds whatever they do.
"""

from typing import NamedTuple

import numpy as np

from cablequad._jit import jit
from cablequad.control.control_step import commands
from cablequad.control.design import Design
from cablequad.types import Array

STIFFNESS, DAMPING, INTEGRAL = 4.0, 4.0, 1.5  # 1/s^2, 1/s, 1/s^3, of a vehicle that answers soon enough for them
SOON_S = 0.25  # is soon enough; who answers later is flown as much slower
MOST_INTEGRAL = 2.0  # m/s^2
TILT = 0.35  # tangent
LEAST = 0.3  # of a vehicle's weight, upwards


class Goals(NamedTuple):
    """Where vehicles are to be, how they move there, and what hangs on them."""

    x: Array  # (n, 3) m, W
    v: Array  # (n, 3) m/s, W
    a: Array  # (n, 3) m/s^2, W
    hung: Array  # (n,) N, down
    power: Array  # (n,) 0 .. 1: share of all of it; 0 stands on the ground with motors idle


class Flown(NamedTuple):
    """What is commanded of the vehicles."""

    A: Array  # (n, 3) N, W
    R_c: Array  # (n, 3, 3)
    f: Array  # (n,) N
    Psi: Array  # (n,)


@jit
def quickness(design: Design) -> Array:
    """(n,) 0 .. 1: how fast each is flown, by the lag of its attitude, 2 zeta / omega, and the delay before it.

    A loop that is s times as fast has the same margins where what it commands lags 1 / s times as much: its gains on
    the position, its rate and its integral are s^2, s and s^3 times as large.
    """
    lag = 2.0 * design.airframe.damping / design.airframe.bandwidth + design.delay * design.period
    return np.minimum(1.0, SOON_S / lag)


@jit
def integrated(design: Design, integral: Array, x: Array, goals: Goals) -> Array:
    """The integrals (n, 3) m/s^2 a period later; they rest where a vehicle does not fly."""
    out, quick = integral.copy(), quickness(design)
    for i in range(x.shape[0]):
        for b in range(3):
            moved = out[i, b] + INTEGRAL * quick[i] ** 3 * design.period * (goals.x[i, b] - x[i, b])
            out[i, b] = min(max(moved, -MOST_INTEGRAL), MOST_INTEGRAL) if goals.power[i] >= 1.0 else 0.0
    return out


@jit
def fly_each(design: Design, x: Array, v: Array, R: Array, integral: Array, goals: Goals, R_before: Array) -> Flown:
    """Attitudes and thrusts that fly vehicles at x, v (n, 3), R (n, 3, 3) towards `goals`."""
    system = design.system
    n = x.shape[0]
    A, quick = np.empty((n, 3)), quickness(design)
    for i in range(n):
        m, power = system.m[i], goals.power[i]
        stiffness, damping = STIFFNESS * quick[i] ** 2, DAMPING * quick[i]
        for b in range(3):
            pull = stiffness * (goals.x[i, b] - x[i, b]) + damping * (goals.v[i, b] - v[i, b]) + integral[i, b]
            A[i, b] = m * (goals.a[i, b] + pull)
        A[i, 2] -= m * system.g + goals.hung[i]
        up = max(-A[i, 2], LEAST * m * system.g)
        if power < 1.0:  # on its feet: no tilt
            up, A[i, 0], A[i, 1] = max(m * system.g * power, 1e-3), 0.0, 0.0
        A[i, 2] = -up
        side = np.sqrt(A[i, 0] ** 2 + A[i, 1] ** 2)
        if side > TILT * up:
            A[i, 0] *= TILT * up / side
            A[i, 1] *= TILT * up / side
    R_c, f, Psi = commands(
        A, R, design.b1, design.authority, design.airframe.max_thrust, design.airframe.max_thrust, R_before
    )
    for i in range(n):
        if goals.power[i] <= 0.0:
            f[i] = 0.0
    return Flown(A, R_c, f, Psi)
