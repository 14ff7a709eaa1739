"""pymavlink's mavutil against four vehicles: `python with_mavutil.py PERSONA PORT_OFFSET`. Raises what fails."""

import math
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

PERSONA, OFFSET = sys.argv[1], int(sys.argv[2])
GUIDED = 4 if PERSONA == "arducopter" else 6 << 16
CONTROL = (1, 4) if PERSONA == "arducopter" else (1, 6)
LAND = (1, 9) if PERSONA == "arducopter" else (1, 4, 6)

ground = mavutil.mavlink_connection(f"udpin:127.0.0.1:{14550 + OFFSET}")
seen: set[int] = set()
end = time.monotonic() + 10
while not {1, 2, 3, 4} <= seen and time.monotonic() < end:
    beat = ground.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
    if beat is not None and beat.type == 2:
        seen.add(beat.get_srcSystem())
assert seen >= {1, 2, 3, 4}, seen
print("four vehicles", flush=True)

if PERSONA == "arducopter":  # where SITL waits for its first client
    link = mavutil.mavlink_connection(f"tcp:127.0.0.1:{5760 + 20 + OFFSET}", source_system=42)
else:
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{14542 + OFFSET}", source_system=42)
assert link.wait_heartbeat(timeout=5) is not None
assert link.target_system == 3

setpoint: list[Any] = [[1.0, 0.0, 0.0, 0.0], 0.0]
going = True


def stream() -> None:
    while going:
        link.mav.set_attitude_target_send(0, 3, 1, 7, setpoint[0], 0, 0, 0, setpoint[1])
        time.sleep(0.02)


def ask(command: int, *params: float) -> None:
    link.mav.command_long_send(3, 1, command, 0, *params, *([0] * (7 - len(params))))


def until(what: str, kind: str, test: Callable[[Any], bool], again: tuple[float, ...] = (), seconds: float = 12) -> Any:
    end, asked = time.monotonic() + seconds, 0.0
    while time.monotonic() < end:
        if again and time.monotonic() - asked > 0.5:
            asked = time.monotonic()
            ask(*again)  # type: ignore[arg-type]
        message = link.recv_match(type=kind, blocking=True, timeout=0.5)
        if message is not None and message.get_srcSystem() == 3 and test(message):
            print(what, flush=True)
            return message
    raise AssertionError(f"waited {seconds:.0f} s for: {what}")


link.param_fetch_all()
names: dict[str, int] = {}
end = time.monotonic() + 5
while time.monotonic() < end and len(names) != next(iter(names.values()), -1):
    value = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=1)
    if value is not None:
        names[value.param_id] = value.param_count
assert names, "no parameters"
assert len(names) == next(iter(names.values())), names
print(f"{len(names)} parameters", flush=True)

for msgid in (30, 32, 245):
    until(
        f"message {msgid} at 20 Hz", "COMMAND_ACK", lambda m: m.command == 511 and m.result == 0, (511, msgid, 50_000)
    )
first = until("attitude", "ATTITUDE", lambda m: True)
until("attitude again, later", "ATTITUDE", lambda m: m.time_boot_ms > first.time_boot_ms)
threading.Thread(target=stream, daemon=True).start()
until("the mode that takes setpoints", "HEARTBEAT", lambda m: m.custom_mode == GUIDED, (176, *CONTROL))
until("armed", "HEARTBEAT", lambda m: m.base_mode & 128, (400, 1))
half = math.radians(12) / 2
for what, quat, ok in (
    ("rolls right", [math.cos(half), math.sin(half), 0.0, 0.0], lambda m: m.roll > 0.18),
    ("pitches down", [math.cos(half), 0.0, -math.sin(half), 0.0], lambda m: m.pitch < -0.18),
):
    setpoint[:] = [quat, 0.62 if PERSONA == "px4" else 0.34]
    until(what, "ATTITUDE", ok)
until("went north and east", "LOCAL_POSITION_NED", lambda m: m.x > 0.3 and m.y > 0.3)
until("in the air", "EXTENDED_SYS_STATE", lambda m: m.landed_state == 2)
going = False
until("lands", "HEARTBEAT", lambda m: m.custom_mode != GUIDED, (176, *LAND))
until("landed and disarmed", "HEARTBEAT", lambda m: not m.base_mode & 128, seconds=30)
print("done", flush=True)
