"""What is done with a log: looked into, checked, mended, exported, decided again, drawn."""

import contextlib
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from conftest import cablequad
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from pymavlink import mavutil

from docs.log import page as log_page
from docs.scenario import page as scenario_page
from logs.reading.columns import columns
from logs.reading.inspect import check, info, lost
from logs.reading.messages import Messages
from logs.reading.reader import LogError, Run, missing_before, read
from logs.reading.records import Damage, entries
from logs.schema import cablequad_pb2 as pb
from logs.views import figures, replay, video
from logs.views import report as page
from logs.views.motion import motion_of
from logs.writing.encode import single
from missions.analysis.replay_control import redecide

HERE = Path(__file__).parent
GOLDEN = sorted((HERE / "golden").glob("*.mcap"))
CASE_2 = HERE / "golden" / "v2-paper-case-2-50hz.mcap"
FLEET = HERE / "golden" / "v2-lemniscate-fleet.mcap"


@pytest.fixture(scope="module")
def case_2() -> Run:
    return read(CASE_2)


@pytest.mark.parametrize("path", GOLDEN, ids=lambda p: p.stem)
def test_a_log_of_each_schema_version_keeps_opening(path: Path, tmp_path: Path) -> None:
    assert {p.stem[:2] for p in GOLDEN} == {"v1", "v2"}
    assert not [f for f in check(path) if f.serious]
    run = read(path)
    assert run.complete
    assert len(run.columns["/plant/state"]["step"]) > 100
    m = motion_of(run, 1000.0)
    assert len(m.t) == len(run.columns["/plant/state"]["step"])
    told = run.columns["/plant/state"]["quad_position"][-1].reshape(-1, 3)
    np.testing.assert_allclose(m.quads[-1], told, atol=2e-6)  # the drawn cables end where the vehicles are
    replay.save(run, tmp_path / "x.rrd")


@pytest.mark.parametrize("path", GOLDEN, ids=lambda p: p.stem)
def test_todays_controller_decides_as_the_one_that_wrote_the_log(path: Path) -> None:
    """Bit for bit on the machine that wrote it; elsewhere rounding may differ.

    Version 1 was flown by an observer that looked at no attitudes between the tracker's stamps: it sees the same load.
    """
    again = redecide(path)
    assert again.decisions > 100
    judged = ("e_x0", "position") if path.stem.startswith("v1") else tuple(again.largest)
    assert all(again.largest[name] < 1e-7 for name in judged), again


def test_a_decision_that_was_tampered_with_is_found(tmp_path: Path) -> None:
    from mcap.writer import Writer

    target = tmp_path / "tampered.mcap"
    with open(target, "wb") as file:
        writer = Writer(file)
        writer.start()
        schemas, channels = {}, {}
        summary = make_reader(open(CASE_2, "rb")).get_summary()  # noqa: SIM115
        assert summary is not None
        for key, s in summary.schemas.items():
            schemas[key] = writer.register_schema(s.name, s.encoding, s.data)
        for c in summary.channels.values():
            channels[c.topic] = writer.register_channel(c.topic, c.message_encoding, schemas[c.schema_id])
        for name, data in read(CASE_2).attachments.items():
            writer.add_attachment(0, 0, name, "text/plain", data)
        count = 0
        for entry in entries(CASE_2):
            data = entry.data
            if entry.topic == "/control/state":
                count += 1
                if count == 150:
                    message = pb.ControlState.FromString(data)
                    message.thrust[2] += 1e-6
                    data = message.SerializeToString()
            writer.add_message(channels[entry.topic], entry.log_time, data, entry.publish_time)
        writer.finish()
    first = redecide(target).first
    assert first is not None
    assert (first.field, first.decided_before) == ("thrust", 149)
    assert first.largest == pytest.approx(1e-6, rel=1e-3)
    code, out, _ = cablequad("log", "replay-control", str(target))
    assert code == 1
    assert "after 149 equal ones thrust differs" in out


