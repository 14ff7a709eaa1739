"""`encode(value)` and `decode(message)`: one function each way per message, side by side."""

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from bridge.wire.dialect import CABLE_STATE, Message, mavlink
from bridge.wire.values import (
    AttitudeTarget,
    CableShape,
    Command,
    CommandAck,
    Heartbeat,
    LandedState,
    MissionCount,
    MissionRequestList,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    PayloadState,
    Ping,
    ServerVersion,
    SetMode,
    StatusText,
    Timesync,
    VehicleAttitude,
    VehiclePosition,
)
from cablequad import lie

LINKS_PER_FRAME = 10
TEXT_BYTES = 50
ATTITUDE_AND_THRUST = 7  # type mask: body rates ignored

_NAN_COVARIANCE = [math.nan] + [0.0] * 20


class WireError(ValueError):
    """A value that may not go on the wire."""


def attitude_target(boot_ms: int, system: int, R_c: Any, thrust: float) -> AttitudeTarget:
    """The one setpoint our bridge sends: type mask 7, unit quaternion, component 1. Raises WireError if not finite."""
    quat = lie.quat_from_rotation(R_c)
    if not (math.isfinite(thrust) and np.all(np.isfinite(quat))):
        raise WireError(f"vehicle {system}: non-finite setpoint (thrust {thrust}, quaternion {quat.tolist()})")
    w, x, y, z = quat.tolist()
    return AttitudeTarget(boot_ms, system, 1, ATTITUDE_AND_THRUST, (w, x, y, z), (0.0, 0.0, 0.0), thrust)


def cable_frames(shape: CableShape) -> list[CableShape]:
    """The whole cable in as many values as it takes at ten links a message."""
    return [
        shape._replace(
            first_link=k,
            q=shape.q[k : k + LINKS_PER_FRAME],
            omega=shape.omega[k : k + LINKS_PER_FRAME],
        )
        for k in range(0, shape.n_links, LINKS_PER_FRAME)
    ]


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


def _heartbeat(v: Heartbeat) -> Message:
    return mavlink.MAVLink_heartbeat_message(v.type, v.autopilot, v.base_mode, v.custom_mode, v.system_status, 3)


def _read_heartbeat(m: Message) -> Heartbeat:
    return Heartbeat(m.type, m.autopilot, m.base_mode, m.custom_mode, m.system_status)


def _attitude(v: VehicleAttitude) -> Message:
    w, x, y, z = lie.quat_from_rotation(v.R).tolist()
    p, q, r = v.Omega.tolist()
    return mavlink.MAVLink_attitude_quaternion_message(v.boot_ms, w, x, y, z, p, q, r)


def _read_attitude(m: Message) -> VehicleAttitude:
    R = lie.rotation_from_quat(np.array((m.q1, m.q2, m.q3, m.q4)))
    return VehicleAttitude(m.time_boot_ms, R, np.array((m.rollspeed, m.pitchspeed, m.yawspeed)))


def _position(v: VehiclePosition) -> Message:
    return mavlink.MAVLink_local_position_ned_message(v.boot_ms, *v.x.tolist(), *v.v.tolist())


def _read_position(m: Message) -> VehiclePosition:
    return VehiclePosition(m.time_boot_ms, np.array((m.x, m.y, m.z)), np.array((m.vx, m.vy, m.vz)))


def _payload(v: PayloadState) -> Message:
    quat = lie.quat_from_rotation(v.R0).tolist()
    body = (v.R0.T @ v.v0).tolist()
    return mavlink.MAVLink_odometry_message(
        v.boot_us,
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_BODY_NED,
        *v.x0.tolist(),
        quat,
        *body,
        *v.Omega0.tolist(),
        _NAN_COVARIANCE,
        _NAN_COVARIANCE,
        0,
        mavlink.MAV_ESTIMATOR_TYPE_MOCAP,
        100,
    )


def _read_payload(m: Message) -> PayloadState | None:
    if m.frame_id != mavlink.MAV_FRAME_LOCAL_NED:
        return None
    R0 = lie.rotation_from_quat(np.array(m.q, dtype=float))
    return PayloadState(
        m.time_usec,
        np.array((m.x, m.y, m.z)),
        R0 @ np.array((m.vx, m.vy, m.vz)),
        R0,
        np.array((m.rollspeed, m.pitchspeed, m.yawspeed)),
    )


def _cable(v: CableShape) -> Message:
    links = np.concatenate([v.q, v.omega], axis=1).ravel().tolist()
    links += [0.0] * (6 * LINKS_PER_FRAME - len(links))
    return CABLE_STATE(v.boot_us, v.tension_N, v.cable, v.n_links, v.first_link, links)


def _read_cable(m: Message) -> CableShape:
    k = max(0, min(LINKS_PER_FRAME, m.n_links - m.first_link))
    links = np.array(m.links, dtype=float)[: 6 * k].reshape(k, 6)
    return CableShape(m.time_usec, m.cable_id, m.n_links, m.first_link, m.tension, links[:, :3], links[:, 3:])


def _target(v: AttitudeTarget) -> Message:
    return mavlink.MAVLink_set_attitude_target_message(
        v.boot_ms, v.system, v.component, v.type_mask, v.quat_wxyz, *v.rates, v.thrust
    )


def _read_target(m: Message) -> AttitudeTarget:
    w, x, y, z = m.q
    rates = (m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate)
    return AttitudeTarget(
        m.time_boot_ms, m.target_system, m.target_component, m.type_mask, (w, x, y, z), rates, m.thrust
    )


