"""Values <-> messages, and the bytes of a link."""

import math
import socket
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.fleet.setpoint_batch import Setpoints, WireError
from bridge.wire import generate, poller
from bridge.wire.dialect import CABLE_STATE, mavlink
from bridge.wire.frames import Packed, Signer, Verdict, fields, frame, packed
from bridge.wire.link import Endpoint, Link, LinkError
from bridge.wire.messages import decode, encode, param_bits, param_int, reread
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
from cablequad.model import lie
from cablequad.model.earth import Home
from cablequad.model.instant import row
from cablequad.model.state import State
from sitl.firmware.attitude_batch import Attitudes
from sitl.firmware.telemetry import BUILD, Snapshot
from sitl.tracker_batch import LoadReport


def over_the_wire(value: object) -> Any:
    return reread(encode(value))


def equal(a: object, b: object) -> None:
    assert type(a) is type(b)
    for x, y in zip(a, b, strict=True):  # type: ignore[call-overload]
        if isinstance(x, np.ndarray):
            np.testing.assert_allclose(x, y, rtol=0, atol=1e-6)
        elif isinstance(x, float | tuple):
            assert y == pytest.approx(x, rel=1e-6, abs=1e-6)
        else:
            assert x == y


R = lie.exp(np.array([0.3, -0.4, 2.1]))
V = np.array([0.25, -1.5, 3.0])


