"""The flights that the README quotes, and how many one core flies in an hour: `python -m benchmarks.flights [--out F]`.

Every flight is in one process and thread, everything recorded unless it says otherwise. `--short` flies Case 1 alone.
"""

import argparse
import json
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.trajectory import at
from logs.reading.reader import read
from missions.flight.run import Options, Progress, run
from missions.scenario import laws
from missions.scenario import loading as scenarios

FLIGHTS = (
    ("paper-case-1", "px4"), ("paper-case-2", "px4"), ("ground-to-ground", "px4"), ("ground-to-ground", "arducopter"),
)  # fmt: skip


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def flown(name: str, firmware: str, folder: Path) -> dict[str, Any]:
    """One flight: its figures, and the processor time that it took."""
    flight = scenarios.load(name, firmware=firmware)
    begun, used = time.perf_counter(), _processor_s()
    summary, _ = run(flight, Options(out=folder, in_process=True), Progress())
    wall_s, core_s = time.perf_counter() - begun, _processor_s() - used
    columns = read(Path(summary.log or "")).columns
    out: dict[str, Any] = {
        "scenario": name, "firmware": firmware, "passed": summary.passed, "flown_s": summary.flown_s, "wall_s": wall_s,
        "core_s": core_s, "per_core_hour": 3600.0 / core_s, "final_error_m": summary.final_position_error_m,
        "final_speed_m_s": summary.final_speed_m_s, "final_e_q": summary.final_e_q, "max_psi": summary.max_psi,
        "set_down_error_m": summary.set_down_error_m, "touch_down_m_s": summary.touch_down_m_s,
    }  # fmt: skip
    if flight.scenario.mission is None:
        control = columns["/control/state"]
        flying = control["phase"] == "fly"
        t = control["t"][flying]
        error = np.linalg.norm(control["position"][flying] - np.array(flight.scenario.target.position_m), axis=1)
        out["error_8_10_m"] = float(error[(t >= 8.0) & (t <= 10.0 + 1e-9)].max())
        out["e_q_10"] = float(control["e_q"][flying][np.argmin(np.abs(t - 10.0))])
    return out


def not_recorded(name: str) -> dict[str, float]:
    """The same plan by the same law without a wire, a sensor or a log."""
    flight = scenarios.load(name)
    law, period = laws.design(flight), flight.control_us * 1e-6
    timing = LoopTiming(period, flight.control_us // flight.physics_us, flight.scenario.control.delay_ticks)
    ticks = round(flight.scenario.duration_s / period)

    def once() -> float:
        used = _processor_s()
        plan = flight.trajectory
        for _ in rollout(
            law, flight.airframe, lambda t: at(plan, t), flight.initial, timing, ticks, law=laws.law_of(flight)
        ):
            pass
        return _processor_s() - used

    once()
    core_s = min(once() for _ in range(2))
    return {"core_s": core_s, "per_core_hour": 3600.0 / core_s}


def main() -> None:
    """Fly, print, and write where asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--short", action="store_true")
    asked = parser.parse_args()
    table = Table(title="flights in one process and thread, everything recorded", title_justify="left")
    for heading in ("scenario", "firmware", "verdict", "simulated, s", "core, s", "flights a core and hour"):
        table.add_column(heading, justify="left" if heading in ("scenario", "firmware") else "right")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        flown("paper-case-1-50hz", "px4", Path(folder))  # compiled, cached, warm
        for name, firmware in FLIGHTS[:1] if asked.short else FLIGHTS:
            row = flown(name, firmware, Path(folder))
            rows.append(row)
            table.add_row(
                name, firmware, "passed" if row["passed"] else "failed", f"{row['flown_s']:.1f}",
                f"{row['core_s']:.2f}", f"{row['per_core_hour']:.0f}",
            )  # fmt: skip
    bare = not_recorded("paper-case-1")
    console = Console(width=120)
    console.print(table)
    console.print(f"Case 1 without a wire and a log: {bare['per_core_hour']:.0f} flights a core and hour")
    if asked.out is not None:
        asked.out.write_text(json.dumps({"flights": rows, "without_wire": bare}, indent=1) + "\n")


if __name__ == "__main__":
    main()
