"""A vehicle on a table, its clock in our hand."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.messages import reread
from bridge.wire.values import IN_AIR, ON_GROUND, AttitudeTarget, Command, CommandAck, Heartbeat, StatusText
from cablequad.model import lie
from cablequad.model.earth import Home
from sitl.firmware.autopilot import Autopilot, Body, LinkKind
from sitl.firmware.outbox import ATTITUDE_QUATERNION, Outgoing
from sitl.firmware.telemetry import BUILD, Snapshot

TICK = 4000
CMD_ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
CMD_SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
CMD_INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
CMD_TAKEOFF = mavlink.MAV_CMD_NAV_TAKEOFF
CMD_REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE
CMD_REPOSITION = mavlink.MAV_CMD_DO_REPOSITION
CMD_RETURN = mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH
CMD_LAND = mavlink.MAV_CMD_NAV_LAND
CMD_CAPABILITIES = mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES
LEVEL = (1.0, 0.0, 0.0, 0.0)
BODY = Body(0.755, 25.0, 9.81)
LINKS = (LinkKind.ONBOARD, LinkKind.GROUND, LinkKind.GROUND)
ROLLED = lie.exp(np.array([0.2, 0.0, 0.0]))
ROLLED_QUAT: tuple[float, ...] = tuple(lie.quat_from_rotation(ROLLED).tolist())


class Point(NamedTuple):
    """A mass with perfect attitude over level ground at z = 0: enough for a position loop."""

    x: np.ndarray
    v: np.ndarray


class Bench:
    """One vehicle, told what the test tells it; `drive` lets it move as it asks."""

    def __init__(self, vehicle: Autopilot) -> None:
        self.vehicle: Any = vehicle  # of either firmware, whose modes differ
        self.now = 0
        self.R, self.Omega = np.eye(3), np.zeros(3)
        self.point = Point(np.zeros(3), np.zeros(3))
        self.heard: list[Any] = []
        self.act: Any = None  # an Actuation, once it has ticked

    def tick(self, ticks: int = 1, target: AttitudeTarget | None = None) -> None:
        for _ in range(ticks):
            self.now += TICK
            if target is not None:
                self.send(target)
            self.vehicle.tick(self.now)
            self.act = self.vehicle.actuation(self.snapshot())
            out = self.outgoing((True, False, False))
            self.heard += [reread(o.message) for o in out if o.link in (0, None)]

    def outgoing(self, audible: tuple[bool, ...]) -> list[Outgoing]:
        """Everything that is said at this tick, what closes it last."""
        s, vehicle = self.snapshot(), self.vehicle
        out = vehicle.outgoing(s, audible)
        return out + [Outgoing(link, BUILD[ATTITUDE_QUATERNION](s)) for link in vehicle.out.closing]

    def snapshot(self) -> Snapshot:
        return self.vehicle.snapshot(self.now, self.R, self.Omega, *self.point, np.zeros(3), Home())

    def drive(self, seconds: float, pull: Callable[[Point], np.ndarray] | None = None, floor: bool = True) -> None:
        """Let the vehicle fly as a point mass by what it asks of its rotors; `pull` is a cable's force, N."""
        h = TICK * 1e-6
        for _ in range(round(seconds / h)):
            self.tick()
            x, v = self.point
            if not self.act.rate_only:
                self.R = self.act.R_c
            thrust = BODY.max_thrust_N * self.act.throttle**2
            force = np.array([0.0, 0.0, BODY.mass_kg * BODY.g]) - thrust * self.R[:, 2]
            force += 0.0 if pull is None else pull(self.point)
            v = v + h * force / BODY.mass_kg
            x = x + h * v
            stands = floor and x[2] >= 0.0
            if stands:
                x, v = np.array([x[0], x[1], 0.0]), np.zeros(3)
            self.point = Point(x, v)
            self.vehicle.set_landed(ON_GROUND if stands else IN_AIR)

    def send(self, value: object, system: int = 255, component: int = 190, link: int = 0) -> None:
        self.vehicle.handle(link, system, component, value, self.now)

    def command(self, number: int, *params: float, system: int = 1, component: int = 1) -> list[int]:
        """Results acknowledged for a command."""
        self.heard.clear()
        p = (*params, *([0.0] * (7 - len(params))))
        self.send(Command(system, component, number, p[:7]))  # type: ignore[arg-type]
        self.tick()
        return [a.result for a in self.heard if isinstance(a, CommandAck) and a.command == number]

    def texts(self) -> list[str]:
        said: list[str] = []
        for h in self.heard:
            if isinstance(h, StatusText):
                said += [h.text] if h.chunk == 0 else [said.pop() + h.text]
        return said

    def beat(self, target: AttitudeTarget | None = None) -> Heartbeat:
        """The next heartbeat."""
        self.heard.clear()
        self.tick(251, target)
        return next(h for h in self.heard if isinstance(h, Heartbeat))

    def count(self, msgid: int, ticks: int = 250) -> int:
        """How many messages of a kind go out on the first link."""
        total = 0
        for _ in range(ticks):
            self.now += TICK
            out = self.outgoing((True, True, False))
            total += sum(o.message.msgid == msgid and o.link in (0, None) for o in out)
        return total


def target(**changes: Any) -> AttitudeTarget:
    return AttitudeTarget(0, 1, 1, 7, LEVEL, (0.0, 0.0, 0.0), 0.6)._replace(**changes)
