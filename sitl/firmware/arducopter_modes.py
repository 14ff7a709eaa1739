"""ArduCopter's modes and arming as transition tables."""

from enum import IntEnum
from typing import NamedTuple

from sitl.firmware.transitions import ACCEPTED, CRITICAL, FAILED, INFO, Row


class CopterMode(IntEnum):
    """The modes this vehicle knows, by ArduCopter's numbers."""

    STABILIZE = 0
    ACRO = 1
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17
    GUIDED_NOGPS = 20


NEEDS_POSITION = frozenset(
    {CopterMode.AUTO, CopterMode.GUIDED, CopterMode.LOITER, CopterMode.RTL, CopterMode.POSHOLD, CopterMode.BRAKE}
)
NOT_ARMABLE = frozenset({CopterMode.RTL, CopterMode.LAND, CopterMode.BRAKE, CopterMode.AUTO})
TAKES_SETPOINTS = frozenset({CopterMode.GUIDED, CopterMode.GUIDED_NOGPS})


class CopterConditions(NamedTuple):
    """What the tables look at."""

    armed: bool
    landed: bool
    mode: CopterMode  # it is in, or for an entry the one asked for
    position: bool  # the estimator uses GPS
    forced: bool = False  # param2 = 2989 or 21196: optional checks are skipped, mandatory ones are not


Table = tuple[Row[CopterConditions], ...]

ENTRY: Table = (
    Row(lambda s: s.mode is CopterMode.AUTO and s.armed, FAILED, CRITICAL, "Mode change to AUTO failed: no mission"),
    Row(
        lambda s: s.armed and s.mode in NEEDS_POSITION and not s.position,
        FAILED,
        CRITICAL,
        "Mode change failed: requires position",
    ),
    Row(lambda s: True, ACCEPTED),
)
ARM: Table = (
    Row(lambda s: s.armed, ACCEPTED),
    Row(lambda s: s.mode in NOT_ARMABLE, FAILED, CRITICAL, "Arm: Mode not armable"),
    Row(lambda s: s.mode in NEEDS_POSITION and not s.position, FAILED, CRITICAL, "Arm: Need Position Estimate"),
    Row(lambda s: True, ACCEPTED, INFO, "Arming motors"),
)
DISARM: Table = (
    Row(lambda s: not s.armed, ACCEPTED),
    Row(lambda s: s.landed or s.forced, ACCEPTED, INFO, "Disarming motors"),
    Row(lambda s: True, FAILED),
)
TAKEOFF: Table = (
    Row(lambda s: s.armed and s.mode is CopterMode.GUIDED and s.landed, ACCEPTED),
    Row(lambda s: True, FAILED),
)
