"""Transition tables: a row is (condition, result, what is said); the first whose condition holds decides.

Results are MAV_RESULT numbers. Facts about the firmware behind the rows: docs/vehicles.md.
"""

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
INFO, WARNING, CRITICAL = 6, 4, 2

S = TypeVar("S")


class Row(NamedTuple, Generic[S]):
    """One transition."""

    holds: Callable[[S], bool]
    result: int
    severity: int = INFO
    text: str = ""


def decide(table: tuple[Row[S], ...], situation: S) -> Row[S]:
    """The first row that holds."""
    return next(row for row in table if row.holds(situation))
