"""Autopilots of their own under the load: the two physics interfaces, joint lockstep, and stand-ins that fly it.

The stand-ins (`tests/peers/autopilot.py`) are written from the protocols alone and import nothing of ours.
"""

import contextlib
import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Command, cablequad, flown, next_offset
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav
from scipy.integrate import solve_ivp

from bridge.fleet.profiles import PROFILES
from bridge.fleet.readback import Readback
from bridge.loop.tick_barrier import TickBarrier
from bridge.loop.time_sync import TimeSync
from bridge.wire.messages import param_bits
from bridge.wire.values import Origin, ParamValue, PayloadState, Timesync, VehicleAttitude, VehiclePosition
from cablequad.model import lie
from cablequad.model.earth import Home
from logs.reading.reader import Run, read
from logs.schema import cablequad_pb2 as pb
from missions.analysis.identify import answers, fitted
from missions.flight.processes.launch import (
    arducopter_values,
    authority,
    launches,
    parameter_file,
    px4_values,
    start_lines,
    started_with,
)
from missions.flight.processes.simulate import Serving, settings
from missions.scenario import loading as scenarios
from missions.scenario.autopilots import behind
from missions.scenario.flights import ScenarioError
from sitl.external import ardupilot, px4
from sitl.external.ardupilot import ArduPilotSeat, PacketError, servos
from sitl.external.joint import JointServer, Steps, steps
from sitl.external.px4 import Px4Seat
from sitl.external.seat import Own, SeatError
from sitl.external.seats import AutopilotError
from sitl.instruments import Grades, Instruments
from sitl.settings import plant_of

pytestmark = pytest.mark.alone

GOLDEN = Path(__file__).parent / "golden"
PEER = Path(__file__).parent / "peers" / "autopilot.py"
MARK = 47.397742, 8.545594, 488.0


def captured(name: str) -> list[tuple[str, bytes]]:
    """The lines of a golden capture: which way as the physics sees it, and the bytes."""
    lines = [line.split() for line in (GOLDEN / name).read_text().splitlines()]
    return [(way, bytes.fromhex(data)) for way, data in lines]


def simulator_json(text: bytes) -> dict[str, list[float]]:
    """A line as SIM_JSON.cpp reads it: a search for the key, then numbers; its own little reader."""
    assert text[:1] == b"\n"
    assert text[-1:] == b"\n"
    out = {}
    for key, count in {
        "timestamp": 1,
        "gyro": 3,
        "accel_body": 3,
        "position": 3,
        "quaternion": 4,
        "velocity": 3,
    }.items():
        assert text.count(b'"' + key.encode() + b'"') == 1
        at = text.index(b'"' + key.encode() + b'":') + len(key) + 3
        if count > 1:
            assert text[at : at + 1] == b"["
            at += 1
        out[key] = [float(n) for n in re.split(rb"[,\]}]", text[at:])[:count]]
    return out


def own(t: float = 0.004, **change: Any) -> Own:
    still = Own(round(t * 1e6), np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -9.81]))
    return still._replace(**change)


# -- golden packets ----------------------------------------------------------------------------------------------------


def test_every_servo_packet_of_the_capture_is_read_as_it_was_sent() -> None:
    frames = [servos(data) for way, data in captured("ardupilot-physics.txt") if way == "in"]
    assert len(frames) == 100
    assert [f.frame for f in frames] == list(range(frames[0].frame, frames[0].frame + 100))
    shares = np.array([[ardupilot.thrust_share(p) for p in f.pwm[:4]] for f in frames])
    assert shares.sum(axis=1) * 25.0 / 4 == pytest.approx(
        9.05, abs=0.15
    )  # N: it carries itself and a fourth of the load


def test_every_answer_of_the_capture_is_made_again_to_its_last_digit() -> None:
    """All but the quaternion, which goes through a matrix here."""
    for way, data in captured("ardupilot-physics.txt"):
        if way == "out":
            n = {key: np.array(value) for key, value in simulator_json(data).items()}
            R = lie.rotation_from_quat(n["quaternion"])
            state = Own(round(n["timestamp"][0] * 1e6), R, n["gyro"], n["position"], n["velocity"], n["accel_body"])
            again = simulator_json(ardupilot.line(state))
            for key, value in n.items():
                wanted = pytest.approx(value.tolist(), abs=2e-9) if key == "quaternion" else value.tolist()
                assert again[key] == wanted, key


def test_a_stream_of_px4_is_read_whole_and_in_pieces_of_any_size() -> None:
    stream = b"".join(data for way, data in captured("px4-physics.txt") if way == "in")
    whole, rest, refused = px4.split(stream)
    assert (len(whole), rest, refused) == (50, b"", 0)
    assert np.diff([c.time_us for c in whole]) == pytest.approx(4000)
    for size in (1, 7, 40, 81, 500):
        pieces, rest = [], b""
        for at in range(0, len(stream), size):
            said, rest, refused = px4.split(rest + stream[at : at + size])
            pieces += said
            assert refused == 0
        assert pieces == whole


def test_what_px4_is_told_reads_as_its_own_dialect_says() -> None:
    parser = mav.MAVLink(None)
    told = [m for way, data in captured("px4-physics.txt") if way == "out" for m in parser.parse_buffer(data)]
    sensors = [m for m in told if m.get_type() == "HIL_SENSOR"]
    assert np.diff([m.time_usec for m in sensors]) == pytest.approx(4000)
    assert {m.fields_updated & 0x3F for m in sensors} == {0x3F}
    assert {m.id for m in sensors} == {0}
    assert sum(bool(m.fields_updated & 0x1C0) for m in sensors) == len(sensors) / 5  # a magnetometer at 50 Hz
    assert len({m.zacc for m in sensors}) == len(sensors)  # what stays the same is declared stale
    (fix,) = {(m.fix_type, m.satellites_visible) for m in told if m.get_type() == "HIL_GPS"}
    assert fix == (3, 12)


# -- the protocols -----------------------------------------------------------------------------------------------------


@given(st.binary(max_size=100))
def test_no_bytes_but_a_servo_packet_are_one(data: bytes) -> None:
    try:
        packet = servos(data)
    except PacketError:
        return
    assert len(data) in (40, 72)
    assert max(packet.pwm[:4]) <= 2500


