"""Vehicles by themselves on level ground."""

from collections.abc import Sequence

import numpy as np

from cablequad.environment.untethered import fly_untethered
from cablequad.model.attitude import Airframe
from cablequad.model.state import State, positions
from cablequad.model.system import System
from cablequad.types import Array
from sitl.firmware.autopilot import Actuation
from sitl.plant import commanded


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
        self._setpoint = commanded(actuation, self.airframe.max_thrust.tolist(), [1.0] * len(actuation))
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
