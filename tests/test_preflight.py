"""What a page before the flight says of its drills and of a set-up that loses a vehicle."""

import pytest

from missions.analysis.drills import Drill, changed, compared
from missions.analysis.preflight import one_lost
from missions.flight.summary import Summary
from missions.scenario import loading as scenarios
from missions.scenario.tables import FailureTable

GUST = Drill("gust", "a gust")
OUT = Drill("vehicle out", "all rotors of a vehicle stop", (FailureTable(kind="vehicle-out", at_s=1.0, vehicle=4),))
NEAR_M = 0.2


def ended(crashed: int = 0, touch: float | None = 0.2, most: float = 0.1, rms: float = 0.05) -> Summary:
    """A flight that ended so."""
    nothing = dict.fromkeys(Summary._fields)
    figures = {
        "scenario": "s", "passed": crashed == 0, "reason": "flown", "vehicles_crashed": crashed,
        "touch_down_m_s": touch, "largest_tracking_error_m": most, "rms_tracking_error_m": rms,
    }  # fmt: skip
    return Summary(**{**nothing, **figures})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("drill", "protected", "bare", "verdict"),
    [
        (GUST, ended(), ended(crashed=1), "go"),
        (GUST, ended(), ended(touch=1.5), "go"),
        (GUST, ended(), ended(touch=None), "go"),
        (GUST, ended(most=0.1), ended(most=0.4), "go"),
        (GUST, ended(), ended(), "note"),
        (GUST, ended(most=0.19), ended(most=0.1), "note"),  # apart by less than half of what is near
        (GUST, ended(most=0.3), ended(most=0.1), "no-go"),
        (GUST, ended(most=0.3), ended(most=0.1, touch=0.6), "no-go"),
        (GUST, ended(crashed=1), ended(crashed=4), "no-go"),
        (GUST, ended(touch=0.6), ended(crashed=4), "no-go"),
        (GUST, ended(touch=None), ended(crashed=4), "no-go"),
        (OUT, ended(crashed=1), ended(crashed=4), "go"),
        (OUT, ended(crashed=1), ended(crashed=1), "note"),
        (OUT, ended(crashed=2), ended(crashed=4), "no-go"),
    ],
)
def test_a_protection_is_one_where_a_drill_ends_better_with_it_and_well(
    drill: Drill, protected: Summary, bare: Summary, verdict: str
) -> None:
    assert compared(drill, protected, bare, NEAR_M).verdict == verdict


def test_a_load_that_three_vehicles_hold_within_its_guard_is_a_go() -> None:
    (line,) = one_lost(scenarios.load("ground-to-ground"))
    assert line.verdict == "go"
    assert "without vehicle " in line.why


def test_a_load_that_tilts_without_a_vehicle_is_noted() -> None:
    flight = scenarios.load("ground-to-ground")
    s = flight.scenario
    assert s.mission is not None
    guards = s.mission.guards.model_copy(update={"load_tilt_deg": 0.5})
    (line,) = one_lost(changed(flight, {"mission": s.mission.model_copy(update={"guards": guards})}))
    assert line.verdict == "note"
    assert "(guard: 0.5)" in line.why


def test_a_load_that_needs_every_vehicle_is_noted_before_one_is_lost() -> None:
    flight = scenarios.load("ground-to-ground")
    weak = [v.model_copy(update={"max_thrust_N": 10.0}) for v in flight.scenario.vehicles]
    (line,) = one_lost(changed(flight, {"vehicles": weak}))
    assert line.verdict == "note"
    assert int(line.why.rpartition("need ")[2].split(" %")[0]) > 100
