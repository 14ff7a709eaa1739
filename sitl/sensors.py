"""What is measured: white noise on what vehicles and the payload tracker report, from one seeded generator."""

import numpy as np

from bridge.wire.telemetry import Snapshot
from cablequad import lie
from cablequad.noise import Noise
from cablequad.state import State
from cablequad.types import Array
from sitl.plant import Truth


class Sensors:
    """The estimates of the vehicles and the tracker: the truth with noise of its own at every instant."""

    def __init__(self, noise: Noise, rng: np.random.Generator) -> None:
        self._noise = noise
        self._rng = rng
        self._exact = noise == Noise()

    def vehicle(self, s: Snapshot) -> Snapshot:
        """What a vehicle says of itself."""
        if self._exact:
            return s
        n = self._noise
        return s._replace(
            x=self._off(s.x, n.position), v=self._off(s.v, n.velocity), R=self._turned(s.R),
            Omega=self._off(s.Omega, n.rate),
        )  # fmt: skip

    def tracked(self, truth: Truth) -> Truth:
        """What the tracker says of the load and the cables."""
        if self._exact:
            return truth
        n, s = self._noise, truth.state
        q = self._off(s.q, n.link_direction)
        q /= np.linalg.norm(q, axis=-1, keepdims=True)
        omega = self._off(s.omega, n.link_rate)
        omega -= np.sum(omega * q, axis=-1, keepdims=True) * q
        seen = State(
            self._off(s.x0, n.position), self._off(s.v0, n.velocity), self._turned(s.R0), self._off(s.Omega0, n.rate),
            q, omega, s.R, s.Omega,
        )  # fmt: skip
        return truth._replace(state=seen)

    def _off(self, value: Array, deviation: float) -> Array:
        return value + deviation * self._rng.normal(size=value.shape)

    def _turned(self, R: Array) -> Array:
        return R @ lie.exp(self._noise.attitude * self._rng.normal(size=3))