def test_info_says_what_a_log_holds() -> None:
    code, out, _ = cablequad("log", "info", "--json", str(CASE_2))
    assert code == 0
    found = json.loads(out)
    assert found["complete"]
    assert found["run"]["scenario"] == "paper-case-2-50hz"
    assert found["run"]["schema_version"] == "2"
    assert found["result"]["passed"] in ("true", "false")
    assert found["topics"]["/control/state"]["rate_hz"] == pytest.approx(50, rel=0.01)
    assert found["topics"]["/plant/state"]["messages"] == len(read(CASE_2).columns["/plant/state"]["step"])
    assert info(CASE_2)["flown_s"] == pytest.approx(0.5, abs=0.03)


def test_a_log_cut_at_every_kib_reads_and_is_mended(tmp_path: Path) -> None:
    data = FLEET.read_bytes()
    cut = tmp_path / "cut.mcap"
    seen = []
    for size in range(1024, len(data), 1024):
        cut.write_bytes(data[:size])
        seen.append(sum(1 for _ in entries(cut)))
    assert seen == sorted(seen)
    assert seen[-1] > 0.9 * sum(1 for _ in entries(FLEET))
    cut.write_bytes(data[: len(data) // 2])
    texts = [f.text for f in check(cut) if f.serious]
    assert any("cut short" in text for text in texts)
    assert any("no result" in text for text in texts)
    code, out, _ = cablequad("log", "salvage", str(cut))
    assert code == 0
    mended = tmp_path / "cut-salvaged.mcap"
    assert str(mended) in out
    assert [(e.topic, e.log_time, e.data) for e in entries(mended)] == [
        (e.topic, e.log_time, e.data) for e in entries(cut)
    ]
    with open(mended, "rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert read(mended).attachments == read(FLEET).attachments
    code, _, err = cablequad("log", "salvage", str(cut))
    assert code == 1
    assert "exists already" in err


def test_a_damaged_byte_loses_messages_and_makes_none_up(tmp_path: Path) -> None:
    data = bytearray(FLEET.read_bytes())
    whole = {(e.topic, e.log_time, e.data) for e in entries(FLEET)}
    least = len(whole)
    rng = np.random.default_rng(3)
    bad = tmp_path / "bad.mcap"
    for at in rng.integers(100, len(data) - 100, 25):
        changed = data.copy()
        changed[at] ^= 0x55
        bad.write_bytes(changed)
        found = {(e.topic, e.log_time, e.data) for e in entries(bad)}
        assert found <= whole
        least = min(least, len(found))
    assert least < len(whole)


def test_every_message_decodes_by_the_schema_in_the_file_alone() -> None:
    """As Foxglove and others read it: no module of ours, only the descriptors that the file brings."""
    from mcap_protobuf.decoder import DecoderFactory

    with open(FLEET, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = {channel.topic for _, channel, _, _ in reader.iter_decoded_messages()}
    assert {"/tf", "/scene", "/log", "/plant/state", "/mavlink/quad1/rx"} <= topics


def test_fields_of_a_later_schema_are_passed_over() -> None:
    later = pb.PlantState(sim_time_ns=5, step=3, tension=[1.0, 2.0]).SerializeToString()
    unknown = b"\xfa\x06\x03abc" + b"\xf0\x06\x07"  # fields 111 (bytes) and 110 (varint)
    out = columns(pb.PlantState.DESCRIPTOR, Messages([later, later + unknown]))
    np.testing.assert_array_equal(out["sim_time_ns"], [5, 5])
    np.testing.assert_array_equal(out["tension"], [[1, 2], [1, 2]])


def test_columns_are_those_of_the_protobuf_library() -> None:
    """Side by side and one by one, whatever is left out because it is zero."""
    rng = np.random.default_rng(1)
    messages = [
        pb.ControlState(
            sim_time_ns=int(rng.choice([0, 1, 10**6, 10**12, -5])), t=float(rng.choice([0.0, 1.5])),
            phase=str(rng.choice(["", "fly", "prepare"])), e_x0=rng.normal(size=3), tension=rng.normal(size=2).astype("f4"),
            Psi=[] if rng.random() < 0.3 else [1.0, 2.0],
        )
        for _ in range(400)
    ]  # fmt: skip
    out = columns(pb.ControlState.DESCRIPTOR, Messages([m.SerializeToString() for m in messages]))
    for k, m in enumerate(messages):
        assert out["sim_time_ns"][k] == m.sim_time_ns
        assert out["t"][k] == m.t
        assert out["phase"][k] == m.phase
        assert out["e_x0"][k].tolist() == list(m.e_x0)
        assert out["tension"][k].tolist() == list(m.tension)
        assert out["Psi"][k].tolist() == (list(m.Psi) or [0.0, 0.0])


def test_missing_frames_are_counted_also_where_some_come_late() -> None:
    assert missing_before(np.array([250, 251, 254, 255, 0, 1])).tolist() == [0, 0, 2, 0, 0, 0]
    late = missing_before(np.array([1, 3, 2, 4, 4, 7, 6]))
    assert late.sum() == 1  # 5 never came; 4 twice is none missing
    rng = np.random.default_rng(0)
    sent = np.arange(5000)
    kept = sent[rng.random(5000) > 0.1]
    shuffled = kept[np.argsort(kept + rng.uniform(0, 8, len(kept)), kind="stable")] & 255
    assert missing_before(shuffled).sum() == pytest.approx(5000 - len(kept), abs=8)


def test_a_lost_frame_shows_in_the_check(case_2: Run) -> None:
    assert all(missing == 0 for missing, _ in lost(case_2).values())


def test_tlogs_are_read_by_pymavlink_without_bad_data(case_2: Run, tmp_path: Path) -> None:
    code, out, _ = cablequad("log", "export", str(CASE_2), "--out", str(tmp_path))
    assert code == 0
    files = [Path(line) for line in out.splitlines()]
    assert len(files) == 5
    for path in files:
        log = mavutil.mavlink_connection(str(path), dialect="common")
        kinds, stamps = [], []
        while (message := log.recv_match()) is not None:
            kinds.append(message.get_type())
            stamps.append(message._timestamp)
        assert "BAD_DATA" not in kinds
        assert stamps == sorted(stamps)
        who = path.stem.removeprefix(f"{CASE_2.stem}-")
        there = sum(len(case_2.frames[t]) for t in case_2.frames if t.split("/")[2] == who)
        assert len(kinds) == there
        if who != "payload":
            assert {"HEARTBEAT", "SET_ATTITUDE_TARGET", "ATTITUDE_QUATERNION"} <= set(kinds)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_tables_hold_the_columns(case_2: Run, tmp_path: Path, form: str) -> None:
    code, out, _ = cablequad("log", "export", str(CASE_2), "--out", str(tmp_path), "--format", form)
    assert code == 0
    path = next(Path(line) for line in out.splitlines() if "plant-state" in line)
    if form == "csv":
        lines = path.read_text().splitlines()
        names = lines[0].split(",")
        column = [float(line.split(",")[names.index("payload_position_2")]) for line in lines[1:]]
    else:
        from pyarrow import parquet

        column = parquet.read_table(path)["payload_position_2"].to_pylist()
    assert column == case_2.columns["/plant/state"]["payload_position"][:, 2].tolist()


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("info", "nowhere.mcap"), 2, "nowhere.mcap"),
        (("check", str(HERE / "conftest.py")), 1, "not an MCAP file"),
        (("export", str(CASE_2), "--format", "xls"), 2, "write tlog, csv or parquet"),
        (("replay-control", str(HERE / "conftest.py")), 1, "not an MCAP file"),
    ],
)
def test_a_log_command_that_cannot_says_so_in_one_line(arguments: tuple[str, ...], code: int, text: str) -> None:
    got, _, err = cablequad("log", *arguments)
    assert got == code
    assert text in err
    assert len(err.strip().splitlines()) == 1


def test_a_full_file_system_keeps_what_was_flushed(tmp_path: Path) -> None:
    """A real one, of 200 kB."""
    if os.geteuid() != 0 or sys.platform != "linux":
        pytest.skip("mounting a small file system takes root on Linux")
    from test_logs import motion, write

    small = tmp_path / "small"
    small.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "none", small], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip("this machine lets nobody mount a file system")
    try:
        out = write(small / "a.mcap", 10)
        out.flush()
        assert sum(1 for e in entries(out.part) if e.topic == "/plant/state") == 10
        for k in range(1500):
            us = 10**6 + 4000 * k
            out.write(us, out.truths([us], [False], single(motion(0.001 * k)))[0])
            if k % 100 == 0:
                out.flush()
        path = out.finish()
        assert out.error is not None
        assert "No space left on device" in out.error
        assert len(read(path).columns["/plant/state"]["step"]) >= 10
    finally:
        subprocess.run(["umount", small], check=True)


