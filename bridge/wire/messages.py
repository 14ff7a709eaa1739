"""`encode(value)` and `decode(message)`: one function each way per message, side by side."""

import math
import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from bridge.wire.dialect import CABLE_STATE, Kind, mavlink
from bridge.wire.frames import Packed, fields, frame, pack, packed, payload_of, whole_payload
from bridge.wire.values import (
    AttitudeTarget,
    BatteryStatus,
    CableShape,
    Command,
    CommandAck,
    DataStream,
    FileRefusal,
    FileRequest,
    GpsFix,
    Heartbeat,
    Imu,
    LandedState,
    MissionAck,
    MissionClear,
    MissionCount,
    MissionRequestList,
    Origin,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    PayloadState,
    Ping,
    PositionTarget,
    ServerVersion,
    SetMode,
    StatusText,
    Timesync,
    Value,
    VehicleAttitude,
    VehiclePosition,
)
from cablequad.model import lie
from cablequad.types import Array

TEXT_BYTES = 50
LINKS_PER_FRAME = 10  # of CABLE_STATE
NO_ATTITUDE = 1e-6  # q.q of a quaternion that says nothing

_NO_COVARIANCES = 2 * struct.pack("<21f", math.nan, *[0.0] * 20)
_ODOMETRY_POSE = struct.Struct("<Q13f")  # before them
_ATTITUDE = mavlink.MAVLink_attitude_quaternion_message
_POSITION = mavlink.MAVLink_local_position_ned_message
_ODOMETRY = mavlink.MAVLink_odometry_message
_TARGET = mavlink.MAVLink_set_attitude_target_message
_IMU = mavlink.MAVLink_highres_imu_message
_FLOAT: Any = np.dtype("<f4")
_SEVEN = struct.Struct("<7f")
_CABLE_HEAD = struct.Struct("<QfBBB")  # before the links
_ODOMETRY_FRAME = struct.calcsize("<Q55f")  # where its frame_id stands, behind the numbers


def text_frames(said: StatusText, id: int) -> list[StatusText]:
    """The whole text in as many values as it takes; `id` (above 0) ties the chunks together."""
    if len(said.text.encode()) <= TEXT_BYTES:
        return [said]
    parts = [said.text[k : k + TEXT_BYTES] for k in range(0, len(said.text), TEXT_BYTES)]
    if len(parts[-1]) == TEXT_BYTES:
        parts.append("")  # only a chunk that is not full ends a text
    return [StatusText(said.severity, part, id, k) for k, part in enumerate(parts)]


def param_bits(value: int) -> float:
    """An INT32 parameter as PX4 puts it on the wire: its bits, read as a float."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def param_int(value: float) -> int:
    """The INT32 whose bits stand in `value`."""
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


def _heartbeat(v: Heartbeat) -> Packed:
    return packed(
        mavlink.MAVLink_heartbeat_message, v.type, v.autopilot, v.base_mode, v.custom_mode, v.system_status, 3
    )


def _read_heartbeat(m: Any) -> Heartbeat:
    return Heartbeat(m.type, m.autopilot, m.base_mode, m.custom_mode, m.system_status)


def attitude(boot_ms: int, quat_wxyz: Sequence[float], rates: Sequence[float]) -> Packed:
    """ATTITUDE_QUATERNION, quaternion B -> W and body rates in rad/s."""
    return pack(_ATTITUDE, boot_ms, *quat_wxyz, *rates, 0.0, 0.0, 0.0, 0.0)


def _attitude(v: VehicleAttitude) -> Packed:
    numbers = v.frame.tolist()
    return attitude(v.boot_ms, numbers[:4], numbers[4:])


def _finite(numbers: Iterable[float]) -> None:
    """Raise ValueError where a measurement is none: nothing can be made of a NaN."""
    if not math.isfinite(sum(numbers)):
        raise ValueError("not finite")


def _turns(w: float, x: float, y: float, z: float) -> None:
    """Raise ValueError for a quaternion that is no attitude."""
    if w * w + x * x + y * y + z * z < NO_ATTITUDE:
        raise ValueError("a quaternion of length 0")


def _read_attitude(p: bytes) -> VehicleAttitude:
    w, x, y, z, *rates = _SEVEN.unpack_from(p, 4)
    _finite((w, x, y, z, *rates))
    _turns(w, x, y, z)
    return VehicleAttitude(_whole(p, 4), np.frombuffer(p, _FLOAT, 7, 4))


def _position(v: VehiclePosition) -> Packed:
    return pack(_POSITION, v.boot_ms, *v.x.tolist(), *v.v.tolist())


def _read_position(p: bytes) -> VehiclePosition:
    a = _floats(p, 4, 6)
    _finite(a.tolist())
    return VehiclePosition(_whole(p, 4), a[:3], a[3:])


def odometry(boot_us: int, x: Array, v: Array, R: Array, Omega: Array, child: int, estimator: int) -> Packed:
    """ODOMETRY of a body: v is in the world frame, as everywhere here; on the wire it is in the body's."""
    pose = _ODOMETRY_POSE.pack(boot_us, *x.tolist(), *lie.wxyz_from_rotation(R), *(v @ R).tolist(), *Omega.tolist())
    rest = bytes((mavlink.MAV_FRAME_LOCAL_NED, child, 0, estimator, 100))
    return Packed(_ODOMETRY.id, _ODOMETRY.msgname, _ODOMETRY.crc_extra, pose + _NO_COVARIANCES + rest)


