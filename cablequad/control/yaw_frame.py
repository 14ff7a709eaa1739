"""Vectors, frames and states seen from a frame turned about e3: the linear model holds in the one of the load's yaw."""

import numpy as np

from cablequad._jit import jit
from cablequad.control.trajectory import Reference
from cablequad.model.state import State
from cablequad.types import Array


@jit
def about_down(angle: float) -> Array:
    """(3, 3): the rotation by `angle` rad about e3."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@jit
def turned(vectors: Array, angle: float) -> Array:
    """Vectors (..., 3) of the world, turned by `angle` rad about e3."""
    c, s = np.cos(angle), np.sin(angle)
    out = np.empty_like(vectors)
    out[..., 0] = c * vectors[..., 0] - s * vectors[..., 1]
    out[..., 1] = s * vectors[..., 0] + c * vectors[..., 1]
    out[..., 2] = vectors[..., 2]
    return out


@jit
def turned_frames(R: Array, angle: float) -> Array:
    """Frames (n, 3, 3), B -> W, turned by `angle` rad about e3."""
    out = np.empty_like(R)
    spin = about_down(angle)
    for i in range(R.shape[0]):
        out[i] = spin @ np.ascontiguousarray(R[i])
    return out


@jit
def turned_state(s: State, angle: float) -> State:
    """Everything turned by `angle` rad about e3."""
    return State(
        turned(s.x0, angle), turned(s.v0, angle), about_down(angle) @ s.R0, s.Omega0, turned(s.q, angle),
        turned(s.omega, angle), turned_frames(s.R, angle), s.Omega,
    )  # fmt: skip


@jit
def turned_reference(r: Reference, angle: float) -> Reference:
    """A reference turned by `angle` rad about e3; its own yaw stays as it is."""
    return Reference(
        turned(r.x0, angle), turned(r.v0, angle), turned(r.a0, angle), turned(r.j0, angle), turned(r.s0, angle), r.yaw
    )