@given(st.lists(st.one_of(st.binary(max_size=60), st.just(b"\xfd\x09\x00\x00"), st.just(b"\xfd\xff\x01")), max_size=6))
def test_damage_never_hides_a_whole_frame_that_comes_after_it(damage: list[bytes]) -> None:
    out = mav.MAVLink(None, 1, 1)
    frame = mav.MAVLink_hil_actuator_controls_message(8000, [0.7] * 16, 129, 1).pack(out)
    said, _, _ = px4.split(b"".join(damage) + frame)
    assert [c.time_us for c in said] == [8000]
    assert said[0].motors == pytest.approx([0.7] * 4)


@pytest.fixture
def ardupilot_seat() -> Iterator[tuple[ArduPilotSeat, socket.socket]]:
    port = 9002 + next_offset()
    seat = ArduPilotSeat(1, ("127.0.0.1", port))
    peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    peer.connect(("127.0.0.1", port))
    peer.settimeout(1.0)
    yield seat, peer
    seat.close()
    peer.close()


def packet(frame: int, pwm: int = 1500) -> bytes:
    return ardupilot.HEADER.pack(ardupilot.MAGIC_16, 1000, frame) + np.full(16, pwm, "<u2").tobytes()


def heard(seat: ArduPilotSeat) -> None:
    time.sleep(0.01)
    seat.hear()


def test_the_same_frame_again_is_answered_again_and_not_stepped_again(
    ardupilot_seat: tuple[ArduPilotSeat, socket.socket],
) -> None:
    seat, peer = ardupilot_seat
    assert not seat.present
    peer.send(packet(0))
    heard(seat)
    assert seat.present
    assert seat.settled
    peer.send(packet(0))  # before the answer: one is enough
    heard(seat)
    time.sleep(0.01)
    seat.tell(own())
    first = peer.recv(4096)
    assert not seat.settled
    peer.setblocking(False)
    with pytest.raises(BlockingIOError):
        peer.recv(4096)
    peer.setblocking(True)
    peer.send(packet(0))  # after it: the answer was lost
    heard(seat)
    assert peer.recv(4096) == first
    assert not seat.settled
    assert (seat.tally.taken, seat.tally.repeated, seat.tally.answered) == (1, 2, 2)


def test_an_answer_too_many_does_not_go_round_for_ever(ardupilot_seat: tuple[ArduPilotSeat, socket.socket]) -> None:
    """SITL asks once for every answer that it gets, again for its frame where the answer tells no new time."""
    seat, peer = ardupilot_seat
    peer.setblocking(False)
    frame, last = 0, -1.0
    peer.send(packet(frame))
    repeated = []
    for step in range(8):
        heard(seat)
        assert seat.settled
        seat.tell(own(0.00125 * (step + 1)))
        if step == 1:
            peer.send(packet(frame))  # its answer was on its way
            heard(seat)
        time.sleep(0.01)
        with contextlib.suppress(BlockingIOError):
            while True:
                told = json.loads(peer.recv(4096))["timestamp"]
                frame, last = frame + (told > last), told
                peer.send(packet(frame))
        repeated.append(seat.tally.repeated)
    assert frame == 8
    assert repeated[-1] == repeated[3] == 2


def test_old_frames_are_left_and_a_count_that_begins_anew_is_an_autopilot_that_did(
    ardupilot_seat: tuple[ArduPilotSeat, socket.socket],
) -> None:
    seat, peer = ardupilot_seat
    for frame in (40, 41):
        peer.send(packet(frame))
        heard(seat)
        seat.tell(own())
    peer.send(packet(40))
    heard(seat)
    assert seat.tally.stale == 1
    assert not seat.settled
    peer.send(packet(0))
    with pytest.raises(SeatError, match="began anew: its frame count went back from 41 to 0"):
        heard(seat)


@pytest.mark.parametrize(
    "bad", [b"", b"\0" * 40, packet(5)[:-1], packet(5) + b"x", b"\xff" * 4000, packet(5, 65535)], ids=len
)
def test_hostile_datagrams_are_refused_counted_and_change_nothing(
    ardupilot_seat: tuple[ArduPilotSeat, socket.socket], bad: bytes
) -> None:
    seat, peer = ardupilot_seat
    peer.send(bad)
    heard(seat)
    assert not seat.present
    assert seat.tally.refused == 1
    assert seat.share == (0.0, 0.0, 0.0, 0.0)


def test_controls_that_make_no_sense_are_refused_and_the_last_ones_stand() -> None:
    port = 4560 + next_offset()
    seat = Px4Seat(1, ("127.0.0.1", port), Home(), Instruments(Grades(), np.random.default_rng(1)))
    out = mav.MAVLink(None, 1, 1)
    with socket.create_connection(("127.0.0.1", port)) as peer:
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        time.sleep(0.01)
        seat.hear()
        assert seat.settled  # nothing comes before the allocator runs, and the clock goes on without it
        seat.tell(own(0.004))

        def say(time_us: int, control: float) -> None:
            peer.sendall(mav.MAVLink_hil_actuator_controls_message(time_us, [control] * 16, 129, 1).pack(out))
            time.sleep(0.01)
            seat.hear()

        say(4000, 0.5)
        assert seat.share == (0.25,) * 4
        seat.tell(own(0.008))
        assert not seat.settled
        for time_us, control in ((8000, math.nan), (8000, 1e30), (8000, -math.inf), (2**60, 0.1)):
            say(time_us, control)
        assert (seat.tally.refused, seat.share, seat.settled) == (4, (0.25,) * 4, False)
        say(3000, 0.1)
        assert (seat.tally.stale, seat.settled) == (1, False)
        say(8000, 1.0)
        assert (seat.share, seat.settled) == ((1.0,) * 4, True)
    time.sleep(0.01)
    with pytest.raises(SeatError, match="connection"):
        seat.hear()
    seat.close()


def test_arducopters_curve_makes_a_throttle_its_share_of_the_greatest_thrust() -> None:
    """MOT_THST_EXPO 0.65 between MOT_SPIN_MIN 0.15 and MOT_SPIN_MAX 0.95, as the firmware turns a throttle into PWM."""
    for share in (0.0, 0.1, 0.36, 0.7, 1.0):
        c = (-0.35 + math.sqrt(0.35**2 + 4 * 0.65 * share)) / (2 * 0.65)
        assert ardupilot.thrust_share(int(1000 + 1000 * (0.15 + 0.8 * c))) == pytest.approx(share, abs=1e-3)
    assert ardupilot.thrust_share(0) == ardupilot.thrust_share(1000) == ardupilot.thrust_share(1100) == 0.0


