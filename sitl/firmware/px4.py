"""A vehicle that answers as PX4 does.

What it does with an attitude target follows PX4 field by field, dangerous answers included: a NaN thrust or the
throttle-ignore bit stops the motors, a zero or NaN quaternion leaves the attitude to drift. Each says so in STATUSTEXT.
"""

import math
from typing import ClassVar

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.values import IN_AIR, ON_GROUND, AttitudeTarget, Command, Heartbeat, PositionTarget, SetMode
from cablequad.model import lie
from sitl.firmware import px4_modes as modes
from sitl.firmware.autopilot import (
    COMMON_CAPABILITIES,
    MAX_RATE,
    MOST_INTERVAL_US,
    NO_RATE,
    SINK_M_S,
    Actuation,
    Autopilot,
    Body,
    LinkKind,
)
from sitl.firmware.navigate import A_IGNORED, FORCE_SET, X_IGNORED, Goal, goal_of
from sitl.firmware.parameters import px4_parameters
from sitl.firmware.px4_modes import Px4Conditions, Px4Mode
from sitl.firmware.telemetry import BUILD, Snapshot
from sitl.firmware.transitions import (
    ACCEPTED,
    CRITICAL,
    DENIED,
    FAILED,
    INFO,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    decide,
)

M = mavlink
MAGIC_FORCE = 21196.0
READY_US = 2_000_000
ROTORS = 4

DEFAULT_HZ: dict[LinkKind, dict[int, float]] = {
    LinkKind.ONBOARD: {
        M.MAVLINK_MSG_ID_ATTITUDE: 100, M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50, M.MAVLINK_MSG_ID_HIGHRES_IMU: 50,
        M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 50, M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30,
        M.MAVLINK_MSG_ID_ODOMETRY: 30, M.MAVLINK_MSG_ID_ATTITUDE_TARGET: 10, M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 10,
        M.MAVLINK_MSG_ID_VFR_HUD: 10, M.MAVLINK_MSG_ID_ALTITUDE: 10, M.MAVLINK_MSG_ID_TIMESYNC: 10,
        M.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 10, M.MAVLINK_MSG_ID_GPS_RAW_INT: 8,
        M.MAVLINK_MSG_ID_SYS_STATUS: 5, M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5, M.MAVLINK_MSG_ID_SYSTEM_TIME: 1,
        M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1, M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
        M.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    },
    LinkKind.GROUND: {
        M.MAVLINK_MSG_ID_ATTITUDE: 10, M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10,
        M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5, M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 5, M.MAVLINK_MSG_ID_VFR_HUD: 4,
        M.MAVLINK_MSG_ID_ALTITUDE: 1, M.MAVLINK_MSG_ID_GPS_RAW_INT: 1, M.MAVLINK_MSG_ID_SYS_STATUS: 1,
        M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1, M.MAVLINK_MSG_ID_SYSTEM_TIME: 1, M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 0.5,
        M.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5, M.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
        M.MAVLINK_MSG_ID_ATTITUDE_TARGET: 2,
    },
}  # fmt: skip
_MODE_COMMANDS = {
    M.MAV_CMD_NAV_TAKEOFF: Px4Mode.TAKEOFF,
    M.MAV_CMD_NAV_LAND: Px4Mode.LAND,
    M.MAV_CMD_NAV_RETURN_TO_LAUNCH: Px4Mode.RTL,
    M.MAV_CMD_NAV_LOITER_UNLIM: Px4Mode.LOITER,
}
_LOSS_ACTIONS = {
    0: Px4Mode.POSCTL, 1: Px4Mode.ALTCTL, 2: Px4Mode.STABILIZED, 3: Px4Mode.RTL, 4: Px4Mode.LAND, 5: Px4Mode.LOITER,
}  # fmt: skip
_TERMINATE, _DISARM = 6, 7


