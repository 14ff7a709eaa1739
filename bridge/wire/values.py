"""What crosses the wire, in SI units, world NED, body FRD."""

from typing import NamedTuple

import numpy as np

from cablequad.model import lie
from cablequad.types import Array


class Heartbeat(NamedTuple):
    """HEARTBEAT (#0); fields as numbered by MAVLink."""

    type: int
    autopilot: int
    base_mode: int
    custom_mode: int
    system_status: int

    @property
    def armed(self) -> bool:
        """Whether the motors are armed."""
        return bool(self.base_mode & 128)


class VehicleAttitude(NamedTuple):
    """ATTITUDE_QUATERNION (#31), in the numbers that cross the wire; `of` makes one of arrays."""

    boot_ms: int
    frame: np.ndarray  # (7,): quaternion (w, x, y, z), B -> W, of any length; rad/s, B; as single as CableShape's links

    @classmethod
    def of(cls, boot_ms: int, R: Array, Omega: Array) -> "VehicleAttitude":
        """That of R (3, 3), B -> W, and Omega (3,) rad/s, B."""
        return cls(boot_ms, np.array([*lie.wxyz_from_rotation(R), *Omega.tolist()]))

    @property
    def R(self) -> Array:
        """(3, 3) B -> W."""
        return lie.rotation_from_wxyz(*self.frame[:4].tolist())

    @property
    def Omega(self) -> Array:
        """(3,) rad/s, B."""
        return self.frame[4:].astype(float)


class VehiclePosition(NamedTuple):
    """LOCAL_POSITION_NED (#32)."""

    boot_ms: int
    x: Array  # (3,) m, W
    v: Array  # (3,) m/s, W


class PayloadState(NamedTuple):
    """ODOMETRY (#331) of the payload tracker: frame LOCAL_NED, child frame BODY_NED, so twist in the payload frame."""

    boot_us: int
    x0: Array  # (3,) m, W
    v0: Array  # (3,) m/s, W
    R0: Array  # (3, 3) payload -> W
    Omega0: Array  # (3,) rad/s, payload frame


class CableShape(NamedTuple):
    """CABLE_STATE (#53100): some consecutive links of one cable."""

    boot_us: int
    cable: int  # 1..n
    n_links: int  # of the whole cable
    first_link: int  # from 0
    tension_N: float  # of the link at the payload
    links: np.ndarray  # (k, 6): unit, W, quadrotor -> payload; rad/s, W; of single precision where it came by wire

    @property
    def q(self) -> np.ndarray:
        """(k, 3) unit, W, quadrotor -> payload."""
        return self.links[:, :3]

    @property
    def omega(self) -> np.ndarray:
        """(k, 3) rad/s, W."""
        return self.links[:, 3:]


class AttitudeTarget(NamedTuple):
    """SET_ATTITUDE_TARGET (#82) as it stands on the wire: a vehicle judges it, so nothing is normalised here."""

    boot_ms: int  # time of the state it answers
    system: int
    component: int
    type_mask: int
    quat_wxyz: tuple[float, float, float, float]
    rates: tuple[float, float, float]  # rad/s
    thrust: float  # 0..1


class PositionTarget(NamedTuple):
    """SET_POSITION_TARGET_LOCAL_NED (#84) as it stands on the wire; a vehicle judges frame and type mask."""

    boot_ms: int
    system: int
    component: int
    frame: int  # MAV_FRAME
    type_mask: int  # POSITION_TARGET_TYPEMASK: what is to be ignored
    x: tuple[float, float, float]  # m
    v: tuple[float, float, float]  # m/s
    a: tuple[float, float, float]  # m/s^2
    yaw: float  # rad
    yaw_rate: float  # rad/s


class Command(NamedTuple):
    """COMMAND_LONG (#76), or COMMAND_INT (#75) with its integer place as degrees (NaN where it is left out)."""

    system: int
    component: int
    command: int
    params: tuple[float, float, float, float, float, float, float]
    confirmation: int = 0
    frame: int | None = None  # MAV_FRAME of a COMMAND_INT


class CommandAck(NamedTuple):
    """COMMAND_ACK (#77)."""

    command: int
    result: int
    system: int  # who asked
    component: int


