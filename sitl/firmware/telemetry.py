"""What a vehicle says of itself: one builder per streamed message, from one snapshot in SI units."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.frames import Packed, pack, packed
from bridge.wire.messages import attitude, encode, odometry
from bridge.wire.values import LandedState, Origin, VehiclePosition
from cablequad.model import lie
from cablequad.model.earth import FIELD_GAUSS, Home, altitude_m, geodetic, pressure_hPa
from cablequad.types import Array

_NO_FIELD = 65535


ORIGIN = np.zeros(3)


def origin(home: Home) -> Packed:
    """GPS_GLOBAL_ORIGIN: where local (0, 0, 0) lies."""
    return encode(Origin(home.latitude_deg, home.longitude_deg, home.altitude_m))


class Snapshot(NamedTuple):
    """Everything a vehicle knows of itself at one instant."""

    boot_us: int
    R: Array  # (3, 3) B -> W
    Omega: Array  # (3,) rad/s, B
    x: Array  # (3,) m, W
    v: Array  # (3,) m/s, W
    specific_force: Array  # (3,) m/s^2, B: what an accelerometer reads
    throttle: float  # 0..1, motor command
    armed: bool
    landed: int
    offboard_target: tuple[Array, Array, float]  # commanded R_c (3, 3), rates (3,) rad/s, thrust 0..1
    home: Home
    home_x: Array = ORIGIN  # (3,) m, W: where it was armed, and returns to
    battery: float = 1.0  # 0 .. 1: what is left
    gps_fix: int = 3  # GPS_FIX_TYPE
    fix: tuple[Array, Array] | None = None  # (3,) m and (3,) m/s, W, by the GPS receiver; None: it is right
    imu: tuple[Array, Array, Array, float] | None = None  # acceleration, rate, field, pressure; None: they are right

    @property
    def boot_ms(self) -> int:
        """Milliseconds since boot."""
        return self.boot_us // 1000


def euler(R: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw in rad (z-y-x)."""
    pitch = math.asin(max(-1.0, min(1.0, -float(R[2, 0]))))
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _geodetic(s: Snapshot, x: Array) -> tuple[int, int, int]:
    """Latitude and longitude in 1e-7 deg, altitude in mm."""
    lat, lon, altitude = geodetic(s.home, x)
    return round(lat * 1e7), round(lon * 1e7), round(altitude * 1e3)


def _height(s: Snapshot) -> float:
    """m above home."""
    return float(s.home_x[2] - s.x[2])


def _heading_cdeg(s: Snapshot) -> int:
    return round(math.degrees(euler(s.R)[2]) * 100) % 36000


def _attitude(s: Snapshot) -> Packed:
    return pack(mavlink.MAVLink_attitude_message, s.boot_ms, *euler(s.R), *s.Omega.tolist())


def _quaternion(s: Snapshot) -> Packed:
    return attitude(s.boot_ms, lie.wxyz_from_rotation(s.R), s.Omega.tolist())


def _local(s: Snapshot) -> Packed:
    return encode(VehiclePosition(s.boot_ms, s.x, s.v))


def _global(s: Snapshot) -> Packed:
    lat, lon, alt = _geodetic(s, s.x)
    cm_s = [max(-32768, min(32767, round(v * 100))) for v in s.v.tolist()]
    return pack(
        mavlink.MAVLink_global_position_int_message,
        *(s.boot_ms, lat, lon, alt, round(_height(s) * 1e3), *cm_s, _heading_cdeg(s)),
    )


def _imu(s: Snapshot) -> Packed:
    altitude = s.home.altitude_m - float(s.x[2])
    acceleration, rate, field, hPa = s.specific_force, s.Omega, s.R.T @ FIELD_GAUSS, pressure_hPa(altitude)
    if s.imu is not None:
        acceleration, rate, field, hPa = s.imu
        altitude = altitude_m(hPa)
    read = (*acceleration.tolist(), *rate.tolist(), *field.tolist(), hPa, 0.0, altitude, 25.0, 0x1BFF, 0)
    return pack(mavlink.MAVLink_highres_imu_message, s.boot_us, *read)


