"""Drills: one thing goes wrong in a flight that begins in the air, with what protects against it and without.

A scenario that begins on the ground is cut to the part in which the load hangs; one that begins in the air gets ground
below it. Both are then flown as a mission: hang still, carry, set down, land.
"""

import math
from typing import Any, NamedTuple

from bridge.mission.scale import USUAL
from missions.flight.run import Options, Progress, run
from missions.flight.summary import Summary
from missions.scenario import flights
from missions.scenario.flights import Flight, ScenarioError
from missions.scenario.mission_setup import scale_of_flight
from missions.scenario.tables import BREAKING, CutTable, FailureTable, GroundTable, MissionTable

HOVER_S = 2.0  # when what happens at hover happens, since the release
TRANSIT_S = 6.0
EARLY = 0.3  # of the carriage, when the link is cut: all of the cut falls in it
HOLD_S = 3.0
LONGEST_S, LONGEST_BARE_S = 50.0, 35.0
LIFT, SET_DOWN, TAKE_OFF = 1.5, 5.0 / 3.0, 1.6  # times as fast as usual
SHIFT_M, SHIFT = 0.1, 0.25  # of a centre of mass: no more than this share of the load's shorter edge
CLEAR_M = 1.2  # below the lowest place of a scenario without ground
SOFT_M_S = 0.5  # of a load that is set down in an emergency
WORSE = 1.05  # a protection must make the harm smaller by at least this factor
ALIKE = 0.5  # of what counts as near: flights that end well, and stray no further apart than this, are alike


class Drill(NamedTuple):
    """One thing that goes wrong."""

    name: str
    what: str
    failures: tuple[FailureTable, ...] = ()
    cuts: tuple[CutTable, ...] = ()


class Drilled(NamedTuple):
    """How a drill ended, with protection and without."""

    drill: Drill
    protected: Summary
    bare: Summary
    verdict: str  # go, no-go, note
    why: str


def drills(flight: Flight) -> tuple[Drill, ...]:
    """The eight drills of a flight; what befalls one vehicle befalls the last."""
    n = len(flight.system.m)
    under_way = HOLD_S + EARLY * flight.trajectory.duration

    def one(kind: str, at_s: float, **more: Any) -> tuple[FailureTable, ...]:
        return (FailureTable(kind=kind, at_s=at_s, vehicle=n, **more),)  # type: ignore[arg-type]

    cut = (CutTable(vehicle=n, from_s=under_way, to_s=under_way + 2.0),)
    empty = one("low-battery", HOVER_S, remaining=0.15, lasts_s=30.0)
    shift = min(SHIFT_M, SHIFT * min(flight.scenario.payload.box_m[:2]))
    shifted = one("payload-shift", HOVER_S, offset_m=[shift, 0.0, 0.0])
    return (
        Drill("rotor out", "a rotor stops while the load hangs still", one("rotor-out", HOVER_S)),
        Drill("vehicle out", "all rotors of a vehicle stop in transit", one("vehicle-out", TRANSIT_S)),
        Drill("cable cut", "a cable comes off the load in transit", one("cable-cut", TRANSIT_S)),
        Drill("payload shift", f"the load's centre of mass shifts by {100 * shift:.3g} cm", shifted),
        Drill("gust", "a gust of 8 m/s over 3 s in transit", one("gust", TRANSIT_S, lasts_s=3.0)),
        Drill("link cut", "nothing passes to or from a vehicle for 2 s", (), cut),
        Drill("GPS loss", "a vehicle does not know where it is for 6 s", one("gps-loss", TRANSIT_S, lasts_s=6.0)),
        Drill("low battery", "a battery is at 15 % and empty 30 s later", empty),
    )  # fmt: skip


def rehearsal(flight: Flight) -> Flight:
    """The same load, vehicles and way, begun in the air over ground, as a mission. Raises ScenarioError."""
    s = flight.scenario
    start, target = list(s.initial.position_m), list(s.target.position_m)
    if s.mission is not None and s.mission.start == "ground":
        start[2] -= s.mission.lift_m
    scale = scale_of_flight(flight)
    quick = {
        "start": "air", "hold_s": HOLD_S, "lift_speed_m_s": round(LIFT * scale.lift_m_s, 6),
        "set_down_speed_m_s": round(SET_DOWN * scale.set_down_m_s, 6),
        "take_off_speed_m_s": round(TAKE_OFF * scale.take_off_m_s, 6),
    }  # fmt: skip
    mission = (s.mission or MissionTable()).model_copy(update=quick)
    ground = s.ground
    if ground is None:
        places = [start, target, *s.plan.waypoints_m, *([s.plan.centre_m] if s.plan.centre_m else [])]
        ground = GroundTable(z_m=max(p[2] for p in places) + 0.5 * math.hypot(*s.payload.box_m) + CLEAR_M)
    changes = {
        "ground": ground, "mission": mission, "duration_s": LONGEST_S,
        "initial": s.initial.model_copy(update={"position_m": start}),
        "acceptance": s.acceptance.model_copy(update=dict.fromkeys(type(s.acceptance).model_fields)),
    }  # fmt: skip
    if s.control.sensing == "vehicles":
        changes["control"] = s.control.model_copy(update={"sensing": "fleet"})
    return changed(flight, changes)


