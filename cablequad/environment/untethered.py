"""Quadrotors without cables over level ground: the same attitude loops, gravity, thrust, and a floor they stand on."""

import numpy as np
import numpy.typing as npt

from cablequad._jit import jit
from cablequad.model import lie
from cablequad.model.attitude import Airframe, Setpoint, angular_acceleration
from cablequad.types import Array


@jit
def fly_untethered(
    m: Array,
    g: float,
    airframe: Airframe,
    setpoint: Setpoint,
    x: Array,
    v: Array,
    R: Array,
    Omega: Array,
    ground_z: float,
    h: float,
    steps: int,
) -> npt.NDArray[np.bool_]:
    """Advance x, v (n, 3), R (n, 3, 3) and Omega (n, 3) in place by `steps` midpoint steps of `h` s; (n,) who stands.

    A vehicle stands while it is at `ground_z` (m, down positive) and its thrust does not lift it; touching down takes
    all its velocity, as an inelastic floor with enough friction does.
    """
    n = m.shape[0]
    stands = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        f = min(max(setpoint.thrust[i], 0.0), airframe.max_thrust[i]) / m[i]
        for _ in range(steps):
            O = (Omega[i, 0], Omega[i, 1], Omega[i, 2])
            first = angular_acceleration(airframe, setpoint, i, R[i], O)
            middle = np.array([O[0] + 0.5 * h * first[0], O[1] + 0.5 * h * first[1], O[2] + 0.5 * h * first[2]])
            R_mid = R[i] @ lie.exp(0.5 * h * Omega[i])
            slope = angular_acceleration(airframe, setpoint, i, R_mid, (middle[0], middle[1], middle[2]))
            a = np.array([-f * R_mid[0, 2], -f * R_mid[1, 2], g - f * R_mid[2, 2]])
            stands[i] = x[i, 2] >= ground_z and v[i, 2] >= 0.0 and a[2] >= 0.0
            if stands[i]:
                x[i, 2] = ground_z
                v[i] = 0.0
                Omega[i] = 0.0
                continue
            x[i] += h * v[i] + 0.5 * h * h * a
            v[i] += h * a
            R[i] = R[i] @ lie.exp(h * middle)
            for k in range(3):
                Omega[i, k] += h * slope[k]
    return stands
