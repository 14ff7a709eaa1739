"""The world: rotors, attitude loops and cablequad's step, held still until the release or standing on the ground."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cablequad.boxed import box
from cablequad.environment.air import Air
from cablequad.environment.ground import Ground, ground, standing
from cablequad.environment.rotors import Rotors
from cablequad.environment.untethered import fly_untethered
from cablequad.environment.world import (
    AIR,
    DRIVEN,
    GROUND,
    ROTORS,
    Whole,
    World,
    fly_alone,
    fly_in,
    observe,
    turn_on_stands,
)
from cablequad.model.attitude import Airframe, Setpoint
from cablequad.model.instant import Motion, Shapes, motion_of, motion_shapes, places, row, specific_force
from cablequad.model.integrate import RotorOutput, Scratch, scratch
from cablequad.model.state import State, positions
from cablequad.model.system import System, cut_off, without
from cablequad.types import Array
from sitl.firmware.autopilot import NO_RATE, Actuation
from sitl.wind import Wind

LANDED_THRUST = 0.6  # of its weight: a vehicle that gives less, with its feet on the ground, is landing
LANDED_S = 0.3
LOOK_S = 0.004  # how often it is looked at
CUT_REACH_M = 1.0
WIND_AHEAD = 60  # steps that are drawn at a time
ARM_M, DRAG_M = 0.17, 0.02  # of rotors that nothing is said of


class Surroundings(NamedTuple):
    """What a plant has around it besides the model; what is None is not there."""

    air: Air | None = None
    rotors: Rotors | None = None
    ground_z: float | None = None  # m
    friction: float = 0.6
    corners: Array = np.zeros((0, 3))  # (c, 3) m, of the load
    feet: Array = np.zeros((0, 3))  # (4, 3) m, of a vehicle
    downwash: float = 0.0
    airborne: bool = False  # held in the air at first, over the ground
    driven: bool = False  # flight controllers drive every rotor by itself; restrained vehicles are free to turn


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


class PhysicsError(ArithmeticError):
    """The motion left the numbers."""


def _commanded(actuation: Sequence[Actuation], max_thrust: Sequence[float], scale: Sequence[float]) -> Setpoint:
    """What flight controllers ask, as the attitude loops take it: rotors give max_thrust throttle^2, times `scale`."""
    R_c, thrust = np.array([a.R_c for a in actuation]), []
    Omega_c, rate_only = np.zeros((len(actuation), 3)), np.zeros(len(actuation), dtype=np.bool_)
    for i, (_, rates, throttle, only) in enumerate(actuation):
        if only or rates is not NO_RATE:
            Omega_c[i], rate_only[i] = rates, only
        throttle, most = min(max(throttle, 0.0), 1.0), max_thrust[i]
        thrust.append(min(scale[i] * (most * (throttle * throttle)), most))
    return Setpoint(R_c, Omega_c, np.array(thrust), rate_only)


class _Part:
    """What hangs together: the load with its vehicles, or a vehicle with a cable that came off."""

    def __init__(
        self, system: System, members: list[int], airframe: Airframe, state: State, world: World, rotor_thrust: Array
    ) -> None:
        self.system, self.members, self.state, self.world = system, members, state, world
        self.whole = members == list(range(len(airframe.max_thrust)))
        self.airframe = Airframe(*(field[members].copy() for field in airframe))
        self.rotor_thrust = rotor_thrust[members].copy()
        self.command = RotorOutput(np.zeros(len(members)), np.zeros((len(members), 3)))
        self.work: Scratch = scratch(system, state)
        whole = Whole(system, self.airframe, state, world, self.rotor_thrust, self.command, self.work)
        self.boxed = box(whole)
        self.shapes = motion_shapes(*system.length.shape)
        self.observed: Array | None = None  # what there is to `look` at since the last move

    def move(self, setpoint: Setpoint, h: float, steps: int, wind: Array | None) -> Array:
        """Go on under the members' part of `setpoint`; the instant that comes then, as `look` gives it."""
        own = setpoint if self.whole else setpoint.of(self.members)
        if wind is None:
            self.observed = fly_alone(self.boxed, own, h, steps)
        else:
            self.observed = fly_in(self.boxed, own, h, wind)
        return self.observed

    def look(self, thrust: Array) -> Array:
        """This instant as an `instant.row`, with `thrust` (members,) N."""
        if self.observed is None:
            self.observed = observe(self.system, self.state, thrust, self.work)
        return self.observed


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
        self.system = system
        self.airframe = airframe
        self.initial = initial
        self.h = h
        self.around = self._around = around or Surroundings()
        self.grounded = self.around.ground_z is not None
        self._shapes, self._places = motion_shapes(*system.length.shape), places(*system.length.shape)
        self._max_thrust: list[float] = airframe.max_thrust.tolist()
        self._thrust_scale: list[float] = [1.0] * len(system.m) if thrust_scale is None else thrust_scale.tolist()
        self._given_scale = list(self._thrust_scale)
        self._wind = wind
        self._blows = np.zeros((0, 3))  # m/s: of the wind, already drawn
        self._rotors = self.around.rotors or _instant(airframe)
        a = self.around
        self._plain = a.air is None and a.rotors is None and a.ground_z is None and a.downwash == 0.0 and not a.driven
        self.reset()
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile the step before a clock runs, the part of it too that something which breaks would need."""
        n = len(self.system.m)
        self.command([Actuation(self.state.R[i], np.zeros(3), 0.0, False) for i in range(n)])
        if self.around.driven:
            self.restrained = True
            self.advance(1)
        still = None if self._plain else np.zeros((1, 3))
        self._parts[0].move(self._setpoint, self.h, 1, still)
        self.reset()
        self.specific_force(self.truth(0))

    def reset(self) -> None:
        """Back to the initial state, held where there is no ground."""
        n = len(self.system.m)
        self.around = self._around
        self.restrained = not self.grounded or self.around.airborne
        self.thrust = np.zeros(n)
        self._rotor_thrust = np.zeros((n, 4))
        state = self.initial.copy()
        whole = self._world(self.system, self.around.corners, list(range(n)))
        self._parts = [_Part(self.system, list(range(n)), self.airframe, state, whole, self._rotor_thrust)]
        self._gust, self._gust_s, self._gust_at = np.zeros(3), 0.0, 0.0
        self._apart: list[int] = []
        self._shifted = False
        self._offset = np.zeros(3)  # of the load's centre of mass, in its frame, from where it was
        self._standing = [self.grounded and not self.around.airborne] * n
        self._settled_s = [0.0] * n
        self._since_look = 0.0

    def _world(self, system: System, corners: Array, members: list[int]) -> World:
        a, n = self.around, len(self.system.m)
        none = Air(0.0, 0.0, np.zeros(n), np.zeros(self.system.length.shape))
        air = a.air or none
        own = Air(air.density, air.payload, air.vehicles[members].copy(), air.links[members].copy())
        rotors = Rotors(*(np.ascontiguousarray(field[members]) for field in self._rotors))
        z = math.inf if a.ground_z is None else a.ground_z
        feet = a.feet if len(a.feet) else np.zeros((0, 3))
        floor: Ground = ground(system, z, corners, feet, self.h, a.friction)
        has = np.zeros(4)
        has[AIR], has[ROTORS], has[GROUND], has[DRIVEN] = a.air is not None, not self._plain, self.grounded, a.driven
        reach = 0.5 * float(np.linalg.norm(np.ptp(corners, axis=0))) if len(corners) else CUT_REACH_M
        return World(own, rotors, floor, a.downwash if len(members) == n else 0.0, reach, has, np.zeros((n, 4)))

    @property
    def state(self) -> State:
        """Where everything is, as one state; cables that came off keep their links' directions."""
        s = self._parts[0].state
        if not self._apart and not self._shifted:
            return s
        x0 = s.x0 - s.R0 @ self._offset
        v0 = s.v0 - s.R0 @ np.cross(s.Omega0, self._offset)
        out = self.initial.copy()._replace(x0=x0, v0=v0, R0=s.R0.copy(), Omega0=s.Omega0.copy())
        for part in self._parts:
            k = part.system.length.shape[1]
            for own, i in enumerate(part.members):
                out.q[i, :k], out.omega[i, :k] = part.state.q[own], part.state.omega[own]
                out.R[i], out.Omega[i] = part.state.R[own], part.state.Omega[own]
        return out

    @property
    def attitudes(self) -> tuple[Array, Array]:
        """(n, 3, 3) and (n, 3) rad/s: of the vehicles."""
        s = self.state
        return s.R, s.Omega

    def standing(self) -> list[bool]:
        """Who stands on something, as a land detector says it: feet on the ground and little thrust for a while."""
        return list(self._standing) if self.grounded and not self.restrained else [self.restrained] * len(self.system.m)

    def command(self, actuation: Sequence[Actuation]) -> None:
        """What acts from now on."""
        self._setpoint = _commanded(actuation, self._max_thrust, self._thrust_scale)
        if self._plain:
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
            if self.around.driven:
                whole = self._parts[0]
                turn_on_stands(whole.boxed, self.h, steps)
                self.thrust, whole.observed = whole.command.thrust.copy(), None
            return
        wind = self._air(steps)
        for part in self._parts:
            seen = part.move(self._setpoint, self.h, steps, wind)
            if not math.isfinite(seen @ seen):
                raise PhysicsError("the motion is no longer finite; the vehicles and the load have flown apart")
        if not self._plain:
            self.thrust = self.thrust.copy()
            for part in self._parts:
                self.thrust[part.members] = part.command.thrust
        if self.grounded:
            self._since_look += steps * self.h
            if self._since_look >= LOOK_S - 1e-9:
                self._detect_landing(self._since_look)
                self._since_look = 0.0

    def _detect_landing(self, passed_s: float) -> None:
        for part in self._parts:
            feet = standing(part.system, part.state, part.world.ground)
            for own, i in enumerate(part.members):
                idle = self.thrust[i] < LANDED_THRUST * self.system.m[i] * self.system.g
                self._settled_s[i] = self._settled_s[i] + passed_s if feet[own] >= 2 and idle else 0.0
                if self._settled_s[i] >= LANDED_S:
                    self._standing[i] = True
                elif feet[own] == 0:
                    self._standing[i] = False

    # -- what breaks ---------------------------------------------------------------------------------------------------

    def set_rotor(self, i: int, rotor: int | None, works: float) -> None:
        """Rotor `rotor` (from 0) of vehicle i, or all of them, gives this share of its thrust from now on."""
        self._needs_world()
        for part in self._parts:
            if i in part.members:
                part.world.rotors.works[part.members.index(i), slice(None) if rotor is None else rotor] = works

    def weaken(self, i: int, scale: float) -> None:
        """Vehicle i gives `scale` of what its rotors gave at first from now on."""
        self._thrust_scale[i] = self._given_scale[i] * scale

    def cut(self, i: int) -> bool:
        """Cable i comes off the load; whether it was on. The last cable of a load cannot come off."""
        whole = self._parts[0]
        if i not in whole.members or len(whole.members) == 1:
            return False
        own = whole.members.index(i)
        left = [k for k in whole.members if k != i]
        s = whole.state
        rest = [k for k in range(len(whole.members)) if k != own]
        rotor_thrust = self._gathered()
        self._apart.append(i)
        kept = State(s.x0, s.v0, s.R0, s.Omega0, *(np.ascontiguousarray(field[rest]) for field in s[4:]))
        L = int(max(self.system.n_links[k] for k in left))
        kept = kept._replace(q=np.ascontiguousarray(kept.q[:, :L]), omega=np.ascontiguousarray(kept.omega[:, :L]))
        system = without(whole.system, [own])
        works = whole.world.rotors.works
        world = self._world(system, self.around.corners, left)
        main = _Part(system, left, self.airframe, kept.copy(), world, rotor_thrust)
        main.world.rotors.works[:] = works[rest]
        free = cut_off(whole.system, own)
        end = s.x0 + s.R0 @ whole.system.rho[own]
        v = s.v0 + s.R0 @ np.cross(s.Omega0, whole.system.rho[own])
        k = free.length.shape[1]
        loose = State(
            end, v, np.eye(3), np.zeros(3), s.q[own : own + 1, :k], s.omega[own : own + 1, :k], s.R[own : own + 1],
            s.Omega[own : own + 1],
        ).copy()  # fmt: skip
        alone = _Part(free, [i], self.airframe, loose, self._world(free, np.zeros((1, 3)), [i]), rotor_thrust)
        alone.world.rotors.works[:] = works[own]
        self._parts = [main, *self._parts[1:], alone]
        return True

    def shift(self, offset: Array) -> None:
        """What lies on the load slides by `offset` (3,) m in its frame: its centre of mass moves there."""
        whole = self._parts[0]
        s, old = whole.state, whole.system
        rho = old.rho - offset
        moved = old._replace(rho=np.ascontiguousarray(rho))
        outer = np.einsum("ia,ib->iab", rho, rho)
        steiner = np.einsum("ia,ia->i", rho, rho)[:, None, None] * np.eye(3) - outer
        moved = moved._replace(Jbar0=old.J0 + np.einsum("i,iab->ab", old.M_iT, steiner))
        at = s._replace(x0=s.x0 + s.R0 @ offset, v0=s.v0 + s.R0 @ np.cross(s.Omega0, offset)).copy()
        self._offset, self._shifted = self._offset + offset, True
        corners = self.around.corners - offset
        self.around = self.around._replace(corners=corners)
        works = whole.world.rotors.works
        world = self._world(moved, corners, whole.members)
        part = _Part(moved, whole.members, self.airframe, at, world, self._gathered())
        part.world.rotors.works[:] = works
        self._parts = [part, *self._parts[1:]]

    def _gathered(self) -> Array:
        out = self._rotor_thrust
        for part in self._parts:
            out[part.members] = part.rotor_thrust
        return out

    def _needs_world(self) -> None:
        """Rotors that act at once, where none were described, so that they can fail."""
        self._plain = False
        for part in self._parts:
            part.world.has[ROTORS] = 1.0

    def blow(self, wind: Array, seconds: float) -> None:
        """A gust of (1 - cos) shape begins: MIL-F-8785C's discrete gust, up to `wind` (3,) m/s and down again."""
        self._gust, self._gust_s, self._gust_at = wind, seconds, 0.0

    def _air(self, steps: int) -> Array | None:
        """(steps, 3) m/s, W: how the air moves in the next steps."""
        wind = None
        if self._wind is not None:
            if len(self._blows) < steps:
                self._blows = np.concatenate([self._blows, self._wind.next(WIND_AHEAD + steps)])
            wind, self._blows = self._blows[:steps], self._blows[steps:]
        if wind is None and not self._plain:
            wind = np.zeros((steps, 3))
        if wind is not None and self._gust_at < self._gust_s:
            t = self._gust_at + self.h * np.arange(steps)
            share = np.where(t < self._gust_s, 0.5 * (1.0 - np.cos(2.0 * np.pi * t / self._gust_s)), 0.0)
            wind = wind + share[:, None] * self._gust
            self._gust_at += steps * self.h
        return wind

    # -- what is told --------------------------------------------------------------------------------------------------

    def kinematics(self) -> tuple[Array, Array]:
        """(n, 3) m and (n, 3) m/s, W: where the quadrotors are and how they move."""
        row, n, x, v = self._look(), len(self.system.m), self._places.x, self._places.v
        return row[x : x + 3 * n].reshape(n, 3), row[v : v + 3 * n].reshape(n, 3)

    def truth(self, boot_us: int) -> Truth:
        """Everything, at this instant."""
        return Truth(boot_us, self.restrained, self._look(), self._shapes)

    def _look(self) -> Array:
        if not self._apart and not self._shifted:
            return self._parts[0].look(self.thrust)
        n = len(self.system.m)
        x, v, tension = np.empty((n, 3)), np.empty((n, 3)), np.zeros(self.system.length.shape)
        for part in self._parts:
            own = motion_of(part.look(self.thrust[part.members]), part.shapes)
            x[part.members], v[part.members] = own.x, own.v
            tension[part.members, : own.tension.shape[1]] = own.tension
        return row(self.state, x, v, tension, self.thrust)

    def specific_force(self, truth: Truth) -> Array:
        """(n, 3) m/s^2, body frames: what each accelerometer reads; the support carries vehicles while restrained."""
        n, L = self.system.length.shape
        pushed = np.empty((n, 3))
        for part in self._parts:
            pushed[part.members] = part.work.on_vehicles
        return specific_force(truth.row, L, self.system.m, self.system.g, pushed, truth.restrained)


