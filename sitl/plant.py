"""The world: rotors, attitude loops and cablequad's step, held still until the release."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cablequad.air import Air, fly_in_wind
from cablequad.attitude import Airframe, Setpoint, fly
from cablequad.dynamics import accelerations
from cablequad.integrate import scratch
from cablequad.loose import fly_loose
from cablequad.state import State, positions, velocities
from cablequad.system import System
from cablequad.types import Array
from sitl.firmware.autopilot import Actuation
from sitl.wind import Wind


class Truth(NamedTuple):
    """The whole state at one instant, for the recorder alone."""

    boot_us: int
    held: bool
    state: State
    x: Array  # (n, 3) m, W: quadrotors
    v: Array  # (n, 3) m/s, W
    tension: Array  # (n, L) N
    thrust: Array  # (n,) N


class PhysicsError(ArithmeticError):
    """The motion left the numbers."""


def _commanded(airframe: Airframe, actuation: Sequence[Actuation]) -> Setpoint:
    """What flight controllers ask, as the attitude loops take it: rotors give max_thrust throttle^2."""
    n = len(actuation)
    R_c, Omega_c = np.empty((n, 3, 3)), np.empty((n, 3))
    for i, a in enumerate(actuation):
        R_c[i], Omega_c[i] = a.R_c, a.Omega_c
    throttle = np.array([min(max(a.throttle, 0.0), 1.0) for a in actuation])
    rate_only = np.array([a.rate_only for a in actuation])
    return Setpoint(R_c, Omega_c, airframe.max_thrust * throttle**2, rate_only)


class Plant:
    """n vehicles under one load."""

    def __init__(
        self,
        system: System,
        airframe: Airframe,
        initial: State,
        h: float,
        thrust_scale: Array | None = None,
        air: Air | None = None,
        wind: Wind | None = None,
    ) -> None:
        """`thrust_scale` (n,): newtons that rotors give for one that is asked. `air` and `wind` go together."""
        self.system = system
        self.airframe = airframe
        self.initial = initial
        self.h = h
        self._thrust_scale = np.ones(len(system.m)) if thrust_scale is None else thrust_scale
        self._air, self._wind = air, wind
        self.reset()
        self._work = scratch(system, self.state)
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile the step before a clock runs."""
        n = len(self.system.m)
        self.command([Actuation(self.state.R[i], np.zeros(3), 0.0, False) for i in range(n)])
        self._move(self.state.copy(), 1)
        self._work = scratch(self.system, self.state)
        self.specific_force(self.truth(0, *self.kinematics()))

    def reset(self) -> None:
        """Back to the initial state, held."""
        self.state = self.initial.copy()
        self.held = True
        self.thrust = np.zeros(len(self.system.m))

    @property
    def attitudes(self) -> tuple[Array, Array]:
        """(n, 3, 3) and (n, 3) rad/s: of the vehicles."""
        return self.state.R, self.state.Omega

    def standing(self) -> list[bool]:
        """Who stands on something."""
        return [self.held] * len(self.system.m)

    def command(self, actuation: Sequence[Actuation]) -> None:
        """What acts from now on."""
        asked = _commanded(self.airframe, actuation)
        self._setpoint = asked._replace(thrust=np.minimum(self._thrust_scale * asked.thrust, self.airframe.max_thrust))
        self.thrust = self._setpoint.thrust

    def _move(self, state: State, steps: int) -> None:
        if self._air is None or self._wind is None:
            fly(self.system, self.airframe, self._setpoint, state, self.h, steps, self._work)
        else:
            wind = self._wind.next(steps)
            fly_in_wind(self.system, self.airframe, self._setpoint, state, self.h, self._air, wind, self._work)

    def advance(self, steps: int) -> None:
        """`steps` physics steps under what was commanded. Raises PhysicsError when the state is no longer finite."""
        if self.held:
            return
        self._move(self.state, steps)
        if not math.isfinite(float(self.state.x0.sum()) + float(self.state.omega.sum())):
            raise PhysicsError("the motion is no longer finite; the vehicles and the load have flown apart")

    def kinematics(self) -> tuple[Array, Array]:
        """(n, 3) m and (n, 3) m/s, W: where the quadrotors are and how they move."""
        return positions(self.system, self.state)[:, 0], velocities(self.system, self.state)[:, 0]

    def truth(self, boot_us: int, x: Array, v: Array) -> Truth:
        """Everything, in arrays of its own; tensions are those of this instant under what is commanded from it on."""
        s, work = self.state.copy(), self._work.work
        force = self._work.on_vehicles - self.thrust[:, None] * s.R[:, :, 2]
        if work.loaded[0]:
            tension = accelerations(self.system, s, force, work.on_payload, work.on_nodes).tension
        else:
            tension = accelerations(self.system, s, force).tension
        return Truth(boot_us, self.held, s, x, v, tension, self.thrust)

    def specific_force(self, truth: Truth) -> Array:
        """(n, 3) m/s^2, body frames: what each vehicle's accelerometer reads; the support carries it while held."""
        s = truth.state
        if truth.held:
            support = np.array([0.0, 0.0, -self.system.g])
            return np.einsum("iba,b->ia", s.R, support)
        pull = truth.tension[:, 0, None] * s.q[:, 0]
        blown = self._work.on_vehicles
        world = (pull + blown - truth.thrust[:, None] * s.R[:, :, 2]) / self.system.m[:, None]
        return np.einsum("iba,ib->ia", s.R, world)


class LoosePlant:
    """n vehicles by themselves on level ground at z = 0: a fleet for ground stations and scripts, without a load."""

    def __init__(self, system: System, airframe: Airframe, initial: State, h: float) -> None:
        self.system, self.airframe, self.h = system, airframe, h
        self._places = positions(system, initial)[:, 0]
        self._places[:, 2] = 0.0
        self.held = False
        self.thrust = np.zeros(len(system.m))
        self.reset()
        self.command([Actuation(np.eye(3), np.zeros(3), 0.0, False) for _ in system.m])
        self.advance(1)
        self.reset()

    def reset(self) -> None:
        """Everyone on the ground in its place."""
        n = len(self.system.m)
        self.x, self.v = self._places.copy(), np.zeros((n, 3))
        self.R, self.Omega = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        self._standing = np.full(n, True)

    @property
    def attitudes(self) -> tuple[Array, Array]:
        """(n, 3, 3) and (n, 3) rad/s: of the vehicles."""
        return self.R, self.Omega

    def standing(self) -> list[bool]:
        """Who stands on the ground."""
        stands: list[bool] = self._standing.tolist()
        return stands

    def kinematics(self) -> tuple[Array, Array]:
        """(n, 3) m and (n, 3) m/s, W."""
        return self.x.copy(), self.v.copy()

    def command(self, actuation: Sequence[Actuation]) -> None:
        """What acts from now on."""
        self._setpoint = _commanded(self.airframe, actuation)
        self.thrust = self._setpoint.thrust

    def advance(self, steps: int) -> None:
        """`steps` physics steps under what was commanded."""
        self.R, self.Omega = self.R.copy(), self.Omega.copy()  # what was handed out stays as it was
        self._standing = fly_loose(
            self.system.m, self.system.g, self.airframe, self._setpoint, self.x, self.v, self.R, self.Omega, 0.0,
            self.h, steps,
        )  # fmt: skip

    def specific_force(self) -> Array:
        """(n, 3) m/s^2, body frames: what each vehicle's accelerometer reads."""
        out = np.zeros_like(self.x)
        out[:, 2] = -self.thrust / self.system.m
        out[self._standing] = (0.0, 0.0, -self.system.g)
        return out
