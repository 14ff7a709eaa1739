"""Recorded flights with real autopilots, against personas on the same scenarios: `python -m benchmarks.flown FOLDER`.

FOLDER has arducopter-case-1/run.mcap and so on. A persona flies the recorded scenario with the recorded law, answering
as its firmware is known to, from where the recorded load was lifted: it had crept there. Positions of the load are
compared phase by phase, from the beginning of each.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from logs.reading.reader import Run, read
from sitl.firmware.personas import PERSONAS

Array = NDArray[np.float64]
FLIGHTS = ("case-1", "ground-to-ground")
SEEDS = 10
COMPARED = {"carry", "set down"}
STEP_S = 0.02


class Motion(NamedTuple):
    """What a flight was like: the load's true position since the beginning of each phase that is compared."""

    phases: dict[str, Array]  # (k, 3) m, STEP_S apart
    largest_tension_N: float  # in any link, since the release
    age_ms: float  # mean, of the oldest part of the states that decisions in flight went by


def motion(run: Run) -> Motion:
    """Of a log with truth."""
    plant = run.columns["/plant/state"]
    t, x = plant["sim_time_ns"] * 1e-9, plant["payload_position"]
    begins = [(e.time_ns * 1e-9, e.text) for e in run.events if e.kind == "phase"]
    last = max(e.time_ns * 1e-9 for e in run.events if e.kind == "end")
    if not begins:  # no mission: all of it is one phase
        begins = [(run.release_ns * 1e-9, "carry")]
    out = {}
    for (start, name), (end, _) in zip(begins, [*begins[1:], (last, "")], strict=True):
        if name in COMPARED:
            at = np.arange(start, end, STEP_S)
            out[name] = np.column_stack([np.interp(at, t, x[:, k]) for k in range(3)])
    control = run.columns["/control/state"]
    own = (control["sim_time_ns"] >= run.release_ns) & (control["sim_time_ns"] * 1e-9 <= last)
    pulled = plant["tension"][(plant["sim_time_ns"] >= run.release_ns) & (t <= last)]
    return Motion(out, float(np.nanmax(pulled)), 1e3 * float(control["state_age"][own].mean()))


def begun(run: Run, scenario: dict[str, Any]) -> dict[str, Any]:
    """The scenario from where the load lay when it was lifted: in recordings of missions it had crept by 5 cm."""
    lifted = [e.time_ns for e in run.events if (e.kind, e.text) == ("phase", "lift")]
    if not lifted:
        return scenario
    plant = run.columns["/plant/state"]
    x, y, _ = plant["payload_position"][np.searchsorted(plant["sim_time_ns"], lifted[0])].tolist()
    initial = scenario["initial"]
    return scenario | {"initial": initial | {"position_m": [x, y, initial["position_m"][2]]}}


def difference(a: Motion, b: Motion) -> tuple[float, float]:
    """RMS and largest distance (m) between two motions, phase by phase, as long as both last."""
    off = []
    for name in a.phases.keys() & b.phases.keys():
        k = min(len(a.phases[name]), len(b.phases[name]))
        off.append(np.linalg.norm(a.phases[name][:k] - b.phases[name][:k], axis=1))
    whole = np.concatenate(off)
    return float(np.sqrt(np.mean(whole**2))), float(whole.max())


def persona(scenario: dict[str, Any], firmware: str, seed: int, folder: Path) -> tuple[Motion, dict[str, Any]]:
    """Today's persona on a recorded scenario: the law as it was, the vehicle as its firmware is known to answer."""
    known = PERSONAS[firmware].known
    scenario = json.loads(json.dumps(scenario))
    scenario["seed"] = seed
    scenario["vehicle"] |= {
        "firmware": firmware,
        "delay_ms": 1e3 * known.own_delay_s,
        "stream_phase_ms": known.phase_ms,
    }
    for vehicle in scenario["vehicles"]:
        vehicle["firmware"] = None
    scenario.setdefault("real", {})
    scenario["real"] |= {"attitude_bandwidth_rad_s": known.bandwidth_rad_s, "attitude_damping": known.damping}
    scenario.setdefault("sensors", {})
    scenario["sensors"] |= {
        "attitude_bias_deg": known.bias_deg, "position_offset_m": known.position_offset_m,
        "attitude_offset_deg": known.attitude_offset_deg,
    }  # fmt: skip
    file = folder / "scenario.json"
    file.write_text(json.dumps(scenario))
    command = [sys.executable, "-m", "missions.cli.main", "fly", str(file), "--in-process", "--json", "--no-replay"]
    more = ["--out", str(folder)]
    done = subprocess.run([*command, *more], capture_output=True, text=True, check=False)
    summary = json.loads(done.stdout)
    return motion(read(Path(summary["log"]))), summary


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--flights", nargs="*", default=FLIGHTS)
    given = parser.parse_args()
    table = Table(title="the load's position, real flight against persona", title_justify="left")
    for column in (
        "firmware", "flight", "rms, cm", "largest, cm", "floor rms, cm", "set down, cm", "touch-down, m/s",
        "tension, N: real", "persona", "age, ms: real", "persona", "made / asked",
    ):  # fmt: skip
        table.add_column(column)
    for firmware in PERSONAS:
        for name in given.flights:
            run = read(given.folder / f"{firmware}-{name}" / "run.mcap")
            scenario = begun(run, json.loads(run.attachments["scenario.json"]))
            real = motion(run)
            flown = []
            with tempfile.TemporaryDirectory() as folder:
                flown += [persona(scenario, firmware, seed, Path(folder)) for seed in range(given.seeds)]
            against = [difference(real, m) for m, _ in flown]
            spread = [difference(flown[0][0], m)[0] for m, _ in flown[1:]]
            set_down = [s["set_down_error_m"] for _, s in flown if s["set_down_error_m"] is not None]
            touch = [s["touch_down_m_s"] for _, s in flown if s["touch_down_m_s"] is not None]
            made = [k["scale"] for _, s in flown for k in s["thrust_scale"] or () if k is not None]
            table.add_row(
                PERSONAS[firmware].known.name, name, f"{100 * np.median([a for a, _ in against]):.2f}",
                f"{100 * np.median([b for _, b in against]):.2f}", f"{100 * float(np.mean(spread or [0.0])):.2f}",
                f"{100 * np.median(set_down):.1f}" if set_down else "", f"{np.median(touch):.2f}" if touch else "",
                f"{real.largest_tension_N:.1f}", f"{np.median([m.largest_tension_N for m, _ in flown]):.1f}",
                f"{real.age_ms:.0f}", f"{np.median([m.age_ms for m, _ in flown]):.0f}",
                f"{min(made):.4f} to {max(made):.4f}" if made else "not known",
            )  # fmt: skip
    Console(width=190).print(table)


if __name__ == "__main__":
    main()