def _instant(airframe: Airframe) -> Rotors:
    """Rotors that give at once what is asked, within their limits."""
    n = len(airframe.max_thrust)
    return Rotors(np.full(n, ARM_M), np.full(n, DRAG_M), np.zeros(n), airframe.max_thrust / 4.0, np.ones((n, 4)))


class UntetheredPlant:
    """n vehicles by themselves on level ground at z = 0: a fleet for ground stations and scripts, without a load."""

    def __init__(self, system: System, airframe: Airframe, initial: State, h: float) -> None:
        self.system, self.airframe, self.h = system, airframe, h
        self._places = positions(system, initial)[:, 0]
        self._places[:, 2] = 0.0
        self.restrained = False
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
        self._setpoint = _commanded(actuation, self.airframe.max_thrust.tolist(), [1.0] * len(actuation))
        self.thrust = self._setpoint.thrust

    def advance(self, steps: int) -> None:
        """`steps` physics steps under what was commanded."""
        self.R, self.Omega = self.R.copy(), self.Omega.copy()  # what was handed out stays as it was
        self._standing = fly_untethered(
            self.system.m, self.system.g, self.airframe, self._setpoint, self.x, self.v, self.R, self.Omega, 0.0,
            self.h, steps,
        )  # fmt: skip

    def specific_force(self) -> Array:
        """(n, 3) m/s^2, body frames: what each vehicle's accelerometer reads."""
        out = np.zeros_like(self.x)
        out[:, 2] = -self.thrust / self.system.m
        out[self._standing] = (0.0, 0.0, -self.system.g)
        return out