def test_a_report_shows_everything_in_one_file(case_2: Run, tmp_path: Path) -> None:
    code, out, _ = cablequad("report", str(CASE_2), "--out", str(tmp_path), "--at", "0", "--at", "0.3")
    assert code == 0
    text = Path(out.strip()).read_text()
    assert text.count("data:image/png;base64,") == 3
    assert "src='http" not in text
    assert case_2.metadata["run"]["git_commit"] in text
    assert "initial_link_directions" in text  # the scenario
    assert {p.suffix for p in tmp_path.iterdir()} == {".png", ".pdf", ".html"}


def test_figures_have_axes_with_names_and_units(case_2: Run) -> None:
    for figure in (figures.histories(case_2), figures.tensions(case_2)):
        for ax in figure.axes:
            assert "[" in ax.get_ylabel()
    assert len(figures.snapshots(case_2, [0.0, 0.14, 0.3]).axes) == 9


def test_a_moving_picture_shows_the_run(case_2: Run, tmp_path: Path) -> None:
    from PIL import Image

    count = video.save(case_2, tmp_path / "x.gif", speed=0.5)
    with Image.open(tmp_path / "x.gif") as image:
        assert getattr(image, "n_frames", 1) == count >= 12
    with pytest.raises(LogError, match=r"write a \.gif"):
        video.save(case_2, tmp_path / "x.avi")


