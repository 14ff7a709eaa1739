"""Whole flights over links that fail, are signed, or are TCP; and who is refused on the way."""

import json
import socket
import time
from importlib import resources
from pathlib import Path

import pytest
from conftest import Command, cablequad, flown, wait_for_line

from bridge.wire.dialect import mavlink
from bridge.wire.frames import SIGNING_EPOCH_S, Signer, frame
from bridge.wire.link import Endpoint, Link
from bridge.wire.messages import encode
from bridge.wire.signing_keys import read_key
from bridge.wire.values import Command as Asked
from bridge.wire.values import Heartbeat
from logs.reading.records import entries
from logs.schema import cablequad_pb2 as pb

HOSTILE = """

[faults]
down = { loss = 0.1, jitter_ms = 10, duplicate = 0.05 }
up = { loss = 0.1, jitter_ms = 10, burst_loss = 0.02 }
tracker = { loss = 0.1, jitter_ms = 10, reorder = 0.05 }

[[faults.vehicles]]
vehicle = 3
up = { delay_ms = 4 }

[[faults.cuts]]
vehicle = 1
from_s = 0.5
to_s = 1.0
"""


def case_1(tmp_path: Path, more: str = "", **changes: str) -> str:
    text = (resources.files("missions") / "scenarios" / "paper-case-1.toml").read_text()
    for old, new in changes.items():
        text = text.replace(old, new)
    path = tmp_path / "case.toml"
    path.write_text(text + more)
    return str(path)


def test_an_arducopter_fleet_flies_case_1_as_px4_does(tmp_path: Path, offset: int) -> None:
    s = flown("--firmware", "arducopter", "--no-replay", "--out", str(tmp_path), "--port-offset", str(offset))
    assert s["passed"], s["reason"]
    assert s["final_position_error_m"] < 0.001
    assert s["predicted_ticks"] == 0
    for k in s["thrust_scale"]:  # found in flight: newtons made per newton asked
        assert k["scale"] == pytest.approx(1.0, abs=2e-3)
        assert k["error"] < 1e-3


def test_two_of_each_with_the_response_of_stock_firmware_fly_together(tmp_path: Path, offset: int) -> None:
    s = flown("mixed-fleet", "--no-replay", "--out", str(tmp_path), "--port-offset", str(offset))
    assert s["passed"], s["reason"]


def test_weak_rotors_are_found_in_flight(tmp_path: Path, offset: int) -> None:
    """The bridge believes in 25 N; vehicle 2 was built with 22.5."""
    text = case_1(tmp_path)
    built = Path(text).with_name("built.toml")
    built.write_text(Path(text).read_text().replace(
        "attachment_m = [0.3, 0.4, -0.1]", "attachment_m = [0.3, 0.4, -0.1]\nmax_thrust_N = 22.5"))  # fmt: skip
    server = Command("sitl", str(built), "--port-offset", str(offset), "--speed", "max")
    try:
        wait_for_line(server, "lockstep")
        ends = [f"udpin:127.0.0.1:{port + offset}" for port in (14540, 14541, 14542, 14543, 14600)]
        s = flown("--no-replay", "--duration", "6", "--out", str(tmp_path), *(f"--connect={e}" for e in ends))
    finally:
        server.interrupt()
        server.wait()
    scales = [k["scale"] for k in s["thrust_scale"]]
    assert scales[1] == pytest.approx(0.9, abs=0.005)
    assert scales[0] == pytest.approx(1.0, abs=0.01)


def test_a_hostile_link_is_flown_and_fails_the_same_way_twice(tmp_path: Path, offset: int) -> None:
    logs = []
    for k in range(2):
        s = flown(case_1(tmp_path, HOSTILE), "--no-replay", "--duration", "4", "--out", str(tmp_path / str(k)),
                  "--port-offset", str(offset + 100 * k), sockets=k == 0)  # fmt: skip
        assert s["flown_s"] == pytest.approx(4.0)
        assert s["max_psi"] < 0.5
        assert s["predicted_ticks"] > 500
        w = s["wire"]
        assert w["down_sent"] == w["down_received"]
        assert w["down_received"] + w["down_duplicated"] == w["down_passed"] + w["down_lost"] + w["down_waiting"]
        assert w["up_received"] + w["up_duplicated"] == w["up_passed"] + w["up_lost"] + w["up_waiting"]
        logs.append([(e.topic, e.log_time, e.data) for e in entries(Path(s["log"])) if e.topic != "/perf"])
    assert logs[0] == logs[1]


@pytest.mark.alone
def test_the_same_faults_work_in_real_time(tmp_path: Path, offset: int) -> None:
    s = flown(case_1(tmp_path, HOSTILE), "--no-replay", "--duration", "4", "--speed", "1", "--out", str(tmp_path),
              "--port-offset", str(offset))  # fmt: skip
    assert s["flown_s"] == pytest.approx(4.0)
    assert s["max_psi"] < 0.5
    assert s["wire"]["down_lost"] > 100


@pytest.mark.alone
def test_served_faults_reach_clients_that_have_none_of_their_own(tmp_path: Path, offset: int) -> None:
    quiet = case_1(tmp_path, "\n\n[faults]\ndown = { loss = 0.5 }\n")
    code, _, err = cablequad("sitl", quiet, "--faults", "--speed", "max")
    assert (code, "give a --speed" in err) == (2, True)
    server = Command("sitl", quiet, "--faults", "--speed", "1", "--port-offset", str(offset))
    link = Link([Endpoint(("127.0.0.1", 14540 + offset), None)])
    try:
        wait_for_line(server, "x real time")
        until, heard = time.monotonic() + 4, 0
        while time.monotonic() < until:
            heard += sum(f.msgid == 30 for f in link.poll(0.1))
    finally:
        link.close()
        server.interrupt()
        server.wait()
    assert heard / 4 == pytest.approx(50, rel=0.3)  # of 100 a second