def _odometry(s: Snapshot) -> Packed:
    child, estimator = mavlink.MAV_FRAME_BODY_FRD, mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT
    return odometry(s.boot_us, s.x, s.v, s.R, s.Omega, child, estimator)


def _attitude_target(s: Snapshot) -> Packed:
    R_c, rates, thrust = s.offboard_target
    quat = lie.quat_from_rotation(R_c).tolist()
    return packed(mavlink.MAVLink_attitude_target_message, s.boot_ms, 0, quat, *rates.tolist(), abs(thrust))


def _servos(s: Snapshot) -> Packed:
    pwm = round(1000 + 1000 * s.throttle) if s.armed else 1000
    return packed(mavlink.MAVLink_servo_output_raw_message, s.boot_us & 0xFFFFFFFF, 0, pwm, pwm, pwm, pwm)


def _hud(s: Snapshot) -> Packed:
    up = s.home.altitude_m - float(s.x[2]), -float(s.v[2])
    ground_m_s, heading_deg = math.hypot(s.v[0], s.v[1]), _heading_cdeg(s) // 100
    return packed(mavlink.MAVLink_vfr_hud_message, 0.0, ground_m_s, heading_deg, round(100 * s.throttle), *up)


def _altitude(s: Snapshot) -> Packed:
    local = -float(s.x[2])
    amsl = s.home.altitude_m + local
    return packed(mavlink.MAVLink_altitude_message, s.boot_us, amsl, amsl, local, _height(s), math.nan, math.nan)


def _position_target(s: Snapshot) -> Packed:
    return packed(
        mavlink.MAVLink_position_target_local_ned_message, s.boot_ms, mavlink.MAV_FRAME_LOCAL_NED, 0, *[math.nan] * 11
    )


def _gps(s: Snapshot) -> Packed:
    x, v = (s.x, s.v) if s.fix is None else s.fix
    lat, lon, alt = _geodetic(s, x)
    speed = math.hypot(v[0], v[1])
    course = round(math.degrees(math.atan2(v[1], v[0])) * 100) % 36000 if speed > 0.1 else _NO_FIELD
    good = s.gps_fix >= 3
    eph, epv, seen = (70, 110, 12) if good else (_NO_FIELD, _NO_FIELD, 0)
    return packed(
        mavlink.MAVLink_gps_raw_int_message,
        *(s.boot_us, s.gps_fix, lat, lon, alt, eph, epv, round(speed * 100), course, seen),
    )


_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_GEOFENCE
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
)


def _sys_status(s: Snapshot) -> Packed:
    volts, left = _volts(s), round(100 * s.battery)
    seen = (_SENSORS, _SENSORS, _SENSORS)
    return packed(mavlink.MAVLink_sys_status_message, *seen, 150, round(4000 * volts), 100, left)


def _volts(s: Snapshot) -> float:
    """V of a lithium cell at rest, between 3.5 V empty and 4.05 V full."""
    return 3.5 + 0.55 * s.battery


def _landed(s: Snapshot) -> Packed:
    return encode(LandedState(s.landed))


def _system_time(s: Snapshot) -> Packed:
    return packed(mavlink.MAVLink_system_time_message, s.home.epoch_s * 10**6 + s.boot_us, s.boot_ms)


def _estimator(s: Snapshot) -> Packed:
    return packed(mavlink.MAVLink_estimator_status_message, s.boot_us, 831, 0.02, 0.02, 0.02, 0.02, 0.0, 0.0, 0.1, 0.1)


def _battery(s: Snapshot) -> Packed:
    cells = [round(1000 * _volts(s))] * 4 + [_NO_FIELD] * 6
    return packed(mavlink.MAVLink_battery_status_message, 0, 0, 1, 2500, cells, 100, 0, -1, round(100 * s.battery))


def _home(s: Snapshot) -> Packed:
    where = (*_geodetic(s, s.home_x), *s.home_x.tolist())
    return packed(mavlink.MAVLink_home_position_message, *where, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, s.boot_us)


BUILD: dict[int, Callable[[Snapshot], Packed]] = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _quaternion,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: _imu,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: _attitude_target,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _servos,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: _hud,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: _altitude,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _position_target,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _gps,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _landed,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _estimator,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: _battery,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _home,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: lambda s: origin(s.home),
}