class SetMode(NamedTuple):
    """SET_MODE (#11)."""

    system: int
    base_mode: int
    custom_mode: int


class ParamRequestRead(NamedTuple):
    """PARAM_REQUEST_READ (#20); number -1 asks by name."""

    system: int
    component: int
    name: str
    number: int = -1


class ParamRequestList(NamedTuple):
    """PARAM_REQUEST_LIST (#21)."""

    system: int
    component: int


class ParamSet(NamedTuple):
    """PARAM_SET (#23); `value` is the float as it stands on the wire."""

    system: int
    component: int
    name: str
    value: float
    type: int


class ParamValue(NamedTuple):
    """PARAM_VALUE (#22); `value` is the float as it stands on the wire."""

    name: str
    value: float
    type: int
    total: int
    number: int  # place in the list, from 0


class Timesync(NamedTuple):
    """TIMESYNC (#111), ns; tc1 = 0 asks."""

    tc1: int
    ts1: int


class Ping(NamedTuple):
    """PING (#4); system and component 0 ask."""

    time_us: int
    seq: int
    system: int
    component: int


class StatusText(NamedTuple):
    """STATUSTEXT (#253): one message holds 50 bytes; longer texts come in chunks that share an id above 0."""

    severity: int
    text: str
    id: int = 0
    chunk: int = 0


class LandedState(NamedTuple):
    """EXTENDED_SYS_STATE (#245): 1 on ground, 2 in air."""

    landed: int


class Origin(NamedTuple):
    """GPS_GLOBAL_ORIGIN (#49): where the origin of a system's local frame lies."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


class BatteryStatus(NamedTuple):
    """SYS_STATUS (#1), as far as it is used."""

    remaining: float  # 0 .. 1; below 0 where the vehicle does not know


class GpsFix(NamedTuple):
    """GPS_RAW_INT (#24), as far as it is used."""

    fix: int  # 3: 3D


class MissionRequestList(NamedTuple):
    """MISSION_REQUEST_LIST (#43)."""

    system: int
    component: int
    type: int = 0


class MissionCount(NamedTuple):
    """MISSION_COUNT (#44): the answer to a request of the list, or the offer of one."""

    system: int
    component: int
    total: int
    type: int = 0


class MissionClear(NamedTuple):
    """MISSION_CLEAR_ALL (#45)."""

    system: int
    component: int
    type: int = 0


class MissionAck(NamedTuple):
    """MISSION_ACK (#47)."""

    system: int
    component: int
    result: int
    type: int = 0


class FileRequest(NamedTuple):
    """FILE_TRANSFER_PROTOCOL (#110): what names a request."""

    system: int
    component: int
    seq: int
    session: int
    opcode: int


class FileRefusal(NamedTuple):
    """FILE_TRANSFER_PROTOCOL (#110): NAK of a request."""

    system: int
    component: int
    seq: int  # of the request, plus one
    session: int
    refused_opcode: int
    error: int


class DataStream(NamedTuple):
    """REQUEST_DATA_STREAM (#66)."""

    system: int
    component: int
    stream: int
    rate_hz: int
    start: bool


class Imu(NamedTuple):
    """HIGHRES_IMU (#105), as far as it is used."""

    boot_us: int
    specific_force: Array  # (3,) m/s^2, B


class ServerVersion(NamedTuple):
    """AUTOPILOT_VERSION (#148)."""

    capabilities: int
    version: tuple[int, int, int]
    uid: int


ON_GROUND, IN_AIR = 1, 2

Addressed = (
    AttitudeTarget
    | PositionTarget
    | Command
    | ParamRequestRead
    | ParamRequestList
    | ParamSet
    | MissionRequestList
    | MissionCount
    | MissionClear
    | FileRequest
    | DataStream
)
"""What asks one component of one system for something: `system` and `component` say which."""

Value = (
    Addressed
    | SetMode
    | Heartbeat
    | VehicleAttitude
    | VehiclePosition
    | PayloadState
    | CableShape
    | CommandAck
    | ParamValue
    | Timesync
    | Ping
    | StatusText
    | LandedState
    | Origin
    | BatteryStatus
    | GpsFix
    | MissionAck
    | FileRefusal
    | Imu
    | ServerVersion
)
"""Everything that a frame may be read as."""