def _payload(v: PayloadState) -> Packed:
    child, estimator = mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_ESTIMATOR_TYPE_MOCAP
    return odometry(v.boot_us, v.x0, v.v0, v.R0, v.Omega0, child, estimator)


def _read_payload(p: bytes) -> PayloadState | None:
    if p[_ODOMETRY_FRAME] != mavlink.MAV_FRAME_LOCAL_NED:
        return None
    a = _floats(p, 8, 13)
    _finite(a.tolist())
    _turns(*a[3:7].tolist())
    R0 = lie.rotation_from_quat(a[3:7])
    return PayloadState(_whole(p, 8), a[:3], R0 @ a[7:10], R0, a[10:])


def _cable(v: CableShape) -> Packed:
    head = _CABLE_HEAD.pack(v.boot_us, v.tension_N, v.cable, v.n_links, v.first_link)
    links = v.links.astype(_FLOAT).tobytes()
    return Packed(CABLE_STATE.id, CABLE_STATE.msgname, CABLE_STATE.crc_extra, (head + links).rstrip(b"\0"))


def _read_cable(p: bytes) -> CableShape:
    boot_us, tension, cable, n_links, first = _CABLE_HEAD.unpack_from(p)
    k = max(0, min(LINKS_PER_FRAME, n_links - first))
    links = np.frombuffer(p, _FLOAT, 6 * k, _CABLE_HEAD.size).reshape(k, 6)
    _finite((tension, *memoryview(p)[_CABLE_HEAD.size : _CABLE_HEAD.size + 24 * k].cast("f")))
    return CableShape(boot_us, cable, n_links, first, tension, links)


def _target(v: AttitudeTarget) -> Packed:
    return pack(_TARGET, v.boot_ms, *v.quat_wxyz, *v.rates, v.thrust, v.system, v.component, v.type_mask)


def _read_target(p: bytes) -> AttitudeTarget:
    f = _TARGET.unpacker.unpack(p)
    return AttitudeTarget(f[0], f[9], f[10], f[11], f[1:5], f[5:8], f[8])


def _floats(payload: bytes, at: int, count: int) -> Array:
    return np.frombuffer(payload, _FLOAT, count, at).astype(float)


def _whole(payload: bytes, size: int) -> int:
    return int.from_bytes(payload[:size], "little")


def _command(v: Command) -> Packed:
    return packed(mavlink.MAVLink_command_long_message, v.system, v.component, v.command, v.confirmation, *v.params)


def _read_command(m: Any) -> Command:
    params = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
    return Command(m.target_system, m.target_component, m.command, params, m.confirmation)


def _ack(v: CommandAck) -> Packed:
    return packed(mavlink.MAVLink_command_ack_message, v.command, v.result, 0, 0, v.system, v.component)


def _read_ack(m: Any) -> CommandAck:
    return CommandAck(m.command, m.result, m.target_system, m.target_component)


