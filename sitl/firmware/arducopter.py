"""A vehicle that answers as ArduCopter does.

Setpoints count in GUIDED alone. The thrust field is a climb rate unless GUID_OPTIONS holds 8, and is then multiplied by
1 / cos(tilt) unless ATC_ANGLE_BOOST is 0. A setpoint it does not take stops the vehicle where it is; a NaN thrust drops
it. Each says so in STATUSTEXT.
"""

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.values import (
    IN_AIR,
    ON_GROUND,
    AttitudeTarget,
    Command,
    DataStream,
    Heartbeat,
    PositionTarget,
    SetMode,
    Timesync,
)
from cablequad.model import lie
from cablequad.types import Array
from sitl.firmware import arducopter_modes as modes
from sitl.firmware.arducopter_modes import CopterConditions, CopterMode
from sitl.firmware.autopilot import (
    COMMON_CAPABILITIES,
    MAX_RATE,
    MOST_INTERVAL_US,
    NO_RATE,
    Actuation,
    Autopilot,
    Body,
    LinkKind,
)
from sitl.firmware.navigate import A_IGNORED, FAR_M, V_IGNORED, X_IGNORED, Goal, goal_of
from sitl.firmware.outbox import Outgoing
from sitl.firmware.parameters import arducopter_parameters
from sitl.firmware.telemetry import BUILD, Snapshot
from sitl.firmware.transitions import ACCEPTED, CRITICAL, DENIED, FAILED, INFO, UNSUPPORTED, WARNING, decide

M = mavlink
THRUST_NOT_CLIMB = 8  # GUID_OPTIONS
FORCED = (2989.0, 21196.0)
READY_US = 30_000_000  # the estimator takes GPS in half a minute after boot
UNIT = 1e-3  # |q.q - 1| of a quaternion that is taken
MAX_BOOST = 10.0
NOT_ITS = frozenset({M.MAVLINK_MSG_ID_ALTITUDE, M.MAVLINK_MSG_ID_ODOMETRY})  # messages that it does not have
FASTEST_US = 3000  # of a message at the 400 Hz loop
TIMESYNC_HZ = 0.1

