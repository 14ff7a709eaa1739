"""What both personas have in common: services, streams, texts. Messages in, messages out, on the vehicle's clock."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from enum import Enum
from typing import Any, ClassVar, NamedTuple

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.frames import Packed, packed
from bridge.wire.messages import GLOBAL_FRAMES, encode, text_frames
from bridge.wire.values import (
    ON_GROUND,
    Addressed,
    AttitudeTarget,
    Command,
    CommandAck,
    DataStream,
    FileRefusal,
    FileRequest,
    Heartbeat,
    MissionAck,
    MissionClear,
    MissionCount,
    MissionRequestList,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    Ping,
    PositionTarget,
    ServerVersion,
    SetMode,
    StatusText,
    Timesync,
    Value,
)
from cablequad.model.earth import Home, local
from cablequad.types import Array
from sitl.firmware.navigate import FAR_M, Goal, Navigator, attitude
from sitl.firmware.parameters import Parameters
from sitl.firmware.streams import Streams
from sitl.firmware.telemetry import BUILD, Snapshot
from sitl.firmware.transitions import ACCEPTED, CRITICAL, INFO, UNSUPPORTED, Row

M = mavlink
ATTITUDE_QUATERNION = M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
HIGHRES_IMU = M.MAVLINK_MSG_ID_HIGHRES_IMU
EXTENDED_SYS_STATE = M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
HEARTBEAT_US = 1_000_000
PARAMS_PER_TICK = 4
MISSION_UNSUPPORTED = 3
FTP_FILE_NOT_FOUND = 10
GROUND_STATION = M.MAV_TYPE_GCS
SINK_M_S = 0.3  # a PX4 in position mode without a radio
MAX_RATE = 35.0  # rad/s: what a gyroscope can measure, 2000 deg/s; no rate loop asks for more
MOST_MSGID, MOST_INTERVAL_US = 65535, 2**31 - 1  # that MESSAGE_INTERVAL can tell
RELATIVE_FRAMES = frozenset({M.MAV_FRAME_GLOBAL_RELATIVE_ALT, M.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})
NO_RATE = np.zeros(3)
COMMON_CAPABILITIES = (
    M.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | M.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | M.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | M.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | M.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)  # what the firmware has beyond these (missions, fence, rally points, FTP, terrain) is not here, and not claimed


class LinkKind(Enum):
    """What a link is for; personas stream accordingly."""

    ONBOARD = 0
    GROUND = 1


class Body(NamedTuple):
    """What an autopilot was set up with for its airframe."""

    mass_kg: float
    max_thrust_N: float  # where it flies
    g: float
    density_ratio: float = 1.0  # of the air there to that at sea level


class Actuation(NamedTuple):
    """What the flight controller asks of its attitude loop and rotors."""

    R_c: Array  # (3, 3)
    Omega_c: Array  # (3,) rad/s: feed-forward, or body rates where rate_only
    throttle: float  # 0..1 motor command; the rotors give max_thrust throttle^2
    rate_only: bool


class Outgoing(NamedTuple):
    """A message for one of the vehicle's links; None means all of them."""

    link: int | None
    message: Packed


