"""The record: whole, cut short, on a full disk; and what it is turned into."""

import errno
import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from bridge.mission.phases import FLY
from bridge.wire.frames import frame
from bridge.wire.messages import encode
from bridge.wire.values import AttitudeTarget
from cablequad.control.control_step import Measurement, Sample, control_step, first_memory
from cablequad.control.design import Weights, sampled_law
from cablequad.control.trajectory import Reference
from cablequad.model.attitude import Airframe
from cablequad.model.instant import Motion
from cablequad.model.state import Difference, State, difference, differences, positions
from cablequad.model.system import System
from logs.reading.messages import Messages
from logs.reading.reader import LogError, read
from logs.reading.records import entries, is_complete
from logs.schema import cablequad_pb2 as pb
from logs.schema import generate
from logs.views.motion import motion_of
from logs.writing import recorder as recorders
from logs.writing.encode import Model, single
from logs.writing.recorder import Attachment, Decisions, Recorder, RecorderError
from logs.writing.serialize import LogWriter, PendingMessages, serialized
from missions.flight.recording.header import drawn_model

SYSTEM = System.paper(1)
MODEL = Model(SYSTEM, (0.6, 0.8, 0.2), (25.0,) * 4)
AIRFRAME = Airframe(np.full(4, 40.0), np.full(4, 0.9), np.full(4, 25.0))
DESIGN = sampled_law(SYSTEM, AIRFRAME, Weights(), 0.004, 1)


def motion(x: float) -> Motion:
    s = State.hanging(SYSTEM, (x, 0.0, 0.0))
    rng = np.random.default_rng(round(1000 * x))
    return Motion(s, positions(SYSTEM, s)[:, 0], np.zeros((4, 3)), rng.normal(size=(4, 5)), rng.uniform(5, 9, 4))


def write(path: Path, ticks: int, epoch_ns: int = recorders.EPOCH_NS) -> Recorder:
    """A recorder that has been given `ticks` instants of everything."""
    out = Recorder(
        path, MODEL, {"run": {"seed": "1"}, "model": drawn_model(MODEL, (0.0, 0.0, 0.0))},
        [Attachment("scenario.toml", "application/toml", b"name = 'x'")], epoch_ns, True, NAMES,
    )  # fmt: skip
    memory = first_memory(DESIGN)
    out.write(0, out.line(0, "release", "all", "t = 0"))
    for k in range(ticks):
        us = 4000 * k
        m = motion(0.001 * k)
        memory, sample = control_step(
            memory, Measurement(us * 1e-6, m.state), Reference(np.zeros(3), np.zeros(3)), DESIGN
        )
        out.write(us, out.truths([us], [False], single(m))[0])
        decide(out, us, sample, difference(sample.state, motion(0.001 * k + 1e-4).state, SYSTEM.n_links))
        out.frames(us, "tx", [1], [SETPOINT[:4] + bytes([k & 255]) + SETPOINT[5:]])
        if k % 250 == 0:
            out.perf(us, 1e-4, k, 0)
        out.settle()
    return out


SETPOINT = frame(encode(AttitudeTarget(4000, 1, 1, 7, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.6)), 0, 250, 191)
NAMES = {82: "SET_ATTITUDE_TARGET"}


def decide(out: Recorder, us: int, sample: Sample, off: Difference | None = None) -> None:
    """Give a recorder one decision."""
    one = Decisions([us], single(sample), [[1.0] * 4], [FLY], [0.004])
    out.write(us, out.decided(one, None if off is None else single(off), [] if off is None else [0])[0])


def test_what_went_in_comes_out(tmp_path: Path) -> None:
    out = write(tmp_path / "a.mcap", 300)
    out.metadata("result", {"passed": "true"})
    path = out.finish()
    assert out.error is None
    assert not (tmp_path / "a.mcap.part").exists()
    run = read(path)
    assert run.complete
    assert run.metadata["result"] == {"passed": "true"}
    assert run.attachments["scenario.toml"] == b"name = 'x'"
    plant = run.columns["/plant/state"]
    assert plant["link_direction"].shape == (300, 60)
    for k in (0, 137, 299):
        np.testing.assert_array_equal(plant["tension"][k], motion(0.001 * k).tension.astype(np.float32).ravel())
        np.testing.assert_allclose(plant["thrust"][k], motion(0.001 * k).thrust, rtol=2e-11, atol=0)
    assert run.columns["/control/state"]["Psi"].shape == (300, 4)
    assert run.events[0].kind == "release"


