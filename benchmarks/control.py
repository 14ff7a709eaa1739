"""Every scenario that ships, flown with our law and with the paper's: `python -m benchmarks.control [SCENARIO ...]`.

Figures are those of the log's truth. The prototype's are those that the design notes give for a discrete LQR of the
same loop without prediction, reference shaping or integral action. `--out FILE` writes them as JSON.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from logs.reading import reader
from missions.flight.run import Options, Progress, run
from missions.scenario import loading as scenarios

PROTOTYPE = {
    "paper-case-1-50hz": {"error_8_10_m": 0.012},
    "paper-case-2": {
        "error_8_10_m": 0.028, "error_18_20_m": 0.005, "psi_0_8_10": 6e-5, "e_q_10": 0.44, "e_q_20": 0.19,
        "max_psi": 0.44, "max_thrust_N": 13.4,
    },
    "paper-case-2-50hz": {
        "error_8_10_m": 0.052, "error_18_20_m": 0.046, "psi_0_8_10": 1.3e-2, "e_q_10": 1.8, "e_q_20": 2.4,
        "max_psi": 0.48, "max_thrust_N": 16.3,
    },
}  # fmt: skip
SHOWN = (
    ("error_8_10_m", "largest error 8-10 s, cm", 100.0, "{:.2f}"),
    ("error_18_20_m", "18-20 s, cm", 100.0, "{:.2f}"),
    ("psi_0_8_10", "Psi_0 8-10 s", 1.0, "{:.1e}"),
    ("psi_0_18_20", "Psi_0 18-20 s", 1.0, "{:.1e}"),
    ("e_q_10", "e_q at 10 s", 1.0, "{:.2f}"),
    ("e_q_20", "e_q at 20 s", 1.0, "{:.2f}"),
    ("rms_m", "rms tracking, cm", 100.0, "{:.2f}"),
    ("mean_last_m", "mean of last 10 s, cm", 100.0, "{:.2f}"),
    ("link_deg", "links, deg rms", 1.0, "{:.2f}"),
    ("max_psi", "Psi_i", 1.0, "{:.2f}"),
    ("max_thrust_N", "thrust, N", 1.0, "{:.1f}"),
)


def flown(name: str, law: str, folder: Path) -> dict[str, Any]:
    """One flight's figures."""
    source = scenarios.text(name).replace('law = "sampled"', f'law = "{law}"')
    path = folder / f"{name}-{law}.toml"
    path.write_text(source)
    flight = scenarios.load(str(path))
    summary, _ = run(flight, Options(out=folder, in_process=True), Progress())
    out: dict[str, Any] = {
        "scenario": name, "law": law, "passed": summary.passed, "reason": summary.reason, "flown_s": summary.flown_s,
        "max_psi": summary.max_psi, "max_thrust_N": summary.max_thrust_N, "rms_m": summary.rms_tracking_error_m,
        "mean_last_m": summary.mean_position_error_m, "link_deg": summary.link_direction_error_deg,
    }  # fmt: skip
    log = reader.read(Path(summary.log or ""))
    control = log.columns["/control/state"]
    flying = control["phase"] == "fly"
    t, psi_0, e_q = control["t"][flying], control["Psi_0"][flying], control["e_q"][flying]
    target = np.array(flight.scenario.target.position_m)
    error = np.linalg.norm(control["position"][flying] - target, axis=1)
    for first, last in ((8, 10), (18, 20)):
        window = (t >= first) & (t <= last + 1e-9)
        if window.any() and t[-1] >= last - 0.1:
            out[f"error_{first}_{last}_m"] = float(error[window].max())
            out[f"psi_0_{first}_{last}"] = float(psi_0[window].max())
            out[f"e_q_{last}"] = float(e_q[np.argmin(np.abs(t - last))])
    Path(summary.log or "").unlink(missing_ok=True)
    return out


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", help="which; all that ship where none is given")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    table = Table(title="scenarios flown in process", title_justify="left")
    for heading in ("scenario", "law", "verdict", *(shown[1] for shown in SHOWN)):
        table.add_column(heading, justify="left" if heading in ("scenario", "law") else "right")
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.scenarios or scenarios.names():
            for law in ("sampled", "paper"):
                found.append(flown(name, law, Path(folder)))
                _row(table, name, law, "passed" if found[-1]["passed"] else "failed", found[-1])
            if name in PROTOTYPE:
                _row(table, name, "prototype", "", PROTOTYPE[name])
    Console(width=210).print(table)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")


def _row(table: Table, name: str, law: str, verdict: str, figures: dict[str, Any]) -> None:
    cells = []
    for key, _, scale, form in SHOWN:
        value = figures.get(key)
        cells.append("" if value is None or not np.isfinite(value) else form.format(scale * value))
    table.add_row(name, law, verdict, *cells)


if __name__ == "__main__":
    main()
