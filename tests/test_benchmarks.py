"""Every benchmark and every drawing that the documents name runs: one that no longer fits the code is known at once."""

import json
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import benchmarks
from docs import figures
from missions.flight.options import Options, Progress
from missions.flight.run import run
from missions.scenario.loading import load

ROOT = str(Path(__file__).parents[1])
SHORT = {
    "wire": (["--seconds", "0.5"], ["SET_ATTITUDE_TARGET", "x real time", "pymavlink alone", "observe"]),
    "sizes": (["--sizes", "2x2"], ["design s", "dlqr s"]),
    "model": (["--short", "--out", "OUT"], ["MuJoCo RK4 step", "whole step", "x real time on one core", "first line"]),
    "control": (["one-vehicle", "--out", "OUT"], ["sampled", "paper", "rms tracking"]),
    "margins": (["--systems", "1", "--bisections", "1", "--out", "OUT"], ["payload lighter", "vehicles,"]),
    "record": (["--seconds", "6", "--out", "OUT"], ["share of a core", "protobuf's and mcap's own objects"]),
    "autopilots": (["one-vehicle"], ["ardupilot"]),
    "flights": (["--short", "--out", "OUT"], ["flights a core and hour", "without a wire"]),
    "flown": (["FOLDER", "--seeds", "1", "--flights", "case-1"], ["PX4", "ArduCopter", "rms, cm"]),
}  # arguments that take seconds, and what is printed
HELPERS = {"peer"}  # of benchmarks


def ran(name: str, arguments: list[str]) -> str:
    """What a benchmark prints."""
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{name}", *arguments], cwd=ROOT, env={**os.environ, "PYTHONPATH": ROOT},
        capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


def recordings(folder: Path) -> None:
    """Flights in the places where the recordings of real autopilots are."""
    for firmware in ("px4", "arducopter"):
        into = folder / f"{firmware}-case-1"
        summary, _ = run(load("paper-case-1-50hz", firmware=firmware), Options(out=into, in_process=True), Progress())
        Path(summary.log or "").rename(into / "run.mcap")


def test_every_benchmark_has_a_short_form() -> None:
    assert {m.name for m in pkgutil.iter_modules(benchmarks.__path__)} == set(SHORT) | HELPERS


@pytest.mark.parametrize("name", SHORT)
def test_a_benchmark_measures_to_its_end(name: str, tmp_path: Path) -> None:
    arguments, printed = SHORT[name]
    if "FOLDER" in arguments:
        recordings(tmp_path)
    out = tmp_path / "results.json"
    shown = ran(name, [{"OUT": str(out), "FOLDER": str(tmp_path)}.get(a, a) for a in arguments])
    for words in printed:
        assert words in shown
    assert "nan" not in shown
    if "OUT" in arguments:
        assert json.loads(out.read_text())


def test_the_documents_figures_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "OUT", tmp_path)
    figures.main()
    drawn = {path.name for path in tmp_path.iterdir()}
    assert drawn == {"order.png", "precision.png", "linear.png", "certificate.png"}
    assert all(path.stat().st_size > 10_000 for path in tmp_path.iterdir())
