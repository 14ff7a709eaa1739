"""Real-time factor of the joint lockstep: stand-ins for autopilots, each a process of its own, as fast as they go.

python -m benchmarks.autopilots [SCENARIO ...]
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

PEER = Path(__file__).parents[1] / "tests" / "peers" / "autopilot.py"
OFFSET = 20_000
FLIGHTS = (
    ("paper-case-1-50hz", "ardupilot", 4), ("paper-case-1-50hz", "px4", 4), ("ground-to-ground", "ardupilot", 4),
    ("ground-to-ground", "px4", 4), ("two-vehicles", "ardupilot", 2), ("one-vehicle", "ardupilot", 1),
)  # fmt: skip


def factor(scenario: str, backend: str, n: int) -> float:
    """Simulated seconds a second from the release to the end."""
    peers = []
    for i in range(n):
        physics = 9002 + OFFSET + 10 * i if backend == "ardupilot" else 4560 + OFFSET + i
        command = [sys.executable, str(PEER), backend, "--instance", str(i), "--physics", str(physics)]
        peers.append(subprocess.Popen([*command, "--mavlink", str(14540 + OFFSET + i)], stderr=subprocess.DEVNULL))
    try:
        with tempfile.TemporaryDirectory() as folder:
            flight = [
                sys.executable,
                "-m",
                "missions.cli.main",
                "fly",
                scenario,
                "--backend",
                backend,
                "--speed",
                "max",
            ]
            more = ["--json", "--no-replay", "--out", folder, "--port-offset", str(OFFSET)]
            out = subprocess.run([*flight, *more], capture_output=True, text=True, check=False).stdout
    finally:
        for peer in peers:
            peer.kill()
            peer.wait()
    return float(json.loads(out)["real_time_factor"] or "nan")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenarios", nargs="*", help="which; all where none is given")
    asked = parser.parse_args().scenarios
    table = Table(title="real-time factor with stand-ins for autopilots")
    for column in ("scenario", "backend", "vehicles", "x real time"):
        table.add_column(column)
    for scenario, backend, n in (f for f in FLIGHTS if not asked or f[0] in asked):
        table.add_row(scenario, backend, str(n), f"{factor(scenario, backend, n):.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()
