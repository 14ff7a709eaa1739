"""MAVSDK against four vehicles: `python with_mavsdk.py PERSONA PORT_OFFSET`. Prints one line a step; raises what fails."""

import sys
import time
from collections.abc import Callable, Iterator
from functools import partial

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Attitude, Offboard, PositionNedYaw, VelocityNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

PERSONA, OFFSET = sys.argv[1], int(sys.argv[2])


def until(what: str, done: Callable[[], bool], seconds: float = 12.0) -> None:
    end = time.monotonic() + seconds
    while not done():
        if time.monotonic() > end:
            raise AssertionError(f"waited {seconds:.0f} s for: {what}")
        time.sleep(0.02)
    print(what, flush=True)


sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
for i in range(4):
    sdk.add_any_connection(f"udpin://127.0.0.1:{14540 + i + OFFSET}")


def autopilots() -> dict:
    return {s.get_system_id(): s for s in sdk.get_systems() if s.has_autopilot() and s.is_connected()}


until("four autopilots", lambda: set(autopilots()) == {1, 2, 3, 4})
two = autopilots()[2]
telemetry, action, param, offboard = Telemetry(two), Action(two), Param(two), Offboard(two)
telemetry.set_rate_attitude_euler(20.0)
telemetry.set_rate_attitude_quaternion(20.0)
telemetry.set_rate_position(10.0)
telemetry.set_rate_position_velocity_ned(20.0)
telemetry.set_rate_in_air(10.0)
before = telemetry.attitude_quaternion().timestamp_us
until("telemetry changes", lambda: telemetry.attitude_quaternion().timestamp_us > before > 0 or not before)


def paced(times: int) -> Iterator[None]:
    for _ in range(times):
        time.sleep(0.05)
        yield


stamps = {telemetry.attitude_quaternion().timestamp_us for _ in paced(20)}
assert len(stamps) > 8, stamps
names = param.get_all_params()
known = {p.name for p in names.int_params} | {p.name for p in names.float_params}
assert ("MPC_THR_HOVER" if PERSONA == "px4" else "GUID_OPTIONS") in known, known
print(f"{len(known)} parameters")
level = Attitude(0.0, 0.0, 0.0, 0.1)
offboard.set_attitude(level)


def insists(call: Callable[[], object]) -> bool:
    """Whether the vehicle accepts; a refusal is asked again."""
    try:
        call()
    except Exception as error:
        print(f"refused: {error}", flush=True)
        time.sleep(0.5)
        return False
    return True


def tilted(roll: float, pitch: float) -> bool:
    now = telemetry.attitude_euler()
    return abs(now.roll_deg - roll) < 2.0 and abs(now.pitch_deg - pitch) < 2.0


def moved(axis: str, start: float) -> bool:
    return bool(getattr(telemetry.position_velocity_ned().position, axis) - start > 0.3)


until("offboard", lambda: insists(offboard.start))
until("armed", lambda: insists(action.arm))
until("shown as armed", telemetry.armed)
for roll, pitch, axis in ((12.0, 0.0, "east_m"), (0.0, -12.0, "north_m")):
    offboard.set_attitude(Attitude(roll, pitch, 0.0, 0.62 if PERSONA == "px4" else 0.34))
    until(f"roll {roll:g}, pitch {pitch:g} as asked", partial(tilted, roll, pitch))
    start = getattr(telemetry.position_velocity_ned().position, axis)
    until(
        f"goes {axis}",
        partial(moved, axis, start),
    )
until("in the air", telemetry.in_air)


def ned() -> tuple[float, float, float]:
    p = telemetry.position_velocity_ned().position
    return p.north_m, p.east_m, p.down_m


def near(x: float, y: float, z: float) -> bool:
    return max(abs(a - b) for a, b in zip(ned(), (x, y, z), strict=True)) < 0.4


north, east, down = ned()
offboard.set_position_ned(PositionNedYaw(north + 2.0, east - 1.0, down - 1.0, 0.0))
until("offboard by position", lambda: near(north + 2.0, east - 1.0, down - 1.0), 20.0)
offboard.set_velocity_ned(VelocityNedYaw(0.0, 1.0, 0.0, 0.0))
until("offboard by velocity", lambda: ned()[1] - east > 1.0, 20.0)
action.hold()
until("hold before goto", lambda: telemetry.flight_mode().name in ("HOLD", "GUIDED", "POSCTL"))
where = telemetry.position()
action.goto_location(where.latitude_deg + 2.0 / 111_195.0, where.longitude_deg, where.absolute_altitude_m + 1.0, 90.0)
until("goto", lambda: (telemetry.position().latitude_deg - where.latitude_deg) * 111_195.0 > 1.6, 20.0)
until("goto climbs", lambda: telemetry.position().absolute_altitude_m - where.absolute_altitude_m > 0.7)
action.hold()
until("hold", lambda: telemetry.flight_mode().name in ("HOLD", "GUIDED", "POSCTL"))
action.land()
until("lands", lambda: telemetry.flight_mode().name == "LAND")
until("landed and disarmed", lambda: not telemetry.armed(), 30.0)
print("done", flush=True)
sdk.destroy()
