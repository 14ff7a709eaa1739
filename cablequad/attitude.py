"""The vehicle's attitude loop: the law that turns an attitude-and-thrust setpoint into a moment, and its response.

Rollout, predictor and sitl share this one file. The law is the rigid body's second-order response of the given
bandwidth and damping, M = J(-w^2 e - 2 zeta w (Omega - R'R_c Omega_c)) + Omega x J Omega, with e the rotation vector of
R_c'R, evaluated at every physics step.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cablequad import lie
from cablequad._jit import jit
from cablequad.integrate import Command, Scratch, advance, scratch
from cablequad.state import State
from cablequad.system import System
from cablequad.types import Array


class Airframe(NamedTuple):
    """How the vehicles answer setpoints."""

    bandwidth: Array  # (n,) rad/s, natural frequency of the attitude response
    damping: Array  # (n,) damping ratio
    max_thrust: Array  # (n,) N, rotor limit of a vehicle


class Setpoint(NamedTuple):
    """What the attitude loops are to follow, held until the next."""

    R_c: Array  # (n, 3, 3) commanded attitude, B -> W
    Omega_c: Array  # (n, 3) rad/s, rates of the commanded frame in that frame; body rates where rate_only
    thrust: Array  # (n,) N
    rate_only: npt.NDArray[np.bool_]  # (n,): follow Omega_c and ignore R_c

    @classmethod
    def attitude(cls, R_c: Array, thrust: Array) -> "Setpoint":
        """Attitude and thrust alone, as a SET_ATTITUDE_TARGET of type mask 7 says."""
        n = len(thrust)
        return cls(R_c, np.zeros((n, 3)), thrust, np.zeros(n, dtype=np.bool_))


@jit
def moments(system: System, airframe: Airframe, setpoint: Setpoint, state: State, command: Command) -> None:
    """Write the loops' moments (n, 3) N m and the limited thrusts (n,) N into `command`."""
    for i in range(system.m.shape[0]):
        R, O, J = state.R[i], state.Omega[i], system.J[i]
        w = airframe.bandwidth[i]
        if setpoint.rate_only[i]:
            error = np.zeros(3)
            rate = O - setpoint.Omega_c[i]
        else:
            relative = np.ascontiguousarray(setpoint.R_c[i].T) @ R
            error = lie.log(relative)
            rate = O - np.ascontiguousarray(relative.T) @ setpoint.Omega_c[i]
        wanted = -w * w * error - 2.0 * airframe.damping[i] * w * rate
        command.moment[i] = J @ wanted + lie.cross(O, J @ O)
        command.thrust[i] = min(max(setpoint.thrust[i], 0.0), airframe.max_thrust[i])


@jit
def fly(
    system: System, airframe: Airframe, setpoint: Setpoint, state: State, h: float, steps: int, work: Scratch
) -> None:
    """Advance `state` in place by `steps` steps of `h` s with the attitude loops closed at every step."""
    n = system.m.shape[0]
    command = Command(np.zeros(n), np.zeros((n, 3)))
    for _ in range(steps):
        moments(system, airframe, setpoint, state, command)
        advance(system, state, command, h, 1, work)


def flown(system: System, airframe: Airframe, setpoint: Setpoint, state: State, h: float, steps: int) -> State:
    """The state after `steps` steps of `h` s under `setpoint` held."""
    out = state.copy()
    fly(system, airframe, setpoint, out, h, steps, scratch(system, out))
    return out
