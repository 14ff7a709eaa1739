"""The world: rotors, attitude loops and cablequad's step, held still until the release or standing on the ground."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cablequad.environment.world import turn_on_stands
from cablequad.model.attitude import Airframe, Setpoint
from cablequad.model.instant import Motion, Shapes, motion_of, motion_shapes, places, specific_force
from cablequad.model.state import State
from cablequad.model.system import System
from cablequad.types import Array
from sitl.firmware.autopilot import NO_RATE, Actuation
from sitl.land_detector import LandDetector
from sitl.moving_air import MovingAir
from sitl.parts import Parts, Surroundings
from sitl.wind import Wind

AIR_US = 100_000  # between two words on how the air moves


class Truth(NamedTuple):
    """The whole state at one instant, for the recorder alone."""

    boot_us: int
    restrained: bool
    row: Array  # of `cablequad.model.instant`, its own
    shapes: Shapes  # of what is in it

    @property
    def motion(self) -> Motion:
        """Everything, as views of the row; tensions are those of this instant under what is commanded from it on."""
        return motion_of(self.row, self.shapes)


class AirMotion(NamedTuple):
    """How the air moves at an instant: for the recorder alone."""

    boot_us: int
    wind: tuple[float, float, float]  # m/s, W


class PhysicsError(ArithmeticError):
    """The motion left the numbers."""


def commanded(actuation: Sequence[Actuation], max_thrust: Sequence[float], scale: Sequence[float]) -> Setpoint:
    """What flight controllers ask, as the attitude loops take it: rotors give max_thrust throttle^2, times `scale`."""
    R_c, thrust = np.array([a.R_c for a in actuation]), []
    Omega_c, rate_only = np.zeros((len(actuation), 3)), np.zeros(len(actuation), dtype=np.bool_)
    for i, (_, rates, throttle, only) in enumerate(actuation):
        if only or rates is not NO_RATE:
            Omega_c[i], rate_only[i] = rates, only
        throttle, most = min(max(throttle, 0.0), 1.0), max_thrust[i]
        thrust.append(min(scale[i] * (most * (throttle * throttle)), most))
    return Setpoint(R_c, Omega_c, np.array(thrust), rate_only)


class Plant:
    """n vehicles under one load."""

    def __init__(
        self,
        system: System,
        airframe: Airframe,
        initial: State,
        h: float,
        thrust_scale: Array | None = None,
        around: Surroundings | None = None,
        wind: Wind | None = None,
    ) -> None:
        """`thrust_scale` (n,): newtons that rotors give for one that is asked. `around.air` and `wind` go together."""
        self.system, self.h = system, h
        self._around = around or Surroundings()
        self._max_thrust: list[float] = airframe.max_thrust.tolist()
        self._thrust_scale: list[float] = [1.0] * len(system.m) if thrust_scale is None else thrust_scale.tolist()
        self._given_scale = list(self._thrust_scale)
        self._air = MovingAir(wind, h)
        self._parts = Parts(system, airframe, initial, h, self._around)
        self._shapes, self._places = motion_shapes(*system.length.shape), places(*system.length.shape)
        self.reset()
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile the step before a clock runs, the part of it too that something which breaks would need."""
        n = len(self.system.m)
        self.command([Actuation(self.state.R[i], np.zeros(3), 0.0, False) for i in range(n)])
        if self._around.driven:
            self.restrained = True
            self.advance(1)
        still = None if self._parts.plain else np.zeros((1, 3))
        self._parts.main.move(self._setpoint, self.h, 1, still)
        self.reset()
        self.specific_force(self.truth(0))

    def reset(self) -> None:
        """Back to the initial state, held where there is no ground."""
        self.restrained = not self.grounded or self._around.airborne
        self.thrust = np.zeros(len(self.system.m))
        self._parts.reset()
        self._air.calm_down()
        stand = self.grounded and not self._around.airborne
        self._landing = LandDetector(self.system.m * self.system.g, stand)

    @property
    def grounded(self) -> bool:
        """Whether there is a ground."""
        return self._around.ground_z is not None

    @property
    def state(self) -> State:
        """Where everything is, as one state; cables that came off keep their links' directions."""
        return self._parts.state

    @property
    def attitudes(self) -> tuple[Array, Array]:
        """(n, 3, 3) and (n, 3) rad/s: of the vehicles."""
        s = self.state
        return s.R, s.Omega

    def standing(self) -> list[bool]:
        """Who stands on something, as a land detector says it."""
        if self.grounded and not self.restrained:
            return list(self._landing.standing)
        return [self.restrained] * len(self.system.m)

    def command(self, actuation: Sequence[Actuation]) -> None:
        """What acts from now on."""
        self._setpoint = commanded(actuation, self._max_thrust, self._thrust_scale)
        if self._parts.plain:
            self.thrust = self._setpoint.thrust
            for part in self._parts:
                part.observed = None

    def drive(self, asked: Array) -> None:
        """What every rotor is asked for from now on, (n, 4) N, where flight controllers drive them (`driven`)."""
        given = np.array(self._thrust_scale)[:, None] * asked
        for part in self._parts:
            part.world.asked[:] = given if part.whole else given[part.members]

    def advance(self, steps: int) -> None:
        """`steps` physics steps under what was commanded. Raises PhysicsError when the state is no longer finite."""
        if self.restrained:
            if self._around.driven:
                whole = self._parts.main
                turn_on_stands(whole.boxed, self.h, steps)
                self.thrust, whole.observed = whole.command.thrust.copy(), None
            return
        wind = self._air.next(steps, not self._parts.plain)
        for part in self._parts:
            seen = part.move(self._setpoint, self.h, steps, wind)
            if not math.isfinite(seen @ seen):
                raise PhysicsError("the motion is no longer finite; the vehicles and the load have flown apart")
        if not self._parts.plain:
            self.thrust = self.thrust.copy()
            for part in self._parts:
                self.thrust[part.members] = part.command.thrust
        if self.grounded:
            self._landing.passed(steps * self.h, list(self._parts), self.thrust)

    # -- what breaks ---------------------------------------------------------------------------------------------------

    def set_rotor(self, i: int, rotor: int | None, works: float) -> None:
        """Rotor `rotor` (from 0) of vehicle i, or all of them, gives this share of its thrust from now on."""
        self._parts.set_rotor(i, rotor, works)

    def weaken(self, i: int, scale: float) -> None:
        """Vehicle i gives `scale` of what its rotors gave at first from now on."""
        self._thrust_scale[i] = self._given_scale[i] * scale

    def cut(self, i: int) -> bool:
        """Cable i comes off the load; whether it was on. The last cable of a load cannot come off."""
        return self._parts.cut(i)

    def shift(self, offset: Array) -> None:
        """What lies on the load slides by `offset` (3,) m in its frame: its centre of mass moves there."""
        self._parts.shift(offset)

    def blow(self, wind: Array, seconds: float) -> None:
        """A gust begins, up to `wind` (3,) m/s and down again in so many seconds."""
        self._air.blow(wind, seconds)

    # -- what is told --------------------------------------------------------------------------------------------------

    def kinematics(self) -> tuple[Array, Array]:
        """(n, 3) m and (n, 3) m/s, W: where the quadrotors are and how they move."""
        row, n, at = self._parts.look(self.thrust), len(self.system.m), self._places
        return row[at.x : at.x + 3 * n].reshape(n, 3), row[at.v : at.v + 3 * n].reshape(n, 3)

    def truth(self, boot_us: int) -> Truth:
        """Everything, at this instant."""
        return Truth(boot_us, self.restrained, self._parts.look(self.thrust), self._shapes)

    def air(self, boot_us: int) -> AirMotion | None:
        """How the air moves; None where it never did."""
        wind = self._air.newest
        return None if wind is None else AirMotion(boot_us, (float(wind[0]), float(wind[1]), float(wind[2])))

    def specific_force(self, truth: Truth) -> Array:
        """(n, 3) m/s^2, body frames: what each accelerometer reads; the support carries vehicles while restrained."""
        n, L = self.system.length.shape
        pushed = np.empty((n, 3))
        for part in self._parts:
            pushed[part.members] = part.work.on_vehicles
        return specific_force(truth.row, L, self.system.m, self.system.g, pushed, truth.restrained)
