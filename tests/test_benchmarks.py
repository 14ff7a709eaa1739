"""Every benchmark that the documents name can be started: one that no longer fits the code is known at once."""

import importlib
import pkgutil

import pytest

import benchmarks


@pytest.mark.parametrize("name", [m.name for m in pkgutil.iter_modules(benchmarks.__path__)])
def test_a_benchmark_fits_the_code(name: str) -> None:
    importlib.import_module(f"benchmarks.{name}")