class Autopilot(ABC):
    """One vehicle's flight controller."""

    autopilot: ClassVar[int]  # MAV_AUTOPILOT
    capabilities: ClassVar[int]
    version: ClassVar[tuple[int, int, int]]

    def __init__(
        self,
        system_id: int,
        tick_us: int,
        links: tuple[LinkKind, ...],
        body: Body,
        parameters: Parameters,
        default_hz: Mapping[LinkKind, Mapping[int, float]],
        ready_us: int,
    ) -> None:
        """`ready_us`: when the estimator has a position, on the vehicle's clock."""
        self.system_id = system_id
        self.links = links
        self.body = body
        self.parameters = parameters
        self.streams = [Streams(default_hz[kind], tick_us) for kind in links]
        self.navigator = Navigator(body.mass_kg, body.g, tick_us)
        self.armed = False
        self.hook_open = False
        self.injected: list[tuple[str, int | None]] = []  # failures that were commanded: kind, rotor
        self.landed = ON_GROUND
        self.failsafe = False
        self._ready_us = ready_us
        self._now_us = 0
        self._target: AttitudeTarget | Goal | None = None  # a Goal: places and velocities are asked for
        self._origin = Home()
        self._target_at_us = -(10**12)
        self._armed_at_us = 0
        self._landed_at_us = 0
        self._ground_heard_us: int | None = None
        self._home = np.zeros(3)
        self._at, self._R = np.zeros(3), np.eye(3)  # where it was last, and how it was turned
        self._v_down, self._sinks_m_s2, self._noted_us = 0.0, 0.0, -1
        self._next_heartbeat_us = 0
        self._outbox: list[Outgoing] = []
        self._asked_for: list[tuple[int | None, int]] = []  # (link, message id) to build from the tick's snapshot
        self.closing: list[int] = []  # links on which the attitude quaternion ends what is said at this tick
        self._param_queue: list[tuple[int, int]] = []
        self._warned = ""
        self._texts_said = 0
        self._throttle = 0.0
        self._commanded: tuple[Array, Array, float] = (np.eye(3), np.zeros(3), 0.0)

    # -- what a persona decides ----------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def mode_name(self) -> str:
        """The mode in words."""

    @abstractmethod
    def fresh_setpoint(self, now_us: int) -> bool:
        """Whether an attitude setpoint is in force."""

    @abstractmethod
    def carries(self, now_us: int) -> bool:
        """Whether the vehicle can be let go: armed, motors up to speed and told to fly."""

    @abstractmethod
    def tick(self, now_us: int) -> None:
        """Let time pass: failsafes, time-outs, idle disarming."""

    @abstractmethod
    def leave(self, mode: str) -> None:
        """Go into LAND or RTL by itself, as a failsafe does."""

    @abstractmethod
    def actuation(self, s: Snapshot) -> Actuation:
        """Attitude and motor command for the time until the next tick."""

    @abstractmethod
    def _setpoint(self, value: AttitudeTarget, now_us: int) -> None:
        """Take SET_ATTITUDE_TARGET."""

    @abstractmethod
    def _position_setpoint(self, value: PositionTarget, now_us: int) -> None:
        """Take SET_POSITION_TARGET_LOCAL_NED."""

    @abstractmethod
    def _addressed(self, c: Command) -> bool:
        """Whether a command is for this vehicle."""

    @abstractmethod
    def _command(self, link: int, c: Command, now_us: int) -> list[int]:
        """Obey; the results to acknowledge, in their order."""

    @abstractmethod
    def _set_mode(self, value: SetMode, now_us: int) -> int | None:
        """Take SET_MODE; the result to acknowledge, None for silence."""

    @abstractmethod
    def _heartbeat(self, now_us: int) -> Heartbeat:
        """What HEARTBEAT says now."""

    # -- what comes in -------------------------------------------------------------------------------------------------

    def handle(self, link: int, system: int, component: int, value: Value | None, now_us: int) -> None:
        """Take one message that (system, component) sent on `link`; what it does not act on changes nothing."""
        match value:
            case AttitudeTarget():
                if value.system == self.system_id:  # never system 0: n vehicles would all obey
                    self._setpoint(value, now_us)
            case Command():
                if self._addressed(value):
                    for result in self._command(link, value, now_us):
                        self._reply(link, CommandAck(value.command, result, system, component))
            case SetMode():
                if value.system == self.system_id:
                    answer = self._set_mode(value, now_us)
                    if answer is not None:
                        self._reply(link, CommandAck(M.MAV_CMD_DO_SET_MODE, answer, system, component))
            case Heartbeat():
                if value.type == GROUND_STATION:
                    self._ground_heard(system, now_us)
            case Timesync():
                if value.tc1 == 0:
                    self._reply(link, Timesync(now_us * 1000, value.ts1))
            case Ping():
                if (value.system, value.component) == (0, 0):
                    self._reply(link, Ping(value.time_us, value.seq, system, component))
            case PositionTarget():
                if value.system == self.system_id and value.component in (0, 1):
                    self._position_setpoint(value, now_us)
            case (
                ParamRequestRead() | ParamRequestList() | ParamSet() | MissionRequestList() | MissionCount()
                | MissionClear() | FileRequest() | DataStream()
            ) if self._mine(value):  # fmt: skip
                self._service(link, system, component, value)
            case _:
                pass

    def _mine(self, value: Addressed) -> bool:
        return value.system in (0, self.system_id) and value.component in (0, 1)

    def _service(self, link: int, system: int, component: int, value: Addressed) -> None:
        match value:
            case ParamRequestRead():
                if answer := self.parameters.read(value):
                    self._reply(link, answer)
            case ParamRequestList():
                self._param_queue = [entry for entry in self._param_queue if entry[0] != link]
                self._param_queue += [(link, index) for index in range(len(self.parameters))]
            case ParamSet():
                if answer := self.parameters.write(value):
                    self._reply(link, answer)
            case MissionRequestList():
                self._reply(link, MissionCount(system, component, 0, value.type))
            case MissionCount():
                self._reply(link, MissionAck(system, component, MISSION_UNSUPPORTED, value.type))
            case MissionClear():
                self._reply(link, MissionAck(system, component, 0, value.type))
            case FileRequest():
                refusal = FileRefusal(system, component, value.seq + 1, value.session, value.opcode, FTP_FILE_NOT_FOUND)
                self._reply(link, refusal)
            case DataStream():
                self._data_stream(link, value)
            case _:
                pass

    def _data_stream(self, link: int, value: DataStream) -> None:
        """REQUEST_DATA_STREAM, where a persona obeys it."""
        del link, value

    def _ground_heard(self, system: int, now_us: int) -> None:
        del system
        self._ground_heard_us = now_us

    def _request(self, link: int, command: int, msgid: int, unknown: int) -> int:
        """Commands that only ask for a message: the result, `unknown` for a message that this vehicle does not have."""
        match command:
            case M.MAV_CMD_GET_MESSAGE_INTERVAL if not 0 <= msgid <= MOST_MSGID:
                return unknown
            case M.MAV_CMD_GET_MESSAGE_INTERVAL:
                asked = msgid
                interval = packed(M.MAVLink_message_interval_message, asked, self.streams[link].interval_us(asked))
                self._outbox.append(Outgoing(link, interval))
            case M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                self._reply(link, ServerVersion(self.capabilities, self.version, self.system_id))
            case M.MAV_CMD_GET_HOME_POSITION:
                self._asked_for.append((link, M.MAVLINK_MSG_ID_HOME_POSITION))
            case M.MAV_CMD_REQUEST_MESSAGE if msgid == M.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                self._reply(link, ServerVersion(self.capabilities, self.version, self.system_id))
            case M.MAV_CMD_REQUEST_MESSAGE if msgid in BUILD:
                self._asked_for.append((link, msgid))
            case M.MAV_CMD_REQUEST_MESSAGE:
                return unknown
            case M.MAV_CMD_DO_GRIPPER:
                self.hook_open = True  # GRIPPER_ACTION_RELEASE; once let go a cable stays off
            case _:
                return UNSUPPORTED
        return ACCEPTED

    # -- what goes out -------------------------------------------------------------------------------------------------

    def set_landed(self, landed: int) -> None:
        """What the land detector says; a change is sent at once on every link that streams it."""
        if landed != self.landed:
            self.landed, self._landed_at_us = landed, self._now_us
            self._land_detected()
            for link, streams in enumerate(self.streams):
                if streams.interval_us(EXTENDED_SYS_STATE) > 0:
                    self._asked_for.append((link, EXTENDED_SYS_STATE))

    def _land_detected(self) -> None:
        """What a persona says of it."""
        return

    def snapshot(
        self, boot_us: int, R: Array, Omega: Array, x: Array, v: Array, specific_force: Array, home: Home
    ) -> Snapshot:
        """What the vehicle knows of itself, where it is and moves like this; see Snapshot."""
        self._origin = home
        return Snapshot(
            boot_us, R, Omega, x, v, specific_force, self._throttle, self.armed, self.landed, self._commanded, home,
            self._home,
        )  # fmt: skip

    def will_tell(self, msgid: int, now_us: int) -> bool:
        """Whether a message of this kind goes out at this tick, as things stand."""
        for streams in self.streams:
            if streams.is_due(msgid, now_us):
                return True
        return bool(self._asked_for) and any(asked == msgid for _, asked in self._asked_for)

    def outgoing(self, s: Snapshot, audible: tuple[bool, ...]) -> list[Outgoing]:
        """What to send at this tick, but for the attitude quaternion, which closes it on the links in `closing`.

        Links that are not `audible` (nobody there yet) get no streams.
        """
        now_us = s.boot_us
        out = self._outbox + [Outgoing(link, BUILD[msgid](s)) for link, msgid in self._asked_for]
        self._outbox, self._asked_for = [], []
        if now_us >= self._next_heartbeat_us:
            self._next_heartbeat_us += HEARTBEAT_US * (1 + (now_us - self._next_heartbeat_us) // HEARTBEAT_US)
            out.append(Outgoing(None, encode(self._heartbeat(now_us))))
        if self._param_queue:
            for link, index in self._param_queue[:PARAMS_PER_TICK]:
                out.append(Outgoing(link, encode(self.parameters.report(index))))
            del self._param_queue[:PARAMS_PER_TICK]
        built: dict[int, Packed] = {}
        self.closing = []
        for link, streams in enumerate(self.streams):
            if not audible[link]:
                continue
            for msgid in streams.due(now_us):
                if msgid == ATTITUDE_QUATERNION:
                    self.closing.append(link)
                elif msgid == M.MAVLINK_MSG_ID_TIMESYNC:
                    out.append(Outgoing(link, encode(self._timesync(now_us))))
                else:
                    if msgid not in built:
                        built[msgid] = BUILD[msgid](s)
                    out.append(Outgoing(link, built[msgid]))
        return out

    def _timesync(self, now_us: int) -> Timesync:
        """The question this vehicle asks of others."""
        return Timesync(0, now_us * 1000)

    def _reply(self, link: int, value: Any) -> None:
        self._outbox.append(Outgoing(link, encode(value)))

    def _say(self, row: Row[Any]) -> None:
        if row.text:
            self._text(row.severity, row.text)

    def _text(self, severity: int, text: str) -> None:
        self._texts_said = self._texts_said % 65535 + 1
        for part in text_frames(StatusText(severity, text), self._texts_said):
            self._outbox.append(Outgoing(None, encode(part)))

    def _warn(self, text: str) -> None:
        """Say something dangerous once."""
        if text != self._warned:
            self._warned = text
            self._text(CRITICAL, text)

    # -- what it does by itself ----------------------------------------------------------------------------------------

    def _set_armed(self, arm: bool, now_us: int) -> None:
        if arm != self.armed:
            self.armed, self._armed_at_us, self._warned = arm, now_us, ""
            self.navigator.end()
            if arm:
                self._home = self._at.copy()

    def _disarm_by_itself(self, text: str) -> None:
        self._set_armed(False, self._now_us)
        self._text(INFO, text)

    def _act(self, act: Actuation, shown_thrust: float) -> Actuation:
        """Remember what ATTITUDE_TARGET and the servo outputs will show."""
        self._throttle = act.throttle
        self._commanded = (act.R_c, act.Omega_c, shown_thrust)
        return act

    def _place(self, c: Command) -> Array | None:
        """(3,) m, W: the place in a command's parameters 5 to 7, NaN for where it is; None for none on earth."""
        lat, lon, altitude = c.params[4:]
        x = self._at.copy()
        if c.frame is not None and c.frame not in GLOBAL_FRAMES:
            return None
        if math.isfinite(lat) and math.isfinite(lon):
            if abs(lat) > 90.0 or abs(lon) > 180.0:
                return None
            x[:2] = local(self._origin, lat, lon, 0.0)[:2]
        if math.isfinite(altitude):
            above_home = c.frame in RELATIVE_FRAMES
            x[2] = self._home[2] - altitude if above_home else self._origin.altitude_m - altitude
        return x if float(np.abs(x).max()) < FAR_M else None

    def _thrust_now_N(self) -> float:
        return self.body.max_thrust_N * self._throttle**2

    def _motor_command_of(self, thrust_N: float) -> float:
        return math.sqrt(min(max(thrust_N / self.body.max_thrust_N, 0.0), 1.0))

    def _go(self, s: Snapshot, goal: Goal | None) -> Actuation:
        """Fly to `goal` by the vehicle's own position loop, or stay where it began."""
        if not self.navigator.active:
            self._begin(s)
        if goal is not None:
            self.navigator.goal = goal
        force = self.navigator.force(s)
        thrust_N = float(np.linalg.norm(force))
        R_c = attitude(s, force, self.navigator.yaw(s))
        return Actuation(R_c, NO_RATE, self._motor_command_of(thrust_N), False)

    def _begin(self, s: Snapshot) -> None:
        self.navigator.begin(s, 0.0 if self.landed == ON_GROUND else self._thrust_now_N(), self._sinks_m_s2)

    def _down(self, speed: float) -> Goal:
        """Straight down until something stops it."""
        here = self.navigator.goal.x if self.navigator.active else self._at
        return Goal(np.array([here[0], here[1], FAR_M]), speed)

    def _homewards(self, s: Snapshot, altitude_m: float, speed: float, land_speed: float) -> Goal:
        """Return: up to the altitude where it is lower, over to home, down."""
        over = math.hypot(s.x[0] - self._home[0], s.x[1] - self._home[1])
        if over < 0.5:
            return Goal(np.array([self._home[0], self._home[1], FAR_M]), land_speed)
        height = min(float(s.x[2]), float(self._home[2]) - altitude_m)
        if self.navigator.active and self.navigator.goal.x[2] < FAR_M:
            height = min(height, float(self.navigator.goal.x[2])) if over > 0.5 else height
        if float(s.x[2]) > height + 0.5:
            return Goal(np.array([s.x[0], s.x[1], height]), speed)
        return Goal(np.array([self._home[0], self._home[1], height]), speed)

    def _note(self, s: Snapshot) -> None:
        """Keep track of where it is and how it accelerates downwards."""
        dt = (s.boot_us - self._noted_us) * 1e-6
        if 0 < dt < 0.1:
            self._sinks_m_s2 = (float(s.v[2]) - self._v_down) / dt
        self._at, self._R, self._v_down, self._noted_us = s.x, s.R, float(s.v[2]), s.boot_us
