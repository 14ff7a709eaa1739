"""The phases of a mission: what each may follow, and how long it may take."""

from enum import StrEnum
from typing import NamedTuple


class Phase(StrEnum):
    """What a mission is about."""

    PREFLIGHT = "preflight"
    ARM = "arm"
    TAKE_OFF = "take off"
    TENSION = "tension"
    LIFT = "lift"
    CARRY = "carry"
    SET_DOWN = "set down"
    RELEASE = "release"
    LAND = "land"
    DISARM = "disarm"


class Rule(NamedTuple):
    """One phase's row."""

    after: frozenset[Phase | None]  # what it may follow; None: nothing yet
    limit_s: float  # what it may take
    enters_when: str  # in words
    exits_when: str


P = Phase
RULES: dict[Phase, Rule] = {
    P.PREFLIGHT: Rule(frozenset({None}), 90.0, "the vehicles are heard", "every check holds"),
    P.ARM: Rule(frozenset({P.PREFLIGHT}), 60.0, "every check held", "every vehicle is armed and obeys setpoints"),
    P.TAKE_OFF: Rule(
        frozenset({P.ARM}), 30.0, "all armed, on their feet", "all hover above their ends of the cables, still slack"
    ),
    P.TENSION: Rule(
        frozenset({P.TAKE_OFF, P.RELEASE}), 20.0, "all hover on slack cables",
        "every cable is straight and bears its share",
    ),
    P.LIFT: Rule(frozenset({P.TENSION, P.ARM}), 30.0, "every cable is straight", "the load hangs still at its height"),
    P.CARRY: Rule(frozenset({P.LIFT, P.CARRY}), 600.0, "the load hangs", "the load is still at the end of its way"),
    P.SET_DOWN: Rule(frozenset({P.LIFT, P.CARRY}), 60.0, "the load hangs", "the load stands"),
    P.RELEASE: Rule(
        frozenset({P.SET_DOWN, P.TENSION}), 20.0, "the load stands", "all hover on slack cables again"
    ),
    P.LAND: Rule(frozenset({P.RELEASE, P.TAKE_OFF}), 30.0, "all hover on slack cables", "all stand beside the load"),
    P.DISARM: Rule(
        frozenset({P.LAND, P.ARM, P.PREFLIGHT}), 15.0, "all stand on the ground", "every vehicle says so"
    ),
}  # fmt: skip
ORDER = tuple(Phase)
LOADED = frozenset({P.LIFT, P.CARRY, P.SET_DOWN})  # the load hangs, or is about to
FLYING = LOADED | {P.TAKE_OFF, P.TENSION, P.RELEASE, P.LAND}
PREPARE, FLY = "prepare", "fly"  # the two phases of a flight that begins in the air
CARRIED: frozenset[str] = frozenset({FLY, *LOADED})  # phases in which a load is flown along its reference
ON_PLAN = frozenset({P.LIFT, P.CARRY})  # the load is to be where its reference is; set down, it is led into the ground
SLACK = frozenset({P.TAKE_OFF, P.TENSION, P.RELEASE})  # nobody carries yet, or any more