# -- time and place ----------------------------------------------------------------------------------------------------


def test_a_vehicles_clock_is_found_by_timesync_and_one_like_the_trackers_is_taken_for_it() -> None:
    relation = TimeSync(2, 200, asks=True)
    attitude = VehicleAttitude.of(5000, np.eye(3), np.zeros(3))
    assert relation.mapped(1, attitude) is None  # nobody knows yet when that was
    rng, now = np.random.default_rng(0), 100.0
    for _ in range(8):
        sim_ns = round((now - 90) * 1e9)
        asked = relation.due(now, sim_ns // 1000)
        assert asked is not None
        assert relation.due(now + 0.01, sim_ns // 1000) is None
        us = sim_ns // 1000
        relation.answered(200, Timesync(sim_ns, asked.ts1), now + 0.001, us)
        relation.answered(1, Timesync(sim_ns + 1_370_000_000, asked.ts1), now + 0.001 + 0.004 * rng.random(), us)
        relation.answered(2, Timesync(sim_ns + 3_000_000, asked.ts1), now + 0.002, us)
        now += 0.2
    assert relation.mapped(1, attitude).boot_ms == pytest.approx(5000 - 1370, abs=5)
    assert relation.mapped(2, attitude) is attitude


def test_clocks_that_catch_up_after_a_pause_are_not_taken_for_set_anew() -> None:
    """Ten times faster than the wall clock: between two answers of one question lie 30 ms of theirs."""
    relation = TimeSync(1, 200, asks=True)
    now, sim_us, found = 100.0, 50_000_000, []
    for k in range(80):
        asked = relation.due(now, sim_us)
        assert asked is not None
        fast = 10 if k in (30, 31, 60) else 1
        relation.answered(200, Timesync(sim_us * 1000, asked.ts1), now + 0.001, sim_us)
        sim_us += 3_000 * fast
        found += relation.answered(1, Timesync((sim_us + 700_000) * 1000, asked.ts1), now + 0.004, sim_us)
        now, sim_us = now + 1.0, sim_us + 996_000
    assert [offset.offset_ms for offset in found] == [pytest.approx(700, abs=5)]


def test_a_vehicle_whose_origin_is_where_it_stood_is_put_into_the_trackers_frame() -> None:
    relation = TimeSync(1, 200, asks=False)
    here = VehiclePosition(0, np.array([1.0, 2.0, -3.0]), np.zeros(3))
    relation.learn(1, Origin(MARK[0], MARK[1], MARK[2]))
    assert relation.mapped(1, here) is here
    relation.learn(200, Origin(MARK[0], MARK[1], MARK[2]))
    assert relation.mapped(1, here) is here
    relation.learn(1, Origin(MARK[0] + math.degrees(2.0 / 6378137.0), MARK[1], MARK[2] + 0.5))
    assert relation.mapped(1, here).x == pytest.approx([3.0, 2.0, -3.5], abs=1e-3)


# -- stands ------------------------------------------------------------------------------------------------------------


def test_on_its_stand_a_vehicle_turns_by_its_rotors_alone_and_stays_where_it_is() -> None:
    flight = scenarios.load("paper-case-1-50hz")
    values = settings(flight, Serving(False, backend="ardupilot"))
    plant = plant_of(values._replace(around=values.around._replace(driven=True)))
    x = plant.kinematics()[0]
    asked = np.full((4, 4), 2.0)
    asked[0] += 0.01 * np.array([-1.0, 1.0, 1.0, -1.0])  # vehicle 1: the left rotors push more
    plant.drive(asked)
    plant.advance(100)
    R, Omega = plant.attitudes
    J = float(flight.system.J[0, 0, 0])
    expected = 4 * 0.01 * (0.17 / math.sqrt(2)) / J * 0.1
    assert Omega[0] == pytest.approx([expected, 0.0, 0.0], rel=1e-9)
    assert math.acos(R[0, 2, 2]) == pytest.approx(0.5 * expected * 0.1, rel=1e-6)
    assert (Omega[1:] == 0.0).all()
    assert (plant.kinematics()[0] == x).all()
    plant.restrained = False
    plant.advance(1)
    assert (plant.kinematics()[0] != x).any()


MIXED, ARDUPILOTS = ("arducopter", "px4"), ("arducopter", "arducopter")


def test_time_goes_on_in_steps_that_every_autopilot_of_the_fleet_takes() -> None:
    for us in (1000, 500, 250):
        assert steps(us, 4000, 4000, 20_000, MIXED) == Steps(1000, us, 4000, 4000)
    assert steps(500, 12_500, 12_500, 12_500, MIXED).frame_us == 500  # 80 Hz: ticks are whole numbers of frames
    # ArduPilots alone are asked at 800 Hz, where the control rate and what is recorded let them
    assert steps(1000, 4000, 4000, 20_000, ARDUPILOTS) == Steps(1250, 625, 5000, 5000)
    assert steps(300, 4000, 4000, 20_000, ARDUPILOTS) == Steps(1250, 250, 5000, 5000)
    assert steps(1000, 4000, 4000, 4000, ARDUPILOTS) == Steps(1000, 1000, 4000, 4000)
    assert steps(1000, 4000, 1000, 20_000, ARDUPILOTS) == Steps(1000, 1000, 4000, 1000)


def test_a_physics_step_that_no_autopilot_takes_is_refused_by_name() -> None:
    for physics_us, tick_us in ((2000, 4000), (1000, 12_500), (813, 33_333)):
        with pytest.raises(ValueError, match=r"physics\.rate_hz, control\.rate_hz"):
            steps(physics_us, tick_us, tick_us, tick_us, MIXED)


def test_who_never_comes_is_named_with_the_address_it_should_have_used() -> None:
    flight = scenarios.load("two-vehicles")
    offset = next_offset()
    values = settings(flight, Serving(False, port_offset=offset, backend="ardupilot"))
    assert values.external is not None
    server = JointServer(values._replace(external=values.external._replace(connect_s=0.3)), lambda _: None)
    try:
        with pytest.raises(AutopilotError, match=f"vehicle 2 .*{9012 + offset}.*: no autopilot came within 0.3 s"):
            server.run(lambda: False)
    finally:
        server.close()


def test_physics_alone_answers_in_joint_lockstep_and_goes_no_further_than_the_slowest() -> None:
    flight = scenarios.load("two-vehicles")
    offset = next_offset()
    server = JointServer(
        settings(flight, Serving(False, speed=math.inf, port_offset=offset, backend="ardupilot")), lambda _: None
    )
    stopped = threading.Event()
    thread = threading.Thread(target=lambda: server.run(stopped.is_set))
    peers = []
    for i in range(2):
        peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        peer.connect(("127.0.0.1", 9002 + offset + 10 * i))
        peer.settimeout(60.0)  # the first step may have to be compiled
        peers.append(peer)
    thread.start()
    try:
        for frame in range(50):
            times = []
            peers[0].send(packet(frame, 1000))
            if frame:
                peers[0].settimeout(0.02)
                with pytest.raises(TimeoutError):
                    peers[0].recv(4096)  # the other has not spoken
                peers[0].settimeout(60.0)
            peers[1].send(packet(frame, 1000))
            for peer in peers:
                told = simulator_json(peer.recv(4096))
                times.append(told["timestamp"][0])
                assert told["accel_body"] == pytest.approx([0.0, 0.0, -9.81], abs=1e-9)
            assert times == pytest.approx([1.0 + frame * 1e-3] * 2)
    finally:
        stopped.set()
        thread.join(5.0)
        server.close()
        for peer in peers:
            peer.close()


# -- starting them -----------------------------------------------------------------------------------------------------


def test_command_lines_and_parameters_follow_the_scenario(tmp_path: Path) -> None:
    flight = scenarios.load("mixed-fleet")
    starts = launches(flight, "mixed", None, 0, "127.0.0.1", 1.0)
    lines = [start.line() for start in starts]
    for i, kind in enumerate(flight.firmware):
        assert ("--model JSON:127.0.0.1" in lines[i]) == (kind == "arducopter")
        assert f"-I {i}" in lines[i] or f"-i {i}" in lines[i]
    two = flight.firmware.index("arducopter")
    assert f"--serial0 udpclient:127.0.0.1:{14540 + two}" in lines[two]
    tilting, turning = authority(flight, 0)
    assert tilting == pytest.approx(2 * (25 / 4) * 0.17 / math.sqrt(2) / 0.557e-2)
    assert turning == pytest.approx(2 * (25 / 4) * 0.02 / 1.05e-2)
    table = dict(line.split() for line in parameter_file(arducopter_values(flight, two)).splitlines())
    assert float(table["ATC_RAT_RLL_P"]) * tilting == pytest.approx(18.0, rel=1e-4)
    assert (table["FRAME_TYPE"], table["GUID_OPTIONS"]) == ("1", "8")
    assert px4_values(flight, 0)["MPC_THR_HOVER"] == pytest.approx(math.sqrt(0.755 * 9.81 / 25))
    with pytest.raises(ScenarioError, match="no px4 that can be run there"):
        launches(flight, "px4", tmp_path, 0, "127.0.0.1", 1.0)


def test_what_contradicts_the_backend_is_usage() -> None:
    for arguments, word in (
        (("fly", "--backend", "gazebo"), "--backend"),
        (("fly", "--launch", "."), "--launch"),
        (("fly", "--backend", "px4", "--firmware", "arducopter"), "contradicts"),
        (("fly", "--backend", "px4", "--launch", "nowhere"), "no px4"),
        (("sitl", "--backend", "px4", "--no-load"), "--no-load"),
    ):
        code, _, err = cablequad(*arguments)
        assert code == 2, arguments
        assert word in err
        assert err.count("\n") == 1


# -- flights -----------------------------------------------------------------------------------------------------------


class Fleet:
    """Stand-ins for the autopilots of a flight."""

    def __init__(self, kinds: str, offset: int, **own: str) -> None:
        """`kinds`: a letter a vehicle, a for ArduPilot and p for PX4; `own`: more arguments, by v1, v2, ..."""
        self.processes = []
        for i, kind in enumerate(kinds):
            physics = 9002 + offset + 10 * i if kind == "a" else 4560 + offset + i
            self.processes.append(
                subprocess.Popen(
                    [
                        sys.executable, str(PEER), "ardupilot" if kind == "a" else "px4", "--instance", str(i),
                        "--physics", str(physics), "--mavlink", str(14540 + offset + i), "--boot", str(1.37 * i),
                        *own.get(f"v{i + 1}", "").split(),
                    ], stderr=subprocess.DEVNULL,
                )
            )  # fmt: skip

    def __enter__(self) -> "Fleet":
        return self

    def __exit__(self, *_: object) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


BACKEND = {"a": "ardupilot", "p": "px4"}


def flies(scenario: str, kinds: str, folder: Path, **own: str) -> dict:
    """`cablequad fly SCENARIO --backend ...` with stand-ins, as fast as they go."""
    offset = next_offset()
    backend = BACKEND[kinds[0]] if len(set(kinds)) == 1 else "mixed"
    with Fleet(kinds, offset, **own):
        return flown(
            scenario, "--backend", backend, "--firmware", "auto", "--speed", "max", "--no-replay", "--out", str(folder),
            "--port-offset", str(offset),
        )  # fmt: skip


def events(s: dict) -> list[tuple[str, str]]:
    return [(e.kind, e.text) for e in read(Path(s["log"])).events]


@pytest.mark.parametrize("kinds", ["aaaa", "pppp"])
def test_four_autopilots_carry_case_1_from_a_held_start(kinds: str, tmp_path: Path) -> None:
    s = flies("paper-case-1-50hz", kinds, tmp_path)
    assert s["exit_code"] == 0, s["reason"]
    assert s["final_position_error_m"] < 0.01  # measured 0.0000 and 0.0003
    assert s["final_e_q"] < (0.05 if kinds == "aaaa" else 0.4)  # measured 0.00 and 0.29; recorded 0.01 and 0.33
    for scale in s["thrust_scale"]:
        assert scale["scale"] == pytest.approx(1.0, abs=0.005)  # measured 0.9987 to 1.0002
    assert s["state_age_ms"] < 5.0  # measured 2.0 and 0.0, of attitudes at four times the control rate
    run = read(Path(s["log"]))
    told = {e.subject: e.text for e in run.events if e.kind == "clock"}
    for i in range(4):
        ahead = 1370 * i - 1000 if kinds[i] == "a" else 0  # it counts from its first answer, at 1 s of the physics
        assert int(told[f"vehicle {i + 1}"].partition("=")[2]) == pytest.approx(ahead, abs=6)
    assert recorded(run)
    code, out, err = cablequad("log", "replay-control", s["log"], "--json")  # the same decisions again, clocks and all
    assert code == 0, err
    assert json.loads(out)["decisions"] > 700


def recorded(run: Run) -> bool:
    """Truth, what the autopilots say, what was sent and PWM are all in the log."""
    said = {
        (way, pb.MavlinkFrame.FromString(data).msgid)
        for way in ("rx", "tx")
        for data in run.frames[f"/mavlink/quad2/{way}"].data
    }
    wanted = {("rx", m) for m in (31, 32, 36, 49)} | {("tx", 82)}  # attitude, position, PWM, origin; setpoints
    return {"/plant/state", "/control/state"} <= set(run.columns) and wanted <= said


@pytest.mark.parametrize("kinds", ["aaaa", "pppp"])
def test_four_autopilots_fly_from_the_ground_to_the_ground(kinds: str, tmp_path: Path) -> None:
    s = flies("ground-to-ground", kinds, tmp_path)
    assert s["exit_code"] == 0, s["reason"]
    assert s["set_down_error_m"] < 0.05  # measured 0.015 to 0.022
    assert s["touch_down_m_s"] < 0.2
    assert s["vehicles_crashed"] == 0
    phases = [text for kind, text in events(s) if kind == "phase"]
    assert phases == [
        "preflight", "arm", "take off", "tension", "lift", "carry", "set down", "release", "land", "disarm"
    ]  # fmt: skip
    code, out, err = cablequad("report", s["log"])
    assert code == 0, err
    assert "Nothing went wrong" in Path(out.strip()).read_text()


def test_two_of_each_carry_it_together_while_two_of_them_are_hostile(tmp_path: Path) -> None:
    s = flies("mixed-fleet", "ppaa", tmp_path, v1="--hostile", v4="--hostile")
    assert s["final_position_error_m"] < 0.01, s["reason"]
    assert s["wire"]["physics_packets_refused"] > 500
    assert s["wire"]["physics_packets_repeated"] > 100


@pytest.mark.parametrize(
    ("scenario", "kinds"),
    [
        ("one-vehicle", "a"), ("one-vehicle", "p"), ("two-vehicles", "aa"), ("two-vehicles", "pp"),
        ("six-vehicles", "pppppp"),
    ],
)  # fmt: skip
def test_one_two_and_six_vehicles_fly_too_though_their_scenarios_suppose_quicker_ones(
    scenario: str, kinds: str, tmp_path: Path
) -> None:
    """40 rad/s at 250 Hz are in the scenario; the law is designed for what the autopilots are known to do."""
    s = flies(scenario, kinds, tmp_path)
    assert s["final_position_error_m"] < 0.03, s["reason"]
    assert s["exit_code"] == 0, s["reason"]


def test_an_autopilot_that_dies_is_named_and_the_others_come_down_in_order(tmp_path: Path) -> None:
    s = flies("ground-to-ground", "pppp", tmp_path, v3="--die-at 8")
    assert s["exit_code"] == 1
    assert "vehicle 3: is silent since t = 8.0" in s["reason"]
    told = events(s)
    (lost,) = [text for kind, text in told if kind == "sitl-autopilot-lost"]
    assert lost.startswith("vehicle 3 (PX4")
    assert lost.endswith("closed its connection; its motors stop")
    assert [text for kind, text in told if kind == "phase"][-2:] == ["land", "disarm"]
    assert read(Path(s["log"])).complete


def test_an_autopilot_that_begins_anew_ends_the_flight_with_its_name(tmp_path: Path) -> None:
    s = flies("paper-case-1-50hz", "aaaa", tmp_path, v2="--restart-at 7")
    assert s["exit_code"] == 1
    assert "vehicle 2" in s["reason"]
    assert any("began anew: its frame count went back" in text for _, text in events(s))
    assert read(Path(s["log"])).complete


def test_sitl_serves_physics_that_fly_connects_to(tmp_path: Path) -> None:
    from conftest import Command, wait_for_line

    offset = next_offset()
    served = Command("sitl", "paper-case-1-50hz", "--backend", "ardupilot", "--port-offset", str(offset))
    wait_for_line(served, "start the autopilots")
    urls = [f"udpin:127.0.0.1:{port + offset}" for port in (14540, 14541, 14542, 14543, 14600)]
    with Fleet("aaaa", offset):
        s = flown(
            "paper-case-1-50hz", *(word for url in urls for word in ("--connect", url)), "--configure", "--no-replay",
            "--duration", "6", "--out", str(tmp_path),
        )  # fmt: skip
        assert "plan flown" in s["reason"] or "asked" in s["reason"]
        assert s["final_position_error_m"] < 0.1
    served.interrupt()
    code, out, _ = served.wait()
    assert code == 0
    assert "stopped after" in out


ARDUCOPTER = """#!{python}
import os, sys
arguments = sys.argv[1:]
after = lambda word: arguments[arguments.index(word) + 1]
assert after("--model") == "JSON:127.0.0.1" and os.path.exists(after("--defaults"))
print("I am", os.getpid(), flush=True)
os.execv(sys.executable, [sys.executable, {peer!r}, "ardupilot", "--instance", str(int(after("--sysid")) - 1),
    "--physics", str(9002 + 10 * int(after("-I"))), "--mavlink", after("--serial0").rsplit(":", 1)[1],
    "--defaults", after("--defaults")])
"""
PX4 = """#!{python}
import os, sys
arguments = sys.argv[1:]
i, etc = int(arguments[arguments.index("-i") + 1]), arguments[-1]
told = [(name[10:], value) for name, value in os.environ.items() if name.startswith("PX4_PARAM_")]
open("told.parm", "w").write("".join(f"{{n}} {{v}}\\n" for n, v in told))
print("I am", os.getpid(), flush=True)
os.execv(sys.executable, [sys.executable, {peer!r}, "px4", "--instance", str(i), "--physics", str(4560 + i),
    "--mavlink", str(14540 + i), "--defaults", "told.parm", "--etc", etc])
"""


def binary(folder: Path, text: str, name: str = "arducopter") -> Path:
    """Something that is started as arducopter, or px4, is."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)
    return path


def build_of_px4(folder: Path) -> Path:
    """A build folder as PX4's: bin/px4, and the start scripts that it needs."""
    scripts = folder / "etc" / "init.d-posix"
    scripts.mkdir(parents=True)
    (scripts / "rcS").write_text("")
    return binary(folder, PX4.format(python=sys.executable, peer=str(PEER)), "bin/px4")


def test_autopilots_are_started_with_their_parameters_and_stopped_by_their_own_process_ids(tmp_path: Path) -> None:
    path = binary(tmp_path, ARDUCOPTER.format(python=sys.executable, peer=str(PEER)))
    offset = next_offset() // 10 * 10
    s = flown(
        "two-vehicles", "--backend", "ardupilot", "--launch", str(path), "--duration", "2", "--no-replay", "--out",
        str(tmp_path), "--port-offset", str(offset), "--speed", "max",
    )  # fmt: skip
    assert s["flown_s"] == pytest.approx(2.0, abs=0.1), s["reason"]
    folder = Path(s["log"]).with_suffix("")
    for k in (1, 2):
        own = folder / f"vehicle-{k}-arducopter"
        assert "FRAME_TYPE 1" in (own / "vehicle.parm").read_text()
        pid = int((own / "autopilot.log").read_text().split()[2])
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_an_autopilot_that_does_not_start_ends_the_run_at_once_with_its_name(tmp_path: Path) -> None:
    path = binary(tmp_path, "#!/bin/sh\necho no such parameter\nexit 3\n")
    offset = next_offset() // 10 * 10
    code, _, err = cablequad(
        "fly", "two-vehicles", "--backend", "ardupilot", "--launch", str(path), "--no-replay", "--out", str(tmp_path),
        "--port-offset", str(offset),
    )  # fmt: skip
    assert code == 1
    assert "vehicle-1-arducopter ended by itself (exit code 3); see its autopilot.log" in err


# -- how vehicles answer -----------------------------------------------------------------------------------------------


def test_a_response_is_found_from_what_was_told_and_how_it_turned() -> None:
    rng = np.random.default_rng(4)
    times = np.arange(0.0, 8.0, 0.02)
    angles = np.where((times[:, None] % 2.0) < 0.5, 0.14, 0.0) * np.array([1.0, -0.7])
    at = np.arange(0.5, 8.0, 0.0173)
    exact = answers(np.array([12.0, 0.8, 0.033]), (times, angles), at, np.zeros(2))
    seen = exact + 0.004 * rng.normal(size=exact.shape)
    (w, z, d), left = fitted((times, angles), at, seen)
    assert w == pytest.approx(12.0, rel=0.05)
    assert z == pytest.approx(0.8, abs=0.06)
    assert d == pytest.approx(0.033, abs=0.008)
    assert left == pytest.approx(0.004, rel=0.1)


def test_a_response_without_noise_is_found_as_an_integrator_of_its_own_made_it() -> None:
    """Delays between the steps of the fit too; no slope of it is lost where a command's stamp is passed."""
    times = np.arange(0.0, 6.0, 0.02)
    angles = np.where((times[:, None] % 2.0) < 0.5, 0.14, 0.0) * np.array([1.0, -0.7])
    at = np.arange(0.5, 6.0, 0.01)
    for w, z, d in ((9.0, 1.07, 0.0123), (14.0, 0.8, 0.0271), (40.0, 0.9, 0.0049)):

        def turning(t: float, y: np.ndarray, w: float = w, z: float = z, d: float = d) -> np.ndarray:
            goal = angles[max(0, int(np.searchsorted(times, t - d, side="right")) - 1)]
            return np.concatenate([y[2:], w * w * (goal - y[:2]) - 2 * z * w * y[2:]])

        start = np.array([0.0, 0.0, 0.0, 0.0])
        made = solve_ivp(turning, (at[0], at[-1]), start, t_eval=at, max_step=0.002, rtol=1e-9, atol=1e-11)
        (found_w, found_z, found_d), left = fitted((times, angles), at, made.y[:2].T)
        assert found_w == pytest.approx(w, rel=3e-3)
        assert found_z == pytest.approx(z, rel=3e-3)
        assert found_d == pytest.approx(d, abs=3e-4)
        assert left < 1e-4


def test_vehicles_are_identified_at_hover_and_the_flight_that_follows_is_designed_for_it(tmp_path: Path) -> None:
    base = scenarios.load("ground-to-ground").scenario
    clean = base.model_copy(
        update={
            "vehicle": base.vehicle.model_copy(update={"rotors": None, "attitude_bandwidth_rad_s": 25.0}),
            "real": base.real.model_copy(update={"thrust_scale": [0.9, 1.0, 1.0, 1.05], "attitude_bandwidth_rad_s": 9.0}),
            "sensors": type(base.sensors)(), "wind": None, "name": "clean",
        }
    )  # fmt: skip
    file = tmp_path / "clean.json"
    file.write_text(clean.model_dump_json())
    code, out, err = cablequad(
        "identify", str(file), "--json", "--out", str(tmp_path), "--port-offset", str(next_offset())
    )
    assert code == 0, err
    told = json.loads(out)
    for vehicle, scale in zip(told["vehicles"], (0.9, 1.0, 1.0, 1.05), strict=True):
        assert vehicle["bandwidth_rad_s"] == pytest.approx(9.0, abs=0.3)  # what flies, not what the scenario said
        assert vehicle["damping"] == pytest.approx(0.9, abs=0.05)
        assert vehicle["delay_s"] == pytest.approx(0.02, abs=0.005)
        assert vehicle["thrust_scale"] == pytest.approx(scale, abs=0.015)
    found = scenarios.load(told["scenario"])
    assert found.airframe.bandwidth == pytest.approx(9.0, abs=0.3)
    assert found.airframe.max_thrust == pytest.approx([22.5, 25.0, 25.0, 26.25], rel=0.015)
    assert found.world.thrust_scale == pytest.approx(
        [1.0] * 4, abs=0.015
    )  # its rotors give what they are now taken for


def test_who_cannot_take_off_cannot_be_identified() -> None:
    code, _, err = cablequad("identify", "paper-case-1")
    assert code == 2
    assert "[ground]" in err


# -- what the first flights with real ones showed ----------------------------------------------------------------------


def names_of(autopilot: str) -> set[str]:
    """The parameters that the real one has, as its own log of a flight lists them."""
    lines = (PEER.parent / f"{autopilot}-parameters.txt").read_text().splitlines()
    return {line.split()[0] for line in lines}


def test_every_parameter_that_is_set_exists() -> None:
    flight = scenarios.load("mixed-fleet")
    for i in range(4):
        assert set(arducopter_values(flight, i)) <= names_of("arducopter")
        assert set(px4_values(flight, i)) <= names_of("px4")


def test_an_accelerometer_that_is_not_there_is_not_calibrated() -> None:
    """SITL has two, and arms with no third one calibrated."""
    assert not [name for name in arducopter_values(scenarios.load("two-vehicles"), 0) if name.startswith("INS_ACC3")]


def test_rotors_give_as_much_less_as_the_air_is_thinner_and_the_law_knows_it() -> None:
    flight = scenarios.load("paper-case-1-50hz")
    thin = behind(flight, ("arducopter", "px4", "arducopter", "px4"))
    ratio = (1.0 - 0.0065 * 488.0 / 288.15) ** 4.2559  # of the standard atmosphere, by its lapse rate
    assert thin.airframe.max_thrust == pytest.approx(ratio * flight.airframe.max_thrust, rel=1e-3)
    assert settings(thin, Serving(False, backend="mixed")).airframe.max_thrust == pytest.approx(ratio * 25.0, rel=1e-3)
    most, known = float(thin.airframe.max_thrust[0]), thin.scenario.vehicle.air_density_ratio
    copter = PROFILES[3].law(most, {"ATC_ANGLE_BOOST": 0.0}, known)
    px4 = PROFILES[12].law(most, {}, known)
    share = copter.field(11.0, 1.0) / known  # ArduCopter divides by the density
    assert share * ratio * 25.0 == pytest.approx(11.0, rel=1e-3)
    assert px4.field(11.0, 1.0) ** 2 * ratio * 25.0 == pytest.approx(11.0, rel=1e-3)


def test_a_scenario_that_says_what_its_air_is_keeps_it(tmp_path: Path) -> None:
    file = tmp_path / "high.toml"
    file.write_text(scenarios.text("two-vehicles").replace("[vehicle]", "[vehicle]\nair_density_ratio = 0.8", 1))
    high = behind(scenarios.load(str(file)), ("px4", "px4"))
    assert high.airframe.max_thrust == pytest.approx(0.8 * 25.0)


def test_the_law_is_designed_for_what_an_autopilot_is_known_to_do_unless_it_was_identified() -> None:
    flight = scenarios.load("two-vehicles")
    known = behind(flight, ("px4", "arducopter"))
    assert known.airframe.bandwidth.tolist() == [10.2, 12.9]
    assert known.scenario.control.delay_ticks == round(0.019 * 250)  # its rotors have no lag
    assert behind(scenarios.load("ground-to-ground"), ("arducopter",) * 4).scenario.control.delay_ticks == 2
    assert any("PX4 is known to answer at 10.2 rad/s" in note for note in known.notes)
    s = flight.scenario
    found = s.model_copy(update={"vehicle": s.vehicle.model_copy(update={"identified": True})})
    kept = behind(flight._replace(scenario=found), ("px4", "arducopter"))
    assert (kept.airframe.bandwidth == flight.airframe.bandwidth).all()


def test_acceptance_that_supposes_perfect_attitudes_is_widened_by_what_the_estimator_does() -> None:
    """Recorded with real ones: e_q, a sum over 20 links, ends at 0.33 with PX4 and at 0.01 with ArduCopter."""
    flight = scenarios.load("paper-case-1")
    asked = flight.scenario.acceptance.model_copy(update={"e_q": 0.1})
    assert asked.link_error_deg == 0.3
    flight = flight._replace(scenario=flight.scenario.model_copy(update={"acceptance": asked}))
    px4 = behind(flight, ("px4",) * 4).scenario.acceptance
    copter = behind(flight, ("arducopter",) * 4).scenario.acceptance
    assert 0.33 < (px4.e_q or 0.0) < 0.6
    assert math.degrees(0.33 / 20) < (px4.link_error_deg or 0.0) < math.degrees(0.6 / 20)
    assert 0.1 <= (copter.e_q or 0.0) < 0.15
    assert 0.3 <= (copter.link_error_deg or 0.0) < 0.45


def test_attitudes_are_asked_for_as_often_as_the_autopilots_send_and_the_links_bear(tmp_path: Path) -> None:
    flight = scenarios.load("paper-case-1-50hz")
    assert behind(flight, ("px4",) * 4).scenario.control.attitude_rate == 4  # 200 Hz of 50
    assert behind(scenarios.load("two-vehicles"), ("px4",) * 2).scenario.control.attitude_rate == 1  # 250 Hz
    slow = tmp_path / "slow.toml"
    slow.write_text(scenarios.text("paper-case-1-50hz") + "\n[faults]\ndown = { rate_bytes_s = 12000.0 }\n")
    assert behind(scenarios.load(str(slow)), ("px4",) * 4).scenario.control.attitude_rate == 2


def test_a_vehicle_that_speaks_between_ticks_is_waited_for_at_ticks_alone() -> None:
    barrier = TickBarrier(2, 200, 20, "full", 4)
    for ms in range(0, 101, 5):
        barrier.feed(1, VehicleAttitude.of(ms, np.eye(3), np.zeros(3)))
        barrier.feed(2, VehicleAttitude.of(ms + 3, np.eye(3), np.zeros(3)))  # at times of its own
        if ms % 20 == 0:
            barrier.feed(200, PayloadState(ms * 1000, np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3)))
            opened = barrier.open()
            assert opened == ms if ms > 20 else opened in (None, ms)
        else:
            assert barrier.open() is None


@pytest.mark.parametrize(("shown", "word"), [(0.2, "is 0.2"), (None, "no such parameter")])
def test_a_parameter_that_was_not_taken_is_named(shown: float | None, word: str) -> None:
    readback = Readback({"MC_YAWRATE_P": 0.378, "SDLOG_MODE": -1.0})
    for k in range(60):
        for asked in readback.due(1, 0.1 * k):
            if asked.name == "SDLOG_MODE":
                readback.take(ParamValue("SDLOG_MODE", param_bits(-1), 6, 9, 0), bytewise=True)
            elif shown is not None:
                readback.take(ParamValue("MC_YAWRATE_P", shown, 9, 9, 0), bytewise=True)
    assert readback.done
    (text,) = readback.wrong
    assert text.startswith("MC_YAWRATE_P: it was set to 0.378")
    assert word in text


def test_a_parameter_of_the_firmware_itself_goes_through_and_is_read_back(tmp_path: Path) -> None:
    """Our own vehicles have no SDLOG_MODE and refuse it; PX4 has no MOT_THST_EXPO and says nothing, which is told."""
    file = tmp_path / "own.toml"
    text = scenarios.text("two-vehicles").replace("duration_s", "# duration_s", 1)
    file.write_text("duration_s = 60.0\n" + text + "\n[vehicle.parameters]\nSDLOG_MODE = 0\nMOT_THST_EXPO = 0.5\n")
    code, _, err = cablequad("fly", str(file))
    assert code == 2
    assert "SDLOG_MODE" in err
    flight = scenarios.load(str(file), external=True)
    assert started_with(flight, "px4", 0)["SDLOG_MODE"] == 0.0
    path = build_of_px4(tmp_path / "build")
    (start, *_) = launches(flight, "px4", path, 0, "127.0.0.1", 1.0)
    assert start.environment["PX4_PARAM_SDLOG_MODE"] == "0"


def test_every_line_that_is_printed_runs_as_printed(tmp_path: Path) -> None:
    """In a shell, in its folder, with the autopilots on the PATH: what the stand-ins refuse, the real ones do."""
    px4 = build_of_px4(tmp_path / "build")
    binary(px4.parent, ARDUCOPTER.format(python=sys.executable, peer=str(PEER)))
    flight = behind(scenarios.load("mixed-fleet"), scenarios.load("mixed-fleet").firmware)
    lines = start_lines(launches(flight, "mixed", None, 0, "127.0.0.1", 1.0), tmp_path / "flown here")
    path = f"{px4.parent}{os.pathsep}{os.environ['PATH']}"
    for line in lines:
        process = subprocess.Popen(
            ["sh", "-c", line], env={**os.environ, "PATH": path}, cwd=tmp_path, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        try:
            out, _ = process.communicate(timeout=1.5)
            raise AssertionError(f"{line}\n{out}")  # it ended by itself
        except subprocess.TimeoutExpired:
            pass
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    assert not list(tmp_path.glob("**/etc/etc"))


def test_one_that_stalls_is_waited_for_and_the_flight_goes_on(tmp_path: Path) -> None:
    """Stopped for four seconds in flight: no verdict comes of it."""
    offset = next_offset()
    with Fleet("pp", offset) as fleet:
        flying = Command(
            "fly", "two-vehicles", "--backend", "px4", "--speed", "max", "--no-replay", "--json", "--out",
            str(tmp_path), "--port-offset", str(offset),
        )  # fmt: skip
        time.sleep(12.0)
        os.kill(fleet.processes[1].pid, signal.SIGSTOP)
        time.sleep(4.0)
        os.kill(fleet.processes[1].pid, signal.SIGCONT)
        _, out, err = flying.wait(120.0)
    s = json.loads(out)
    assert s["tested"], err
    assert s["flown_s"] == pytest.approx(12.0, abs=0.1)  # to its end
    assert s["final_position_error_m"] < 0.03


def test_one_that_hangs_for_good_leaves_the_flight_untested(tmp_path: Path) -> None:
    offset = next_offset()
    with Fleet("aa", offset) as fleet:
        flying = Command(
            "fly", "two-vehicles", "--backend", "ardupilot", "--no-replay", "--json", "--out", str(tmp_path),
            "--port-offset", str(offset), "--stall-timeout", "4",
        )  # fmt: skip
        time.sleep(12.0)
        os.kill(fleet.processes[1].pid, signal.SIGSTOP)
        code, out, err = flying.wait(120.0)
    assert code == 3, err
    s = json.loads(out)
    assert not s["tested"]
    assert "not tested: vehicle 2 (ArduPilot" in s["reason"]
    assert "it still runs" in s["reason"]


def test_an_ardupilot_that_is_killed_is_known_at_once_by_its_closed_port(tmp_path: Path) -> None:
    s = flies("ground-to-ground", "aaaa", tmp_path, v3="--die-at 12")
    assert s["exit_code"] == 1
    told = events(s)
    (lost,) = [text for kind, text in told if kind == "sitl-autopilot-lost"]
    assert "no longer runs: its port is closed" in lost
    assert [text for kind, text in told if kind == "phase"][-2:] == ["land", "disarm"]
    fates = [text for kind, text in told if kind == "fate"]
    assert len(fates) == 4
    assert sum("lost in phase" in text for text in fates) == 1


@pytest.mark.parametrize(("kinds", "response"), [("pppp", (9.0, 1.0, 0.012)), ("aaaa", (14.0, 0.8, 0.022))])
def test_identify_finds_what_the_autopilots_answer_with_at_fifty_hertz_and_streams_of_their_own_phase(
    kinds: str, response: tuple[float, float, float], tmp_path: Path
) -> None:
    """Rotors without lag, so that it is their own; a setpoint is on its way for 2 to 8 ms, as both keep their own time."""
    base = scenarios.load("ground-to-ground").scenario
    quick = base.model_copy(
        update={"vehicle": base.vehicle.model_copy(update={"rotors": None}), "wind": None, "name": "quick"}
    )
    file = tmp_path / "quick.json"
    file.write_text(quick.model_dump_json(exclude_unset=True))
    w, z, d = response
    own = {f"v{k + 1}": f"--bandwidth {w} --damping {z} --delay {d}" for k in range(4)}
    offset = next_offset()
    with Fleet(kinds, offset, **own):
        code, out, err = cablequad(
            "identify", str(file), "--backend", BACKEND[kinds[0]], "--json", "--out", str(tmp_path), "--port-offset",
            str(offset),
        )  # fmt: skip
    assert code == 0, err
    for vehicle in json.loads(out)["vehicles"]:
        assert vehicle["bandwidth_rad_s"] == pytest.approx(w, abs=0.3)
        assert vehicle["damping"] == pytest.approx(z, abs=0.05)
        assert vehicle["delay_s"] == pytest.approx(d + 0.005, abs=0.005)
        assert vehicle["thrust_scale"] == pytest.approx(1.0, abs=0.015)
    assert json.loads(out)["scenario"].endswith("quick-identified.json")
