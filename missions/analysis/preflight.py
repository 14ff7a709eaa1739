"""`cablequad preflight`: design, margins, the nominal flight and the drills on one page, go or no-go line by line."""

import html
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from missions.analysis.check import check
from missions.analysis.drills import Drill, compared, drills, flown, in_the_air, rehearsal
from missions.analysis.margins import measure
from missions.flight.processes.child_process import worker_pool
from missions.flight.run import Options, Progress, run
from missions.flight.summary import Summary
from missions.flight.terminal import margin_text
from missions.scenario import laws
from missions.scenario.flights import Flight, ScenarioError
from missions.scenario.mission_setup import contingencies, scale_of_flight

COARSE = 4  # bisections of a margin: whether it is enough is asked, not how large it is to a per cent
THRUST_SHARE = 0.6  # of its greatest, that a vehicle may need at rest
ASKED = {
    "delay on top": 1.0, "loss of setpoints": 0.05, "thrust stronger": 1.1, "thrust weaker": 0.9,
    "payload heavier": 1.2, "payload lighter": 0.8,
}  # fmt: skip
STYLE = """
body{font:14px/1.45 system-ui,sans-serif;max-width:960px;margin:2em auto;padding:0 1em;color:#1a1a1a}
table{border-collapse:collapse;width:100%} td,th{border-bottom:1px solid #ddd;padding:.3em .6em;text-align:left;
vertical-align:top} .go{color:#00694e;font-weight:700} .no-go{color:#b03a00;font-weight:700} .note{color:#555}
@media print{body{margin:0}}
"""


class NotTested(Exception):
    """A flight that the computer could not carry out, which is no verdict on it."""


class Line(NamedTuple):
    """One line of the page."""

    part: str  # design, margins, flight, drill
    name: str
    verdict: str  # go, no-go, note
    why: str


def preflight(flight: Flight, options: Options, tell: Callable[[str], None]) -> Iterator[Line]:
    """Every line, as soon as it is known; `tell` hears what is being done.

    Each flight is in one process, as many at a time as there are processors: nothing of them depends on the computer.
    """
    flown_drills: list[tuple[Drill, list[Future[Summary]]]] = []
    tell("design")
    in_air, ground = in_the_air(flight), rehearsal(flight)
    near_m = scale_of_flight(flight).near_m
    lines = check(in_air, True, tell)  # before anything flies: what cannot be designed is not flown
    with worker_pool(os.cpu_count() or 1) as pool:
        nominal = pool.submit(_nominal, flight, options)
        for drill in drills(flight):
            pair = [pool.submit(flown, ground, drill, protect, options) for protect in (True, False)]
            flown_drills.append((drill, pair))
        yield from _design(lines)
        yield from one_lost(ground)
        tell("margins, and the flights meanwhile")
        yield from _margins(measure(in_air, bisections=COARSE))
        tell("the flight itself and the drills")
        summary = _tested(nominal.result())
        if summary.log is None:
            raise ScenarioError(summary.reason)
        yield Line("flight", flight.scenario.name, "go" if summary.passed else "no-go", _told(summary._asdict()))
        for drill, (protected, bare) in flown_drills:
            tell(f"drill: {drill.name}, with protection and without")
            result = compared(drill, _tested(protected.result()), _tested(bare.result()), near_m)
            yield Line("drill", f"{drill.name}: {drill.what}", result.verdict, result.why)


def _tested(s: Summary) -> Summary:
    if not s.tested:
        raise NotTested(f"not tested: {s.reason.removeprefix('not tested: ')}")
    return s


def _nominal(flight: Flight, options: Options) -> Summary:
    return run(flight, options, Progress())[0]