def test_a_signed_fleet_is_flown_with_the_key_alone(tmp_path: Path, offset: int) -> None:
    key = tmp_path / "key"
    assert cablequad("signing-key", str(key))[0] == 0
    assert key.stat().st_mode & 0o077 == 0
    logs = []
    for sockets in (True, False):
        s = flown("--signing-key", str(key), "--no-replay", "--duration", "2", "--out", str(tmp_path / str(sockets)),
                  "--port-offset", str(offset), sockets=sockets)  # fmt: skip
        assert s["flown_s"] == pytest.approx(2.0)
        logs.append([(e.topic, e.log_time, e.data) for e in entries(Path(s["log"])) if e.topic != "/perf"])
    frames = [pb.MavlinkFrame.FromString(data).frame for topic, _, data in logs[0] if "/mavlink/" in topic]
    assert len(frames) > 5000
    assert all(
        whole[0] == 0xFD and whole[2] & 1 for whole in frames
    )  # every one of them, both ways, carries a signature
    assert logs[0] == logs[1]  # signatures are dated by simulated time
    stamps = [int.from_bytes(whole[-12:-6], "little") for whole in frames]
    since_2015_s = 1_700_000_000 - SIGNING_EPOCH_S
    assert since_2015_s <= min(stamps) * 1e-5
    assert max(stamps) * 1e-5 < since_2015_s + 20.0


def test_commands_without_the_key_are_refused_and_counted(tmp_path: Path, offset: int) -> None:
    key = tmp_path / "key"
    cablequad("signing-key", str(key))
    server = Command("sitl", "--signing-key", str(key), "--no-load", "--port-offset", str(offset))
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.bind(("127.0.0.1", 14540 + offset))
    client.settimeout(0.2)
    codec = mavlink.MAVLink(None)
    arm = encode(Asked(1, 1, 400, (1.0, 0, 0, 0, 0, 0, 0)))

    def armed(signer: Signer | None, seconds: float) -> bool:
        until, seq = time.monotonic() + seconds, 0
        while time.monotonic() < until:
            if signer is not None:
                signer.at(time.time())
            seq += 1
            client.sendto(frame(arm, seq & 255, 255, 190, signer), ("127.0.0.1", 14580 + offset))
            try:
                datagram = client.recv(65536)
            except TimeoutError:
                continue
            codec.robust_parsing = True
            heard = codec.parse_buffer(datagram) or []
            if any(m.get_type() == "HEARTBEAT" and m.base_mode & 128 for m in heard):
                return True
        return False

    try:
        wait_for_line(server, "x real time")
        assert not armed(None, 4.0)
        assert not armed(Signer(bytes(32)), 2.0)
        assert armed(Signer(read_key(key)), 8.0)
    finally:
        client.close()
        server.interrupt()
        _, out, _ = server.wait()
    assert "unsigned" in out
    assert "wrongly signed" in out
    assert " 0 unsigned" not in out


@pytest.mark.parametrize(
    ("prepare", "why"),
    [
        (lambda path: None, "make one with"),
        (lambda path: [path.write_bytes(b"k" * 32), path.chmod(0o644)], "chmod 600"),
        (lambda path: [path.write_bytes(b"short"), path.chmod(0o600)], "32 bytes"),
    ],
)
def test_a_key_file_that_cannot_be_used_is_a_usage_error(tmp_path: Path, prepare: object, why: str) -> None:
    path = tmp_path / "key"
    prepare(path)  # type: ignore[operator]
    code, _, err = cablequad("fly", "--signing-key", str(path))
    assert code == 2
    assert str(path) in err
    assert why in err
    assert err.count("\n") == 1


def test_an_arducopter_fleet_is_flown_over_its_tcp_ports(tmp_path: Path, offset: int) -> None:
    server = Command("sitl", "--firmware", "arducopter", "--speed", "max", "--port-offset", str(offset))
    try:
        wait_for_line(server, "lockstep")
        ends = [f"tcp:127.0.0.1:{5760 + 10 * i + offset}" for i in range(4)] + [f"udpin:127.0.0.1:{14600 + offset}"]
        s = flown("--no-replay", "--configure", "--out", str(tmp_path), *(f"--connect={e}" for e in ends))
    finally:
        server.interrupt()
        server.wait()
    assert s["passed"], s["reason"]


def test_two_vehicles_with_one_system_id_are_named_and_refused(tmp_path: Path, offset: int) -> None:
    server = Command("sitl", "--port-offset", str(offset), "--speed", "max")
    stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    flying = None
    try:
        wait_for_line(server, "lockstep")
        ends = [f"udpin:127.0.0.1:{port + offset}" for port in (14540, 14541, 14542, 14543, 14600)]
        flying = Command("fly", "--no-replay", "--json", "--out", str(tmp_path), *(f"--connect={e}" for e in ends))
        until = time.monotonic() + 60
        while flying.process.poll() is None and time.monotonic() < until:
            stranger.sendto(frame(encode(Heartbeat(2, 12, 29, 0, 3)), 0, 2, 1), ("127.0.0.1", 14540 + offset))
            time.sleep(0.05)
        code, out, err = flying.wait()
    finally:
        stranger.close()
        server.interrupt()
        server.wait()
    assert code == 1
    assert "two vehicles have system id 2" in err
    assert not json.loads(out)["passed"]