def in_the_air(flight: Flight) -> Flight:
    """What can be said of a flight before it flies is said of its part in which the load hangs."""
    return rehearsal(flight) if flight.scenario.mission is not None else flight


def changed(flight: Flight, changes: dict[str, Any]) -> Flight:
    """The flight with other tables. Raises ScenarioError."""
    s = flight.scenario.model_copy(update=changes)
    try:
        return flights.flight_of(type(s).model_validate_json(s.model_dump_json()), flight.source)
    except ValueError as error:
        raise ScenarioError(f"scenario {s.name}: {error}") from None


def flown(flight: Flight, drill: Drill, protect: bool, options: Options) -> Summary:
    """Fly one drill; `flight` is a rehearsal."""
    s = flight.scenario
    assert s.mission is not None
    name = f"{s.name}-{drill.name.replace(' ', '-').lower()}{'' if protect else '-unprotected'}"
    faults = s.faults.model_copy(update={"cuts": [*s.faults.cuts, *drill.cuts]})
    mission = s.mission.model_copy(update={"protect": protect})
    longer = max(1.0, scale_of_flight(flight).share_s / USUAL.share_s)  # by the period of the cables
    seconds = longer * (LONGEST_S if protect else LONGEST_BARE_S)
    case = changed(
        flight,
        {"name": name, "failures": list(drill.failures), "faults": faults, "mission": mission, "duration_s": seconds},
    )
    return run(case, options, Progress())[0]


def harm(s: Summary) -> float:
    """One figure for how bad a flight ended: vehicles crashed, then how hard the load hit, then how far it strayed.

    10 for each vehicle that hit the ground or another; the load's speed at its first touch beyond what is soft (m/s),
    20 where it never stood; and how far it was from its plan, rms and at most (m), up to 5 each.
    """
    crashed = 10.0 * (s.vehicles_crashed or 0)
    touch = 20.0 if s.touch_down_m_s is None else max(0.0, s.touch_down_m_s - SOFT_M_S)
    return crashed + touch + sum(min(5.0, e or 0.0) for e in (s.largest_tracking_error_m, s.rms_tracking_error_m))


def compared(drill: Drill, protected: Summary, bare: Summary, near_m: float = USUAL.near_m) -> Drilled:
    """What a drill showed, flown with protection and without; `near_m`: what is near, for what flies."""
    said = f"{_ending(protected)}; without protection: {_ending(bare)}"
    if not _safe(protected, drill):
        return Drilled(drill, protected, bare, "no-go", said)
    if harm(bare) > WORSE * harm(protected):
        return Drilled(drill, protected, bare, "go", said)
    if _safe(bare, drill) and harm(protected) <= WORSE * harm(bare) + ALIKE * near_m:
        return Drilled(drill, protected, bare, "note", f"does no harm here, protected or not: {said}")
    said += f" (harm {harm(protected):.2f} and {harm(bare):.2f}: the protection is not one)"
    return Drilled(drill, protected, bare, "no-go", said)


def _safe(s: Summary, drill: Drill) -> bool:
    """Whether nobody but the vehicle that broke came to harm, and the load stands softly."""
    broke = 1 if any(f.kind in BREAKING for f in drill.failures) else 0
    soft = s.touch_down_m_s is not None and s.touch_down_m_s <= SOFT_M_S
    return soft and (s.vehicles_crashed or 0) <= broke


def _ending(s: Summary) -> str:
    """One line: what was done and how it ended."""
    done = "the mission was flown to its end" if s.passed else s.reason
    touch = (
        "the load never stood" if s.touch_down_m_s is None else f"the load touched down at {s.touch_down_m_s:.2f} m/s"
    )
    crashed = s.vehicles_crashed or 0
    who = "no vehicle crashed" if crashed == 0 else f"{crashed} vehicle{'s' if crashed > 1 else ''} crashed"
    strayed = ""
    if s.largest_tracking_error_m is not None and s.rms_tracking_error_m is not None:
        strayed = f", off the plan by {s.largest_tracking_error_m:.2f} m at most, {s.rms_tracking_error_m:.3f} m rms"
    return f"{done}; {touch}{strayed}; {who}"
