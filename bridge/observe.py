"""Messages -> State at one instant: what belongs to the same time stamp is put together, the rest is left out.

Link directions, rates and the payload come from the tracker (ODOMETRY, CABLE_STATE), attitudes and rates from the
vehicles (ATTITUDE_QUATERNION). A vehicle's own LOCAL_POSITION_NED is redundant with those and is kept as a check: it
says whether the vehicle hangs where its cable says it does.
"""

import math
from typing import NamedTuple

import numpy as np

from bridge.wire.values import CableShape, PayloadState, VehicleAttitude, VehiclePosition
from cablequad import lie
from cablequad.state import State, positions
from cablequad.system import System
from cablequad.types import Array

KEPT = 16  # instants that may be under way at once; older incomplete ones are given up


class Instant(NamedTuple):
    """Everything said of one time stamp."""

    boot_ms: int
    state: State
    tension: Array  # (n,) N, of the links at the payload
    position_gap: Array  # (n,) m between a vehicle's own position and where its cable puts it; NaN where not said


class _Parts:
    """What has come in of one time stamp."""

    def __init__(self, n: int, L: int) -> None:
        self.attitudes: dict[int, VehicleAttitude] = {}
        self.positions: dict[int, VehiclePosition] = {}
        self.payload: PayloadState | None = None
        self.q = np.tile(np.array([0.0, 0.0, 1.0]), (n, L, 1))
        self.omega = np.zeros((n, L, 3))
        self.tension = np.zeros(n)
        self.links_missing = 0


class Observer:
    """Collects values by time stamp; `take` gives the newest instant that is complete."""

    def __init__(self, system: System) -> None:
        self._system = system
        self._n, self._L = system.length.shape
        self._links_of = system.n_links.tolist()
        self._links = sum(self._links_of)
        self._parts: dict[int, _Parts] = {}
        self._taken_ms = -1
        self._ready_ms = -1

    def feed(self, source: int, value: object) -> None:
        """Take one value from the vehicle with system id `source`, or from the tracker."""
        match value:
            case VehicleAttitude() if 1 <= source <= self._n:
                self._of(value.boot_ms).attitudes[source - 1] = value
                self._check(value.boot_ms)
            case VehiclePosition() if 1 <= source <= self._n:
                self._of(value.boot_ms).positions[source - 1] = value
            case PayloadState() if source > self._n:
                self._of(value.boot_us // 1000).payload = value
                self._check(value.boot_us // 1000)
            case CableShape() if source > self._n:
                self._cable(value)
                self._check(value.boot_us // 1000)
            case _:
                pass

    def take(self) -> Instant | None:
        """The newest complete instant not yet taken; older ones are dropped with it."""
        if self._ready_ms <= self._taken_ms:
            return None
        boot_ms = self._taken_ms = self._ready_ms
        parts = self._parts[boot_ms]
        for old in [ms for ms in self._parts if ms <= boot_ms]:
            del self._parts[old]
        load = parts.payload
        assert load is not None
        if not lie.normalize(parts.q):
            return None
        n = self._n
        R, Omega, gap = np.empty((n, 3, 3)), np.empty((n, 3)), np.full(n, np.nan)
        for i, vehicle in parts.attitudes.items():
            R[i], Omega[i] = vehicle.R, vehicle.Omega
        state = State(load.x0, load.v0, load.R0, load.Omega0, parts.q, parts.omega, R, Omega)
        if parts.positions:
            hung = positions(self._system, state)
            for i, said in parts.positions.items():
                gap[i] = math.dist(said.x.tolist(), hung[i, 0].tolist())
        return Instant(boot_ms, state, parts.tension, gap)

    def _of(self, boot_ms: int) -> _Parts:
        if boot_ms not in self._parts:
            if boot_ms + 1000 < self._taken_ms:  # the clock went back: a reboot starts everything anew
                self._parts.clear()
                self._taken_ms = self._ready_ms = -1
            while len(self._parts) >= KEPT:
                del self._parts[min(self._parts)]
            self._parts[boot_ms] = _Parts(self._n, self._L)
            self._parts[boot_ms].links_missing = self._links
        return self._parts[boot_ms]

    def _cable(self, c: CableShape) -> None:
        i, k, first = c.cable - 1, len(c.q), c.first_link
        if not 0 <= i < self._n or c.n_links != self._links_of[i] or first + k > self._L:
            return
        parts = self._of(c.boot_us // 1000)
        parts.q[i, first : first + k] = c.q
        parts.omega[i, first : first + k] = c.omega
        parts.links_missing -= k
        parts.tension[i] = c.tension_N

    def _check(self, boot_ms: int) -> None:
        parts = self._parts.get(boot_ms)
        if (
            parts is not None
            and parts.payload is not None
            and len(parts.attitudes) == self._n
            and parts.links_missing <= 0
        ):
            self._ready_ms = max(self._ready_ms, boot_ms)