def _set_mode(v: SetMode) -> Packed:
    return packed(mavlink.MAVLink_set_mode_message, v.system, v.base_mode, v.custom_mode)


def _read_set_mode(m: Any) -> SetMode:
    return SetMode(m.target_system, m.base_mode, m.custom_mode)


def _param_read(v: ParamRequestRead) -> Packed:
    return packed(mavlink.MAVLink_param_request_read_message, v.system, v.component, v.name.encode(), v.number)


def _read_param_read(m: Any) -> ParamRequestRead:
    return ParamRequestRead(m.target_system, m.target_component, _name(m.param_id), m.param_index)


def _param_list(v: ParamRequestList) -> Packed:
    return packed(mavlink.MAVLink_param_request_list_message, v.system, v.component)


def _read_param_list(m: Any) -> ParamRequestList:
    return ParamRequestList(m.target_system, m.target_component)


def _param_set(v: ParamSet) -> Packed:
    return packed(mavlink.MAVLink_param_set_message, v.system, v.component, v.name.encode(), v.value, v.type)


def _read_param_set(m: Any) -> ParamSet:
    return ParamSet(m.target_system, m.target_component, _name(m.param_id), m.param_value, m.param_type)


def _param_value(v: ParamValue) -> Packed:
    return packed(mavlink.MAVLink_param_value_message, v.name.encode(), v.value, v.type, v.total, v.number)


def _read_param_value(m: Any) -> ParamValue:
    return ParamValue(_name(m.param_id), m.param_value, m.param_type, m.param_count, m.param_index)


def _name(field: str | bytes) -> str:
    text = field.decode("ascii", "replace") if isinstance(field, bytes) else field
    return text.split("\0", 1)[0]


def _timesync(v: Timesync) -> Packed:
    return packed(mavlink.MAVLink_timesync_message, v.tc1, v.ts1)


def _read_timesync(m: Any) -> Timesync:
    return Timesync(m.tc1, m.ts1)


def _ping(v: Ping) -> Packed:
    return packed(mavlink.MAVLink_ping_message, v.time_us, v.seq, v.system, v.component)


def _read_ping(m: Any) -> Ping:
    return Ping(m.time_usec, m.seq, m.target_system, m.target_component)


def _statustext(v: StatusText) -> Packed:
    return packed(mavlink.MAVLink_statustext_message, v.severity, v.text.encode()[:TEXT_BYTES], v.id, v.chunk)


def _read_statustext(m: Any) -> StatusText:
    return StatusText(m.severity, _name(m.text), m.id, m.chunk_seq)


def _landed(v: LandedState) -> Packed:
    return packed(mavlink.MAVLink_extended_sys_state_message, 0, v.landed)


def _read_landed(m: Any) -> LandedState:
    return LandedState(m.landed_state)


def _origin(v: Origin) -> Packed:
    lat, lon = round(v.latitude_deg * 1e7), round(v.longitude_deg * 1e7)
    return packed(mavlink.MAVLink_gps_global_origin_message, lat, lon, round(v.altitude_m * 1e3))


def _read_origin(m: Any) -> Origin:
    return Origin(m.latitude * 1e-7, m.longitude * 1e-7, m.altitude * 1e-3)


def _read_battery(m: Any) -> BatteryStatus:
    return BatteryStatus(m.battery_remaining / 100)


def _read_fix(m: Any) -> GpsFix:
    return GpsFix(m.fix_type)


def _mission_list(v: MissionRequestList) -> Packed:
    return packed(mavlink.MAVLink_mission_request_list_message, v.system, v.component, v.type)


def _read_mission_list(m: Any) -> MissionRequestList:
    return MissionRequestList(m.target_system, m.target_component, m.mission_type)


def _mission_count(v: MissionCount) -> Packed:
    return packed(mavlink.MAVLink_mission_count_message, v.system, v.component, v.total, v.type)


def _read_mission_count(m: Any) -> MissionCount:
    return MissionCount(m.target_system, m.target_component, m.count, m.mission_type)


def _mission_clear(v: MissionClear) -> Packed:
    return packed(mavlink.MAVLink_mission_clear_all_message, v.system, v.component, v.type)


