"""Four rotors a vehicle: what they give of the thrust and moment that a flight controller asks, and when.

Quad X in the order of PX4 and ArduCopter: front right and rear left turn counter-clockwise seen from above, front left
and rear right clockwise. A rotor's thrust follows its command with a first-order lag between 0 and its limit, and its
drag turns the body about the thrust the other way round. Where not everything can be given, the moment about the thrust
yields first, then the tilting moments, never the collective.
"""

from typing import NamedTuple

import numpy as np

from cablequad._jit import jit
from cablequad.model.integrate import RotorOutput
from cablequad.types import Array

FORWARD = np.array([1.0, -1.0, 1.0, -1.0])  # of the rotors, times the arm / sqrt 2
RIGHT = np.array([1.0, -1.0, -1.0, 1.0])
TURN = np.array([1.0, 1.0, -1.0, -1.0])  # of their drag torque about body z (down)


class Rotors(NamedTuple):
    """How the rotors of n vehicles are."""

    arm: Array  # (n,) m, from the centre to a rotor
    drag: Array  # (n,) m, drag torque per thrust
    time: Array  # (n,) s, of the lag; 0: none
    most: Array  # (n,) N, of one rotor
    works: Array  # (n, 4) 0 .. 1: share of its thrust that a rotor still gives


@jit
def spin(rotors: Rotors, command: RotorOutput, thrust: Array, h: float) -> None:
    """Turn `command` into what the rotors give in a step of `h` s; `thrust` (n, 4) N, of each rotor, moves on."""
    asked = np.empty_like(thrust)
    for i in range(thrust.shape[0]):
        lever = rotors.arm[i] / np.sqrt(2.0)
        most = rotors.most[i]
        mean = min(command.thrust[i] / 4.0, most)
        tilt, turn = np.empty(4), np.empty(4)
        for k in range(4):
            tilt[k] = (FORWARD[k] * command.moment[i, 1] - RIGHT[k] * command.moment[i, 0]) / (4.0 * lever)
            turn[k] = TURN[k] * command.moment[i, 2] / (4.0 * rotors.drag[i])
        tilting = _share(tilt, np.full(4, mean), most)
        turning = _share(turn, mean + tilting * tilt, most)
        asked[i] = mean + tilting * tilt + turning * turn
    drive(rotors, asked, command, thrust, h)


@jit
def drive(rotors: Rotors, asked: Array, command: RotorOutput, thrust: Array, h: float) -> None:
    """Let rotors that are `asked` for (n, 4) N each move on by `h` s; `command` becomes what they give together."""
    for i in range(thrust.shape[0]):
        lever, most = rotors.arm[i] / np.sqrt(2.0), rotors.most[i]
        decay = np.exp(-h / rotors.time[i]) if rotors.time[i] > 0.0 else 0.0
        total, moment = 0.0, np.zeros(3)
        for k in range(4):
            goal = rotors.works[i, k] * min(max(asked[i, k], 0.0), most)
            thrust[i, k] = goal + decay * (thrust[i, k] - goal)
            total += thrust[i, k]
            moment[0] -= RIGHT[k] * lever * thrust[i, k]
            moment[1] += FORWARD[k] * lever * thrust[i, k]
            moment[2] += TURN[k] * rotors.drag[i] * thrust[i, k]
        command.thrust[i] = total
        command.moment[i] = moment


@jit
def _share(wanted: Array, base: Array, most: float) -> float:
    """How much of `wanted` can be added to `base` with every rotor between 0 and `most`."""
    share = 1.0
    for k in range(4):
        room = most - base[k] if wanted[k] > 0.0 else base[k]
        size = abs(wanted[k])
        if size > room:
            share = min(share, max(room, 0.0) / size)
    return share
