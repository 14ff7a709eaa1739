"""MAVProxy, headless, against four vehicles: `python with_mavproxy.py PERSONA PORT_OFFSET MAVPROXY`. Raises what fails.

Its commands go in by standard input once it has heard the vehicles; what it shows is read from its log of packets,
which it writes as a tlog, and from its output.
"""

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

PERSONA, OFFSET, MAVPROXY = sys.argv[1], int(sys.argv[2]), sys.argv[3]
folder = Path(tempfile.mkdtemp())
out = open(folder / "out.txt", "w+")  # noqa: SIM115 - read while it is written
proxy = subprocess.Popen(
    [MAVPROXY, f"--master=udpin:127.0.0.1:{14550 + OFFSET}", "--state-basedir", str(folder), "--logfile",
     str(folder / "flight.tlog")],
    stdin=subprocess.PIPE, stdout=out, stderr=subprocess.STDOUT, text=True, cwd=folder,
)  # fmt: skip


def say(line: str) -> None:
    assert proxy.stdin is not None
    proxy.stdin.write(line + "\n")
    proxy.stdin.flush()


def heard() -> list:
    """Every message so far, in order."""
    log = mavutil.mavlink_connection(str(folder / "flight.tlog"))
    messages = []
    while (message := log.recv_match()) is not None:
        messages.append(message)
    return messages


def until(what: str, done: Callable[[list], bool], again: str = "", seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if again:
            say(again)
        time.sleep(1.0)
        try:
            if done(heard()):
                print(what, flush=True)
                return
        except OSError:
            continue
    raise AssertionError(f"waited {seconds:.0f} s for: {what}\n{(folder / 'out.txt').read_text()[-2000:]}")


def last(messages: list, kind: str, system: int = 3) -> Any:
    return next((m for m in reversed(messages) if m.get_type() == kind and m.get_srcSystem() == system), None)


def beat(messages: list, test: Callable[[Any], bool]) -> bool:
    shown = last(messages, "HEARTBEAT")
    return shown is not None and test(shown)


def tilt() -> None:
    """An attitude of ten degrees to the right, ten times a second, while `tilting` is set."""
    while proxy.poll() is None:
        if tilting.wait(0.5):
            say(f"attitude 0.9962 0.0872 0 0 {0.55 if PERSONA == 'px4' else 0.5}")
            time.sleep(0.1)


tilting = threading.Event()
threading.Thread(target=tilt, daemon=True).start()
GUIDED = 4 if PERSONA == "arducopter" else 6 << 16
try:
    until("four vehicles", lambda ms: {1, 2, 3, 4} <= {m.get_srcSystem() for m in ms if m.get_type() == "HEARTBEAT"})
    say("vehicle 3")
    time.sleep(1.0)
    until(
        "parameters complete",
        lambda ms: (
            len({m.param_id for m in ms if m.get_type() == "PARAM_VALUE" and m.get_srcSystem() == 3})
            == getattr(last(ms, "PARAM_VALUE"), "param_count", -1)
        ),
        "param fetch",
    )
    say("long SET_MESSAGE_INTERVAL 30 100000")
    say("long SET_MESSAGE_INTERVAL 32 100000")
    until("telemetry that changes", lambda ms: len({m.time_boot_ms for m in ms if m.get_type() == "ATTITUDE"}) > 10)
    if PERSONA == "arducopter":
        until("mode GUIDED", lambda ms: beat(ms, lambda m: m.custom_mode == GUIDED), "mode GUIDED")
        until("armed", lambda ms: beat(ms, lambda m: m.base_mode & 128), "arm throttle")
        until("took off", lambda ms: getattr(last(ms, "LOCAL_POSITION_NED"), "z", 0) < -1.5, "takeoff 2")
        tilting.set()
        until("rolls right", lambda ms: getattr(last(ms, "ATTITUDE"), "roll", 0) > 0.15)
        tilting.clear()
        until("mode LAND", lambda ms: beat(ms, lambda m: m.custom_mode == 9), "mode LAND")
    else:
        until("armed", lambda ms: beat(ms, lambda m: m.base_mode & 128), "arm throttle")
        until(
            "mode TAKEOFF",
            lambda ms: getattr(last(ms, "LOCAL_POSITION_NED"), "z", 0) < -1.5,
            "long DO_SET_MODE 209 4 2",
        )
        tilting.set()
        until("mode OFFBOARD", lambda ms: beat(ms, lambda m: m.custom_mode == 6 << 16), "long DO_SET_MODE 209 6 0")
        until("rolls right", lambda ms: getattr(last(ms, "ATTITUDE"), "roll", 0) > 0.15)
        tilting.clear()
        until(
            "mode LAND", lambda ms: beat(ms, lambda m: m.custom_mode == 4 << 16 | 6 << 24), "long DO_SET_MODE 209 4 6"
        )
    until("landed and disarmed", lambda ms: beat(ms, lambda m: not m.base_mode & 128), seconds=40)
    until("disarm is understood", lambda ms: beat(ms, lambda m: not m.base_mode & 128), "disarm")
    text = (folder / "out.txt").read_text()
    assert "Traceback" not in text, text[-2000:]
    print("done", flush=True)
finally:
    proxy.kill()
