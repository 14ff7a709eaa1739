"""What is measured: noise and bias on what vehicles and the payload tracker report, from seeded generators."""

import numpy as np

from cablequad.model import lie
from cablequad.model.instant import row
from cablequad.model.noise import Noise
from cablequad.model.state import State
from cablequad.types import Array
from sitl.firmware.telemetry import Snapshot
from sitl.instruments import Instruments
from sitl.plant import Truth


class Sensors:
    """The estimates of the vehicles and the tracker: the truth with noise of its own at every instant."""

    def __init__(
        self, noise: Noise, rng: np.random.Generator, wrong: tuple[Array, Array, float] | None = None,
        instruments: list[Instruments] | None = None,
    ) -> None:  # fmt: skip
        """`instruments` of each vehicle, where they are not perfect.

        `wrong`, always: positions (n, 3) m, attitudes (n, 3) rad about the body axes, and all headings, rad: a wrong
        heading turns what a vehicle takes for its attitude about the vertical, so that its thrust leans the wrong way.
        """
        self._noise = noise
        self._rng = rng
        self._exact = noise == Noise()
        self._wrong, self._instruments = wrong, instruments
        self._heading = lie.exp(np.array([0.0, 0.0, wrong[2]])) if wrong is not None and wrong[2] else None

    def vehicle(self, i: int, s: Snapshot, tells_imu: bool) -> Snapshot:
        """What vehicle i (from 0) says of itself; what its IMU reads only where it `tells_imu`."""
        if self._instruments is not None:
            own = self._instruments[i]
            fix = own.fix(s.boot_us, s.x, s.v)
            imu = None
            if tells_imu:
                imu = own.reading(s.specific_force, s.Omega, s.R, s.home.altitude_m - float(s.x[2]))
            s = s._replace(fix=fix, imu=imu)
        if self._wrong is not None:
            R = s.R @ lie.exp(self._wrong[1][i])
            s = s._replace(x=s.x + self._wrong[0][i], R=R if self._heading is None else self._heading @ R)
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
        n, m = self._noise, truth.motion
        s = m.state
        q = self._off(s.q, n.link_direction)
        q /= np.linalg.norm(q, axis=-1, keepdims=True)
        omega = self._off(s.omega, n.link_rate)
        omega -= np.sum(omega * q, axis=-1, keepdims=True) * q
        told = State(
            self._off(s.x0, n.position), self._off(s.v0, n.velocity), self._turned(s.R0), self._off(s.Omega0, n.rate),
            q, omega, s.R, s.Omega,
        )  # fmt: skip
        return truth._replace(row=row(told, m.x, m.v, m.tension, m.thrust))

    def _off(self, value: Array, deviation: float) -> Array:
        return value + deviation * self._rng.normal(size=value.shape)

    def _turned(self, R: Array) -> Array:
        return R @ lie.exp(self._noise.attitude * self._rng.normal(size=3))
