"""What a log holds and whether it is sound."""

from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from logs.reading.columns import flown
from logs.reading.reader import LogError, Run, frame_headers, missing_before, read
from logs.reading.records import Damage, entries, is_complete, missing

GAP = 5.0  # times a topic's usual interval
SHOWN = 20  # findings of one kind


class Finding(NamedTuple):
    """Something about a log that its reader should know."""

    serious: bool
    text: str


class Topic(NamedTuple):
    """One topic of a log."""

    messages: int
    bytes: int
    rate_hz: float
    gaps: int  # intervals of more than five times the usual
    schema: str


def _times(path: Path) -> tuple[dict[str, list[int]], dict[str, int], dict[str, str], list[Damage]]:
    times: dict[str, list[int]] = defaultdict(list)
    sizes: dict[str, int] = defaultdict(int)
    schemas: dict[str, str] = {}
    damages: list[Damage] = []
    for entry in entries(path, damages):
        times[entry.topic].append(entry.log_time)
        sizes[entry.topic] += len(entry.data)
        schemas[entry.topic] = entry.schema
    return times, sizes, schemas, damages


def _gaps(ns: np.ndarray) -> list[tuple[int, int]]:
    """(from, to) of intervals of a steady topic that are far longer than usual; none where nothing is usual."""
    steps = np.diff(ns)
    steps_apart = steps[steps > 0]
    if len(steps_apart) < 10:
        return []
    usual = float(np.median(steps_apart))
    if np.percentile(steps_apart, 90) > 2 * usual:
        return []
    where = np.flatnonzero(steps > GAP * usual)
    return [(int(ns[k]), int(ns[k + 1])) for k in where]


def info(path: Path) -> dict[str, Any]:
    """Duration, topics, rates, gaps, result, scenario and versions, ready for JSON. Raises LogError."""
    times, sizes, schemas, damages = _times(path)
    run = read(path)
    spans = [ns for ns in times.values() if ns]
    begin = min((ns[0] for ns in spans), default=0)
    end = max((ns[-1] for ns in spans), default=0)
    topics = {}
    for name, ns in sorted(times.items()):
        span = (ns[-1] - ns[0]) * 1e-9
        rate = (len(ns) - 1) / span if span > 0 else 0.0
        topics[name] = Topic(len(ns), sizes[name], round(rate, 2), len(_gaps(np.array(ns))), schemas[name])._asdict()
    return {
        "log": str(path),
        "bytes": path.stat().st_size,
        "complete": run.complete,
        "damage": [damage.text(begin) for damage in damages],
        "messages_lost": missing(path, sum(len(ns) for ns in spans)) if damages else 0,
        "duration_s": (end - begin) * 1e-9,
        "flown_s": _flown_s(run.columns),
        "messages": sum(len(ns) for ns in spans),
        "topics": topics,
        "run": run.metadata.get("run", {}),
        "result": run.metadata.get("result"),
        "attachments": sorted(run.attachments),
    }


def _flown_s(columns: dict[str, dict[str, np.ndarray]]) -> float:
    control = columns.get("/control/state")
    if control is None or not flown(control).any():
        return 0.0
    return float(control["t"][flown(control)].max())


def check(path: Path) -> list[Finding]:
    """What is not as it should be: order of time, gaps, lost sequence numbers, a missing end. Raises LogError."""
    found: list[Finding] = []
    if not is_complete(path):
        found.append(Finding(True, "the file is cut short: no summary at its end (cablequad log salvage makes one)"))
    times, _, _, damages = _times(path)
    if not times:
        raise LogError(f"log {path}: no message in it")
    zero = min(ns[0] for ns in times.values())
    found += [Finding(True, f"{damage.text(zero)} (cablequad log salvage keeps the rest)") for damage in damages]
    for topic, listed in sorted(times.items()):
        ns = np.array(listed)
        back = np.flatnonzero(np.diff(ns) < 0)
        found += [
            Finding(
                True, f"{topic}: time goes back by {-int(np.diff(ns)[k]) / 1e6:g} ms at {(ns[k] - zero) * 1e-9:.3f} s"
            )
            for k in back[:SHOWN]
        ]
        if topic.startswith("/mavlink/"):
            continue
        found += [
            Finding(topic != "/perf", f"{topic}: nothing from {(a - zero) * 1e-9:.3f} s to {(b - zero) * 1e-9:.3f} s")
            for a, b in _gaps(ns)[:SHOWN]
        ]
    run = read(path)
    for (topic, system, component), (gone, total) in sorted(lost(run).items()):
        if gone:
            what = f"{gone} of {total + gone} frames of {system}/{component} are missing by their numbers"
            found.append(Finding(False, f"{topic}: {what}"))
    if "result" not in run.metadata:
        found.append(Finding(True, "no result: the run did not end in order"))
    if "run" not in run.metadata:
        found.append(Finding(True, "no record of what was run"))
    return found


def lost(run: Run) -> dict[tuple[str, int, int], tuple[int, int]]:
    """(missing, there) of the frames of each sender on each topic, by their sequence numbers.

    A frame that came late fills the gap that it left.
    """
    out: dict[tuple[str, int, int], tuple[int, int]] = {}
    for topic, frames in run.frames.items():
        head = frame_headers(frames)
        for system, component in sorted(set(zip(head["sysid"].tolist(), head["compid"].tolist(), strict=True))):
            seq = head["seq"][(head["sysid"] == system) & (head["compid"] == component)]
            gaps = missing_before(seq)
            out[topic, system, component] = (max(0, int(gaps.sum())), len(seq))
    return out