class Px4(Autopilot):
    """One PX4 vehicle."""

    autopilot: ClassVar[int] = M.MAV_AUTOPILOT_PX4
    capabilities: ClassVar[int] = COMMON_CAPABILITIES | M.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    version: ClassVar[tuple[int, int, int]] = (1, 16, 0)

    def __init__(
        self, system_id: int, tick_us: int, links: tuple[LinkKind, ...], body: Body, ready_us: int = READY_US
    ) -> None:
        hover = math.sqrt(min(1.0, body.mass_kg * body.g / body.max_thrust_N))
        parameters = px4_parameters(system_id, hover)
        super().__init__(system_id, tick_us, links, body, parameters, default_hz=DEFAULT_HZ, ready_us=ready_us)
        self.mode = Px4Mode.LOITER
        self.terminated = False
        self.returned: Px4Mode | None = None  # the mode a setpoint-loss failsafe interrupted
        self._takeoff_z: float | None = None
        self._reposition: Goal | None = None  # where DO_REPOSITION sent it

    @property
    def mode_name(self) -> str:
        return self.mode.name

    # -- what comes in -------------------------------------------------------------------------------------------------

    def _setpoint(self, value: AttitudeTarget, now_us: int) -> None:
        if value.component in (0, 1):
            self._target.value, self._target.at_us = value, now_us

    def _position_setpoint(self, value: PositionTarget, now_us: int) -> None:
        """Places in the local frame alone, velocities in the body's too; every axis by itself."""
        body = value.frame == M.MAV_FRAME_BODY_NED
        if not body and value.frame != M.MAV_FRAME_LOCAL_NED:
            self._warn(f"SET_POSITION_TARGET_LOCAL_NED: coordinate frame {value.frame} unsupported")
        elif value.type_mask & FORCE_SET and value.type_mask & A_IGNORED != A_IGNORED:
            self._warn("SET_POSITION_TARGET_LOCAL_NED: force setpoint unsupported")
        else:
            asked = value._replace(type_mask=value.type_mask | X_IGNORED) if body else value
            self._target.value = goal_of(
                asked, self._position.x, self._position.R, self.parameters["MPC_XY_CRUISE"], False, body
            )
            self._target.at_us = now_us

    def _addressed(self, c: Command) -> bool:
        return c.system == self.system_id and c.component in (0, 1)

    def _command(self, link: int, c: Command, now_us: int) -> list[int]:
        p = c.params
        number = [int(v) if math.isfinite(v) and abs(v) < 2**31 else -1 for v in p]
        match c.command:
            case M.MAV_CMD_DO_SET_MODE:  # the receiver answers first, the result of the change follows
                known = number[1] in modes.KNOWN_MAIN
                return [ACCEPTED, self._enter(number[1], max(number[2], 0), now_us) if known else ACCEPTED]
            case M.MAV_CMD_COMPONENT_ARM_DISARM:
                wish = round(p[0]) if math.isfinite(p[0]) else -1
                return [self._arm(wish == 1, p[1] == MAGIC_FORCE, now_us)] if wish in (0, 1) else []
            case (
                M.MAV_CMD_NAV_TAKEOFF | M.MAV_CMD_NAV_LAND | M.MAV_CMD_NAV_RETURN_TO_LAUNCH | M.MAV_CMD_NAV_LOITER_UNLIM
            ):
                return [self._switch(_MODE_COMMANDS[c.command], now_us)]
            case M.MAV_CMD_DO_REPOSITION:
                return [self._go_to(c, number[1], now_us)]
            case M.MAV_CMD_SET_MESSAGE_INTERVAL:
                ok = number[0] in BUILD and -1 <= p[1] <= MOST_INTERVAL_US
                if ok:
                    self.streams[link].set_interval(number[0], p[1])
                return [ACCEPTED if ok else FAILED]
            case M.MAV_CMD_INJECT_FAILURE:
                return [self._inject(number)]
            case _:
                return [self._request(link, c.command, number[0], DENIED)]

    def _go_to(self, c: Command, flags: int, now_us: int) -> int:
        """DO_REPOSITION: into Hold, at a place; without its flag for the change of mode it is not obeyed."""
        if flags < 0 or not flags & M.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE:
            return UNSUPPORTED
        place = self._position.asked(c)
        if place is None:
            return DENIED
        result = self._switch(Px4Mode.LOITER, now_us)
        if result == ACCEPTED:
            speed, yaw = c.params[0], c.params[3]
            cruise = self.parameters["MPC_XY_CRUISE"]
            speed = min(speed, cruise) if math.isfinite(speed) and speed > 0 else cruise
            self._reposition = Goal(place, speed, None, yaw if math.isfinite(yaw) else None)
        return result

    def _inject(self, number: list[int]) -> int:
        """MAV_CMD_INJECT_FAILURE with SYS_FAILURE_EN: motors that stop, and a GPS that says nothing any more."""
        unit, kind, instance = number[:3]
        if kind != M.FAILURE_TYPE_OFF or not 0 <= instance <= ROTORS:
            return UNSUPPORTED
        if unit == M.FAILURE_UNIT_SYSTEM_MOTOR:
            self.breakage.injected.append(("rotor-out", None if instance == 0 else instance - 1))
        elif unit == M.FAILURE_UNIT_SENSOR_GPS:
            self.breakage.injected.append(("gps-loss", None))
        else:
            return UNSUPPORTED
        return ACCEPTED

    def leave(self, mode: str) -> None:
        """See Autopilot."""
        self.failsafe = True
        self._change(Px4Mode[mode])
        self._text(CRITICAL, f"Failsafe activated: switching to {self.mode.name}")

    def _set_mode(self, value: SetMode, now_us: int) -> int | None:
        return self._enter(value.custom_mode >> 16 & 255, value.custom_mode >> 24 & 255, now_us)

    def _situation(self, now_us: int, forced: bool = False) -> Px4Conditions:
        ready = now_us >= self._ready_us
        fresh = self.fresh_setpoint(now_us)
        return Px4Conditions(self.armed, self.landed == ON_GROUND, self.mode, fresh, ready, forced)

    def _enter(self, main: int, sub: int, now_us: int) -> int:
        mode = modes.BY_NUMBER.get((main, sub))
        return TEMPORARILY_REJECTED if mode is None else self._switch(mode, now_us)

    def _switch(self, mode: Px4Mode, now_us: int) -> int:
        row = decide(modes.entry(mode), self._situation(now_us))
        self._say(row)
        if row.result == ACCEPTED:
            self._change(mode)
            self.returned = None
            self.failsafe = False
        return row.result

    def _change(self, mode: Px4Mode) -> None:
        if mode is not self.mode:
            self.mode = mode
            self.navigator.end()
            self._takeoff_z, self._reposition = None, None

    def _arm(self, arm: bool, forced: bool, now_us: int) -> int:
        row = decide(modes.ARM if arm else modes.DISARM, self._situation(now_us, forced))
        self._say(row)
        if row.result == ACCEPTED:
            self._set_armed(arm, now_us)
        return row.result

    # -- time ----------------------------------------------------------------------------------------------------------

    def fresh_setpoint(self, now_us: int) -> bool:
        """Whether the offboard signal stands: a setpoint within COM_OF_LOSS_T."""
        return now_us - self._target.at_us <= self.parameters["COM_OF_LOSS_T"] * 1e6

    def carries(self, now_us: int) -> bool:
        if not self.armed or now_us - self.arming.armed_at_us < self.parameters["COM_SPOOLUP_TIME"] * 1e6:
            return False
        return self.fresh_setpoint(now_us) if self.mode is Px4Mode.OFFBOARD else self.mode is Px4Mode.TAKEOFF

    def tick(self, now_us: int) -> None:
        self._now_us = now_us
        fresh = self.fresh_setpoint(now_us)
        if self.mode is Px4Mode.OFFBOARD and self.armed and not fresh:
            self._lose_offboard()
        elif self.returned is Px4Mode.OFFBOARD and fresh:
            self.returned, self.failsafe = None, False
            self._change(Px4Mode.OFFBOARD)
            self._text(INFO, "Offboard setpoints are back")
        elif not self.armed:
            self.returned = None
        self._watch_ground_station(now_us)
        self._disarm_when_idle(now_us)

    def _lose_offboard(self) -> None:
        self.failsafe = True
        action = int(self.parameters["COM_OBL_RC_ACT"])
        if action == _TERMINATE:
            self.terminated = True
            self._text(CRITICAL, "Failsafe: no offboard setpoint, flight terminated")
        elif action == _DISARM:
            self._text(CRITICAL, "Failsafe: no offboard setpoint, disarming")
            self._set_armed(False, self._now_us)
        else:
            self.returned = Px4Mode.OFFBOARD
            self._change(_LOSS_ACTIONS.get(action, Px4Mode.POSCTL))
            self._text(CRITICAL, f"Failsafe: no offboard setpoint, switching to {self.mode.name}")

    def _watch_ground_station(self, now_us: int) -> None:
        action = int(self.parameters["NAV_DLL_ACT"])
        if action == 0 or self._ground_heard_us is None or not self.armed or self.failsafe:
            return
        if now_us - self._ground_heard_us > self.parameters["COM_DL_LOSS_T"] * 1e6:
            self.failsafe = True
            self._change({1: Px4Mode.LOITER, 2: Px4Mode.RTL, 3: Px4Mode.LAND}.get(action, Px4Mode.RTL))
            self._text(CRITICAL, f"Failsafe: no ground station, switching to {self.mode.name}")

    def _disarm_when_idle(self, now_us: int) -> None:
        if not self.armed or self.landed != ON_GROUND:
            return
        idle, after_landing = self.parameters["COM_DISARM_PRFLT"], self.parameters["COM_DISARM_LAND"]
        flew = self.arming.landed_at_us > self.arming.armed_at_us
        if flew and 0 < after_landing <= (now_us - self.arming.landed_at_us) * 1e-6:
            self._disarm_by_itself("Disarmed by landing")
        elif not flew and 0 < idle <= (now_us - self.arming.armed_at_us) * 1e-6 and self.mode is not Px4Mode.TAKEOFF:
            self._disarm_by_itself("Disarmed by auto preflight disarming")

    def _land_detected(self) -> None:
        self._text(INFO, "Takeoff detected" if self.landed == IN_AIR else "Landing detected")

    def _heartbeat(self, now_us: int) -> Heartbeat:
        base = 1 | self.mode.value[2] | (128 if self.armed else 0)
        if self.mode is Px4Mode.OFFBOARD and not self.armed and not self.fresh_setpoint(now_us):
            base = 1
        if self.terminated:
            status = M.MAV_STATE_FLIGHT_TERMINATION
        elif self.armed:
            status = M.MAV_STATE_CRITICAL if self.failsafe else M.MAV_STATE_ACTIVE
        else:
            status = M.MAV_STATE_STANDBY if now_us >= self._ready_us else M.MAV_STATE_UNINIT
        return Heartbeat(M.MAV_TYPE_QUADROTOR, self.autopilot, base, self.mode.custom, status)

    # -- what it does --------------------------------------------------------------------------------------------------

    def actuation(self, s: Snapshot) -> Actuation:
        self._position.note(s)
        spooling = s.boot_us - self.arming.armed_at_us < self.parameters["COM_SPOOLUP_TIME"] * 1e6
        if not self.armed or self.terminated or (spooling and self.landed == ON_GROUND):
            act = Actuation(s.R, NO_RATE, 0.0, True)
        elif self.mode is Px4Mode.OFFBOARD and isinstance(self._target.value, Goal):
            act = self._go(s, self._target.value)
        elif self.mode is Px4Mode.OFFBOARD and isinstance(self._target.value, AttitudeTarget):
            self.navigator.end()
            asked = 0.0 if self._target.value.type_mask & 64 else self._target.value.thrust
            return self._act(self._offboard(s, self._target.value), abs(asked))  # the size of thrust_body
        else:
            act = self._on_board(s)
        return self._act(act, act.throttle)

    def _on_board(self, s: Snapshot) -> Actuation:
        p = self.parameters
        if self.landed == ON_GROUND and self.mode is not Px4Mode.TAKEOFF:
            return Actuation(s.R, NO_RATE, 0.0, True)  # nothing asks it to leave the ground
        match self.mode:
            case Px4Mode.TAKEOFF:
                if self._takeoff_z is None:
                    self._takeoff_z = float(s.x[2]) - p["MIS_TAKEOFF_ALT"]
                goal = Goal(np.array([*self._start(s), self._takeoff_z]), p["MPC_TKO_SPEED"])
                if abs(float(s.x[2]) - self._takeoff_z) < 0.2:
                    self.mode = Px4Mode.LOITER  # the position loop goes on where it is
                return self._go(s, goal)
            case Px4Mode.LOITER if self._reposition is not None:
                return self._go(s, self._reposition)
            case Px4Mode.LAND:
                return self._go(s, self._down(p["MPC_LAND_SPEED"]))
            case Px4Mode.RTL:
                return self._go(s, self._homewards(s, p["RTL_RETURN_ALT"], p["MPC_XY_CRUISE"], p["MPC_LAND_SPEED"]))
            case _:
                return self._go(s, self._down(SINK_M_S) if self.failsafe and self.mode is not Px4Mode.LOITER else None)

    def _start(self, s: Snapshot) -> tuple[float, float]:
        x = self.navigator.goal.x if self.navigator.active else s.x
        return float(x[0]), float(x[1])

    def _offboard(self, s: Snapshot, target: AttitudeTarget) -> Actuation:
        """PX4's reading of the type mask, the quaternion and the thrust."""
        mask = target.type_mask
        throttle = self.motor_command(0.0 if mask & 64 else target.thrust)
        if mask & 64:
            self._warn("Offboard: throttle ignored by type mask, motors off")
        elif not math.isfinite(target.thrust):
            self._warn("Offboard: thrust is not finite, motors off")
        if mask & 128:
            rates = np.clip(target.rates, -MAX_RATE, MAX_RATE)
            return Actuation(s.R, np.where(np.isfinite(rates), rates, s.Omega), throttle, True)
        w, x, y, z = target.quat_wxyz
        size = w * w + x * x + y * y + z * z
        if not math.isfinite(size) or size < 1e-12:
            self._warn("Offboard: invalid quaternion, attitude uncontrolled")
            return Actuation(s.R, s.Omega.copy(), throttle, True)
        R_c = lie.rotation_from_wxyz(w, x, y, z)
        yaw_rate = min(max(target.rates[2], -MAX_RATE), MAX_RATE)
        if mask & 4 or not math.isfinite(yaw_rate):
            return Actuation(R_c, NO_RATE, throttle, False)
        return Actuation(R_c, yaw_rate * R_c[2], throttle, False)

    def motor_command(self, thrust: float) -> float:
        """THR_MDL_FAC inverts fac x^2 + (1 - fac) x = thrust; the allocator saturates, NaN stops the motors."""
        if not math.isfinite(thrust):
            return 0.0
        t = min(max(thrust, 0.0), 1.0)
        fac = self.parameters["THR_MDL_FAC"]
        return 0.0 if t == 0.0 else 2 * t / (1 - fac + math.sqrt((1 - fac) ** 2 + 4 * fac * t))
