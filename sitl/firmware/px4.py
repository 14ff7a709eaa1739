"""A vehicle that answers as PX4 does: messages in, messages out, on its own clock.

What it does with an attitude target follows PX4 field by field, dangerous answers included: a NaN thrust or the
throttle-ignore bit stops the motors, a zero or NaN quaternion leaves the attitude to drift. Each says so in STATUSTEXT.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.frames import Packed, packed
from bridge.wire.messages import encode, text_frames
from bridge.wire.telemetry import BUILD, MOTION_ALONE, Snapshot
from bridge.wire.values import (
    IN_AIR,
    ON_GROUND,
    AttitudeTarget,
    Command,
    CommandAck,
    Heartbeat,
    MissionCount,
    MissionRequestList,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    Ping,
    ServerVersion,
    SetMode,
    StatusText,
    Timesync,
)
from cablequad import lie
from cablequad.types import Array
from sitl.firmware import hold, modes
from sitl.firmware.modes import ACCEPTED, DENIED, FAILED, TEMPORARILY_REJECTED, UNSUPPORTED, Mode, Situation
from sitl.firmware.parameters import px4_parameters
from sitl.firmware.streams import Streams

M = mavlink
ATTITUDE_QUATERNION = M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
HIGHRES_IMU = M.MAVLINK_MSG_ID_HIGHRES_IMU
HEARTBEAT_US = 1_000_000
MAGIC_FORCE = 21196.0
PARAMS_PER_TICK = 4
_NO_RATE = np.zeros(3)

ONBOARD_HZ = {
    M.MAVLINK_MSG_ID_ATTITUDE: 100, M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50, M.MAVLINK_MSG_ID_HIGHRES_IMU: 50,
    M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50, M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30, M.MAVLINK_MSG_ID_ODOMETRY: 30,
    M.MAVLINK_MSG_ID_ATTITUDE_TARGET: 10, M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 10, M.MAVLINK_MSG_ID_VFR_HUD: 10,
    M.MAVLINK_MSG_ID_ALTITUDE: 10, M.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 10, M.MAVLINK_MSG_ID_GPS_RAW_INT: 8,
    M.MAVLINK_MSG_ID_SYS_STATUS: 5, M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5, M.MAVLINK_MSG_ID_SYSTEM_TIME: 1,
    M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1, M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5, M.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
}  # fmt: skip
GCS_HZ = {
    M.MAVLINK_MSG_ID_ATTITUDE: 10, M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10, M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5,
    M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 5, M.MAVLINK_MSG_ID_VFR_HUD: 4, M.MAVLINK_MSG_ID_ALTITUDE: 1,
    M.MAVLINK_MSG_ID_GPS_RAW_INT: 1, M.MAVLINK_MSG_ID_SYS_STATUS: 1, M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1,
    M.MAVLINK_MSG_ID_SYSTEM_TIME: 1, M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.5, M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    M.MAVLINK_MSG_ID_HOME_POSITION: 0.5, M.MAVLINK_MSG_ID_ATTITUDE_TARGET: 2,
}  # fmt: skip


class Actuation(NamedTuple):
    """What the flight controller asks of its attitude loop and rotors."""

    R_c: Array  # (3, 3)
    Omega_c: Array  # (3,) rad/s: feed-forward, or body rates where rate_only
    throttle: float  # 0..1 motor command
    rate_only: bool


class Outgoing(NamedTuple):
    """A message for one of the vehicle's links; None means all of them."""

    link: int | None
    message: Packed


