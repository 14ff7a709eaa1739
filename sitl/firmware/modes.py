"""PX4's modes and arming as transition tables (facts: sections 3 and 4 of the firmware notes).

A row is (condition, result, what is said); the first whose condition holds decides. Results are MAV_RESULT numbers.
"""

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
INFO, WARNING, CRITICAL = 6, 4, 2


class Mode(Enum):
    """The modes this vehicle flies, with PX4's (main, sub) numbers and the base_mode bits they show."""

    POSCTL = (3, 0, 16 | 64)
    LOITER = (4, 3, 16 | 4 | 8)
    OFFBOARD = (6, 0, 16)

    @property
    def custom(self) -> int:
        """HEARTBEAT.custom_mode."""
        return self.value[0] << 16 | self.value[1] << 24


BY_NUMBER = {(mode.value[0], mode.value[1]): mode for mode in Mode}
KNOWN_MAIN = range(1, 11)


class Situation(NamedTuple):
    """What the tables look at."""

    armed: bool
    landed: bool
    mode: Mode
    fresh_setpoint: bool  # an offboard setpoint younger than COM_OF_LOSS_T
    forced: bool = False  # param2 = 21196


class Row(NamedTuple):
    """One transition."""

    holds: Callable[[Situation], bool]
    result: int
    severity: int = INFO
    text: str = ""


OFFBOARD_ENTRY = (
    Row(
        lambda s: s.armed and not s.fresh_setpoint,
        TEMPORARILY_REJECTED,
        CRITICAL,
        "Switching to Offboard is currently not available",
    ),
    Row(lambda s: True, ACCEPTED),
)
OTHER_ENTRY = (Row(lambda s: True, ACCEPTED),)
ARM = (
    Row(lambda s: s.armed, ACCEPTED),
    Row(
        lambda s: s.mode is Mode.OFFBOARD and not s.fresh_setpoint,
        TEMPORARILY_REJECTED,
        CRITICAL,
        "Arming denied: Resolve system health failures first",
    ),
    Row(lambda s: True, ACCEPTED, INFO, "Armed by external command"),
)
DISARM = (
    Row(lambda s: not s.armed, ACCEPTED),
    Row(lambda s: s.landed or s.forced, ACCEPTED, INFO, "Disarmed by external command"),
    Row(lambda s: True, TEMPORARILY_REJECTED, CRITICAL, "Disarming denied: not landed"),
)


def entry(mode: Mode) -> tuple[Row, ...]:
    """The table that decides whether `mode` may be entered."""
    return OFFBOARD_ENTRY if mode is Mode.OFFBOARD else OTHER_ENTRY


def decide(table: tuple[Row, ...], situation: Situation) -> Row:
    """The first row that holds."""
    return next(row for row in table if row.holds(situation))
