"""Figures, each printed by one command: `python -m benchmarks.model`, `python -m benchmarks.loop`."""
