"""What surrounds a flight: wind and drag, rotors that are not at once what is asked of them, ground, downwash."""

from typing import NamedTuple

import numpy as np

from cablequad._jit import jit
from cablequad.boxed import Boxed
from cablequad.environment.air import Air, drag
from cablequad.environment.ground import Ground, advance_on, external_forces
from cablequad.environment.rotors import Rotors, drive, spin
from cablequad.model import lie
from cablequad.model.attitude import Airframe, Setpoint, fly, moments
from cablequad.model.instant import row
from cablequad.model.integrate import RotorOutput, Scratch, advance, look
from cablequad.model.state import State
from cablequad.model.system import System
from cablequad.types import Array


class World(NamedTuple):
    """Everything around a system; what there is of it says `has`."""

    air: Air
    rotors: Rotors
    ground: Ground
    downwash: float  # share of a vehicle's thrust that meets a load right below it
    reach: float  # m: how far from a rotor's axis the load still meets it
    has: Array  # (4,) 0 or 1: air, rotors, ground, rotors that flight controllers drive one by one
    asked: Array  # (n, 4) N, of every rotor, where they are driven one by one


AIR, ROTORS, GROUND, DRIVEN = 0, 1, 2, 3


class Whole(NamedTuple):
    """What hangs together, and everything around it and of it that moves on."""

    system: System
    airframe: Airframe
    state: State
    world: World
    rotor_thrust: Array  # (n, 4) N
    command: RotorOutput  # what the rotors gave last
    work: Scratch


@jit
def observe(system: System, state: State, thrust: Array, work: Scratch) -> Array:
    """`integrate.look`, and all else of the instant, as an `instant.row`."""
    x, v, tension = look(system, state, thrust, work)
    return row(state, x, v, tension, thrust)


@jit
def fly_alone(boxed: Boxed[Whole], setpoint: Setpoint, h: float, steps: int) -> Array:
    """`attitude.fly` with nothing around, and what `observe` gives then.

    The setpoint's thrusts are within the rotors' limits.
    """
    w = boxed.value
    fly(w.system, w.airframe, setpoint, w.state, h, steps, w.work)
    w.command.thrust[:] = setpoint.thrust
    return observe(w.system, w.state, setpoint.thrust, w.work)


@jit
def fly_in(boxed: Boxed[Whole], setpoint: Setpoint, h: float, wind: Array) -> Array:
    """`fly_alone` in a world whose air moves with `wind` (steps, 3) m/s, W, held over each step of `h` s."""
    w = boxed.value
    system, state, world, command, work = w.system, w.state, w.world, w.command, w.work
    for k in range(wind.shape[0]):
        if world.has[DRIVEN] > 0.0:
            drive(world.rotors, world.asked, command, w.rotor_thrust, h)
        else:
            moments(system, w.airframe, setpoint, state, command)
            if world.has[ROTORS] > 0.0:
                spin(world.rotors, command, w.rotor_thrust, h)
        if world.has[AIR] > 0.0:
            drag(system, state, world.air, wind[k], work.on_vehicles, work)
        else:
            work.on_vehicles[:] = 0.0
            work.work.on_payload[:] = 0.0
            work.work.on_nodes[:] = 0.0
        if world.downwash > 0.0:
            _blow(system, state, world, command, work)
        if world.has[GROUND] > 0.0:
            advance_on(system, state, command, h, world.ground, external_forces(work), work)
        else:
            advance(system, state, command, h, 1, work)
    return observe(system, state, command.thrust, work)


@jit
def turn_on_stands(boxed: Boxed[Whole], h: float, steps: int) -> None:
    """Vehicles on stands that hold their places and leave their attitudes free, under rotors that are driven.

    Cables are tied to centres of mass: attitudes turn by the rotors' moments alone. One midpoint step of Euler's
    equations for each `h` s. A vehicle whose rotors do not turn stays as it is.
    """
    w = boxed.value
    system, state, world, command = w.system, w.state, w.world, w.command
    for _ in range(steps):
        drive(world.rotors, world.asked, command, w.rotor_thrust, h)
        for i in range(system.m.shape[0]):
            if command.thrust[i] <= 0.0:
                state.Omega[i] = 0.0
                continue
            J = system.J[i]
            Omega = state.Omega[i].copy()
            middle = Omega + 0.5 * h * np.linalg.solve(J, command.moment[i] - np.cross(Omega, J @ Omega))
            state.R[i] = np.ascontiguousarray(state.R[i]) @ lie.exp(h * middle)
            state.Omega[i] = Omega + h * np.linalg.solve(J, command.moment[i] - np.cross(middle, J @ middle))
            lie.orthonormalize(state.R[i])


@jit
def _blow(system: System, state: State, world: World, command: RotorOutput, work: Scratch) -> None:
    """Vehicles' wakes push the load: the further from their axes the less."""
    work.work.loaded[0] = True
    for i in range(system.m.shape[0]):
        end = state.x0 + state.R0 @ system.rho[i]
        top = end.copy()
        for j in range(system.n_links[i]):
            top -= system.length[i, j] * state.q[i, j]
        way, axis = state.x0 - top, state.R[i, :, 2]
        along = np.sum(way * axis)
        aside = way - along * axis
        share = world.downwash * np.exp(-np.sum(aside * aside) / world.reach**2) if along > 0.0 else 0.0
        work.work.on_payload[:] += share * command.thrust[i] * axis
