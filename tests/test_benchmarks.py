"""Every benchmark that the documents name runs: one that no longer fits the code is known at once."""

import importlib
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import benchmarks

SHORT = {
    "wire": (["--seconds", "0.5"], ["SET_ATTITUDE_TARGET", "x real time", "pymavlink alone", "observe"]),
    "sizes": (["--sizes", "2x2"], ["design s", "dlqr s"]),
}  # arguments of seconds, and what is printed


@pytest.mark.parametrize("name", [m.name for m in pkgutil.iter_modules(benchmarks.__path__)])
def test_a_benchmark_fits_the_code(name: str) -> None:
    importlib.import_module(f"benchmarks.{name}")


@pytest.mark.parametrize("name", SHORT)
def test_a_benchmark_measures_to_its_end(name: str) -> None:
    arguments, printed = SHORT[name]
    root = str(Path(__file__).parents[1])
    ran = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{name}", *arguments], cwd=root, env={**os.environ, "PYTHONPATH": root},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr
    for words in printed:
        assert words in ran.stdout
