"""Scenarios: their tables, loading and validation, mission plans and scripts."""
