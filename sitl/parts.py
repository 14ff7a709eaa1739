"""What hangs together: the load with its vehicles, and each vehicle with a cable that came off."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cablequad.boxed import box
from cablequad.environment.air import Air
from cablequad.environment.ground import Ground, ground
from cablequad.environment.rotors import Rotors
from cablequad.environment.world import AIR, DRIVEN, GROUND, ROTORS, Whole, World, fly_alone, fly_in, observe
from cablequad.model.attitude import Airframe, Setpoint
from cablequad.model.instant import motion_of, motion_shapes, row
from cablequad.model.integrate import RotorOutput, Scratch, scratch
from cablequad.model.state import State
from cablequad.model.system import System, cut_off, without
from cablequad.types import Array

CUT_REACH_M = 1.0
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


class Part:
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


class Parts:
    """All parts of a plant; the first is the load with those that carry it."""

    def __init__(self, system: System, airframe: Airframe, initial: State, h: float, around: Surroundings) -> None:
        self._system, self._airframe, self._initial, self._h, self._given = system, airframe, initial, h, around
        self._rotors = around.rotors or _instant(airframe)
        a = around
        self.plain = a.air is None and a.rotors is None and a.ground_z is None and a.downwash == 0.0 and not a.driven
        self.reset()

    def reset(self) -> None:
        """One part, in the initial state."""
        n = len(self._system.m)
        self._around = self._given
        self._rotor_thrust = np.zeros((n, 4))
        everyone = list(range(n))
        whole = self._world(self._system, self._around.corners, everyone)
        self._parts = [Part(self._system, everyone, self._airframe, self._initial.copy(), whole, self._rotor_thrust)]
        self._shifted = False
        self._offset = np.zeros(3)  # of the load's centre of mass, in its frame, from where it was

    def __iter__(self) -> Iterator[Part]:
        return iter(self._parts)

    @property
    def main(self) -> Part:
        """The load with those that carry it."""
        return self._parts[0]

    def _world(self, system: System, corners: Array, members: list[int]) -> World:
        a, n = self._around, len(self._system.m)
        none = Air(0.0, 0.0, np.zeros(n), np.zeros(self._system.length.shape))
        air = a.air or none
        own = Air(air.density, air.payload, air.vehicles[members].copy(), air.links[members].copy())
        rotors = Rotors(*(np.ascontiguousarray(field[members]) for field in self._rotors))
        z = math.inf if a.ground_z is None else a.ground_z
        feet = a.feet if len(a.feet) else np.zeros((0, 3))
        floor: Ground = ground(system, z, corners, feet, self._h, a.friction)
        has = np.zeros(4)
        has[AIR], has[ROTORS] = a.air is not None, not self.plain
        has[GROUND], has[DRIVEN] = a.ground_z is not None, a.driven
        reach = 0.5 * float(np.linalg.norm(np.ptp(corners, axis=0))) if len(corners) else CUT_REACH_M
        return World(own, rotors, floor, a.downwash if len(members) == n else 0.0, reach, has, np.zeros((n, 4)))

    @property
    def state(self) -> State:
        """Where everything is, as one state; cables that came off keep their links' directions."""
        s = self._parts[0].state
        if self._whole:
            return s
        x0 = s.x0 - s.R0 @ self._offset
        v0 = s.v0 - s.R0 @ np.cross(s.Omega0, self._offset)
        out = self._initial.copy()._replace(x0=x0, v0=v0, R0=s.R0.copy(), Omega0=s.Omega0.copy())
        for part in self._parts:
            k = part.system.length.shape[1]
            for own, i in enumerate(part.members):
                out.q[i, :k], out.omega[i, :k] = part.state.q[own], part.state.omega[own]
                out.R[i], out.Omega[i] = part.state.R[own], part.state.Omega[own]
        return out

    @property
    def _whole(self) -> bool:
        """Whether nothing came off and nothing slid."""
        return len(self._parts) == 1 and not self._shifted

    def look(self, thrust: Array) -> Array:
        """This instant as an `instant.row`, with `thrust` (n,) N."""
        if self._whole:
            return self._parts[0].look(thrust)
        n = len(self._system.m)
        x, v, tension = np.empty((n, 3)), np.empty((n, 3)), np.zeros(self._system.length.shape)
        for part in self._parts:
            own = motion_of(part.look(thrust[part.members]), part.shapes)
            x[part.members], v[part.members] = own.x, own.v
            tension[part.members, : own.tension.shape[1]] = own.tension
        return row(self.state, x, v, tension, thrust)

    def set_rotor(self, i: int, rotor: int | None, works: float) -> None:
        """Rotor `rotor` (from 0) of vehicle i, or all of them, gives this share of its thrust from now on.

        Rotors that act at once, where none were described, can fail from now on.
        """
        self.plain = False
        for part in self._parts:
            part.world.has[ROTORS] = 1.0
            if i in part.members:
                part.world.rotors.works[part.members.index(i), slice(None) if rotor is None else rotor] = works

    def cut(self, i: int) -> bool:
        """Cable i comes off the load; whether it was on. The last cable of a load cannot come off."""
        whole = self._parts[0]
        if i not in whole.members or len(whole.members) == 1:
            return False
        own = whole.members.index(i)
        left = [k for k in whole.members if k != i]
        s = whole.state
        rest = [k for k in range(len(whole.members)) if k != own]
        rotor_thrust = self._gather()
        kept = State(s.x0, s.v0, s.R0, s.Omega0, *(np.ascontiguousarray(field[rest]) for field in s[4:]))
        L = int(max(self._system.n_links[k] for k in left))
        kept = kept._replace(q=np.ascontiguousarray(kept.q[:, :L]), omega=np.ascontiguousarray(kept.omega[:, :L]))
        system = without(whole.system, [own])
        works = whole.world.rotors.works
        world = self._world(system, self._around.corners, left)
        main = Part(system, left, self._airframe, kept.copy(), world, rotor_thrust)
        main.world.rotors.works[:] = works[rest]
        free = cut_off(whole.system, own)
        end = s.x0 + s.R0 @ whole.system.rho[own]
        v = s.v0 + s.R0 @ np.cross(s.Omega0, whole.system.rho[own])
        k = free.length.shape[1]
        loose = State(
            end, v, np.eye(3), np.zeros(3), s.q[own : own + 1, :k], s.omega[own : own + 1, :k], s.R[own : own + 1],
            s.Omega[own : own + 1],
        ).copy()  # fmt: skip
        alone = Part(free, [i], self._airframe, loose, self._world(free, np.zeros((1, 3)), [i]), rotor_thrust)
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
        corners = self._around.corners - offset
        self._around = self._around._replace(corners=corners)
        works = whole.world.rotors.works
        world = self._world(moved, corners, whole.members)
        part = Part(moved, whole.members, self._airframe, at, world, self._gather())
        part.world.rotors.works[:] = works
        self._parts = [part, *self._parts[1:]]

    def _gather(self) -> Array:
        out = self._rotor_thrust
        for part in self._parts:
            out[part.members] = part.rotor_thrust
        return out


def _instant(airframe: Airframe) -> Rotors:
    """Rotors that give at once what is asked, within their limits."""
    n = len(airframe.max_thrust)
    return Rotors(np.full(n, ARM_M), np.full(n, DRAG_M), np.zeros(n), airframe.max_thrust / 4.0, np.ones((n, 4)))
