"""The vehicle's attitude loop: the law that turns an attitude-and-thrust setpoint into a moment, and its response.

Rollout, predictor and sitl share this one file. The law is the rigid body's second-order response of the given
bandwidth and damping, M = J(-w^2 e - 2 zeta w (Omega - R'R_c Omega_c)) + Omega x J Omega, with e the rotation vector of
R_c'R, evaluated at every physics step.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cablequad._jit import inlined, jit
from cablequad.model import lie
from cablequad.model.integrate import RotorOutput, Scratch, advance, scratch
from cablequad.model.state import State
from cablequad.model.system import System
from cablequad.types import Array, Triple


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

    def of(self, members: list[int]) -> "Setpoint":
        """What it says to some of the vehicles."""
        return Setpoint(self.R_c[members], self.Omega_c[members], self.thrust[members], self.rate_only[members])


@inlined
def angular_acceleration(airframe: Airframe, setpoint: Setpoint, i: int, R: Array, O: Triple) -> Triple:
    """What the law makes of vehicle i's attitude R (3, 3) and rate O, rad/s^2, body frame."""
    O_c = (setpoint.Omega_c[i, 0], setpoint.Omega_c[i, 1], setpoint.Omega_c[i, 2])
    w, damping = airframe.bandwidth[i], 2.0 * airframe.damping[i] * airframe.bandwidth[i]
    error = (0.0, 0.0, 0.0)
    if not setpoint.rate_only[i]:
        r = lie.relative(setpoint.R_c[i], R)  # R_c'R
        error = lie.log_of_rows(r)
        O_c = (
            r[0][0] * O_c[0] + r[1][0] * O_c[1] + r[2][0] * O_c[2],
            r[0][1] * O_c[0] + r[1][1] * O_c[1] + r[2][1] * O_c[2],
            r[0][2] * O_c[0] + r[1][2] * O_c[1] + r[2][2] * O_c[2],
        )
    return (
        -w * w * error[0] - damping * (O[0] - O_c[0]),
        -w * w * error[1] - damping * (O[1] - O_c[1]),
        -w * w * error[2] - damping * (O[2] - O_c[2]),
    )


@inlined
def moments(system: System, airframe: Airframe, setpoint: Setpoint, state: State, command: RotorOutput) -> None:
    """Write the loops' moments (n, 3) N m and the limited thrusts (n,) N into `command`."""
    for i in range(system.m.shape[0]):
        O = (state.Omega[i, 0], state.Omega[i, 1], state.Omega[i, 2])
        wanted = angular_acceleration(airframe, setpoint, i, state.R[i], O)
        J = system.J[i]
        h = (
            J[0, 0] * O[0] + J[0, 1] * O[1] + J[0, 2] * O[2],
            J[1, 0] * O[0] + J[1, 1] * O[1] + J[1, 2] * O[2],
            J[2, 0] * O[0] + J[2, 1] * O[1] + J[2, 2] * O[2],
        )
        gyroscopic = lie.cross_triple(O, h)
        for a in range(3):
            turn = J[a, 0] * wanted[0] + J[a, 1] * wanted[1] + J[a, 2] * wanted[2]
            command.moment[i, a] = turn + gyroscopic[a]
        command.thrust[i] = min(max(setpoint.thrust[i], 0.0), airframe.max_thrust[i])


@jit
def fly(
    system: System, airframe: Airframe, setpoint: Setpoint, state: State, h: float, steps: int, work: Scratch
) -> None:
    """Advance `state` in place by `steps` steps of `h` s with the attitude loops closed at every step."""
    n = system.m.shape[0]
    command = RotorOutput(np.zeros(n), np.zeros((n, 3)))
    for _ in range(steps):
        moments(system, airframe, setpoint, state, command)
        advance(system, state, command, h, 1, work)


def flown(system: System, airframe: Airframe, setpoint: Setpoint, state: State, h: float, steps: int) -> State:
    """The state after `steps` steps of `h` s under `setpoint` held."""
    out = state.copy()
    fly(system, airframe, setpoint, out, h, steps, scratch(system, out))
    return out
