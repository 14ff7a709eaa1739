"""All of an instant in one row of numbers: compiled code, pipes and files take one array at less cost than a dozen."""

import math
from typing import NamedTuple

import numpy as np

from cablequad._jit import inlined, jit
from cablequad.model.state import State
from cablequad.types import Array

Shapes = tuple[tuple[int, ...], ...]


class Motion(NamedTuple):
    """Where everything is at one instant, or at many, with a row for each."""

    state: State
    x: Array  # (n, 3) m, W: quadrotors
    v: Array  # (n, 3) m/s, W
    tension: Array  # (n, L) N, of every link; padding 0
    thrust: Array  # (n,) N


def motion_shapes(n: int, L: int) -> Shapes:
    """Of the arrays of a motion, in their order in a row."""
    return (3,), (3,), (3, 3), (3,), (n, L, 3), (n, L, 3), (n, 3, 3), (n, 3), (n, 3), (n, 3), (n, L), (n,)


def split(table: Array, shapes: Shapes) -> list[Array]:
    """Views of consecutive pieces of a row (k,), or of every row of (m, k), one of each shape."""
    parts, at, many = [], 0, table.shape[:-1]
    for shape in shapes:
        size = math.prod(shape)
        parts.append(table[..., at : at + size].reshape(*many, *shape))
        at += size
    return parts


def motion_of(table: Array, shapes: Shapes) -> Motion:
    """The motion whose arrays of `motion_shapes` stand in a row, or the motions in many."""
    fields = split(table, shapes)
    return Motion(State(*fields[:8]), *fields[8:])


class Places(NamedTuple):
    """Where in a row of n vehicles and L links the arrays of a motion begin that lie behind those of the load."""

    q: int
    omega: int
    R: int
    Omega: int
    x: int
    v: int
    tension: int
    thrust: int


LOAD = 18  # numbers of x0, v0, R0, Omega0, with which a row begins


@jit
def places(n: int, L: int) -> Places:
    """See Places."""
    q, links = LOAD, 3 * n * L
    R = q + 2 * links
    Omega = R + 9 * n
    x = Omega + 3 * n
    tension = x + 6 * n
    return Places(q, q + links, R, Omega, x, x + 3 * n, tension, tension + n * L)


@jit
def row(state: State, x: Array, v: Array, tension: Array, thrust: Array) -> Array:
    """A motion as a row, in an array of its own."""
    n, L = tension.shape
    out = np.empty(places(n, L).thrust + n)
    at = _put(out, 0, state.x0)
    at = _put(out, at, state.v0)
    at = _put(out, at, state.R0)
    at = _put(out, at, state.Omega0)
    at = _put(out, at, state.q)
    at = _put(out, at, state.omega)
    at = _put(out, at, state.R)
    at = _put(out, at, state.Omega)
    at = _put(out, at, x)
    at = _put(out, at, v)
    at = _put(out, at, tension)
    _put(out, at, thrust)
    return out


@jit
def specific_force(row: Array, L: int, m: Array, g: float, pushed: Array, restrained: bool) -> Array:
    """(n, 3) m/s^2, body frames: what accelerometers read at the instant in `row`.

    Vehicles of mass m (n,) kg are under their cables, rotors and `pushed` (n, 3) N, W, from outside; where they are
    `restrained`, what carries them is all that their accelerometers read.
    """
    n = len(m)
    at = places(n, L)
    out, force = np.empty((n, 3)), np.zeros(3)
    for i in range(n):
        own = at.R + 9 * i
        for a in range(3):
            force[a] = -g if a == 2 else 0.0
            if not restrained:
                pull = row[at.tension + i * L] * row[at.q + 3 * i * L + a]
                force[a] = (pull + pushed[i, a] - row[at.thrust + i] * row[own + 3 * a + 2]) / m[i]
        for a in range(3):
            out[i, a] = row[own + a] * force[0] + row[own + 3 + a] * force[1] + row[own + 6 + a] * force[2]
    return out


@inlined
def _put(out: Array, at: int, values: Array) -> int:
    flat = values.ravel()
    for k in range(flat.size):
        out[at + k] = flat[k]
    return at + flat.size