def test_bytes_written_by_hand_are_those_of_the_protobuf_library(tmp_path: Path) -> None:
    """Every field of every topic, decoded and serialized again by the library: byte for byte the same."""
    kinds: dict[str, Any] = {
        "/plant/state": pb.PlantState, "/control/state": pb.ControlState, "/control/reference": pb.ControlReference,
        "/control/estimate": pb.EstimateError, "/mavlink/quad1/tx": pb.MavlinkFrame, "/tf": FrameTransforms,
    }  # fmt: skip
    seen: set[str] = set()
    for entry in entries(write(tmp_path / "a.mcap", 300).finish()):
        if entry.topic in kinds:
            seen.add(entry.topic)
            assert kinds[entry.topic].FromString(entry.data).SerializeToString() == entry.data
    assert seen == set(kinds)


@given(values=st.lists(st.floats(width=32), max_size=5), number=st.integers(-(2**63), 2**63 - 1), text=st.text())
def test_any_values_are_serialized_as_the_protobuf_library_does(values: list[float], number: int, text: str) -> None:
    real = values[0] if values else -0.0  # arrays of doubles keep 40 bits, which these numbers of 24 have room in
    by_hand = serialized(pb.ControlState, 2, (
        ("sim_time_ns", [number, 7]), ("t", [real, 0.5]), ("phase", [text, "x"]), ("e_x0", [values, values[::-1]]),
        ("tension", [values, values[::-1]]), ("calm", [-real, 0.0]),
    ))  # fmt: skip
    library = [
        pb.ControlState(sim_time_ns=number, t=real, phase=text, e_x0=values, tension=values, calm=-real),
        pb.ControlState(sim_time_ns=7, t=0.5, phase="x", e_x0=values[::-1], tension=values[::-1]),
    ]
    assert by_hand == [message.SerializeToString() for message in library]


@given(
    frames=st.lists(
        st.tuples(st.binary(max_size=200), st.booleans(), st.integers(0, 255), st.integers(0, 2**24 - 1)), max_size=5
    )
)
def test_what_many_messages_are_written_as_is_what_the_libraries_write_of_each(
    frames: list[tuple[bytes, bool, int, int]],
) -> None:
    names = {msgid: f"NAME_{msgid}" for *_, msgid in frames if msgid % 2}
    together, one_by_one = (
        LogWriter(io.BytesIO(), 10_000, names), Writer(io.BytesIO(), 10_000, compression=CompressionType.ZSTD)
    )  # fmt: skip
    waiting = PendingMessages()
    for writer in (together, one_by_one):
        writer.start(library="x")
        channels = [writer.register_channel(topic, "", 0) for topic in ("/a", "/b", "/c")]
    for k, (body, long, seq, msgid) in enumerate(frames):
        head = bytes((0, 0, seq, 3, k, *msgid.to_bytes(3, "little"))) if long else bytes((seq, 3, k, msgid & 255))
        whole = bytes((0xFD if long else 0xFE, len(body))) + head + body
        number = msgid if long else msgid & 255
        message = pb.MavlinkFrame(
            frame=whole, msgid=number, sysid=3, compid=k, seq=seq, name=names.get(number, "")
        )  # fmt: skip
        times = 10**18 + (msgid ^ 5)
        waiting.put_frames([("/a", "/b")[k % 2]], times, [whole])
        waiting.put("/c", times, body)
        one_by_one.add_message(channels[k % 2], times, message.SerializeToString(), 5)
        one_by_one.add_message(channels[2], times, body, 5)
    together.add_messages(waiting, dict(zip(("/a", "/b", "/c"), channels, strict=True)), 5)
    files = []
    for writer in (together, one_by_one):
        writer.finish()
        files.append(vars(writer)["_Writer__stream"].getvalue())
    assert files[0] == files[1]


def test_chunks_end_where_enough_was_written_and_their_indexes_find_every_message() -> None:
    file = io.BytesIO()
    writer = LogWriter(file, 3000)
    writer.start(library="x")
    channels = [writer.register_channel(topic, "", 0) for topic in ("/a", "/b")]
    written = []
    for part in range(20):
        waiting = PendingMessages()
        for k in range(25 * part, 25 * part + 25):
            waiting.put(("/a", "/b")[k % 2], 10**9 + 7 * (k ^ 3), bytes([k & 255] * (k % 40)))
            written.append((channels[k % 2], 10**9 + 7 * (k ^ 3), bytes([k & 255] * (k % 40))))
        writer.add_messages(waiting, dict(zip(("/a", "/b"), channels, strict=True)), 5)
    writer.add_messages(PendingMessages(), {}, 5)
    writer.finish()
    file.seek(0)
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 500
    assert summary.statistics.chunk_count > 5
    assert summary.statistics.channel_message_counts == dict.fromkeys(channels, 250)
    read_back = [(m.channel_id, m.log_time, m.data) for _, _, m in reader.iter_messages()]
    assert read_back == sorted(written, key=lambda row: row[1])