def _read_mission_clear(m: Any) -> MissionClear:
    return MissionClear(m.target_system, m.target_component, m.mission_type)


def _mission_ack(v: MissionAck) -> Packed:
    return packed(mavlink.MAVLink_mission_ack_message, v.system, v.component, v.result, v.type)


def _read_mission_ack(m: Any) -> MissionAck:
    return MissionAck(m.target_system, m.target_component, m.type, m.mission_type)


def _read_command_int(m: Any) -> Command:
    unit = 1e-7 if m.frame in GLOBAL_FRAMES else 1e-4
    x, y = (math.nan if place == _NO_PLACE else place * unit for place in (m.x, m.y))
    params = (m.param1, m.param2, m.param3, m.param4, x, y, m.z)
    return Command(m.target_system, m.target_component, m.command, params, 0, m.frame)


def _position_target(v: PositionTarget) -> Packed:
    return packed(
        mavlink.MAVLink_set_position_target_local_ned_message,
        *(v.boot_ms, v.system, v.component, v.frame, v.type_mask, *v.x, *v.v, *v.a, v.yaw, v.yaw_rate),
    )


def _read_position_target(m: Any) -> PositionTarget:
    return PositionTarget(
        m.time_boot_ms, m.target_system, m.target_component, m.coordinate_frame, m.type_mask, (m.x, m.y, m.z),
        (m.vx, m.vy, m.vz), (m.afx, m.afy, m.afz), m.yaw, m.yaw_rate,
    )  # fmt: skip


GLOBAL_FRAMES = frozenset({0, 3, 5, 6, 10, 11})  # MAV_FRAME_GLOBAL and its kin
_NO_PLACE = 2**31 - 1  # of a COMMAND_INT: not given
_NAK, _FTP_BYTES = 129, 251


def _file_refusal(v: FileRefusal) -> Packed:
    head = struct.pack("<HBBBBBBI", v.seq & 0xFFFF, v.session, _NAK, 1, v.refused_opcode, 0, 0, 0)
    payload = [*head, v.error]
    return packed(
        mavlink.MAVLink_file_transfer_protocol_message,
        0,
        v.system,
        v.component,
        payload + [0] * (_FTP_BYTES - len(payload)),
    )


def _read_file(m: Any) -> FileRequest:
    seq, session, opcode = struct.unpack("<HBB", bytes(m.payload[:4]))
    return FileRequest(m.target_system, m.target_component, seq, session, opcode)


def _data_stream(v: DataStream) -> Packed:
    return packed(mavlink.MAVLink_request_data_stream_message, v.system, v.component, v.stream, v.rate_hz, int(v.start))


def _read_data_stream(m: Any) -> DataStream:
    return DataStream(m.target_system, m.target_component, m.req_stream_id, m.req_message_rate, bool(m.start_stop))


def _read_imu(p: bytes) -> Imu:
    force = _floats(p, 8, 3)
    _finite(force.tolist())
    return Imu(_whole(p, 8), force)


def _version(v: ServerVersion) -> Packed:
    major, minor, patch = v.version
    flight = major << 24 | minor << 16 | patch << 8 | 255
    zeros = [0] * 8
    return packed(
        mavlink.MAVLink_autopilot_version_message, v.capabilities, flight, 0, 0, 0, zeros, zeros, zeros, 0, 0, v.uid
    )


def _read_version(m: Any) -> ServerVersion:
    v = m.flight_sw_version
    return ServerVersion(m.capabilities, (v >> 24 & 255, v >> 16 & 255, v >> 8 & 255), m.uid)