@pytest.mark.parametrize(
    "value",
    [
        Heartbeat(2, 12, 209, 6 << 16, 4),
        VehicleAttitude.of(123456, R, V),
        VehiclePosition(5, V, -V),
        PayloadState(10**9, V, -V, R, 2 * V),
        CableShape(4000, 3, 2, 0, 1.25, np.hstack([np.eye(3)[:2], np.eye(3)[1:]])),
        AttitudeTarget(99, 4, 1, 7, (0.5, 0.5, -0.5, 0.5), (0.1, 0.2, 0.3), 0.6),
        Command(2, 1, 400, (1.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        CommandAck(400, 1, 250, 191),
        SetMode(3, 1, 6 << 16),
        ParamRequestRead(1, 1, "THR_MDL_FAC", -1),
        ParamRequestList(1, 1),
        ParamSet(1, 1, "MPC_THR_HOVER", 0.5, 9),
        ParamValue("A234567890123456", 1.5, 9, 20, 3),
        Timesync(0, 123456789012345),
        Ping(1, 2, 0, 0),
        StatusText(4, "Arming denied"),
        LandedState(2),
        MissionRequestList(1, 1),
        MissionCount(250, 191, 0),
        ServerVersion(0xE8FF, (1, 16, 0), 3),
    ],
    ids=lambda v: type(v).__name__,
)
def test_every_value_survives_the_wire(value: object) -> None:
    equal(value, over_the_wire(value))


def test_the_committed_dialect_is_what_the_generator_writes() -> None:
    assert Path(generate.MODULE).read_text() == generate.generate()


def test_stock_parsers_skip_cable_state_and_ours_reads_it() -> None:
    assert mavlink.mavlink_map[53100] is CABLE_STATE
    assert CABLE_STATE.unpacker.size == 255


@given(st.lists(st.integers(1, 35), min_size=1, max_size=4))
def test_cables_of_any_length_arrive_whole(n_links: list[int]) -> None:
    rng = np.random.default_rng(n_links)
    n, L = len(n_links), max(n_links)
    q, omega, tension = rng.normal(size=(n, L, 3)), rng.normal(size=(n, L, 3)), rng.normal(size=(n, L))
    report = LoadReport(np.array(n_links))
    still, m = np.zeros((n, 3)), rng.normal(size=(6, 3))
    for _ in range(2):  # nothing of the tick before is left
        q, omega = -q, omega + 1.0
        s = State(m[0], m[1], lie.exp(m[2]), m[3], q, omega, np.zeros((n, 3, 3)), still)
        report.tell(8000, row(s, still, still, tension, np.zeros(n)))
        frames = report.framed(bytes(range(len(report))), b"\x07" * len(report), 191, 0)
    messages: list[Any] = [decode(msgid, whole) for msgid, whole in zip(report.msgids, frames, strict=True)]
    *parts, load = messages
    for i, k in enumerate(n_links):
        own = [p for p in parts if p.cable == i + 1]
        assert [p.first_link for p in own] == list(range(0, k, 10))
        assert {(p.boot_us, p.n_links, p.tension_N) for p in own} == {(8000, k, np.float32(tension[i, k - 1]))}
        np.testing.assert_allclose(np.concatenate([p.q for p in own]), q[i, :k], rtol=0, atol=1e-6)
        np.testing.assert_allclose(np.concatenate([p.omega for p in own]), omega[i, :k], rtol=0, atol=1e-6)
    np.testing.assert_allclose(load.x0, s.x0, atol=1e-6)
    whole = [*parts, PayloadState(8000, s.x0, s.v0, s.R0, s.Omega0)]
    assert frames == [frame(encode(value), k, 7, 191) for k, value in enumerate(whole)]


@given(st.lists(st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4), min_size=1, max_size=12), st.integers(0, 2**31))
def test_setpoints_of_a_fleet_are_those_of_its_vehicles_one_by_one(asked: list[list[float]], boot_ms: int) -> None:
    R_c = np.array([lie.exp(np.array(turn)) for *turn, _ in asked])
    thrust, batch = [abs(t) / 3.0 for *_, t in asked], Setpoints(len(asked))
    batch.tell(boot_ms, R_c, thrust)
    n = len(batch)
    for k, whole in enumerate(batch.framed(bytes(range(n)), bytes([250]) * n, 191, 0)):
        quat = lie.wxyz_from_rotation(R_c[k])
        one = AttitudeTarget(boot_ms, k + 1, 1, 7, quat, (0.0, 0.0, 0.0), thrust[k])
        assert whole == frame(encode(one), k, 250, 191)


@given(st.lists(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), min_size=1, max_size=12), st.integers(0, 2**31))
def test_attitudes_of_a_fleet_are_those_of_its_vehicles_one_by_one(moving: list[list[float]], boot_ms: int) -> None:
    all_R, rates = [lie.exp(np.array(m[:3])) for m in moving], [np.array(m[3:]) for m in moving]
    batch = Attitudes(len(moving) + 2)  # not all have something to say
    for k in (len(moving), 1):
        batch.tell(boot_ms, all_R[:k], rates[:k])
        frames = batch.framed(bytes(range(k)), bytes(range(1, k + 1)), 1, 0)
        told = [VehicleAttitude.of(boot_ms, own, Omega) for own, Omega in zip(all_R[:k], rates, strict=False)]
        assert frames == [frame(encode(one), i, i + 1, 1) for i, one in enumerate(told)]


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_setpoint_that_is_not_finite_never_becomes_a_message(wrong: float) -> None:
    level, batch = np.tile(np.eye(3), (3, 1, 1)), Setpoints(3)
    with pytest.raises(WireError, match="vehicle 2: non-finite setpoint"):
        batch.tell(4, level, [0.5, wrong, 0.5])
    level[2, 0, 1] = wrong
    with pytest.raises(WireError, match="vehicle 3"):
        batch.tell(4, level, [0.5, 0.5, 0.5])


@given(st.integers(-(2**31), 2**31 - 1))
def test_integer_parameters_travel_as_their_bits(value: int) -> None:
    if struct.unpack("<I", struct.pack("<i", value))[0] & 0x7F800000 != 0x7F800000:  # bits of a NaN are not kept
        assert param_int(param_bits(value)) == value


def test_every_streamed_message_can_be_built_and_packed() -> None:
    snapshot = Snapshot(10**6, R, V, V, V, V, 0.6, True, 2, (R, V, 0.5), Home())
    codec = mavlink.MAVLink(None, 1, 1)
    for msgid, build in BUILD.items():
        message = codec.decode(bytearray(frame(build(snapshot), 3, 1, 1)))
        assert message.get_msgId() == msgid
        codec.seq = 3
        assert bytes(message.pack(codec)) == frame(build(snapshot), 3, 1, 1)  # byte for byte as pymavlink packs it


