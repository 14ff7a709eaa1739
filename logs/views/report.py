"""`cablequad report`: a run as one self-contained HTML page."""

import base64
import html
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from logs.reading import inspect
from logs.reading.reader import Run, frame_headers, missing_before
from logs.views.results import rows

STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:1080px;margin:2em auto;padding:0 1em;color:#1a1a1a}
h1{margin-bottom:.1em} .verdict{font-weight:700} .passed{color:#00694e} .failed{color:#b03a00}
table{border-collapse:collapse;margin:.6em 0} td,th{border-bottom:1px solid #ddd;padding:.25em .8em;text-align:left}
img{max-width:100%} pre{background:#f5f5f3;padding:1em;overflow:auto}
figure{margin:1.6em 0} figcaption{color:#555} @media print{pre{white-space:pre-wrap} figure{break-inside:avoid}}
"""
CAPTIONS = {
    "histories": "Position, velocity, rates, attitude errors, thrusts and link errors over time (the paper's Figures 2 "
    "and 4). Grey: the reference.",
    "snapshots": "The system at chosen times: in space, from the side (z points down), from above (the paper's "
    "Figures 3 and 5).",
    "tensions": "Tensions, the vehicles' share of their thrust limit, heights (up is positive), the two vehicles that "
    "are closest, and the age of the state that each decision went by. Lines: means over 0.2 s; shaded: from the least "
    "to the most.",
}


def page(run: Run, figures: Mapping[str, Path]) -> str:
    """The page; everything it shows is inside."""
    about = run.metadata.get("run", {})
    result = {k: _json(v) for k, v in run.metadata.get("result", {}).items()}
    name = html.escape(about.get("scenario", run.path.name))
    if result:
        verdict = PASSED if result.get("passed") else "failed"
        said = html.escape(str(result.get("reason", "")))
    else:
        verdict, said = "failed", "the run did not end in order: the log has no result"
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{name}</title><style>{STYLE}</style>",
        f"<h1>{name}</h1><p class='verdict {verdict}'>{verdict}: {said}</p><p>{_answered(run, verdict)}</p>",
        _table(("", "", "asked"), [tuple(map(html.escape, row)) for row in rows(result)]) if result else "",
    ]
    for key, path in figures.items():
        data = base64.b64encode(path.read_bytes()).decode()
        caption = html.escape(CAPTIONS[key])
        image = f"<img alt='{caption}' src='data:image/png;base64,{data}'>"
        parts.append(f"<figure>{image}<figcaption>{caption}</figcaption></figure>")
    parts += ["<h2>Links</h2>", _table(("topic", "frames", "a second", "missing by their numbers"), _links(run))]
    parts += ["<h2>What happened</h2>", _table(("t [s]", "who", "what"), _events(run))]
    findings: list[tuple[str, ...]] = [
        (("BAD" if f.serious else "note"), html.escape(f.text)) for f in inspect.check(run.path)
    ]
    parts += ["<h2>The log itself</h2>", _table(("", ""), findings) if findings else "<p>sound</p>"]
    parts += ["<h2>Run</h2>", _table(("", ""), [(html.escape(k), html.escape(v)) for k, v in about.items()])]
    for attached in ("scenario.toml", "mission.py"):
        if attached in run.attachments:
            text = html.escape(run.attachments[attached].decode("utf-8", "replace"))
            parts.append(f"<h2>{attached}</h2><pre>{text}</pre>")
    return "\n".join(parts)


def _json(value: str) -> Any:
    try:
        return json.loads(value)
    except json.JSONDecodeError:
        return value


def _links(run: Run) -> list[tuple[str, ...]]:
    lines: list[tuple[str, ...]] = []
    for topic, frames in sorted(run.frames.items()):
        head = frame_headers(frames)
        sender = head["sysid"] * 256 + head["compid"]
        missing = sum(max(0, int(missing_before(head["seq"][sender == who]).sum())) for who in np.unique(sender))
        span = (frames.time_ns[-1] - frames.time_ns[0]) * 1e-9
        rate = f"{len(sender) / span:.1f}" if span > 0 else ""
        lines.append((html.escape(topic), str(len(sender)), rate, str(missing)))
    return lines


PASSED = "passed"
ANSWERS = ("failure", "autopilot-lost", "lost", "crew", "guard", "pause", "resume", "abort")


def _answered(run: Run, verdict: str) -> str:
    """One line: what went wrong, and what the controller did about it."""
    told = [e for e in run.events if e.kind.removeprefix("sitl-") in ANSWERS]
    if not told:
        nothing = "Nothing went wrong: it was flown as planned."
        return nothing if verdict == PASSED else "No vehicle failed, and no guard was broken."
    at = [f"{(e.time_ns - run.release_ns) * 1e-9:.2f} s {e.subject}: {e.text}" for e in told]
    return html.escape("What went wrong, and what was done: " + "; ".join(at) + ".")


def _events(run: Run) -> list[tuple[str, ...]]:
    kept = [e for e in run.events if e.kind not in ("slack", "taut")]
    lines: list[tuple[str, ...]] = [
        (f"{(e.time_ns - run.release_ns) * 1e-9:.3f}", html.escape(e.subject), html.escape(e.text)) for e in kept
    ]
    slack = sum(e.kind == "slack" for e in run.events)
    return lines + ([("", "cables", f"went slack {slack} times in all")] if slack else [])


def _table(head: tuple[str, ...], lines: Sequence[tuple[str, ...]]) -> str:
    top = "".join(f"<th>{h}</th>" for h in head) if any(head) else ""
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in lines)
    return f"<table><tr>{top}</tr>{body}</table>"
