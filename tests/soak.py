"""A long flight over a link that loses frames: `python tests/soak.py [--minutes M] [--loss P] [--out FILE]`.

Case 1 at full rate, everything recorded, every link losing its share both ways. What is looked at: whether it flies,
whether every frame is accounted for on both sides, whether the clocks agree to the end, and whether the memory of its
three processes stays flat.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from logs.schema import cablequad_pb2 as pb
from logs.writing.recorder import EPOCH_NS

SETTLED = 0.2  # of the flight, after which memory may no longer grow


def lossy(minutes: float, loss: float, folder: Path) -> Path:
    """Case 1 with a share of all frames lost."""
    text = (resources.files("missions") / "scenarios" / "paper-case-1.toml").read_text()
    text = text.replace('name = "paper-case-1"', 'name = "soak"')
    text = text.replace("duration_s = 10.0", f"duration_s = {60 * minutes:g}")
    text += "\n\n[faults]\n" + "".join(f"{way} = {{ loss = {loss:g} }}\n" for way in ("down", "up", "tracker"))
    path = folder / "soak.toml"
    path.write_text(text)
    return path


def memory_MB(root: int) -> dict[str, float]:
    """Resident memory of a process and its children, by name."""
    out = {}
    for pid in [root, *_children(root)]:
        try:
            status = Path(f"/proc/{pid}/status").read_text()
        except OSError:
            continue
        size = next((int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")), 0)
        out[str(pid)] = size / 1024
    return out


def _children(pid: int) -> list[int]:
    try:
        return [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def soak(minutes: float, loss: float, offset: int) -> dict[str, Any]:
    """Fly; the figures. Raises AssertionError for what does not hold."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begun = time.monotonic()
        flying = subprocess.Popen(
            [sys.executable, "-m", "missions.cli.main", "fly", str(lossy(minutes, loss, folder)), "--json", "--no-replay",
             "--out", str(folder), "--port-offset", str(offset)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        samples: list[dict[str, float]] = []
        while flying.poll() is None:
            samples.append(memory_MB(flying.pid))
            time.sleep(min(1.0, 0.5 * minutes))
        text, err = flying.communicate()
        assert text, err
        s = json.loads(text)
        w = s["wire"]
        assert s["passed"], s["reason"]
        assert w["down_sent"] == w["down_received"], w
        assert w["down_received"] == w["down_passed"] + w["down_lost"] + w["down_waiting"], w
        assert w["up_sent"] == w["up_received"] == w["up_passed"] + w["up_lost"] + w["up_waiting"], w
        share = w["down_lost"] / w["down_received"]
        assert abs(share - loss) < 0.2 * loss, share
        size_MB = Path(s["log"]).stat().st_size / 1e6
        drift = clocks(Path(s["log"]))
        assert drift["first"] == drift["last"] == 0.0, drift  # in lockstep not a millisecond
        flown = [sample for sample in samples if len(sample) >= 3]
        late = flown[int(SETTLED * len(flown)) :]
        growth = max((late[-2][p] - late[0][p] for p in late[0] if p in late[-2]), default=0.0)
        return {
            "simulated_minutes": minutes,
            "loss": loss,
            "seconds": round(time.monotonic() - begun, 1),
            "real_time_factor": round(s["real_time_factor"], 2),
            "final_position_error_m": s["final_position_error_m"],
            "predicted_ticks": s["predicted_ticks"],
            "memory_growth_MB": round(growth, 1),
            "log_MB": round(size_MB, 1),
            "clock_drift_ms": drift,
            **w,
        }


def clocks(log: Path) -> dict[str, float]:
    """ms, first and last ten seconds: how far a vehicle's or the tracker's stamp is from the tick that it was heard in."""
    with open(log, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        begin, end = summary.statistics.message_start_time, summary.statistics.message_end_time
        out = {}
        for name, start in (("first", begin + 5 * 10**9), ("last", end - 10 * 10**9)):
            out[name] = max(_offsets_ms(reader, start, start + 10 * 10**9), default=math.nan)
        return out


def _offsets_ms(reader: Any, start: int, end: int) -> Iterator[float]:
    topics = [*(f"/mavlink/quad{i}/rx" for i in range(1, 5)), "/mavlink/payload/rx"]
    for _, _, message in reader.iter_messages(topics, start, end):
        frame = pb.MavlinkFrame.FromString(message.data)
        tick_ms = (message.log_time - EPOCH_NS) / 1e6
        if frame.msgid == 31 and frame.sysid < 200:
            yield abs(int.from_bytes(frame.frame[10:14], "little") - tick_ms)
        elif frame.msgid == 331 and frame.sysid == 200:
            yield abs(int.from_bytes(frame.frame[10:18], "little") / 1000 - tick_ms)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--minutes", type=float, default=30.0)
    arguments.add_argument("--loss", type=float, default=0.05)
    arguments.add_argument("--offset", type=int, default=4700)
    arguments.add_argument("--out", type=Path, help="write the figures here as JSON")
    asked = arguments.parse_args()
    figures = soak(asked.minutes, asked.loss, asked.offset)
    print(json.dumps(figures))
    if asked.out:
        asked.out.write_text(json.dumps(figures, indent=1) + "\n")
