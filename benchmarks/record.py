"""What recording costs: `python -m benchmarks.record [--seconds 60] [--out FILE]`.

Case 1 in real time at 250 Hz with everything recorded, truth at 250 Hz and at 1 kHz: share of a core that the log
takes, MB a minute, and what the control loop waits for handing things over. Beside it, in the same run, the same
messages through the protobuf and mcap libraries' own objects, and how long a log takes to read and to convert.
"""

import argparse
import io
import json
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from mcap.writer import CompressionType, Writer
from rich.console import Console
from rich.table import Table

from logs.reading.reader import read
from logs.reading.records import entries
from logs.schema import cablequad_pb2 as pb
from logs.views import replay
from logs.writing.recorder import CHUNK_BYTES
from logs.writing.serialize import LogWriter, PendingMessages, serialized
from missions.flight.recording.log_process import TOGETHER, LogProcess
from missions.flight.run import Options, Progress, run
from missions.scenario import loading as scenarios

WARM_S = 4.0  # of a flight's clock, before which nothing is measured


def _cpu_s(pid: int) -> float:
    times = psutil.Process(pid).cpu_times()
    return float(times.user + times.system)


def recorded(truth_hz: int, seconds: float, folder: Path) -> dict[str, Any]:
    """One flight in real time."""
    path = folder / f"truth-{truth_hz}.toml"
    path.write_text(scenarios.text("paper-case-1") + f"\n[record]\ntruth_rate_hz = {truth_hz}\n")
    waits: list[float] = []
    scribes: list[LogProcess] = []
    samples: list[tuple[float, float]] = []

    def timed(call: Callable[..., None]) -> Callable[..., None]:
        def wrapped(self: LogProcess, *a: Any) -> None:
            if self not in scribes:
                scribes.append(self)
            begun = time.perf_counter()
            call(self, *a)
            waits.append(time.perf_counter() - begun)

        return wrapped

    names = ("received", "sent", "decided", "perf")
    originals = {name: getattr(LogProcess, name) for name in names}
    stop = threading.Event()

    def watch() -> None:
        while not stop.wait(0.25):
            if scribes and (pid := scribes[0]._process.pid):
                try:
                    samples.append((time.monotonic(), _cpu_s(pid)))
                except psutil.Error:
                    return

    for name, call in originals.items():
        setattr(LogProcess, name, timed(call))
    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        summary, _ = run(scenarios.load(str(path), seconds), Options(out=folder, speed=1.0), Progress())
    finally:
        stop.set()
        watcher.join()
        for name, call in originals.items():
            setattr(LogProcess, name, call)
    log = Path(summary.log or "")
    begin = next(k for k, s in enumerate(samples) if s[0] > samples[0][0] + WARM_S)
    (t0, c0), (t1, c1) = samples[begin], samples[-2]
    ticks = len(waits) / 3.0
    begun = time.perf_counter()
    loaded = read(log)
    read_s = time.perf_counter() - begun
    replay.save(loaded, folder / "x.rrd")  # the first loads what conversion needs
    begun = time.perf_counter()
    replay.save(loaded, folder / "x.rrd")
    convert_s = time.perf_counter() - begun
    minutes = (loaded.columns["/control/state"]["sim_time_ns"][-1] * 1e-9) / 60
    us = 1e6 * np.array(waits[len(waits) // 4 :])
    return {
        "truth_hz": truth_hz, "core_percent": 100 * (c1 - c0) / (t1 - t0),
        "MB_per_minute": log.stat().st_size / 1e6 / minutes,
        "wait_us_p50": float(np.percentile(us, 50)), "wait_us_p99_9": float(np.percentile(us, 99.9)),
        "read_s_per_minute": read_s / minutes, "convert_s_per_minute": convert_s / minutes,
        "replay_MB_per_minute": (folder / "x.rrd").stat().st_size / 1e6 / minutes, "calls": ticks, "log": str(log),
    }  # fmt: skip


def libraries(log: Path) -> dict[str, float]:
    """us a message: encoded and written by hand, and by the libraries' objects."""
    kept = [e for e in entries(log) if e.topic == "/plant/state"][:2000]
    messages = [pb.PlantState.FromString(e.data) for e in kept]
    values = [[(f.name, getattr(m, f.name)) for f in m.DESCRIPTOR.fields] for m in messages]
    values = [[(n, np.array(v) if not isinstance(v, int | bool) else v) for n, v in row] for row in values]

    def by_hand() -> None:
        writer = LogWriter(io.BytesIO(), CHUNK_BYTES)
        writer.start()
        channel = writer.register_channel("/x", "protobuf", 0)
        for k in range(0, len(values), TOGETHER):
            together = values[k : k + TOGETHER]
            columns = [(name, [row[f][1] for row in together]) for f, (name, _) in enumerate(together[0])]
            rows = serialized(pb.PlantState, len(together), columns)
            waiting = PendingMessages()
            for j, data in enumerate(rows):
                waiting.put("/x", k + j, data)
            writer.add_messages(waiting, {"/x": channel}, k)

    def by_library() -> None:
        writer = Writer(io.BytesIO(), chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel("/x", "protobuf", 0)
        for k, row in enumerate(values):
            fields: dict[str, Any] = {n: v.ravel().tolist() if isinstance(v, np.ndarray) else v for n, v in row}
            writer.add_message(channel, k, pb.PlantState(**fields).SerializeToString(), k)

    out = {}
    for name, call in (("by_hand_us", by_hand), ("by_library_us", by_library)):
        times = []
        for _ in range(3):
            begun = time.perf_counter()
            call()
            times.append(time.perf_counter() - begun)
        out[name] = min(times) / len(values) * 1e6
    return out


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    table = Table(
        title="recording in real time, 250 Hz, four vehicles of five links, everything on", title_justify="left"
    )
    asked = {250: ("5 %", "40", "0.5"), 1000: ("12 %", "", "2")}
    for heading in (
        "truth", "share of a core", "asked", "MB a minute", "asked", "loop waits, p50", "p99.9",
        "read + convert a minute", "asked", "replay, MB a minute",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for truth_hz in (250, 1000):
            r = recorded(truth_hz, arguments.seconds, Path(folder))
            rows.append(r)
            share, size, speed = asked[truth_hz]
            table.add_row(
                f"{truth_hz} Hz", f"{r['core_percent']:.1f} %", share, f"{r['MB_per_minute']:.1f}", size,
                f"{r['wait_us_p50']:.0f} us", f"{r['wait_us_p99_9']:.0f} us",
                f"{r['read_s_per_minute']:.2f} + {r['convert_s_per_minute']:.2f} s", speed,
                f"{r['replay_MB_per_minute']:.1f}",
            )  # fmt: skip
        peer = libraries(Path(rows[0]["log"]))
    console = Console(width=170)
    console.print(table)
    console.print(
        f"one /plant/state encoded and written: {peer['by_hand_us']:.1f} us; through protobuf's and mcap's own objects "
        f"{peer['by_library_us']:.1f} us, the same bytes but for what arrays keep"
    )
    if arguments.out is not None:
        for row in rows:
            row.pop("log")
        arguments.out.write_text(json.dumps({"recorded": rows, **peer}, indent=1) + "\n")


if __name__ == "__main__":
    main()
