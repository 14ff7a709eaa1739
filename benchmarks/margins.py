"""Predicted and measured margins on systems drawn at random: `python -m benchmarks.margins [--systems 3] [--out FILE]`.

Nothing in the controller was chosen on these: vehicles, masses, cables, attitude loops and rates come from a seed.
"""

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from missions.analysis.margins import BISECTIONS, measure
from missions.flight.terminal import margin_text
from missions.scenario import loading as scenarios


def drawn(seed: int) -> str:
    """A scenario file: 3 to 6 vehicles around a load, at 250 to 50 Hz."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    rate = int(rng.choice([50, 100, 250]))
    links = int(rng.integers(2, 7))
    mass = rng.uniform(0.5, 1.5)
    load = rng.uniform(0.3, 0.8) * n * mass / 2
    angle = np.sort(2 * np.pi * (np.arange(n) + rng.uniform(-0.2, 0.2, n)) / n)
    radius = rng.uniform(0.4, 0.8)
    places = [[round(float(radius * np.cos(a)), 3), round(float(radius * np.sin(a)), 3), -0.1] for a in angle]
    places = [[round(x - float(np.mean([p[k] for p in places])) * (k < 2), 3) for k, x in enumerate(p)] for p in places]
    bandwidth = round(float(rng.uniform(10, 14) if rate == 50 else rng.uniform(15, 40)), 1)
    length = round(float(rng.uniform(0.6, 1.5) / links), 3)
    vehicles = "".join(f"[[vehicles]]\nattachment_m = {place}\n" for place in places)
    return f"""
name = "drawn-{seed}"
description = "{n} vehicles, {rate} Hz, attitude {bandwidth} rad/s, {links} links, load {load:.2f} kg"
duration_s = 10.0
[payload]
mass_kg = {load:.3f}
box_m = [{1.2 * radius:.2f}, {1.2 * radius:.2f}, 0.2]
[vehicle]
mass_kg = {mass:.3f}
inertia_kg_m2 = [{0.007 * mass:.5f}, {0.007 * mass:.5f}, {0.013 * mass:.5f}]
max_thrust_N = {30 * mass:.1f}
attitude_bandwidth_rad_s = {bandwidth}
[cable]
link_masses_kg = {[0.01] * links}
link_lengths_m = {[length] * links}
{vehicles}
[initial]
position_m = [0.0, 0.0, -2.0]
[target]
position_m = [1.0, 1.0, -2.0]
[control]
rate_hz = {rate}
"""


def main() -> None:
    """Draw, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", type=int, default=3)
    parser.add_argument("--first", type=int, default=101, help="seed of the first")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--bisections", type=int, default=BISECTIONS, help="of a measured margin")
    arguments = parser.parse_args()
    found: list[dict[str, Any]] = []
    table = Table(title="margins of systems drawn at random: predicted / measured", title_justify="left")
    table.add_column("system")
    for seed in range(arguments.first, arguments.first + arguments.systems):
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"drawn-{seed}.toml"
            path.write_text(drawn(seed))
            flight = scenarios.load(str(path))
        found.append({**measure(flight, bisections=arguments.bisections), "description": flight.scenario.description})
        rows = found[-1]["margins"]
        if len(found) == 1:
            for row in rows:
                table.add_column(row["name"], justify="right")
        period = found[-1]["period_ms"]
        cells = [" / ".join(margin_text(row, row[key], period) for key in ("predicted", "measured")) for row in rows]
        table.add_row(flight.scenario.description, *cells)
    Console(width=190).print(table)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
