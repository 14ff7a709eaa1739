"""PX4's modes and arming as transition tables."""

from enum import Enum
from typing import NamedTuple

from sitl.firmware.transitions import ACCEPTED, CRITICAL, INFO, TEMPORARILY_REJECTED, Row


class Px4Mode(Enum):
    """The modes this vehicle knows, with PX4's (main, sub) numbers and the base_mode bits they show."""

    MANUAL = (1, 0, 64)
    ALTCTL = (2, 0, 16 | 64)
    POSCTL = (3, 0, 16 | 64)
    TAKEOFF = (4, 2, 16 | 4 | 8)
    LOITER = (4, 3, 16 | 4 | 8)
    MISSION = (4, 4, 16 | 4 | 8)
    RTL = (4, 5, 16 | 4 | 8)
    LAND = (4, 6, 16 | 4 | 8)
    ACRO = (5, 0, 64)
    OFFBOARD = (6, 0, 16)
    STABILIZED = (7, 0, 16 | 64)

    @property
    def custom(self) -> int:
        """HEARTBEAT.custom_mode."""
        return self.value[0] << 16 | self.value[1] << 24


BY_NUMBER = {(mode.value[0], mode.value[1]): mode for mode in Px4Mode}
KNOWN_MAIN = range(1, 8)
STICKS = frozenset(
    {Px4Mode.MANUAL, Px4Mode.ALTCTL, Px4Mode.ACRO, Px4Mode.STABILIZED}
)  # flown by hand, and nobody has a radio here


class Px4Conditions(NamedTuple):
    """What the tables look at."""

    armed: bool
    landed: bool
    mode: Px4Mode
    fresh_setpoint: bool  # an offboard setpoint younger than COM_OF_LOSS_T
    estimator_ready: bool = True
    forced: bool = False  # param2 = 21196; skips nothing when it comes from outside


Table = tuple[Row[Px4Conditions], ...]

OFFBOARD_ENTRY: Table = (
    Row(
        lambda s: s.armed and not s.fresh_setpoint,
        TEMPORARILY_REJECTED,
        CRITICAL,
        "Switching to Offboard is currently not available",
    ),
    Row(lambda s: True, ACCEPTED),
)
STICKS_ENTRY: Table = (
    Row(lambda s: s.armed, TEMPORARILY_REJECTED, CRITICAL, "Switching to this mode needs manual control"),
    Row(lambda s: True, ACCEPTED),
)
MISSION_ENTRY: Table = (
    Row(lambda s: s.armed, TEMPORARILY_REJECTED, CRITICAL, "Mission mode: no mission on board"),
    Row(lambda s: True, ACCEPTED),
)
OTHER_ENTRY: Table = (Row(lambda s: True, ACCEPTED),)
_DENIED = "Arming denied: Resolve system health failures first"
ARM: Table = (
    Row(lambda s: s.armed, ACCEPTED),
    Row(lambda s: not s.estimator_ready, TEMPORARILY_REJECTED, CRITICAL, _DENIED),
    Row(lambda s: s.mode is Px4Mode.OFFBOARD and not s.fresh_setpoint, TEMPORARILY_REJECTED, CRITICAL, _DENIED),
    Row(lambda s: s.mode in STICKS | {Px4Mode.MISSION}, TEMPORARILY_REJECTED, CRITICAL, _DENIED),
    Row(lambda s: True, ACCEPTED, INFO, "Armed by external command"),
)
DISARM: Table = (
    Row(lambda s: not s.armed, ACCEPTED),
    Row(lambda s: s.landed or s.forced, ACCEPTED, INFO, "Disarmed by external command"),
    Row(lambda s: True, TEMPORARILY_REJECTED, CRITICAL, "Disarming denied: not landed"),
)


def entry(mode: Px4Mode) -> Table:
    """The table that decides whether `mode` may be entered."""
    if mode is Px4Mode.OFFBOARD:
        return OFFBOARD_ENTRY
    if mode is Px4Mode.MISSION:
        return MISSION_ENTRY
    return STICKS_ENTRY if mode in STICKS else OTHER_ENTRY