def pymavlinks(value: object) -> bytes:
    """The frame that pymavlink's own objects make of a value."""
    codec = mavlink.MAVLink(None, 9, 1)
    codec.seq = 77
    return bytes(codec.decode(bytearray(frame(encode(value), 77, 9, 1))).pack(codec))


@given(st.lists(st.floats(-50, 50, width=32), min_size=12, max_size=12), st.integers(0, 2**32 - 1))
def test_the_quick_codec_and_pymavlink_make_the_same_bytes(v: list[float], boot_ms: int) -> None:
    """Both directions: what we frame is what pymavlink frames from the same fields, cut zeros included."""
    turn, a, b = lie.exp(np.array(v[0:3])), np.array(v[3:6]), np.array(v[6:9])
    values = (
        VehicleAttitude.of(boot_ms, turn, a),
        VehiclePosition(boot_ms, a, np.zeros(3)),
        PayloadState(boot_ms, a, b, turn, a),
        CableShape(boot_ms, 1, 1, 0, v[9], np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])),
        AttitudeTarget(boot_ms, 3, 1, 7, (1.0, 0.0, 0.0, 0.0), (v[9], v[10], v[11]), 0.5),
    )
    for value in values:
        assert frame(encode(value), 77, 9, 1) == pymavlinks(value)


@given(st.sampled_from(sorted(mavlink.mavlink_map)), st.binary(min_size=1, max_size=255))
def test_fields_by_name_are_those_of_pymavlinks_objects(msgid: int, payload: bytes) -> None:
    """Also of payloads that were cut, and back again into the same bytes."""
    kind = mavlink.mavlink_map[msgid]
    payload = payload[: kind.unpacker.size]
    theirs = mavlink.MAVLink(None).decode(bytearray(frame(Packed(msgid, "", kind.crc_extra, payload), 0, 1, 1)))
    ours = fields(kind, payload)
    for name in kind.fieldnames:
        value, wanted = getattr(ours, name), getattr(theirs, f"_{name}_raw", getattr(theirs, name))
        assert repr(list(value) if isinstance(value, tuple) else value) == repr(wanted)
    again = packed(kind, *(getattr(ours, name) for name in kind.fieldnames))
    assert repr(fields(kind, again.payload)) == repr(ours)


@pytest.mark.parametrize(("frame_kind", "place"), [(6, (47.5, -8.25)), (1, (12.5, -3.25))])
def test_command_int_asks_what_command_long_does(frame_kind: int, place: tuple[float, float]) -> None:
    """Its integers are degrees in 1e-7 in global frames, metres in 1e-4 in local ones."""
    scale = 1e7 if frame_kind == 6 else 1e4
    where = (round(place[0] * scale), round(place[1] * scale), 9.0)
    kind = mavlink.MAVLink_command_int_message
    whole = packed(kind, 3, 1, frame_kind, 400, 0, 0, 1.0, 21196.0, 0.0, 0.5, *where)
    asked = reread(whole)
    near: list[Any] = [pytest.approx(p) for p in place]
    assert asked == Command(3, 1, 400, (1.0, 21196.0, 0.0, 0.5, near[0], near[1], 9.0), 0, frame_kind)


def test_signed_frames_are_those_of_pymavlink() -> None:
    key = bytes(range(32))
    signer, codec = Signer(key), mavlink.MAVLink(None, 9, 1)
    signer.stamp = 1234
    codec.signing.secret_key, codec.signing.link_id, codec.signing.timestamp = key, 5, 1235
    codec.signing.sign_outgoing = True
    beat = mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 3, 3)
    assert frame(packed(mavlink.MAVLink_heartbeat_message, 2, 12, 1, 0, 3, 3), 0, 9, 1, signer, 5) == bytes(
        beat.pack(codec)
    )