class Px4:
    """One vehicle's flight controller."""

    def __init__(self, system_id: int, tick_us: int, gcs_links: tuple[bool, ...], max_thrust_N: float) -> None:
        self.system_id = system_id
        self.parameters = px4_parameters(system_id)
        self.streams = [Streams(GCS_HZ if gcs else ONBOARD_HZ, tick_us) for gcs in gcs_links]
        self.mode = Mode.LOITER
        self.armed = False
        self.landed = ON_GROUND
        self.failsafe = False
        self.returned: Mode | None = None  # the mode a setpoint-loss failsafe interrupted
        self._max_thrust_N = max_thrust_N
        self._target: AttitudeTarget | None = None
        self._target_at_us = -(10**12)
        self._armed_at_us = 0
        self._next_heartbeat_us = 0
        self._anchor: hold.Anchor | None = None
        self._outbox: list[Outgoing] = []
        self._asked_for: list[tuple[int | None, int]] = []  # (link, message id) to build from the tick's snapshot
        self._param_queue: list[tuple[int, int]] = []
        self._prepared: dict[int, Packed] = {}
        self._warned = ""
        self._texts_said = 0
        self._throttle = 0.0
        self._commanded: tuple[Array, Array, float] = (np.eye(3), np.zeros(3), 0.0)

    # -- what comes in -------------------------------------------------------------------------------------------------

    def handle(self, link: int, system: int, component: int, value: Any, now_us: int) -> None:
        """Take one message that (system, component) sent on `link`."""
        match value:
            case AttitudeTarget():
                if value.system == self.system_id and value.component in (0, 1):
                    self._target, self._target_at_us = value, now_us
            case Command():
                if value.system == self.system_id and value.component in (0, 1):
                    self._command(link, system, component, value, now_us)
            case SetMode():
                if value.system == self.system_id:
                    main, sub = value.custom_mode >> 16 & 255, value.custom_mode >> 24 & 255
                    result = self._enter(main, sub, now_us)
                    self._reply(link, CommandAck(M.MAV_CMD_DO_SET_MODE, result, system, component))
            case ParamRequestRead():
                if self._mine(value.system, value.component) and (answer := self.parameters.read(value)):
                    self._reply(link, answer)
            case ParamRequestList():
                if self._mine(value.system, value.component):
                    self._param_queue += [(link, index) for index in range(len(self.parameters))]
            case ParamSet():
                if self._mine(value.system, value.component) and (answer := self.parameters.write(value)):
                    self._reply(link, answer)
            case Timesync():
                if value.tc1 == 0:
                    self._reply(link, Timesync(now_us * 1000, value.ts1))
            case Ping():
                if (value.system, value.component) == (0, 0):
                    self._reply(link, Ping(value.time_us, value.seq, system, component))
            case MissionRequestList():
                if self._mine(value.system, value.component):
                    self._reply(link, MissionCount(system, component, 0))
            case _:
                pass

    def _mine(self, system: int, component: int) -> bool:
        return system in (0, self.system_id) and component in (0, 1)

    def _command(self, link: int, system: int, component: int, c: Command, now_us: int) -> None:
        def ack(result: int) -> None:
            self._reply(link, CommandAck(c.command, result, system, component))

        p = c.params
        if c.command == M.MAV_CMD_DO_SET_MODE:
            ack(ACCEPTED)  # from the receiver; the result of the mode change follows
            main, sub = (int(v) if math.isfinite(v) else 0 for v in p[1:3])
            if main in modes.KNOWN_MAIN:
                ack(self._enter(main, sub, now_us))
            else:
                ack(ACCEPTED)
        elif c.command == M.MAV_CMD_COMPONENT_ARM_DISARM:
            wish = round(p[0]) if math.isfinite(p[0]) else -1
            if wish in (0, 1):
                ack(self._arm(wish == 1, p[1] == MAGIC_FORCE, now_us))
        elif c.command == M.MAV_CMD_SET_MESSAGE_INTERVAL:
            msgid = int(p[0]) if math.isfinite(p[0]) else -1
            ok = msgid in BUILD and math.isfinite(p[1]) and p[1] >= -1
            if ok:
                self.streams[link].set_interval(msgid, p[1])
            ack(ACCEPTED if ok else FAILED)
        elif c.command == M.MAV_CMD_GET_MESSAGE_INTERVAL:
            ack(ACCEPTED)
            msgid = int(p[0]) if math.isfinite(p[0]) else 0
            message = packed(M.MAVLink_message_interval_message(msgid, self.streams[link].interval_us(msgid)))
            self._outbox.append(Outgoing(link, message))
        elif c.command in (M.MAV_CMD_REQUEST_MESSAGE, M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES):
            msgid = int(p[0]) if c.command == M.MAV_CMD_REQUEST_MESSAGE and math.isfinite(p[0]) else 148
            if msgid == M.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                ack(ACCEPTED)
                self._reply(link, ServerVersion(0xE8FF, (1, 16, 0), self.system_id))
            elif msgid in BUILD:
                ack(ACCEPTED)
                self._asked_for.append((link, msgid))
            else:
                ack(DENIED)
        else:
            ack(UNSUPPORTED)

    def _situation(self, now_us: int, forced: bool = False) -> Situation:
        return Situation(self.armed, self.landed == ON_GROUND, self.mode, self.fresh_setpoint(now_us), forced)

    def _enter(self, main: int, sub: int, now_us: int) -> int:
        mode = modes.BY_NUMBER.get((main, sub))
        if mode is None:
            return TEMPORARILY_REJECTED
        row = modes.decide(modes.entry(mode), self._situation(now_us))
        self._say(row)
        if row.result == ACCEPTED:
            self._change(mode)
            self.returned = None
            self.failsafe = False
        return row.result

    def _change(self, mode: Mode) -> None:
        if mode is not self.mode:
            self.mode, self._anchor = mode, None

    def _arm(self, arm: bool, forced: bool, now_us: int) -> int:
        row = modes.decide(modes.ARM if arm else modes.DISARM, self._situation(now_us, forced))
        self._say(row)
        if row.result == ACCEPTED and arm != self.armed:
            self.armed, self._armed_at_us, self._anchor = arm, now_us, None
        return row.result

    # -- what goes out -------------------------------------------------------------------------------------------------

    def tick(self, now_us: int) -> None:
        """Let time pass: setpoint-loss failsafe and its end, disarming of an idle vehicle on the ground."""
        fresh = self.fresh_setpoint(now_us)
        if self.mode is Mode.OFFBOARD and self.armed and not fresh:
            self.returned, self.failsafe = Mode.OFFBOARD, True
            self._change(Mode.POSCTL)
            self._text(modes.CRITICAL, "Failsafe: no offboard setpoint, switching to Position")
        elif self.returned is Mode.OFFBOARD and fresh:
            self.returned, self.failsafe = None, False
            self._change(Mode.OFFBOARD)
            self._text(modes.INFO, "Offboard setpoints are back")
        idle = self.parameters["COM_DISARM_PRFLT"]
        if self.armed and self.landed == ON_GROUND and 0 < idle <= (now_us - self._armed_at_us) * 1e-6:
            self.armed = False
            self._text(modes.INFO, "Disarmed by auto preflight disarming")

    def fresh_setpoint(self, now_us: int) -> bool:
        """Whether the offboard signal stands: a setpoint within COM_OF_LOSS_T."""
        return now_us - self._target_at_us <= self.parameters["COM_OF_LOSS_T"] * 1e6

    def set_landed(self, landed: int) -> None:
        """What the land detector says; a change is sent at once on every link."""
        if landed != self.landed:
            self.landed = landed
            self._text(modes.INFO, "Takeoff detected" if landed == IN_AIR else "Landing detected")
            self._asked_for.append((None, M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE))

    def snapshot(self, s: Snapshot) -> Snapshot:
        """`s` with what only the flight controller knows."""
        return s._replace(
            throttle=self._throttle, armed=self.armed, landed=self.landed, offboard_target=self._commanded
        )

    def will_tell(self, msgid: int, now_us: int) -> bool:
        """Whether a message of this kind goes out at this tick, as things stand."""
        return any(streams.is_due(msgid, now_us) for streams in self.streams) or any(
            asked == msgid for _, asked in self._asked_for
        )

    def prepare(self, s: Snapshot, audible: tuple[bool, ...]) -> None:
        """Build ahead what the next tick will stream and no answer can change any more."""
        for link, streams in enumerate(self.streams):
            if audible[link]:
                for msgid in streams.coming(s.boot_us):
                    if msgid in MOTION_ALONE and msgid not in self._prepared:
                        self._prepared[msgid] = BUILD[msgid](s)

    def forget_prepared(self) -> None:
        """The motion turned out otherwise."""
        self._prepared = {}

    def outgoing(self, s: Snapshot, audible: tuple[bool, ...]) -> list[Outgoing]:
        """Everything to send at this tick; the attitude quaternion comes last, so that it closes the tick.

        Links that are not `audible` (nobody there yet) get no streams.
        """
        now_us = s.boot_us
        out = self._outbox + [Outgoing(link, BUILD[msgid](s)) for link, msgid in self._asked_for]
        self._outbox, self._asked_for = [], []
        if now_us >= self._next_heartbeat_us:
            self._next_heartbeat_us += HEARTBEAT_US * (1 + (now_us - self._next_heartbeat_us) // HEARTBEAT_US)
            out.append(Outgoing(None, encode(self._heartbeat(now_us))))
        for link, index in self._param_queue[:PARAMS_PER_TICK]:
            out.append(Outgoing(link, encode(self.parameters.report(index))))
        del self._param_queue[:PARAMS_PER_TICK]
        built, self._prepared = self._prepared, {}
        last: list[Outgoing] = []
        for link, streams in enumerate(self.streams):
            if not audible[link]:
                continue
            for msgid in streams.due(now_us):
                if msgid not in built:
                    built[msgid] = BUILD[msgid](s)
                (last if msgid == ATTITUDE_QUATERNION else out).append(Outgoing(link, built[msgid]))
        return out + last

    def _heartbeat(self, now_us: int) -> Heartbeat:
        base = 1 | self.mode.value[2] | (128 if self.armed else 0)
        if self.mode is Mode.OFFBOARD and not self.armed and not self.fresh_setpoint(now_us):
            base = 1
        status = M.MAV_STATE_STANDBY
        if self.armed:
            status = M.MAV_STATE_CRITICAL if self.failsafe else M.MAV_STATE_ACTIVE
        return Heartbeat(M.MAV_TYPE_QUADROTOR, M.MAV_AUTOPILOT_PX4, base, self.mode.custom, status)

    def _reply(self, link: int, value: Any) -> None:
        self._outbox.append(Outgoing(link, encode(value)))

    def _say(self, row: modes.Row) -> None:
        if row.text:
            self._text(row.severity, row.text)

    def _text(self, severity: int, text: str) -> None:
        self._texts_said = self._texts_said % 65535 + 1
        for part in text_frames(StatusText(severity, text), self._texts_said):
            self._outbox.append(Outgoing(None, encode(part)))

    # -- what it does --------------------------------------------------------------------------------------------------

    def actuation(self, s: Snapshot) -> Actuation:
        """Attitude and motor command for the time until the next tick."""
        if not self.armed:
            act = Actuation(s.R, np.zeros(3), 0.0, True)
        elif self.mode is Mode.OFFBOARD and self._target is not None:
            act = self._offboard(s, self._target)
        else:
            act = self._on_board(s)
        self._throttle = act.throttle
        self._commanded = (act.R_c, act.Omega_c, act.throttle)
        return act

    def _on_board(self, s: Snapshot) -> Actuation:
        if self._anchor is None:
            thrust = self._max_thrust_N * self._throttle**2 or 9.81  # a vehicle that was idle starts from one of 1 kg
            self._anchor = hold.anchor(s, thrust, sink=0.3 if self.failsafe else 0.0)
        R_c, thrust_N = hold.hold(s, self._anchor)
        return Actuation(R_c, np.zeros(3), min(1.0, math.sqrt(thrust_N / self._max_thrust_N)), False)

    def _offboard(self, s: Snapshot, target: AttitudeTarget) -> Actuation:
        """PX4's reading of the type mask, the quaternion and the thrust."""
        mask = target.type_mask
        throttle = self._motor_command(0.0 if mask & 64 else target.thrust)
        if mask & 64:
            self._warn("Offboard: throttle ignored by type mask, motors off")
        elif not math.isfinite(target.thrust):
            self._warn("Offboard: thrust is not finite, motors off")
        if mask & 128:
            rates = np.array(target.rates)
            return Actuation(s.R, np.where(np.isfinite(rates), rates, s.Omega), throttle, True)
        w, x, y, z = target.quat_wxyz
        size = w * w + x * x + y * y + z * z
        if not math.isfinite(size) or size < 1e-12:
            self._warn("Offboard: invalid quaternion, attitude uncontrolled")
            return Actuation(s.R, s.Omega.copy(), throttle, True)
        R_c = lie.rotation_from_quat(np.array(target.quat_wxyz))
        yaw_rate = target.rates[2]
        if mask & 4 or not math.isfinite(yaw_rate):
            return Actuation(R_c, _NO_RATE, throttle, False)
        return Actuation(R_c, yaw_rate * R_c[2], throttle, False)

    def _motor_command(self, thrust: float) -> float:
        """PX4's THR_MDL_FAC inverts fac x^2 + (1 - fac) x = thrust; the allocator saturates, NaN stops the motors."""
        if not math.isfinite(thrust):
            return 0.0
        t = min(max(thrust, 0.0), 1.0)
        fac = self.parameters["THR_MDL_FAC"]
        return 0.0 if t == 0.0 else 2 * t / (1 - fac + math.sqrt((1 - fac) ** 2 + 4 * fac * t))

    def _warn(self, text: str) -> None:
        if text != self._warned:
            self._warned = text
            self._text(modes.CRITICAL, text)