@given(st.lists(st.lists(st.binary(max_size=30), min_size=1, max_size=4), max_size=4), st.booleans())
def test_messages_are_the_same_wherever_they_stand(parts: list[list[bytes]], loose: bool) -> None:
    messages = Messages()
    bodies: list[bytes] = []
    for part in parts:
        ends = np.cumsum([2 + len(body) for body in part])
        starts = ends - [len(body) for body in part]
        times = np.arange(len(bodies), len(bodies) + len(part))
        if loose:
            for k, body in zip(times.tolist(), part, strict=True):
                messages.put(k, body)
        else:
            messages.put_block(b"".join(b"??" + body for body in part), starts, ends, times)
        loose, bodies = not loose, bodies + part
    assert len(messages) == len(bodies)
    assert messages.data == bodies
    assert messages.time_ns.tolist() == list(range(len(bodies)))
    for length in {len(body) for body in bodies}:
        rows = np.flatnonzero(messages.lengths == length)
        assert [row.tobytes() for row in messages.table(rows, length)] == [bodies[k] for k in rows]
    first = messages.table(np.arange(len(bodies)), 40)
    assert [row.tobytes()[: len(body)] for row, body in zip(first, bodies, strict=True)] == bodies


def test_the_mcap_librarys_own_reader_takes_it_and_finds_every_topic(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", 50).finish()
    with open(path, "rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None
        topics = {channel.topic for channel in summary.channels.values()}
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) > 200
    assert topics == {
        "/plant/state", "/control/state", "/control/reference", "/control/estimate", "/tf", "/scene", "/log", "/event",
        "/perf", "/mavlink/quad1/tx",
    }  # fmt: skip


def test_log_time_is_the_epoch_plus_the_vehicles_clock(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", 10, epoch_ns=5 * 10**18).finish()
    times = [e.log_time for e in entries(path) if e.topic == "/plant/state"]
    assert times == [5 * 10**18 + 4_000_000 * k for k in range(10)]


def test_frames_for_viewers_have_one_parent_each(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", 30).finish()
    parents: dict[str, set[str]] = {}
    for entry in entries(path):
        if entry.topic == "/tf":
            for t in FrameTransforms.FromString(entry.data).transforms:
                parents.setdefault(t.child_frame_id, set()).add(t.parent_frame_id)
                assert t.HasField("translation")
                assert t.HasField("rotation")
    assert all(len(p) == 1 for p in parents.values())
    assert len(parents) == 1 + 1 + 4 + 20
    assert parents["world_ned"] == {"map_enu"}


def test_a_log_cut_anywhere_still_reads(tmp_path: Path) -> None:
    data = write(tmp_path / "a.mcap", 400).finish().read_bytes()
    cut = tmp_path / "cut.mcap"
    seen = []
    for size in range(1024, len(data), max(1024, len(data) // 40)):
        cut.write_bytes(data[:size])
        run = read(cut)
        assert not run.complete
        seen.append(len(run.columns.get("/plant/state", {}).get("step", ())))
    assert seen == sorted(seen)
    assert seen[-1] > 0


def test_a_process_that_is_killed_leaves_all_but_the_last_half_second(tmp_path: Path) -> None:
    code = f"""
import sys, time; sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from test_logs import *
out = write(Path({str(tmp_path / "k.mcap")!r}), 200)
print("written", flush=True)
time.sleep(1.2)
out.write(9_000_000, out.line(9_000_000, "late", "x", "y"))
out.flush()
print("late", flush=True)
time.sleep(60)
"""
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "written\n"
    assert child.stdout.readline() == "late\n"
    child.kill()
    child.wait()
    run = read(tmp_path / "k.mcap.part")
    assert not run.complete
    assert len(run.columns["/plant/state"]["step"]) == 200


def test_a_full_disk_ends_the_recording_with_a_line_and_keeps_what_was_flushed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Full:
        """A file on a disk that fills up."""

        def __init__(self, file: Any) -> None:
            self.file, self.left = file, 120_000

        def write(self, data: bytes) -> int:
            self.left -= len(data)
            if self.left < 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            return int(self.file.write(data))

        def __getattr__(self, name: str) -> Any:
            return getattr(self.file, name)

    real = open
    monkeypatch.setattr("builtins.open", lambda p, m="r", **k: Full(real(p, m, **k)) if m == "xb" else real(p, m, **k))
    out = write(tmp_path / "full.mcap", 40)
    out.flush()
    for k in range(40):
        for _ in range(20):
            out.write(10**6, out.truths([10**6 + 4000 * k], [False], single(motion(0.5)))[0])
            out.frames(10**6, "tx", [1], [b"\xfe" + np.random.default_rng(k).bytes(2000)])
        out.flush()
    assert out.error is not None
    out.frames(10**6, "rx", [9], [SETPOINT])  # of a topic that there was not: it has nowhere to go
    out.flush()
    path = out.finish()
    assert "No space left on device" in out.error
    run = read(path)
    assert not run.complete
    assert len(run.columns["/plant/state"]["step"]) >= 40


def test_two_recorders_never_write_one_file(tmp_path: Path) -> None:
    first = write(tmp_path / "a.mcap", 2)
    with pytest.raises(RecorderError, match="another recorder writes it"):
        write(tmp_path / "a.mcap", 2)
    first.finish()
    with pytest.raises(RecorderError, match="exists already"):
        write(tmp_path / "a.mcap", 2)
    with pytest.raises(RecorderError, match="choose another folder"):
        write(tmp_path / "nowhere" / "a.mcap", 2)


@pytest.mark.parametrize("content", [b"", b"not a log at all, but long enough to try", None])
def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(LogError, match=r"x\.mcap"):
        read(path)
    assert not is_complete(path)


def test_the_generated_schema_module_is_current(tmp_path: Path) -> None:
    generate.generate(tmp_path)
    committed = Path(generate.__file__).parent / "cablequad_pb2.pyi"
    assert (tmp_path / "cablequad_pb2.pyi").read_text() == committed.read_text()


def test_differences_of_many_instants_are_those_of_each() -> None:
    rng = np.random.default_rng(3)
    states = [State(*(field + 0.1 * rng.normal(size=field.shape) for field in motion(0.0).state)) for _ in range(6)]
    first, second = (State(*map(np.stack, zip(*part, strict=True))) for part in (states[:3], states[3:]))
    many = differences(first, second, SYSTEM.n_links)
    for k in range(3):
        for name, one in difference(states[k], states[3 + k], SYSTEM.n_links)._asdict().items():
            np.testing.assert_array_equal(getattr(many, name)[k], one, name)


def test_a_replay_passes_reruns_own_verification(tmp_path: Path) -> None:
    from logs.views import replay

    target = tmp_path / "a.rrd"
    replay.save(read(write(tmp_path / "a.mcap", 300).finish()), target)
    rerun = Path(sys.executable).parent / "rerun"
    done = subprocess.run([rerun, "rrd", "verify", target], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_log_without_a_simulators_truth_is_replayed_from_what_was_measured(tmp_path: Path) -> None:
    from logs.views import replay

    out = Recorder(tmp_path / "m.mcap", MODEL, {"model": drawn_model(MODEL, (0.0, 0.0, 0.0))})
    memory = first_memory(DESIGN)
    for k in range(100):
        state = State.hanging(SYSTEM, (0.01 * k, 0.0, 0.0))
        memory, sample = control_step(memory, Measurement(0.0, state), Reference(np.zeros(3), np.zeros(3)), DESIGN)
        decide(out, 4000 * k, sample)
    run = read(out.finish())
    m = motion_of(run)
    np.testing.assert_allclose(m.quads[-1], positions(SYSTEM, State.hanging(SYSTEM, tuple(m.x0[-1])))[:, 0], atol=1e-12)
    replay.save(run, tmp_path / "m.rrd")


def test_frames_for_viewers_come_from_one_source_however_the_threads_run(tmp_path: Path) -> None:
    """A decision that is written before the first truth must not be drawn: logs of equal runs would differ."""
    out = Recorder(
        tmp_path / "o.mcap",
        MODEL,
        {"model": drawn_model(MODEL, (0.0, 0.0, 0.0))},
        with_truth=True,
    )
    memory = first_memory(DESIGN)
    state = State.hanging(SYSTEM, (0.5, 0.0, 0.0))
    _, sample = control_step(memory, Measurement(0.0, state), Reference(np.zeros(3), np.zeros(3)), DESIGN)
    decide(out, 4000, sample)
    out.write(4000, out.truths([4000], [False], single(motion(0.25)))[0])
    frames = [e for e in entries(out.finish()) if e.topic == "/tf"]
    assert len(frames) == 1
    assert np.float64(0.25).tobytes() in frames[0].data