def _design(c: dict[str, Any]) -> Iterator[Line]:
    yield Line(
        "design", "the plan, simulated without a wire", "no-go" if c["cannot_fly"] else "go",
        "; ".join(c["cannot_fly"]) or "the load follows it",
    )  # fmt: skip
    share = max(c["equilibrium"]["thrust_share"])
    yield Line(
        "design", "thrust at rest", "go" if share <= THRUST_SHARE else "no-go",
        f"the most loaded vehicle needs {100 * share:.0f} % of its thrust, {100 * THRUST_SHARE:.0f} % may be needed",
    )  # fmt: skip
    pull = min(c["equilibrium"]["tension_N"], default=0.0)
    yield Line(
        "design",
        "every cable is taut at rest",
        "go" if pull > 0 else "no-go",
        f"the least tension at rest is {pull:.2f} N",
    )
    radius = c["closed_loop"]["spectral_radius"]
    yield Line(
        "design", "the loop as flown is stable", "go" if radius < 1 else "no-go",
        f"spectral radius {radius:.4f} of the sampled loop with delay and attitude response, below 1 is needed",
    )  # fmt: skip
    missing = c["out_of_reach"]
    said = "; ".join(missing) if missing else "every motion of load and cables is in reach of the vehicles"
    yield Line("design", "what forces can reach", "note" if missing else "go", said)
    certified = c["certificate"].get("verdict", "")
    yield Line("design", "Proposition 3", "note", str(certified) or "see: cablequad check")


def one_lost(flight: Flight) -> Iterator[Line]:
    """What is left, at rest, of a set-up that loses the vehicle that it can spare least: no law makes more of it."""
    assert flight.scenario.mission is not None
    limit, n = flight.scenario.mission.guards.load_tilt_deg, len(flight.system.m)
    left: list[tuple[float, float, int]] = []  # deg, share of thrust, vehicle
    for lost, d in contingencies(flight, laws.design(flight)).designs.items():
        for k in lost:
            share = np.linalg.norm(d.u_star, axis=1) / np.delete(flight.airframe.max_thrust, k)
            left.append((math.degrees(math.acos(min(1.0, float(d.hanging.R0[2, 2])))), float(share.max()), k + 1))
    if len(left) < n:
        missing = sorted(set(range(1, n + 1)) - {k for _, _, k in left})
        who = ", ".join(map(str, missing))
        yield Line("design", "one vehicle lost", "note", f"without vehicle {who} the load cannot be held at rest")
        return
    tilt, share, k = max(left)
    ok = share <= 1.0 and tilt <= limit
    why = (
        f"without vehicle {k} the load hangs tilted by {tilt:.0f} deg (guard: {limit:g}), and at rest the others need "
    )
    yield Line("design", "one vehicle lost", "go" if ok else "note", f"{why}{100 * share:.0f} % of their thrust")


def _margins(m: dict[str, Any]) -> Iterator[Line]:
    for row in m["margins"]:
        measured, predicted = (margin_text(row, row[key], m["period_ms"]) for key in ("measured", "predicted"))
        least = ASKED[row["name"]]
        ok = row["measured"] >= least if least >= row["nominal"] else row["measured"] <= least
        asked = margin_text(row, least, m["period_ms"])
        why = f"stands {measured} (asked {asked}); predicted {predicted}, set by {row['bound']}"
        yield Line("margins", row["name"], "go" if ok else "no-go", why)


def _told(s: dict[str, Any]) -> str:
    asked = [
        f"{c['name']} {c['measured']:.3g} (asked {c['limit']:g})"
        for c in s["criteria"] or []
        if c["measured"] is not None
    ]
    return "; ".join([s["reason"], *asked])


def verdict(lines: list[Line]) -> bool:
    """Whether every line allows the flight."""
    return all(line.verdict != "no-go" for line in lines)


def show(name: str, lines: list[Line], console: Console) -> None:
    """The page on a terminal."""
    go = verdict(lines)
    out = Table(title=f"{name}: {'GO' if go else 'NO-GO'}", title_justify="left")
    for column in ("", "what", "", "why"):
        out.add_column(column, overflow="fold")
    before = ""
    for line in lines:
        colour = {"go": "green", "no-go": "bold red"}.get(line.verdict, "dim")
        out.add_row(line.part if line.part != before else "", line.name, f"[{colour}]{line.verdict}[/]", line.why)
        before = line.part
    console.print(out)


def page(name: str, description: str, lines: list[Line]) -> str:
    """The page as HTML, with everything inside."""
    go = verdict(lines)
    rows = "".join(
        f"<tr><td>{html.escape(line.part)}<td>{html.escape(line.name)}"
        f"<td class='{line.verdict}'>{line.verdict}<td>{html.escape(line.why)}"
        for line in lines
    )
    word = "go" if go else "no-go"
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(name)}: {word}</title>"
        f"<style>{STYLE}</style>"
        f"<h1>{html.escape(name)}: <span class='{word}'>{word.upper()}</span></h1><p>{html.escape(description)}</p>"
        f"<table><tr><th><th>what<th><th>why</tr>{rows}</table></html>"
    )
