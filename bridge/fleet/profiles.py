"""What differs between autopilots, and what is asked of both: modes, parameters, streams."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from bridge.fleet.thrust import LinearShare, MotorCommand, ThrustLaw
from bridge.wire.dialect import mavlink


class Profile(NamedTuple):
    """What differs between autopilots."""

    name: str
    control: tuple[str, int, tuple[float, ...]]  # the mode that obeys setpoints: name, custom_mode, DO_SET_MODE
    hold: tuple[str, int, tuple[float, ...]]
    parameters: tuple[str, ...]  # that decide what a setpoint means
    bytewise: bool  # integer parameters come as raw bits
    arming_s: float  # that its estimator may need after boot, and some
    law: Callable[[float, Mapping[str, float], float], ThrustLaw]  # of its greatest thrust, N, where it flies, those
    # parameters and the air's density there to that at sea level
    streams: frozenset[int]  # messages that are asked for, or stopped, by SET_MESSAGE_INTERVAL


CONTROL_RATE = 0  # us: stands for the control period
STOP = -1
STREAMS_US = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: CONTROL_RATE,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 40_000,  # a check on the tracker, not in the loop
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: 20_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 100_000,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 100_000,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 200_000,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 200_000,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1_000_000,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 2_000_000,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 200_000,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1_000_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: STOP,  # ATTITUDE_QUATERNION says the same
    mavlink.MAVLINK_MSG_ID_ODOMETRY: STOP,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: STOP,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: STOP,
}
NEEDED_STREAMS = frozenset(
    {mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED}
)  # a vehicle that refuses one of these is not flown; of the others it may have its own mind

PROFILES = {
    mavlink.MAV_AUTOPILOT_PX4: Profile(
        "PX4",
        ("OFFBOARD", 6 << 16, (1.0, 6.0)),
        ("HOLD", 4 << 16 | 3 << 24, (1.0, 4.0, 3.0)),
        ("THR_MDL_FAC",),
        True,
        30.0,
        lambda limit_N, known, density: MotorCommand(limit_N, known.get("THR_MDL_FAC", 0.0)),
        frozenset(STREAMS_US),
    ),
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: Profile(
        "ArduCopter",
        ("GUIDED", 4, (1.0, 4.0)),
        ("BRAKE", 17, (1.0, 17.0)),
        ("GUID_OPTIONS", "ATC_ANGLE_BOOST"),
        False,
        60.0,
        lambda limit_N, known, density: LinearShare(limit_N / density, known.get("ATC_ANGLE_BOOST", 1.0) != 0.0),
        frozenset(msgid for msgid, interval in STREAMS_US.items() if interval != STOP),  # it streams nothing unasked
    ),
}