def test_two_runs_share_a_scene_and_pass_reruns_verification(tmp_path: Path) -> None:
    target = tmp_path / "two.rrd"
    code, _, err = cablequad("replay", str(CASE_2), str(FLEET), "--save", str(target))
    assert code == 0, err
    rerun = Path(sys.executable).parent / "rerun"
    done = subprocess.run([rerun, "rrd", "verify", target], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    shown = subprocess.run([rerun, "rrd", "print", target], capture_output=True, text=True, check=False).stdout
    for entity in (
        "/world/ghost/cables/1",
        "/world/asked/1",
        "/world/believed/1",
        "/plots/lost/quad1",
        "/plots/psi/vehicles'",
    ):
        assert entity.replace("'", "") in shown.replace("\\'", "").replace("'", ""), entity


def test_a_browser_opens_the_served_replay(tmp_path: Path) -> None:
    """Headless Chromium loads the page, and the page its viewer."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no chromium; .ci/run installs it")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "missions.cli.main", "replay", str(CASE_2), "--serve", "--port", str(port)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        for _ in range(150):
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=2).read()
                break
            except OSError:
                time.sleep(0.2)
        picture = tmp_path / "page.png"
        subprocess.run(
            [
                chromium, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
                "--disable-background-networking", "--disable-component-update", "--disable-sync",
                f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1200,700", "--virtual-time-budget=8000",
                f"--screenshot={picture}", f"http://127.0.0.1:{port}",
            ],
            capture_output=True, timeout=120, check=True,
        )  # fmt: skip
        from PIL import Image

        with Image.open(picture) as image:
            assert len(image.convert("RGB").resize((60, 35)).getcolors(3000) or []) > 1  # not a blank page
    finally:
        os.killpg(server.pid, signal.SIGTERM)
        server.wait(10)


def test_the_page_on_the_log_is_what_the_schema_says() -> None:
    assert (HERE.parent / "docs" / "log.md").read_text() == log_page()


def test_the_reference_of_scenario_keys_is_current_and_says_what_each_is() -> None:
    assert (HERE.parent / "docs" / "scenario.md").read_text() == scenario_page()
    bare = [row for row in scenario_page().splitlines() if row.startswith("| `") and row.endswith("|  |")]
    assert not bare


def test_a_page_of_a_run_that_did_not_end_says_so(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(CASE_2.read_bytes()[:300_000])
    text = page.page(read(cut), {})
    assert "did not end in order" in text


class TestDamage:
    """Every sound chunk is read; what is lost is counted, timed and told."""

    @pytest.fixture
    def whole(self, tmp_path: Path) -> Path:
        path = tmp_path / "whole.mcap"
        path.write_bytes((Path(__file__).parent / "golden" / "v2-paper-case-2-50hz.mcap").read_bytes())
        return path

    def chunks(self, data: bytes) -> list[tuple[int, int]]:
        """Where chunks' records begin and end."""
        at, out = 8, []
        while at + 9 <= len(data):
            opcode, length = struct.unpack_from("<BQ", data, at)
            if opcode == Opcode.CHUNK:
                out.append((at, at + 9 + length))
            if opcode == Opcode.DATA_END:
                return out
            at += 9 + length
        return out

    def damaged(self, whole: Path, begin: int, end: int) -> Path:
        data = bytearray(whole.read_bytes())
        data[begin:end] = bytes(end - begin)
        path = whole.with_name("damaged.mcap")
        path.write_bytes(data)
        return path

    @pytest.mark.parametrize("where", ["in a chunk", "over a chunk's head", "in the first chunk"])
    def test_a_hole_costs_the_chunks_that_it_touches_alone(self, whole: Path, where: str) -> None:
        places = self.chunks(whole.read_bytes())
        assert len(places) > 3
        begin, end = places[0] if where == "in the first chunk" else places[len(places) // 2]
        hole = (begin - 20, begin + 60) if where == "over a chunk's head" else (begin + 200, begin + 400)
        path = self.damaged(whole, *hole)
        of = sum(1 for _ in entries(whole))
        lost: list[Damage] = []
        kept = sum(1 for _ in entries(path, lost))
        assert 0 < of - kept <= 2 * of // len(places) + 4000
        assert len(lost) == 1
        assert where == "over a chunk's head" or lost[0].messages == of - kept
        assert lost[0].end_ns > lost[0].begin_ns > 0 or where == "in the first chunk"
        run = read(path)
        assert len(run.damages) == 1
        assert sum(len(m) for m in run.frames.values()) > 0
        assert end > begin
        code, out, _ = cablequad("log", "info", str(path))
        assert code == 1
        assert "damaged" in out
        target = path.with_name("kept.mcap")
        code, out, err = cablequad("log", "salvage", str(path), "--out", str(target))
        assert code == 1
        assert f"{kept} messages" in out
        assert f"{of - kept} of {of} messages are lost in all" in err
        assert sum(1 for _ in entries(target)) == kept
        code, out, _ = cablequad("log", "check", str(path))
        assert code == 1
        assert "lost" in out

    def test_two_logs_that_were_joined_are_told(self, whole: Path) -> None:
        joined = whole.with_name("joined.mcap")
        joined.write_bytes(2 * whole.read_bytes())
        code, out, _ = cablequad("log", "check", str(joined))
        assert code == 1
        assert "bytes of another file, joined to this one" in out

    def test_salvage_of_what_is_no_log_leaves_no_file(self, tmp_path: Path) -> None:
        path = tmp_path / "no.mcap"
        path.write_text("hello" * 100)
        code, _, err = cablequad("log", "salvage", str(path))
        assert code == 1
        assert "not an MCAP file" in err
        assert sorted(p.name for p in tmp_path.iterdir()) == ["no.mcap"]

    @settings(max_examples=60)
    @given(st.integers(0, 2**31), st.integers(1, 5000))
    def test_no_damage_at_all_ends_in_anything_but_a_log_or_a_line(self, seed: int, size: int) -> None:
        source = Path(__file__).parent / "golden" / "v2-paper-case-2-50hz.mcap"
        data = bytearray(source.read_bytes())
        rng = np.random.default_rng(seed)
        begin = int(rng.integers(8, len(data)))
        part = len(data[begin : begin + size])
        data[begin : begin + part] = rng.integers(0, 256, part, dtype=np.uint8).tobytes()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "x.mcap"
            path.write_bytes(data)
            with contextlib.suppress(LogError):  # which names the file, and is all that may be raised
                kept = sum(1 for _ in entries(path))
                assert sum(len(c["sim_time_ns"]) for c in read(path).columns.values()) <= kept

    def test_replay_leaves_nothing_in_the_temporary_folder(self, whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        folder = whole.with_name("tmp")
        folder.mkdir()
        monkeypatch.setenv("TMPDIR", str(folder))
        cablequad("replay", str(whole), "--screenshot", str(whole.with_suffix(".png")))
        assert [p.name for p in folder.iterdir() if p.name.startswith("cablequad-")] == []
