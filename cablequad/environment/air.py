"""What moving air does to the bodies: drag 1/2 rho C_d A |w| w of the wind w relative to each."""

from typing import NamedTuple

import numpy as np

from cablequad._jit import jit
from cablequad.model.integrate import Scratch
from cablequad.model.state import State, velocities
from cablequad.model.system import System
from cablequad.types import Array


class Air(NamedTuple):
    """Areas are C_d A, the same from every side."""

    density: float  # kg/m^3
    payload: float  # m^2
    vehicles: Array  # (n,) m^2
    links: Array  # (n, L) m^2; half of a link's acts at each of its ends; padding 0


@jit
def drag(system: System, state: State, air: Air, wind: Array, force: Array, work: Scratch) -> None:
    """Drag in N, W, under the `wind` (3,) m/s: on vehicles into `force` (n, 3), on the rest into `work.work`."""
    outside = work.work
    v = velocities(system, state)
    outside.loaded[0] = True
    outside.on_nodes[:] = 0.0
    _drag(air.density * air.payload, wind, state.v0, outside.on_payload)
    for i in range(system.m.shape[0]):
        _drag(air.density * air.vehicles[i], wind, v[i, 0], force[i])
        each = np.empty(3)
        for j in range(system.n_links[i]):
            half = 0.5 * air.density * air.links[i, j]
            _drag(half, wind, v[i, j], each)
            target = force[i] if j == 0 else outside.on_nodes[i, j - 1]
            for b in range(3):
                target[b] += each[b]
            _drag(half, wind, v[i, j + 1], each)
            for b in range(3):
                outside.on_nodes[i, j, b] += each[b]


@jit
def _drag(density_area: float, wind: Array, v: Array, out: Array) -> None:
    w = (wind[0] - v[0], wind[1] - v[1], wind[2] - v[2])
    size = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    for b in range(3):
        out[b] = 0.5 * density_area * size * w[b]
