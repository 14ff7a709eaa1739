"""Vectors, frames and states expressed in a frame turned about e3; the linear model holds in the load's yaw frame."""

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
def in_yaw_frame(vectors: Array, angle: float) -> Array:
    """Vectors (..., 3) of the world, turned by `angle` rad about e3."""
    c, s = np.cos(angle), np.sin(angle)
    out = np.empty_like(vectors)
    out[..., 0] = c * vectors[..., 0] - s * vectors[..., 1]
    out[..., 1] = s * vectors[..., 0] + c * vectors[..., 1]
    out[..., 2] = vectors[..., 2]
    return out


@jit
def frames_in_yaw_frame(R: Array, angle: float) -> Array:
    """Frames (n, 3, 3), B -> W, turned by `angle` rad about e3."""
    out = np.empty_like(R)
    spin = about_down(angle)
    for i in range(R.shape[0]):
        out[i] = spin @ np.ascontiguousarray(R[i])
    return out


@jit
def state_in_yaw_frame(s: State, angle: float) -> State:
    """Everything turned by `angle` rad about e3."""
    return State(
        in_yaw_frame(s.x0, angle), in_yaw_frame(s.v0, angle), about_down(angle) @ s.R0, s.Omega0,
        in_yaw_frame(s.q, angle), in_yaw_frame(s.omega, angle), frames_in_yaw_frame(s.R, angle), s.Omega,
    )  # fmt: skip


@jit
def reference_in_yaw_frame(r: Reference, angle: float) -> Reference:
    """A reference turned by `angle` rad about e3; its own yaw stays as it is."""
    return Reference(
        in_yaw_frame(r.x0, angle),
        in_yaw_frame(r.v0, angle),
        in_yaw_frame(r.a0, angle),
        in_yaw_frame(r.j0, angle),
        in_yaw_frame(r.s0, angle),
        r.yaw,
    )