_PAIRS: list[tuple[type, int, Callable[[Any], Packed], Callable[[Any], Any]]] = [
    (Heartbeat, mavlink.MAVLINK_MSG_ID_HEARTBEAT, _heartbeat, _read_heartbeat),
    (Command, mavlink.MAVLINK_MSG_ID_COMMAND_LONG, _command, _read_command),
    (CommandAck, mavlink.MAVLINK_MSG_ID_COMMAND_ACK, _ack, _read_ack),
    (SetMode, mavlink.MAVLINK_MSG_ID_SET_MODE, _set_mode, _read_set_mode),
    (ParamRequestRead, mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ, _param_read, _read_param_read),
    (ParamRequestList, mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST, _param_list, _read_param_list),
    (ParamSet, mavlink.MAVLINK_MSG_ID_PARAM_SET, _param_set, _read_param_set),
    (ParamValue, mavlink.MAVLINK_MSG_ID_PARAM_VALUE, _param_value, _read_param_value),
    (Timesync, mavlink.MAVLINK_MSG_ID_TIMESYNC, _timesync, _read_timesync),
    (Ping, mavlink.MAVLINK_MSG_ID_PING, _ping, _read_ping),
    (StatusText, mavlink.MAVLINK_MSG_ID_STATUSTEXT, _statustext, _read_statustext),
    (LandedState, mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, _landed, _read_landed),
    (Origin, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, _origin, _read_origin),
    (MissionRequestList, mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST, _mission_list, _read_mission_list),
    (MissionCount, mavlink.MAVLINK_MSG_ID_MISSION_COUNT, _mission_count, _read_mission_count),
    (ServerVersion, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, _version, _read_version),
    (PositionTarget, mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, _position_target, _read_position_target),
]
_HOT: list[tuple[type, Kind, Callable[[Any], Packed], Callable[[bytes], Any]]] = [
    (VehicleAttitude, _ATTITUDE, _attitude, _read_attitude),
    (VehiclePosition, _POSITION, _position, _read_position),
    (PayloadState, _ODOMETRY, _payload, _read_payload),
    (CableShape, CABLE_STATE, _cable, _read_cable),
    (AttitudeTarget, _TARGET, _target, _read_target),
]  # many times a tick: read straight from their bytes; the others have their fields by name
_ENCODE: dict[type, Callable[[Any], Packed]] = {value: write for value, _, write, _ in _PAIRS}
_ENCODE |= {value: write for value, _, write, _ in _HOT}
_ENCODE |= {
    MissionAck: _mission_ack,
    MissionClear: _mission_clear,
    FileRefusal: _file_refusal,
    DataStream: _data_stream,
}
_BY_NAME: dict[int, Callable[[Any], Any]] = {number: read for _, number, _, read in _PAIRS}
_BY_NAME |= {
    mavlink.MAVLINK_MSG_ID_COMMAND_INT: _read_command_int,
    mavlink.MAVLINK_MSG_ID_MISSION_ACK: _read_mission_ack,
    mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: _read_mission_clear,
    mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _read_file,
    mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: _read_data_stream,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _read_battery,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _read_fix,
}  # one direction only, or not the same value in both
_AS_BYTES: dict[int, Callable[[bytes], Any]] = {
    kind.id: read for kind, read in [*((kind, read) for _, kind, _, read in _HOT), (_IMU, _read_imu)]
}


class Known(NamedTuple):
    """What a receiver needs of a kind of message."""

    name: str
    crc_extra: bytes
    read: Callable[[bytes], Any] | None  # the value in a whole payload; None for a kind that nobody here reads
    size: int  # bytes of a whole payload


def _reader(kind: Kind) -> Callable[[bytes], Any] | None:
    by_name = _BY_NAME.get(kind.id)
    if kind.id in _AS_BYTES or by_name is None:
        return _AS_BYTES.get(kind.id)
    return lambda payload: by_name(fields(kind, payload))


KINDS = {
    number: Known(kind.msgname, bytes((kind.crc_extra,)), _reader(kind), kind.unpacker.size)
    for number, kind in mavlink.mavlink_map.items()
}


def encode(value: object) -> Packed:
    """The MAVLink message of a value of `bridge.wire.values`. Raises KeyError for anything else."""
    return _ENCODE[type(value)](value)


def decode(msgid: int, whole: bytes) -> Value | None:
    """The value in a frame with a right checksum; None for a kind that nobody here reads, or fields without sense."""
    kind = KINDS.get(msgid)
    if kind is None or kind.read is None:
        return None
    try:
        return kind.read(whole_payload(payload_of(whole), kind.size))
    except (ValueError, ArithmeticError, struct.error):
        return None


def reread(message: Packed) -> Any:
    """What the other side makes of a message."""
    return decode(message.msgid, frame(message, 0, 1, 1))
