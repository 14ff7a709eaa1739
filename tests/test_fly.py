"""End to end, over the socket: the README's flight, its determinism, other people's clients, and what goes wrong."""

import json
import math
import signal
import socket
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Command, cablequad, flown, next_offset, wait_for_line
from mcap.reader import make_reader

from bridge.wire.dialect import mavlink
from bridge.wire.link import Endpoint, Link
from bridge.wire.ports import GROUND_PORT
from bridge.wire.values import VehicleAttitude
from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.trajectory import at
from logs.reading.reader import read
from logs.reading.records import entries
from missions.flight.options import Options, Progress
from missions.flight.run import run as fly_it
from missions.scenario import laws
from missions.scenario import loading as scenario

TARGET = np.array([0.44, 0.78, -0.5])


@pytest.fixture(scope="module")
def case_1(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """The README's flight, once."""
    return flown("--out", str(tmp_path_factory.mktemp("case1")), "--port-offset", str(next_offset()), sockets=True)


def test_case_1_arrives_within_the_asked_bounds(case_1: dict) -> None:
    assert case_1["exit_code"] == 0
    assert case_1["passed"]
    assert case_1["final_position_error_m"] < 0.02
    assert case_1["final_speed_m_s"] < 0.02
    assert case_1["final_e_q"] < 0.1
    assert case_1["final_psi"] < 0.01
    assert case_1["max_thrust_N"] < 25
    assert case_1["min_tension_N"] > 0
    assert case_1["messages_lost"] == 0
    assert case_1["messages_late"] == 0
    asked = (
        "scenario passed reason final_position_error_m final_speed_m_s settling_time_s max_psi max_thrust_N "
        "min_tension_N messages_sent messages_lost messages_late real_time_factor log replay"
    )
    assert set(asked.split()) <= set(case_1)


def test_its_log_passes_the_mcap_librarys_reader_and_its_replay_reruns_verification(case_1: dict) -> None:
    with open(case_1["log"], "rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    topics = {c.topic for c in summary.channels.values()}
    for system in ("quad1", "quad2", "quad3", "quad4"):
        assert {f"/mavlink/{system}/rx", f"/mavlink/{system}/tx"} <= topics
    assert "/mavlink/payload/rx" in topics
    rerun = Path(sys.executable).parent / "rerun"
    done = subprocess.run([rerun, "rrd", "verify", case_1["replay"]], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_agrees_with_the_offline_rollout_of_the_same_design(case_1: dict) -> None:
    """Same rates, same one-tick age, no wire: the payload within 1 cm throughout."""
    flight = scenario.load("paper-case-1")
    samples = rollout(
        laws.design(flight), flight.airframe, lambda t: at(flight.trajectory, t), flight.initial,
        LoopTiming(0.004, 4, 1), 2500,
    )  # fmt: skip
    offline = np.array([s.state.x0 for s in samples])
    run = read(Path(case_1["log"]))
    plant = run.columns["/plant/state"]
    flying = (plant["sim_time_ns"] >= run.release_ns) & (plant["sim_time_ns"] <= run.release_ns + 10 * 10**9)
    online = plant["payload_position"][flying]
    assert len(online) == len(offline) == 2501
    gap = float(np.abs(online - offline).max())
    print(f"wire and rollout differ by at most {1000 * gap:.4f} mm")
    assert gap < 0.01


def test_the_controller_heard_what_the_simulator_did(case_1: dict) -> None:
    """Messages are floats: what was measured is the truth to their precision, and nothing else is used."""
    run = read(Path(case_1["log"]))
    plant, control = run.columns["/plant/state"], run.columns["/control/state"]
    rows = np.searchsorted(plant["sim_time_ns"], control["sim_time_ns"])
    np.testing.assert_allclose(control["position"], plant["payload_position"][rows], rtol=0, atol=1e-6)
    np.testing.assert_allclose(control["link_direction"], plant["link_direction"][rows], rtol=0, atol=1e-6)


def messages(name: str, folder: Path, duration_s: float, **options: Any) -> dict[str, list[tuple[int, bytes]]]:
    """By topic: when, and what, of a flight."""
    flight = scenario.load(name, duration_s=duration_s)
    summary, _ = fly_it(flight, Options(out=folder, **options), Progress())
    by_topic: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
    for entry in entries(Path(str(summary.log))):
        if entry.topic != "/perf":
            by_topic[entry.topic].append((entry.log_time, entry.data))
    return by_topic


def same(a: dict[str, list[tuple[int, bytes]]], b: dict[str, list[tuple[int, bytes]]]) -> bool:
    """Whether two logs are equal; says where they part."""
    assert a.keys() == b.keys()
    for topic in a:
        assert len(a[topic]) == len(b[topic]), topic
        for k, (one, other) in enumerate(zip(a[topic], b[topic], strict=True)):
            assert one == other, (topic, k, one[0], other[0])
    return True


KEY = bytes(range(32))


@pytest.mark.parametrize(
    ("name", "signed"), [*((name, False) for name in scenario.names()), ("mixed-fleet", True), ("lossy-link", True)]
)
def test_one_seed_gives_one_log_over_sockets_and_in_one_process(
    name: str, signed: bool, tmp_path: Path, offset: int
) -> None:
    key = KEY if signed else None
    over_sockets = messages(name, tmp_path, 1.0, port_offset=offset, signing_key=key)
    assert same(over_sockets, messages(name, tmp_path, 1.0, in_process=True, signing_key=key))


def test_no_flight_leaves_anything_to_the_next_one_in_its_process(tmp_path: Path) -> None:
    first = messages("ground-to-ground", tmp_path, 1.0, in_process=True)
    others = [name for _ in range(3) for name in scenario.names()][:40]
    for k, name in enumerate(others):
        messages(name, tmp_path / str(k), 0.1, in_process=True)
    assert same(first, messages("ground-to-ground", tmp_path, 1.0, in_process=True))


def test_failed_criteria_are_named_and_exit_with_one(tmp_path: Path, offset: int) -> None:
    source = scenario.text("paper-case-1").replace("speed_m_s = 0.02", "speed_m_s = 1e-12")
    path = tmp_path / "strict.toml"
    path.write_text(source)
    summary = flown(str(path), "--out", str(tmp_path), "--no-replay", "--port-offset", str(offset))
    assert summary["exit_code"] == 1
    assert "speed_m_s is" in summary["reason"]


def connections(offset: int) -> list[str]:
    ports = [14540, 14541, 14542, 14543, 14600]
    return [word for p in ports for word in ("--connect", f"udpin:127.0.0.1:{p + offset}")]


@pytest.mark.parametrize("speed", ["max", "2"])
@pytest.mark.alone
def test_a_server_in_one_terminal_is_flown_from_another(tmp_path: Path, offset: int, speed: str) -> None:
    server = Command("sitl", "--speed", speed, "--port-offset", str(offset))
    try:
        wait_for_line(server, "whoever speaks")
        summary = flown("--out", str(tmp_path), *connections(offset))
    finally:
        server.interrupt()
        code, out, _ = server.wait()
    assert summary["passed"], summary["reason"]
    assert code == 0
    assert "released" in out
    assert "stopped after" in out
    if speed == "max":
        assert summary["messages_late"] == 0
    run = read(Path(summary["log"]))
    assert "/plant/state" not in run.columns  # nobody told the truth, and nobody asked
    assert summary["replay"]


def test_a_stranger_with_mavutil_arms_flies_and_disarms(offset: int) -> None:
    """pymavlink's own client: sees four vehicles, streams setpoints, OFFBOARD, arm, disarm, reads parameters."""
    code = f"""
import os, threading, time
os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil
ground = mavutil.mavlink_connection("udpin:127.0.0.1:{14550 + offset}")
seen, until = set(), time.time() + 10
while time.time() < until and not {{1, 2, 3, 4}} <= seen:
    m = ground.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
    if m is not None and m.type == 2:
        seen.add(m.get_srcSystem())
assert seen == {{1, 2, 3, 4}}, seen
one = mavutil.mavlink_connection("udpin:127.0.0.1:{14540 + offset}")
one.wait_heartbeat(timeout=5)
assert one.target_system == 1
going = True
def stream():
    while going:
        one.mav.set_attitude_target_send(0, 1, 1, 7, [1, 0, 0, 0], 0, 0, 0, 0.6)
        time.sleep(0.02)
threading.Thread(target=stream, daemon=True).start()
time.sleep(0.5)
def ask(command, *p):
    one.mav.command_long_send(1, 1, command, 0, *p, *([0] * (7 - len(p))))
def beat(test, what, again):
    until = time.time() + 8
    while time.time() < until:
        ask(*again)
        m = one.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
        if m is not None and test(m):
            return
    raise SystemExit("no heartbeat with " + what)
beat(lambda m: m.custom_mode == 6 << 16, "OFFBOARD", (176, 1, 6))
beat(lambda m: m.base_mode & 128, "armed", (400, 1))
beat(lambda m: not m.base_mode & 128, "disarmed", (400, 0))
one.param_fetch_all()
names, until = {{}}, time.time() + 5
while time.time() < until:
    m = one.recv_match(type="PARAM_VALUE", blocking=True, timeout=1)
    if m is not None:
        names[m.param_id] = m.param_count
        if len(names) == m.param_count:
            break
assert len(names) == set(names.values()).pop()
going = False
print("done")
"""
    server = Command("sitl", "--port-offset", str(offset))
    try:
        wait_for_line(server, "whoever speaks")
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    finally:
        server.interrupt()
        server.wait()
    assert done.stdout == "done\n", done.stderr


def test_a_client_that_speaks_first_is_answered_where_it_is(offset: int) -> None:
    """Port 14555: nothing is sent there until someone speaks; then all four vehicles answer."""
    server = Command("sitl", "--port-offset", str(offset))
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.settimeout(0.5)
    codec = mavlink.MAVLink(None, 255, 190)
    codec.robust_parsing = True
    try:
        wait_for_line(server, "whoever speaks")
        hello = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(codec)
        seen: set[Any] = set()
        until = time.monotonic() + 5
        while time.monotonic() < until and seen != {1, 2, 3, 4}:
            client.sendto(hello, ("127.0.0.1", 14555 + offset))
            try:
                for m in codec.parse_buffer(client.recv(2048)) or []:
                    seen.add(m.get_srcSystem())
            except TimeoutError:
                continue
        assert seen == {1, 2, 3, 4}
    finally:
        client.close()
        server.interrupt()
        server.wait()


def test_a_nan_setpoint_stops_the_motors_and_the_vehicle_says_so(offset: int) -> None:
    server = Command("sitl", "--port-offset", str(offset))
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.bind(("127.0.0.1", 14540 + offset))
    client.settimeout(0.2)
    codec = mavlink.MAVLink(None, 255, 190)
    codec.robust_parsing = True
    vehicle = ("127.0.0.1", 14580 + offset)

    def send(message: object) -> None:
        client.sendto(message.pack(codec), vehicle)  # type: ignore[attr-defined]
        codec.seq = (codec.seq + 1) & 255

    def setpoint(thrust: float) -> object:
        return mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1, 0, 0, 0], 0, 0, 0, thrust)

    texts: list[str] = []
    try:
        wait_for_line(server, "whoever speaks")
        until, asked = time.monotonic() + 9, False
        while time.monotonic() < until and not any("not finite" in t for t in texts):
            send(setpoint(math.nan if asked else 0.5))
            if time.monotonic() > until - 5:
                send(mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0))
                send(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
                asked = True
            for _ in range(10):
                try:
                    heard = codec.parse_buffer(client.recv(2048)) or []
                    texts += [m.text for m in heard if m.get_type() == "STATUSTEXT"]
                except TimeoutError:
                    break
    finally:
        client.close()
        server.interrupt()
        server.wait()
    assert any("thrust is not finite, motors off" in t for t in texts), texts


def test_a_port_in_use_is_named_and_is_no_verdict_on_a_flight(tmp_path: Path, offset: int) -> None:
    taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    taken.bind(("127.0.0.1", 14541 + offset))
    for command in ("fly", "sitl"):
        more = ["--out", str(tmp_path)] if command == "fly" else []
        port = 14541 + offset
        if command == "sitl":
            taken.close()
            taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            taken.bind(("127.0.0.1", 14582 + offset))
            port = 14582 + offset
        code, _, err = cablequad(command, "--port-offset", str(offset), *more)
        assert code == 3
        assert f"127.0.0.1:{port}" in err
        assert "in use" in err
        assert "Traceback" not in err
    taken.close()


def test_a_missing_vehicle_ends_the_run_with_its_name(tmp_path: Path, offset: int) -> None:
    """Three of four vehicles' ports are listened on: the fourth is never heard."""
    mine = tmp_path / "mine.toml"
    mine.write_text(scenario.text("paper-case-1") + "\n[link]\nconnect_timeout_s = 3.0\n")
    server = Command("sitl", "--port-offset", str(offset))
    try:
        wait_for_line(server, "whoever speaks")
        urls = connections(offset)
        urls[7] = f"udpin:127.0.0.1:{14599 + offset}"
        summary = flown(str(mine), "--out", str(tmp_path), "--no-replay", *urls)
    finally:
        server.interrupt()
        server.wait()
    assert summary["exit_code"] == 1
    assert summary["reason"].startswith("vehicle 4: nothing heard within 3 s")
    assert read(Path(summary["log"])).complete


@pytest.mark.alone
def test_ctrl_c_in_mid_flight_ends_in_order(tmp_path: Path, offset: int) -> None:
    run = Command(
        "fly", "--json", "--speed", "1", "--duration", "60", "--out", str(tmp_path), "--port-offset", str(offset)
    )
    until = time.monotonic() + 120
    released = False
    while time.monotonic() < until and not released:
        time.sleep(0.5)
        for part in tmp_path.glob("*.part"):
            released = any(e.topic == "/event" and b"release" in e.data for e in entries(part))
    run.interrupt()
    code, out, err = run.wait()
    assert code == 130
    assert "Traceback" not in err
    summary = json.loads(out)
    assert summary["reason"] == "interrupted by the user"
    log = read(Path(summary["log"]))
    assert log.complete
    assert "result" in log.metadata
    assert log.events[-1].kind == "hold"
    assert len(log.columns["/plant/state"]["step"]) > 100


def test_a_simulator_that_dies_ends_the_run_with_a_complete_log(tmp_path: Path, offset: int) -> None:
    server = Command("sitl", "--port-offset", str(offset))
    fly = None
    try:
        wait_for_line(server, "whoever speaks")
        fly = Command("fly", "--json", "--no-replay", "--duration", "60", "--out", str(tmp_path), *connections(offset))
        time.sleep(3)
        assert fly.process.poll() is None, fly.wait()
        wait_for_line(server, "released")
        time.sleep(1)
        server.process.kill()
        code, out, _ = fly.wait()
    finally:
        server.process.kill()
        server.wait()
    summary = json.loads(out)
    assert code == 1
    assert "silent since t =" in summary["reason"]
    assert read(Path(summary["log"])).complete


@pytest.mark.parametrize("name", ["paper-case-1", "paper-case-1-50hz"])
@pytest.mark.alone
def test_a_run_that_is_killed_with_all_its_processes_keeps_all_but_half_a_second(
    name: str, tmp_path: Path, offset: int
) -> None:
    """A ground station hears how far the flight had come."""
    arguments = ("--speed", "1", "--no-replay", "--duration", "60", "--out", str(tmp_path))
    fly = Command("fly", name, *arguments, "--port-offset", str(offset))
    ground = Link([Endpoint(("127.0.0.1", GROUND_PORT + offset), None)])
    heard_ms, until = 0, time.monotonic() + 60
    try:
        while heard_ms < 7000 and time.monotonic() < until:
            told = [f.value.boot_ms for f in ground.poll(0.1) if isinstance(f.value, VehicleAttitude)]
            heard_ms = max([heard_ms, *told])
        fly.signal_all(signal.SIGKILL)
        told = [f.value.boot_ms for f in ground.poll(0.0) if isinstance(f.value, VehicleAttitude)]
        heard_ms = max([heard_ms, *told])
    finally:
        ground.close()
    assert heard_ms >= 7000
    (log,) = tmp_path.glob("*.mcap.part")
    kept = read(log).columns["/control/state"]["sim_time_ns"][-1] * 1e-9
    assert heard_ms * 1e-3 - kept <= 0.5


@pytest.mark.parametrize("after_s", [1.0, 1.8, 2.6])
def test_ctrl_c_while_it_gets_ready_leaves_no_traceback_of_anybody(after_s: float, tmp_path: Path, offset: int) -> None:
    fly = Command("fly", "--no-replay", "--out", str(tmp_path), "--port-offset", str(offset))
    time.sleep(after_s)
    fly.interrupt()
    code, _, err = fly.wait(30)
    assert code == 130
    assert "Traceback" not in err


def test_replay_saves_an_rrd_also_from_a_cut_log(case_1: dict, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    data = Path(case_1["log"]).read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    code, out, err = cablequad("replay", str(cut), "--save", str(tmp_path / "cut.rrd"))
    assert code == 0
    assert "cut short" in err
    assert out.strip() == str(tmp_path / "cut.rrd")
    code, _, err = cablequad("replay", str(tmp_path / "none.mcap"), "--save", str(tmp_path / "x.rrd"))
    assert code == 2
    assert "no such file" in err


def test_case_2_reports_slack_with_time_and_cable(tmp_path: Path, offset: int) -> None:
    """Its curled cables whip: links that push are events, and their tensions stand in the log as they are."""
    summary = flown(
        "paper-case-2", "--duration", "1", "--no-replay", "--out", str(tmp_path), "--port-offset", str(offset)
    )
    run = read(Path(summary["log"]))
    slack = [e for e in run.events if e.kind == "slack"]
    assert slack
    assert all(e.subject.startswith("cable ") and ("pushes with" in e.text or "curled" in e.text) for e in slack)
    assert any(e.kind == "taut" for e in run.events)
    plant = run.columns["/plant/state"]
    end_ns = next(e.time_ns for e in run.events if e.kind == "end")
    smallest = plant["tension"][~plant["held"] & (plant["sim_time_ns"] <= end_ns)].min()
    assert smallest < 0
    assert summary["min_tension_N"] == pytest.approx(smallest)


@pytest.mark.skipif(not list(Path("/usr/share/vulkan").glob("icd.d/*")), reason="no Vulkan driver to render with")
def test_a_replay_is_pictured_without_a_screen_and_no_view_reports_an_error(case_1: dict, tmp_path: Path) -> None:
    png = tmp_path / "at-2.png"
    code, out, err = cablequad("replay", case_1["log"], "--screenshot", str(png), "--at", "2")
    assert code == 0, err
    assert out.strip() == str(png)
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert png.stat().st_size > 100_000


@pytest.mark.parametrize(
    ("who", "what"),
    [
        ("vehicles", "px4"), ("vehicles", "arducopter"), ("controller", "paper-case-1"), ("controller", "lossy-link"),
        ("controller", "lemniscate-vehicles"), ("controller", "ground-to-ground"),
    ],
)  # fmt: skip
def test_nobody_compiles_anything_once_the_clock_runs(who: str, what: str, offset: int) -> None:
    """What is used for the first time when a setpoint comes, or when vehicles hold, would stop everybody's time."""
    script = [sys.executable, str(Path(__file__).with_name("first_use.py")), who, what, str(offset)]
    done = subprocess.run(script, capture_output=True, text=True, timeout=240)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
