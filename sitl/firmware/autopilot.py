"""What both personas have in common: services, streams, texts. Messages in, messages out, on the vehicle's clock."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, ClassVar, NamedTuple

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.frames import packed
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
    Timesync,
    Value,
)
from cablequad.model.earth import Home
from cablequad.types import Array
from sitl.firmware.navigate import FAR_M, Goal, Navigator, attitude
from sitl.firmware.outbox import Outbox, Outgoing
from sitl.firmware.parameters import Parameters
from sitl.firmware.position import Position
from sitl.firmware.streams import Streams
from sitl.firmware.telemetry import BUILD, Snapshot
from sitl.firmware.transitions import ACCEPTED, INFO, UNSUPPORTED, Row

M = mavlink
HIGHRES_IMU = M.MAVLINK_MSG_ID_HIGHRES_IMU
EXTENDED_SYS_STATE = M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
MISSION_UNSUPPORTED = 3
FTP_FILE_NOT_FOUND = 10
GROUND_STATION = M.MAV_TYPE_GCS
SINK_M_S = 0.3  # a PX4 in position mode without a radio
MAX_RATE = 35.0  # rad/s: what a gyroscope can measure, 2000 deg/s; no rate loop asks for more
MOST_MSGID, MOST_INTERVAL_US = 65535, 2**31 - 1  # that MESSAGE_INTERVAL can tell
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


class Arming:
    """Whether a vehicle is armed and stands on the ground, and since when."""

    def __init__(self) -> None:
        self.armed, self.armed_at_us = False, 0
        self.landed, self.landed_at_us = ON_GROUND, 0


class Target:
    """The last setpoint."""

    def __init__(self) -> None:
        self.value: AttitudeTarget | Goal | None = None  # a Goal: places and velocities are asked for
        self.at_us = -(10**12)


class Breakage:
    """What a vehicle was told to break or to let go of."""

    def __init__(self) -> None:
        self.hook_open = False
        self.injected: list[tuple[str, int | None]] = []  # failures that were commanded: kind, rotor


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
        self.body = body
        self.parameters = parameters
        self.streams = [Streams(default_hz[kind], tick_us) for kind in links]
        self.out = Outbox(self.streams, parameters)
        self.navigator = Navigator(body.mass_kg, body.g, tick_us)
        self.arming = Arming()
        self.breakage = Breakage()
        self.failsafe = False
        self._position = Position()
        self._ready_us = ready_us
        self._now_us = 0
        self._target = Target()
        self._ground_heard_us: int | None = None
        self._shown: tuple[float, tuple[Array, Array, float]] = (0.0, (np.eye(3), np.zeros(3), 0.0))

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return self.arming.armed

    @property
    def landed(self) -> int:
        """MAV_LANDED_STATE."""
        return self.arming.landed

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
                self.out.list_parameters(link)
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
                self.out.put(link, interval)
            case M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                self._reply(link, ServerVersion(self.capabilities, self.version, self.system_id))
            case M.MAV_CMD_GET_HOME_POSITION:
                self.out.ask_for(link, M.MAVLINK_MSG_ID_HOME_POSITION)
            case M.MAV_CMD_REQUEST_MESSAGE if msgid == M.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                self._reply(link, ServerVersion(self.capabilities, self.version, self.system_id))
            case M.MAV_CMD_REQUEST_MESSAGE if msgid in BUILD:
                self.out.ask_for(link, msgid)
            case M.MAV_CMD_REQUEST_MESSAGE:
                return unknown
            case M.MAV_CMD_DO_GRIPPER:
                self.breakage.hook_open = True  # GRIPPER_ACTION_RELEASE; once let go a cable stays off
            case _:
                return UNSUPPORTED
        return ACCEPTED

    # -- what goes out -------------------------------------------------------------------------------------------------

    def set_landed(self, landed: int) -> None:
        """What the land detector says; a change is sent at once on every link that streams it."""
        if landed != self.landed:
            self.arming.landed, self.arming.landed_at_us = landed, self._now_us
            self._land_detected()
            for link, streams in enumerate(self.streams):
                if streams.interval_us(EXTENDED_SYS_STATE) > 0:
                    self.out.ask_for(link, EXTENDED_SYS_STATE)

    def _land_detected(self) -> None:
        """What a persona says of it."""
        return

    def snapshot(
        self, boot_us: int, R: Array, Omega: Array, x: Array, v: Array, specific_force: Array, home: Home
    ) -> Snapshot:
        """What the vehicle knows of itself, where it is and moves like this; see Snapshot."""
        self._position.origin = home
        throttle, commanded = self._shown
        return Snapshot(
            boot_us, R, Omega, x, v, specific_force, throttle, self.armed, self.landed, commanded, home,
            self._position.home,
        )  # fmt: skip

    def outgoing(self, s: Snapshot, audible: Sequence[bool]) -> list[Outgoing]:
        """What to send at this tick; see Outbox.take."""
        return self.out.take(s, audible, self._heartbeat, self._timesync)

    def _timesync(self, now_us: int) -> Timesync:
        """The question this vehicle asks of others."""
        return Timesync(0, now_us * 1000)

    def _reply(self, link: int, value: Any) -> None:
        self.out.reply(link, value)

    def _say(self, row: Row[Any]) -> None:
        if row.text:
            self._text(row.severity, row.text)

    def _text(self, severity: int, text: str) -> None:
        self.out.text(severity, text)

    def _warn(self, text: str) -> None:
        """Say something dangerous once."""
        self.out.warn(text)

    # -- what it does by itself ----------------------------------------------------------------------------------------

    def _set_armed(self, arm: bool, now_us: int) -> None:
        if arm != self.armed:
            self.arming.armed, self.arming.armed_at_us, self.out.warned = arm, now_us, ""
            self.navigator.end()
            if arm:
                self._position.set_home()

    def _disarm_by_itself(self, text: str) -> None:
        self._set_armed(False, self._now_us)
        self._text(INFO, text)

    def _act(self, act: Actuation, shown_thrust: float) -> Actuation:
        """Remember what ATTITUDE_TARGET and the servo outputs will show."""
        self._shown = (act.throttle, (act.R_c, act.Omega_c, shown_thrust))
        return act

    def _thrust_now_N(self) -> float:
        return self.body.max_thrust_N * self._shown[0] ** 2

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
        self.navigator.begin(s, 0.0 if self.landed == ON_GROUND else self._thrust_now_N(), self._position.sinks_m_s2)

    def _down(self, speed: float) -> Goal:
        """Straight down until something stops it."""
        here = self.navigator.goal.x if self.navigator.active else self._position.x
        return Goal(np.array([here[0], here[1], FAR_M]), speed)

    def _homewards(self, s: Snapshot, altitude_m: float, speed: float, land_speed: float) -> Goal:
        """Return: up to the altitude where it is lower, over to home, down."""
        over = math.hypot(s.x[0] - self._position.home[0], s.x[1] - self._position.home[1])
        if over < 0.5:
            return Goal(np.array([self._position.home[0], self._position.home[1], FAR_M]), land_speed)
        height = min(float(s.x[2]), float(self._position.home[2]) - altitude_m)
        if self.navigator.active and self.navigator.goal.x[2] < FAR_M:
            height = min(height, float(self.navigator.goal.x[2])) if over > 0.5 else height
        if float(s.x[2]) > height + 0.5:
            return Goal(np.array([s.x[0], s.x[1], height]), speed)
        return Goal(np.array([self._position.home[0], self._position.home[1], height]), speed)