DEFAULT_HZ: dict[LinkKind, dict[int, float]] = {
    kind: {M.MAVLINK_MSG_ID_TIMESYNC: TIMESYNC_HZ} for kind in LinkKind
}  # nothing else until it is asked for
STREAM_GROUPS: dict[int, tuple[int, ...]] = {
    M.MAV_DATA_STREAM_RAW_SENSORS: (M.MAVLINK_MSG_ID_HIGHRES_IMU,),
    M.MAV_DATA_STREAM_EXTENDED_STATUS: (
        M.MAVLINK_MSG_ID_SYS_STATUS,
        M.MAVLINK_MSG_ID_GPS_RAW_INT,
        M.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    ),
    M.MAV_DATA_STREAM_RC_CHANNELS: (M.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,),
    M.MAV_DATA_STREAM_POSITION: (M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, M.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    M.MAV_DATA_STREAM_EXTRA1: (M.MAVLINK_MSG_ID_ATTITUDE,),
    M.MAV_DATA_STREAM_EXTRA2: (M.MAVLINK_MSG_ID_VFR_HUD,),
    M.MAV_DATA_STREAM_EXTRA3: (
        M.MAVLINK_MSG_ID_SYSTEM_TIME,
        M.MAVLINK_MSG_ID_BATTERY_STATUS,
        M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    ),
}
_TARGET_FRAMES = frozenset(
    {
        M.MAV_FRAME_LOCAL_NED,
        M.MAV_FRAME_LOCAL_OFFSET_NED,
        M.MAV_FRAME_BODY_NED,
        M.MAV_FRAME_BODY_OFFSET_NED,
    }
)
_BODY_FRAMES = frozenset({M.MAV_FRAME_BODY_NED, M.MAV_FRAME_BODY_OFFSET_NED})
_PLACE_ALONE = 0xFFFF & ~X_IGNORED
_POSITION = frozenset(
    {M.MAVLINK_MSG_ID_LOCAL_POSITION_NED, M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, M.MAVLINK_MSG_ID_HOME_POSITION}
)  # sent only once there is a position


class ArduCopter(Autopilot):
    """One ArduCopter vehicle."""

    autopilot: ClassVar[int] = M.MAV_AUTOPILOT_ARDUPILOTMEGA
    capabilities: ClassVar[int] = COMMON_CAPABILITIES
    version: ClassVar[tuple[int, int, int]] = (4, 7, 0)

    def __init__(
        self, system_id: int, tick_us: int, links: tuple[LinkKind, ...], body: Body, ready_us: int = READY_US
    ) -> None:
        hover = min(1.0, body.density_ratio * body.mass_kg * body.g / body.max_thrust_N)
        parameters = arducopter_parameters(system_id, hover)
        super().__init__(system_id, tick_us, links, body, parameters, default_hz=DEFAULT_HZ, ready_us=ready_us)
        self.mode = CopterMode.STABILIZE
        self._stopped = True  # GUIDED without an attitude target: holds where it is
        self._takeoff: Goal | None = None
        self._R_t = np.eye(3)  # the attitude target, which rates carry on
        self._thrust = 0.0  # of the last target that was taken
        self._spun_up_us: int | None = None  # when the motors are up to speed
        self._dt = tick_us * 1e-6

    @property
    def mode_name(self) -> str:
        return self.mode.name

    # -- what comes in -------------------------------------------------------------------------------------------------

    def _setpoint(self, value: AttitudeTarget, now_us: int) -> None:
        """Any component of the right system: with no route to a wrong one, the firmware takes the frame for its own."""
        if self.mode not in modes.TAKES_SETPOINTS:
            return
        mask = value.type_mask
        rates_ignored = mask & 7
        quat = value.quat_wxyz
        size = sum(c * c for c in quat)
        refused = ""
        if rates_ignored not in (0, 7):
            refused = "body rates all or none"
        elif mask & 128 and rates_ignored:
            refused = "neither attitude nor rates"
        elif mask & 64 and self.mode is CopterMode.GUIDED:
            refused = "throttle ignored"
        elif not mask & 128 and not abs(size - 1.0) < UNIT:
            refused = "quaternion is not of length 1"
        if refused:
            self._stop(f"Guided: {refused}, stopping")
            return
        if not mask & 64:
            if not math.isfinite(value.thrust):
                self._warn("Internal Errors 0x400")
            self._thrust = value.thrust
        if not mask & 128:
            self._R_t = lie.rotation_from_quat(np.array(quat))
        self._target.value, self._target.at_us = value, now_us
        self._stopped, self._takeoff = False, None
        if self._wants_thrust() and self.armed and self._spun_up_us is None:
            self._spun_up_us = now_us + round(self.parameters["MOT_SPOOL_TIME"] * 1e6)

    def _position_setpoint(self, value: PositionTarget, now_us: int) -> None:
        """A place, velocities, or both; what is asked for on some axes of a triple alone counts as not asked for."""
        if self.mode is not CopterMode.GUIDED:
            return
        if value.frame not in _TARGET_FRAMES:
            self._stop(f"Guided: coordinate frame {value.frame} unsupported, stopping")
            return
        place, velocity, acceleration = (not value.type_mask & bits for bits in (X_IGNORED, V_IGNORED, A_IGNORED))
        numbers = (*(value.x if place else ()), *(value.v if velocity else ()))
        if not all(math.isfinite(c) and abs(c) < FAR_M for c in numbers):
            self._stop("Guided: position target is not finite, stopping")
        elif not place and not velocity and not acceleration:
            self._stop("Guided: nothing asked for, stopping")
        else:
            asked = value.type_mask | (0 if place else X_IGNORED) | (0 if velocity else V_IGNORED)
            offset, body = value.frame != M.MAV_FRAME_LOCAL_NED, value.frame in _BODY_FRAMES
            speed = self.parameters["WPNAV_SPEED"] / 100
            self._target.value = goal_of(
                value._replace(type_mask=asked), self._position.x, self._position.R, speed, offset, body
            )
            self._target.at_us = now_us
            self._stopped, self._takeoff = False, None

    def _go_to(self, c: Command, flags: int, now_us: int) -> int:
        """DO_REPOSITION: in GUIDED to a place; from another mode only where it says so."""
        change = flags > 0 and flags & M.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
        if self.mode is not CopterMode.GUIDED and not change:
            return DENIED
        place = self._position.asked(c)
        if place is None:
            return DENIED
        if self.mode is not CopterMode.GUIDED and self._switch(CopterMode.GUIDED, now_us) != ACCEPTED:
            return FAILED
        here = (float(place[0]), float(place[1]), float(place[2]))
        frame, none = M.MAV_FRAME_LOCAL_NED, (0.0, 0.0, 0.0)
        self._position_setpoint(PositionTarget(0, 0, 0, frame, _PLACE_ALONE, here, none, none, 0.0, 0.0), now_us)
        return ACCEPTED

    def _stop(self, text: str) -> None:
        self._warn(text)
        self._stopped, self._target.value = True, None
        self.navigator.end()

    def _wants_thrust(self) -> bool:
        return self._thrust > (0.0 if self._thrust_mode() else 0.5)

    def _thrust_mode(self) -> bool:
        return bool(int(self.parameters["GUID_OPTIONS"]) & THRUST_NOT_CLIMB)

    def _addressed(self, c: Command) -> bool:
        return c.system in (0, self.system_id) and c.component in (0, 1)

    def _command(self, link: int, c: Command, now_us: int) -> list[int]:
        p = c.params
        number = [int(v) if math.isfinite(v) and abs(v) < 2**31 else -1 for v in p]
        match c.command:
            case M.MAV_CMD_DO_SET_MODE:
                if number[0] < 0 or not number[0] & 1:
                    return [DENIED]
                return [self._switch(number[1], now_us)]
            case M.MAV_CMD_COMPONENT_ARM_DISARM:
                if p[0] not in (0.0, 1.0):
                    return [UNSUPPORTED]
                return [self._arm(p[0] == 1.0, p[1] in FORCED, now_us)]
            case M.MAV_CMD_NAV_TAKEOFF:
                return [self._take_off(p[6], now_us)]
            case M.MAV_CMD_NAV_LAND:
                return [self._switch(CopterMode.LAND, now_us)]
            case M.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                return [self._switch(CopterMode.RTL, now_us)]
            case M.MAV_CMD_NAV_LOITER_UNLIM:
                return [self._switch(CopterMode.LOITER, now_us)]
            case M.MAV_CMD_DO_REPOSITION:
                return [self._go_to(c, number[1], now_us)]
            case M.MAV_CMD_SET_MESSAGE_INTERVAL:
                return [self._set_interval(link, number[0], p[1], p[2])]
            case M.MAV_CMD_GET_HOME_POSITION if now_us < self._ready_us:
                return [FAILED]
            case _:
                return [self._request(link, c.command, number[0], FAILED)]

    def _set_interval(self, link: int, msgid: int, interval_us: float, p3: float) -> int:
        if msgid not in BUILD or msgid in NOT_ITS:
            self._text(INFO, f"No ap_message for mavlink id ({msgid})")
            return DENIED
        if not -1 <= interval_us <= MOST_INTERVAL_US or p3 not in (0.0,):
            return DENIED
        if 0 < interval_us < FASTEST_US:
            self._text(WARNING, f"Interval of message {msgid} below {FASTEST_US / 1000:g} ms refused")
            return DENIED
        self.streams[link].set_interval(msgid, interval_us)
        return ACCEPTED

    def _data_stream(self, link: int, value: DataStream) -> None:
        groups = STREAM_GROUPS.values() if value.stream == 0 else [STREAM_GROUPS.get(value.stream, ())]
        interval_us = round(1e6 / value.rate_hz) if value.start and value.rate_hz > 0 else -1
        for group in groups:
            for msgid in group:
                self.streams[link].set_interval(msgid, interval_us)

    def _set_mode(self, value: SetMode, now_us: int) -> int | None:
        self._switch(value.custom_mode, now_us)
        return None  # no ack for SET_MODE

    def _switch(self, number: int, now_us: int) -> int:
        if number not in {int(m) for m in CopterMode}:
            self._text(CRITICAL, f"No such mode {number}")
            return FAILED
        mode = CopterMode(number)
        row = decide(modes.ENTRY, self._situation(now_us)._replace(mode=mode))
        self._say(row)
        if row.result == ACCEPTED:
            self._change(mode)
            self.failsafe = False
        return row.result

    def _change(self, mode: CopterMode) -> None:
        if mode is not self.mode:
            self.mode = mode
            self._stopped, self._target.value, self._takeoff = True, None, None
            self.navigator.end()

    def leave(self, mode: str) -> None:
        """See Autopilot."""
        self._change(CopterMode[mode])
        self.failsafe = True
        self._text(CRITICAL, f"Failsafe: {self.mode.name}")

    def _situation(self, now_us: int, forced: bool = False) -> CopterConditions:
        return CopterConditions(self.armed, self.landed == ON_GROUND, self.mode, now_us >= self._ready_us, forced)

    def _arm(self, arm: bool, forced: bool, now_us: int) -> int:
        row = decide(modes.ARM if arm else modes.DISARM, self._situation(now_us, forced))
        self._say(row)
        if row.result == ACCEPTED and arm != self.armed:
            self._set_armed(arm, now_us)
            self._spun_up_us = None
            self._stopped, self._target.value, self._takeoff = True, None, None
        return row.result

    def _take_off(self, altitude_m: float, now_us: int) -> int:
        row = decide(modes.TAKEOFF, self._situation(now_us))
        if row.result == ACCEPTED and math.isfinite(altitude_m) and altitude_m > 0:
            up = np.array([self._position.x[0], self._position.x[1], self._position.home[2] - altitude_m])
            self._takeoff = Goal(up, self.parameters["WPNAV_SPEED_UP"] / 100)
            self._stopped, self._target.value = True, None
            self._spun_up_us = now_us + round(self.parameters["MOT_SPOOL_TIME"] * 1e6)
            return ACCEPTED
        return FAILED

    def _ground_heard(self, system: int, now_us: int) -> None:
        if system == int(self.parameters["MAV_GCS_SYSID"]):
            super()._ground_heard(system, now_us)

    # -- time ----------------------------------------------------------------------------------------------------------

    def fresh_setpoint(self, now_us: int) -> bool:
        """Whether a target is in force: taken, and within GUID_TIMEOUT, which a place to go to does not have."""
        if isinstance(self._target.value, Goal) and bool(np.isfinite(self._target.value.x).all()):
            return True
        return self._target.value is not None and now_us - self._target.at_us <= self.parameters["GUID_TIMEOUT"] * 1e6

    def carries(self, now_us: int) -> bool:
        up = self.armed and self._spun_up_us is not None and now_us >= self._spun_up_us
        return up and (self.fresh_setpoint(now_us) or self._takeoff is not None)

    def tick(self, now_us: int) -> None:
        self._now_us = now_us
        action = int(self.parameters["FS_GCS_ENABLE"])
        heard_us = now_us if self._ground_heard_us is None else self._ground_heard_us
        lost = now_us - heard_us > self.parameters["FS_GCS_TIMEOUT"] * 1e6
        if action and lost and self.armed and not self.failsafe:
            self._change(CopterMode.LAND if action == 5 else CopterMode.RTL)
            self.failsafe = True
            self._text(CRITICAL, f"GCS failsafe: {self.mode.name}")
        idle_s = self.parameters["DISARM_DELAY"]
        if self.armed and self.landed == ON_GROUND and self._takeoff is None and not self._told_to_lift(now_us):
            since = max(self.arming.armed_at_us, self.arming.landed_at_us)
            landing = (
                self.mode in (CopterMode.LAND, CopterMode.RTL) and self.arming.landed_at_us > self.arming.armed_at_us
            )
            if landing or 0 < idle_s <= (now_us - since) * 1e-6:
                self._disarm_by_itself("Disarming motors")

    def _told_to_lift(self, now_us: int) -> bool:
        return self.fresh_setpoint(now_us) and self._wants_thrust()

    def _timesync(self, now_us: int) -> Timesync:
        return Timesync(0, now_us * 1000 + self.system_id)

    def _heartbeat(self, now_us: int) -> Heartbeat:
        position = now_us >= self._ready_us
        base = 1 | 16 | 64 | (8 if position and self.mode in modes.NEEDS_POSITION else 0) | (128 if self.armed else 0)
        status = M.MAV_STATE_STANDBY
        if self.failsafe:
            status = M.MAV_STATE_CRITICAL
        elif self.armed and self.landed == IN_AIR:
            status = M.MAV_STATE_ACTIVE
        elif not position and not self.armed and now_us < 1_000_000:
            status = M.MAV_STATE_BOOT
        return Heartbeat(M.MAV_TYPE_QUADROTOR, self.autopilot, base, int(self.mode), status)

    def outgoing(self, s: Snapshot, audible: Sequence[bool]) -> list[Outgoing]:
        out = super().outgoing(s, audible)
        return out if s.boot_us >= self._ready_us else [o for o in out if o.message.msgid not in _POSITION]

    # -- what it does --------------------------------------------------------------------------------------------------

    def actuation(self, s: Snapshot) -> Actuation:
        self._position.note(s)
        up = self._spun_up_us is not None and s.boot_us >= self._spun_up_us
        if not self.armed or (self.landed == ON_GROUND and not up):
            return self._act(Actuation(s.R, NO_RATE, 0.0, True), 0.0)
        if self.mode in modes.TAKES_SETPOINTS and isinstance(self._target.value, Goal):
            return self._act(act := self._positioned(s, self._target.value), act.throttle**2)
        if self.mode in modes.TAKES_SETPOINTS and isinstance(self._target.value, AttitudeTarget):
            return self._guided(s, self._target.value)
        return self._act(act := self._on_board(s), act.throttle**2)

    def _on_board(self, s: Snapshot) -> Actuation:
        p = self.parameters
        match self.mode:
            case CopterMode.STABILIZE | CopterMode.ACRO:
                return Actuation(_level(s.R), NO_RATE, 0.0, False)  # by hand, and nobody has the stick
            case CopterMode.LAND:
                return self._go(s, self._down(p["LAND_SPEED"] / 100))
            case CopterMode.RTL:
                climb, down = p["WPNAV_SPEED"] / 100, p["LAND_SPEED"] / 100
                return self._go(s, self._homewards(s, p["RTL_ALT"] / 100, climb, down))
            case CopterMode.GUIDED if self._takeoff is not None:
                act = self._go(s, self._takeoff)
                if self.landed == IN_AIR and self.navigator.arrived(s):
                    self._takeoff = None
                return act
            case _:
                if self.landed == ON_GROUND:
                    return Actuation(s.R, NO_RATE, 0.0, True)
                return self._go(s, None)

    def _positioned(self, s: Snapshot, goal: Goal) -> Actuation:
        """GUIDED by places and velocities, as the position loop on board flies them; on the ground it stays there."""
        if self.landed == ON_GROUND:
            return Actuation(s.R, NO_RATE, 0.0, True)
        if not self.fresh_setpoint(s.boot_us):
            self._stop("Guided: no velocity target, stopping")
            return self._go(s, None)
        return self._go(s, goal)

    def _guided(self, s: Snapshot, target: AttitudeTarget) -> Actuation:
        mask, rates = target.type_mask, NO_RATE
        fresh = self.fresh_setpoint(s.boot_us)
        if not fresh:  # level at the target's heading, then no climb; it stays in GUIDED
            self._warn("Guided: no attitude target, level and holding height")
            R_c = _level(self._R_t)
            return self._act(self._climb(s, R_c, NO_RATE, 0.0), self._shown[0] ** 2)
        self.out.warned = "" if self.out.warned.startswith("Guided: no") else self.out.warned
        if mask & 7 == 0:
            rates = np.where(np.isfinite(target.rates), np.clip(target.rates, -MAX_RATE, MAX_RATE), 0.0)
        if mask & 128:
            throttle, shown = self._collective(s, s.R)
            return self._act(Actuation(s.R, rates, throttle, True), shown)
        if rates.any():  # body rates are read in the earth frame, and carry the target on until the next message
            rates = self._R_t @ rates
            self._R_t = self._R_t @ lie.exp(rates * self._dt)
        if not self._thrust_mode():
            return self._act(self._climb(s, self._R_t, rates, self._climb_rate()), self._thrust)
        throttle, shown = self._collective(s, self._R_t)
        return self._act(Actuation(self._R_t, rates, throttle, False), shown)

    def _collective(self, s: Snapshot, R_c: Array) -> tuple[float, float]:
        """Motor command and the thrust that ATTITUDE_TARGET shows, which is the one before the boost."""
        if not self._thrust_mode():
            act = self._climb(s, R_c, NO_RATE, self._climb_rate())
            return act.throttle, self._thrust
        asked = min(max(self._thrust, -1.0), 1.0) if math.isfinite(self._thrust) else 0.0
        boost = 1.0
        if self.parameters["ATC_ANGLE_BOOST"]:
            boost = min(1.0 / max(float(R_c[2, 2]), 1.0 / MAX_BOOST), MAX_BOOST)
        fraction = min(max(asked * boost / self.body.density_ratio, 0.0), 1.0)  # it makes up for thin air
        return math.sqrt(fraction), asked

    def _climb_rate(self) -> float:
        """m/s upwards that the thrust field asks for where it is a climb rate."""
        if not math.isfinite(self._thrust):
            return 0.0
        t = min(max(self._thrust, 0.0), 1.0)
        speed = self.parameters["WPNAV_SPEED_UP" if t > 0.5 else "WPNAV_SPEED_DN"] / 100
        return (t - 0.5) * 2 * speed

    def _climb(self, s: Snapshot, R_c: Array, rates: Array, up_m_s: float) -> Actuation:
        """The attitude as asked, the height by the vehicle's own loop."""
        goal = Goal(np.array([s.x[0], s.x[1], -math.copysign(FAR_M, up_m_s)]), abs(up_m_s)) if up_m_s else None
        if not self.navigator.active:
            self._begin(s)
        if goal is not None:
            self.navigator.goal = goal
        elif abs(float(self.navigator.goal.x[2])) >= FAR_M:
            self.navigator.goal = Goal(s.x.copy(), 1.0)
        lift_N = -float(self.navigator.force(s)[2])
        thrust_N = lift_N / max(float(s.R[2, 2]), 1.0 / MAX_BOOST)
        return Actuation(R_c, rates, self._motor_command_of(thrust_N), False)


def _level(R: Array) -> Array:
    """Level, with the nose where R has it."""
    yaw = math.atan2(R[1, 0], R[0, 0])
    return lie.exp(np.array([0.0, 0.0, yaw]))
