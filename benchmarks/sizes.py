"""What other sizes cost before and in a flight: `python -m benchmarks.sizes [--sizes 4x5 6x20 8x40] [--out FILE]`.

Vehicles on a ring, a metre of cable for five links. Beside each design stands the time of `control.dlqr` for the same
gains, up to `JUDGED` states.
"""

import argparse
import json
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control
import numpy as np
from rich.console import Console
from rich.table import Table

from cablequad.control.control_step import Measurement, control_step, first_memory
from cablequad.control.design import sampled_loop
from cablequad.control.trajectory import at
from cablequad.model.attitude import Setpoint, fly
from cablequad.model.integrate import scratch
from missions.analysis.check import check
from missions.scenario import laws
from missions.scenario import loading as scenarios

SIZES = ("4x5", "6x20", "8x40")
JUDGED = 600


def ring(n: int, links: int) -> str:
    """A scenario file: n vehicles of the paper's over a load, each on a cable of so many links."""
    radius = max(0.5, 0.12 * n)
    angles = [2.0 * math.pi * i / n for i in range(n)]
    places = [[round(radius * math.cos(a), 4), round(radius * math.sin(a), 4), -0.1] for a in angles]
    vehicles = "".join(f"[[vehicles]]\nattachment_m = {place}\n" for place in places)
    return f"""
name = "ring-{n}x{links}"
description = "{n} vehicles, {links} links each"
duration_s = 20.0
payload = {{ mass_kg = {0.125 * n}, box_m = [{1.2 * radius:.2f}, {1.2 * radius:.2f}, 0.2] }}
vehicle = {{ mass_kg = 0.755, inertia_kg_m2 = [5.57e-3, 5.57e-3, 1.05e-2], max_thrust_N = 25.0 }}
cable = {{ link_masses_kg = {[0.01] * links}, link_lengths_m = {[0.2] * links} }}
initial = {{ position_m = [0.0, 0.0, -2.0] }}
target = {{ position_m = [1.0, 1.0, -2.0] }}
control = {{ rate_hz = 50 }}
{vehicles}"""


def took(call: Callable[[], Any]) -> tuple[float, Any]:
    """s, and what came of it."""
    begun = time.perf_counter()
    out = call()
    return time.perf_counter() - begun, out


def measured(n: int, links: int, folder: Path) -> dict[str, Any]:
    """Everything of one size."""
    path = folder / "ring.toml"
    path.write_text(ring(n, links))
    flight = scenarios.load(str(path))
    design_s, design = took(lambda: laws.design(flight))
    period = flight.control_us * 1e-6
    loop = sampled_loop(flight.system, flight.airframe, period, flight.scenario.control.delay_ticks)
    judge_s = None
    if len(loop.A) <= JUDGED:
        judge_s, _ = took(lambda: control.dlqr(loop.A, loop.B, np.eye(len(loop.A)), np.eye(loop.B.shape[1])))
    memory, reference = first_memory(design), at(flight.trajectory, 0.0)
    seen = Measurement(0.0, flight.initial)
    first_s, _ = took(lambda: control_step(memory, seen, reference, design))
    tick_s = min(took(lambda: control_step(memory, seen, reference, design))[0] for _ in range(200))
    state, h = flight.initial.copy(), flight.physics_us * 1e-6
    work = scratch(flight.system, state)
    hover = Setpoint.attitude(state.R, -design.u_star[:, 2])
    fly(flight.system, flight.airframe, hover, state, h, 1, work)
    step_s = (
        min(took(lambda: fly(flight.system, flight.airframe, hover, state, h, 20, work))[0] for _ in range(20)) / 20
    )
    check_s, _ = took(lambda: check(flight, quick=True))
    return {
        "n": n, "links": links, "states": len(loop.A), "design_s": design_s, "dlqr_s": judge_s,
        "check_quick_s": check_s,
        "first_tick_s": first_s, "tick_us": 1e6 * tick_s, "step_us": 1e6 * step_s,
    }  # fmt: skip


def main() -> None:
    """Print the table; write it where asked."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--sizes", nargs="+", default=list(SIZES), metavar="NxLINKS")
    arguments.add_argument("--out", type=Path)
    asked = arguments.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for size in asked.sizes:
            n, links = (int(part) for part in size.split("x"))
            rows.append(measured(n, links, Path(folder)))
    table = Table(title="what sizes cost; the first tick with compiling, or loading what was compiled")
    for name in ("n", "links", "states", "design s", "dlqr s", "check --quick s", "first tick s", "tick us", "step us"):
        table.add_column(name, justify="right")
    for r in rows:
        judge = "-" if r["dlqr_s"] is None else f"{r['dlqr_s']:.2f}"
        table.add_row(
            str(r["n"]), str(r["links"]), str(r["states"]), f"{r['design_s']:.2f}", judge, f"{r['check_quick_s']:.1f}",
            f"{r['first_tick_s']:.1f}", f"{r['tick_us']:.0f}", f"{r['step_us']:.0f}",
        )  # fmt: skip
    Console(width=120, highlight=False).print(table)
    if asked.out:
        asked.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
