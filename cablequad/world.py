"""What surrounds a flight: wind and drag, rotors that are not at once what is asked of them, ground, downwash."""

from typing import NamedTuple

import numpy as np

from cablequad._jit import jit
from cablequad.air import Air, drag
from cablequad.attitude import Airframe, Setpoint, moments
from cablequad.ground import Ground, advance_on, kept
from cablequad.integrate import Command, Scratch, advance
from cablequad.rotors import Rotors, spin
from cablequad.state import State
from cablequad.system import System
from cablequad.types import Array


class World(NamedTuple):
    """Everything around a system; what there is of it says `has`."""

    air: Air
    rotors: Rotors
    ground: Ground
    downwash: float  # share of a vehicle's thrust that meets a load right below it
    reach: float  # m: how far from a rotor's axis the load still meets it
    has: Array  # (3,) 0 or 1: air, rotors, ground


AIR, ROTORS, GROUND = 0, 1, 2


@jit
def fly_in(
    system: System,
    airframe: Airframe,
    setpoint: Setpoint,
    state: State,
    h: float,
    world: World,
    wind: Array,
    rotor_thrust: Array,
    command: Command,
    work: Scratch,
) -> None:
    """`attitude.fly` in a world whose air moves with `wind` (steps, 3) m/s, W, held over each step of `h` s.

    `rotor_thrust` (n, 4) N moves on; `command` is left with what the rotors gave last.
    """
    for k in range(wind.shape[0]):
        moments(system, airframe, setpoint, state, command)
        if world.has[ROTORS] > 0.0:
            spin(world.rotors, command, rotor_thrust, h)
        if world.has[AIR] > 0.0:
            drag(system, state, world.air, wind[k], work.on_vehicles, work)
        else:
            work.on_vehicles[:] = 0.0
            work.work.on_payload[:] = 0.0
            work.work.on_nodes[:] = 0.0
        if world.downwash > 0.0:
            _blow(system, state, world, command, work)
        if world.has[GROUND] > 0.0:
            advance_on(system, state, command, h, world.ground, kept(work), work)
        else:
            advance(system, state, command, h, 1, work)


@jit
def _blow(system: System, state: State, world: World, command: Command, work: Scratch) -> None:
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