def test_signatures_are_believed_only_once_and_only_when_they_are_right() -> None:
    key, beat = b"k" * 32, encode(Heartbeat(2, 12, 1, 0, 3))
    sender, receiver = Signer(key), Signer(key)
    sender.at(1.8e9)
    receiver.at(1.8e9)
    first, second = frame(beat, 0, 9, 1, sender), frame(beat, 1, 9, 1, sender)
    forged = bytearray(second)
    forged[-7:-1] = b"\xff" * 6  # a stamp from the far future, and no key
    assert receiver.judge(bytes(forged)) is Verdict.WRONG
    assert receiver.judge(first) is Verdict.GOOD  # the forgery has not moved the clock
    assert receiver.judge(first) is Verdict.REPLAYED
    assert receiver.judge(second) is Verdict.GOOD
    assert receiver.judge(frame(beat, 2, 9, 1)) is Verdict.UNSIGNED
    assert receiver.judge(frame(beat, 2, 9, 1, Signer(b"x" * 32))) is Verdict.WRONG
    old = Signer(key)
    old.at(1.8e9 - 120)  # a recording of two minutes ago, on a stream not heard before
    assert receiver.judge(frame(beat, 0, 9, 1, old, 7)) is Verdict.STALE


class TestLink:
    """UDP datagrams in, checked frames out."""

    def pair(self, offset: int) -> tuple[Link, socket.socket, tuple[str, int]]:
        address = ("127.0.0.1", 21000 + offset)
        other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        other.bind(("127.0.0.1", 0))
        return Link([Endpoint(address, None)]), other, address

    def frame(self, seq: int, value: object = Heartbeat(2, 12, 1, 0, 3)) -> bytes:
        return frame(encode(value), seq, 9, 1)

    def test_frames_come_out_with_their_header(self, offset: int) -> None:
        link, other, address = self.pair(offset)
        other.sendto(self.frame(3) + self.frame(4, Timesync(0, 5)), address)
        first, second = link.poll(1.0)
        assert (first.system, first.component, first.seq, first.name) == (9, 1, 3, "HEARTBEAT")
        assert second.value == Timesync(0, 5)
        link.close()

    def test_damage_costs_only_the_damaged_frame(self, offset: int) -> None:
        link, other, address = self.pair(offset)
        good = self.frame(0)
        broken = bytearray(good)
        broken[12] ^= 0x40
        for datagram in (
            b"",
            b"\xfd",
            b"\x00" * 300,
            bytes(broken),
            good[:-1],
            b"\xfd\xff" + good,
            bytes(broken) + good,
        ):
            other.sendto(datagram, address)
        other.sendto(good, address)
        frames = []
        for _ in range(5):
            frames += link.poll(0.05)
        assert [f.name for f in frames].count("HEARTBEAT") >= 2
        assert link.counters.bad > 0
        link.close()

    def test_gaps_in_the_sequence_are_counted_as_lost(self, offset: int) -> None:
        link, other, address = self.pair(offset)
        for seq in (250, 251, 254, 255, 0, 3):
            other.sendto(self.frame(seq), address)
        got = []
        for _ in range(3):
            got += link.poll(0.05)
        assert len(got) == 6
        assert sum(link.counters.lost_from.values()) == 4
        link.close()

    def test_a_port_in_use_is_named(self, offset: int) -> None:
        link, _, address = self.pair(offset)
        with pytest.raises(LinkError, match=f"udp 127.0.0.1:{address[1]}.*in use"):
            Link([Endpoint(address, None)])
        link.close()

    @pytest.mark.parametrize(
        "url", ["", "14540", "tcp:1.2.3.4", "tcpin::70", "udpin:localhost", "udpin:h:99999", "serial:/dev/x:9"]
    )
    def test_addresses_that_make_no_sense_say_how_to_write_them(self, url: str) -> None:
        with pytest.raises(LinkError, match="udpin:HOST:PORT"):
            Endpoint.parse(url)

    def test_sequence_numbers_count_per_sender_and_port(self, offset: int) -> None:
        link, other, address = self.pair(offset)
        beat = encode(Heartbeat(2, 12, 1, 0, 3))
        to = other.getsockname()
        seqs = [link.put(0, system, 1, beat, to)[0] for system in (1, 2, 1, 1, 2)]
        assert seqs == [0, 0, 1, 2, 1]
        link.close()
        assert address

    def test_a_burst_goes_out_in_the_order_of_ports_whatever_was_queued_first(self) -> None:
        """So that what closes it is the last to arrive."""
        other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        other.bind(("127.0.0.1", 0))
        other.settimeout(1.0)
        link = Link([Endpoint(None, other.getsockname())] * 3)
        for port in (2, 0, 1):
            link.put(port, port + 1, 1, encode(Heartbeat(2, 12, 1, 0, 3)))
        link.flush()
        assert [other.recv(100)[5] for _ in range(3)] == [1, 2, 3]
        link.close()
        other.close()

    def test_a_system_without_epoll_is_served_as_well(self, offset: int, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(poller, "_EPOLL", None)
        link, other, address = self.pair(offset)
        assert link.poll(0.005) == []
        other.sendto(frame(encode(Heartbeat(2, 12, 1, 0, 3)), 0, 7, 1), address)
        assert [f.system for f in link.poll(0.5)] == [7]
        link.close()
        other.close()

    def test_frames_of_one_breath_share_a_datagram(self, offset: int) -> None:
        link, other, address = self.pair(offset)
        for _ in range(3):
            link.put(0, 1, 1, encode(Heartbeat(2, 12, 1, 0, 3)), other.getsockname())
        link.flush()
        datagram = other.recv(2000)
        assert len(datagram) == 3 * 21
        assert [f[4] for f in (datagram[0:21], datagram[21:42], datagram[42:63])] == [0, 1, 2]
        link.close()
        assert address

    def test_a_key_refuses_commands_without_signature_and_may_let_telemetry_pass(self, offset: int) -> None:
        _, other, _ = self.pair(offset)
        address = ("127.0.0.1", 21500 + offset)
        key = b"k" * 32
        link = Link([Endpoint(address, None)], Signer(key, accept_unsigned_telemetry=True))
        signer = Signer(key)
        signer.at(time.time())
        command = Command(1, 1, 400, (1.0, 0, 0, 0, 0, 0, 0))
        other.sendto(self.frame(0) + self.frame(1, command) + frame(encode(command), 2, 9, 1, signer), address)
        other.sendto(frame(encode(command), 3, 9, 1, Signer(b"x" * 32)), address)
        got = [f for _ in range(3) for f in link.poll(0.05)]
        assert [f.name for f in got] == ["HEARTBEAT", "COMMAND_LONG"]
        assert {why: count for why, count in link.counters.refused.items() if count} == {
            Verdict.UNSIGNED: 1,
            Verdict.WRONG: 1,
        }
        link.close()

    def test_tcp_carries_frames_however_they_are_cut(self, offset: int) -> None:
        server = Link([Endpoint.parse(f"tcpin:127.0.0.1:{22000 + offset}")])
        client = Link([Endpoint.parse(f"tcp:127.0.0.1:{22000 + offset}")])
        client.poll(0.0)  # connects
        server.poll(0.1)
        raw = socket.create_connection(("127.0.0.1", 22000 + offset))
        server.poll(0.1)
        whole = self.frame(0) + self.frame(1, Timesync(0, 5))
        got = []
        for k in range(len(whole)):
            raw.sendall(whole[k : k + 1])
            got += server.poll(0.01)
        assert [f.name for f in got] == ["HEARTBEAT", "TIMESYNC"]
        server.put(0, 1, 1, encode(Heartbeat(2, 12, 1, 0, 3)))
        server.flush()
        assert [f.name for f in client.poll(0.5)] == ["HEARTBEAT"]
        raw.close()
        server.poll(0.1)
        assert len(server.ports[0].addresses()) == 1
        client.close()
        server.close()


def test_the_benchmark_times_calls_that_there_are(offset: int) -> None:
    """It wraps them by name, and nothing else would notice one that was moved."""
    from benchmarks.wire import BRIDGE, VEHICLES, timed

    assert all(callable(getattr(where, name)) for where, name, _ in [*BRIDGE, *VEHICLES])
    link = Link([Endpoint(("127.0.0.1", 14900 + offset), None)])
    with timed(BRIDGE) as spent:
        link.poll(0.0)
        link.flush()
    link.close()
    assert set(spent) == {"socket and wait", "socket"}