def _command(v: Command) -> Message:
    return mavlink.MAVLink_command_long_message(v.system, v.component, v.command, v.confirmation, *v.params)


def _read_command(m: Message) -> Command:
    params = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
    return Command(m.target_system, m.target_component, m.command, params, m.confirmation)


def _ack(v: CommandAck) -> Message:
    return mavlink.MAVLink_command_ack_message(v.command, v.result, 0, 0, v.system, v.component)


def _read_ack(m: Message) -> CommandAck:
    return CommandAck(m.command, m.result, m.target_system, m.target_component)


def _set_mode(v: SetMode) -> Message:
    return mavlink.MAVLink_set_mode_message(v.system, v.base_mode, v.custom_mode)


def _read_set_mode(m: Message) -> SetMode:
    return SetMode(m.target_system, m.base_mode, m.custom_mode)


def _param_read(v: ParamRequestRead) -> Message:
    return mavlink.MAVLink_param_request_read_message(v.system, v.component, v.name.encode(), v.number)


def _read_param_read(m: Message) -> ParamRequestRead:
    return ParamRequestRead(m.target_system, m.target_component, _name(m.param_id), m.param_index)


def _param_list(v: ParamRequestList) -> Message:
    return mavlink.MAVLink_param_request_list_message(v.system, v.component)


def _read_param_list(m: Message) -> ParamRequestList:
    return ParamRequestList(m.target_system, m.target_component)


def _param_set(v: ParamSet) -> Message:
    return mavlink.MAVLink_param_set_message(v.system, v.component, v.name.encode(), v.value, v.type)


def _read_param_set(m: Message) -> ParamSet:
    return ParamSet(m.target_system, m.target_component, _name(m.param_id), m.param_value, m.param_type)


def _param_value(v: ParamValue) -> Message:
    return mavlink.MAVLink_param_value_message(v.name.encode(), v.value, v.type, v.total, v.number)


def _read_param_value(m: Message) -> ParamValue:
    return ParamValue(_name(m.param_id), m.param_value, m.param_type, m.param_count, m.param_index)


def _name(field: str | bytes) -> str:
    text = field.decode("ascii", "replace") if isinstance(field, bytes) else field
    return text.split("\0", 1)[0]


def _timesync(v: Timesync) -> Message:
    return mavlink.MAVLink_timesync_message(v.tc1, v.ts1)


def _read_timesync(m: Message) -> Timesync:
    return Timesync(m.tc1, m.ts1)


def _ping(v: Ping) -> Message:
    return mavlink.MAVLink_ping_message(v.time_us, v.seq, v.system, v.component)


def _read_ping(m: Message) -> Ping:
    return Ping(m.time_usec, m.seq, m.target_system, m.target_component)


def _statustext(v: StatusText) -> Message:
    return mavlink.MAVLink_statustext_message(v.severity, v.text.encode()[:TEXT_BYTES], v.id, v.chunk)


def _read_statustext(m: Message) -> StatusText:
    return StatusText(m.severity, _name(m.text), m.id, m.chunk_seq)


def _landed(v: LandedState) -> Message:
    return mavlink.MAVLink_extended_sys_state_message(0, v.landed)


def _read_landed(m: Message) -> LandedState:
    return LandedState(m.landed_state)


def _mission_list(v: MissionRequestList) -> Message:
    return mavlink.MAVLink_mission_request_list_message(v.system, v.component)


def _read_mission_list(m: Message) -> MissionRequestList:
    return MissionRequestList(m.target_system, m.target_component)


def _mission_count(v: MissionCount) -> Message:
    return mavlink.MAVLink_mission_count_message(v.system, v.component, v.total)


def _read_mission_count(m: Message) -> MissionCount:
    return MissionCount(m.target_system, m.target_component, m.count)


def _version(v: ServerVersion) -> Message:
    major, minor, patch = v.version
    flight = major << 24 | minor << 16 | patch << 8 | 255
    zeros = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(v.capabilities, flight, 0, 0, 0, zeros, zeros, zeros, 0, 0, v.uid)


def _read_version(m: Message) -> ServerVersion:
    v = m.flight_sw_version
    return ServerVersion(m.capabilities, (v >> 24 & 255, v >> 16 & 255, v >> 8 & 255), m.uid)


_PAIRS: list[tuple[type, int, Callable[[Any], Message], Callable[[Message], Any]]] = [
    (Heartbeat, mavlink.MAVLINK_MSG_ID_HEARTBEAT, _heartbeat, _read_heartbeat),
    (VehicleAttitude, mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, _attitude, _read_attitude),
    (VehiclePosition, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, _position, _read_position),
    (PayloadState, mavlink.MAVLINK_MSG_ID_ODOMETRY, _payload, _read_payload),
    (CableShape, CABLE_STATE.id, _cable, _read_cable),
    (AttitudeTarget, mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, _target, _read_target),
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
    (MissionRequestList, mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST, _mission_list, _read_mission_list),
    (MissionCount, mavlink.MAVLINK_MSG_ID_MISSION_COUNT, _mission_count, _read_mission_count),
    (ServerVersion, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, _version, _read_version),
]
_ENCODE = {kind: write for kind, _, write, _ in _PAIRS}
_DECODE = {number: read for _, number, _, read in _PAIRS}
READABLE = frozenset(_DECODE)


def encode(value: object) -> Message:
    """The MAVLink message of a value of `bridge.wire.values`. Raises KeyError for anything else."""
    return _ENCODE[type(value)](value)


def decode(message: Message) -> Any:
    """The value of a received message, or None for a kind that nobody here reads."""
    read = _DECODE.get(message.get_msgId())
    return None if read is None else read(message)
