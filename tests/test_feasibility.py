"""What cannot fly says so first, in one line, wherever it is asked; what passes was flown to where it was asked to."""

import json
import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from conftest import cablequad, next_offset

from cablequad.analysis.margins import modes
from cablequad.model.linear import linearize
from cablequad.model.stiffness import stiffest_mode
from missions.scenario import loading as scenarios
from missions.scenario.feasibility import obstacles, strays
from missions.scenario.flights import ScenarioError

CASE_1 = (resources.files("missions") / "scenarios" / "paper-case-1.toml").read_text()
MISSION = (resources.files("missions") / "scenarios" / "ground-to-ground.toml").read_text()


def written(tmp_path: Path, source: str, *changes: tuple[str, str]) -> str:
    """A scenario file with every pattern replaced."""
    for pattern, value in changes:
        source, count = re.subn(pattern, value, source, flags=re.M)
        assert count, pattern
    path = tmp_path / "mine.toml"
    path.write_text(source)
    return str(path)


WEAK = (r"^max_thrust_N = .*", "max_thrust_N = 5.0")
MOON = (r"^seed = .*", "seed = 1\ngravity_m_s2 = 1.62\nplan = { acceleration_m_s2 = 1.5, jerk_m_s3 = 5.0 }")
MIXED = (r"^link_masses_kg = .*", "link_masses_kg = [0.01, 1e-7, 0.01, 1e-7, 0.01]")
SLOW = (r"^rate_hz = 250", "rate_hz = 1")
HEAVY = (r"^mass_kg = 0.5$", "mass_kg = 500.0")
TOGETHER = (r"^attachment_m = .*", "attachment_m = [0.0, 0.0, -0.1]")
NEAR = (r"^attachment_m = \[0.3, 0.4, -0.1\]", "attachment_m = [0.3, -0.16, -0.1]")
FAST = (r"^\[control\]", "[plan]\nacceleration_m_s2 = 12.0\njerk_m_s3 = 200.0\nspeed_m_s = 30.0\n\n[control]")
CASES: list[tuple[tuple[str, str], str]] = [
    (WEAK, r"vehicle \d needs 182 % of its thrust"),
    (HEAVY, r"vehicle \d needs \d+ % of its thrust"),
    (MOON, r"plan: at t = .* lean by \d+ deg"),
    (FAST, r"plan: at t = .*acceleration_m_s2 = 12"),
    (SLOW, r"control.rate_hz = 1: vehicle 1 \(px4\) takes setpoints 1 s apart"),
    (TOGETHER, r"vehicles 1 and 2 would be 0.00 m apart where the load hangs"),
    (NEAR, r"vehicles 1 and 2 would be 0.24 m apart"),
]


@pytest.mark.parametrize(("change", "said"), CASES, ids=[said for _, said in CASES])
def test_what_cannot_fly_is_known_before_anything_is_designed(
    change: tuple[str, str], said: str, tmp_path: Path
) -> None:
    found = obstacles(scenarios.load(written(tmp_path, CASE_1, change)))
    assert any(re.search(said, line) for line in found), found


def test_links_out_of_all_proportion_are_taken_as_massless(tmp_path: Path) -> None:
    flight = scenarios.load(written(tmp_path, CASE_1, MIXED))
    assert obstacles(flight) == []
    assert flight.notes[-1] == "links lighter than 0.05 g are flown as that: as good as without mass"


@pytest.mark.parametrize("name", scenarios.names())
def test_nothing_is_known_against_what_ships(name: str) -> None:
    flight = scenarios.load(name)
    assert obstacles(flight) == []
    assert flight.notes == []


@pytest.mark.parametrize("command", ["check", "fly", "preflight"])
def test_every_command_refuses_in_one_line_with_the_same_words(command: str, tmp_path: Path) -> None:
    code, out, err = cablequad(command, written(tmp_path, CASE_1, WEAK))
    assert code == 1
    assert out == ""
    assert len(err.splitlines()) == 1
    assert err.startswith("cablequad: paper-case-1: cannot fly: vehicle")
    if command == "check":
        code, out, _ = cablequad("check", "--json", written(tmp_path, CASE_1, WEAK))
        assert code == 1
        assert len(json.loads(out)["cannot_fly"]) == 1


@pytest.mark.parametrize(
    ("source", "change", "said"),
    [
        (CASE_1, (r"^position_m = \[0.44.*", "position_m = [1e6, 0.78, -0.5]"), "duration_s: 10 given; .plan. takes 1.23e"),
        (CASE_1, (r"^duration_s = .*", "duration_s = 1e-6"), "duration_s: 1e-06 given"),
        (CASE_1, (r"^link_lengths_m = .*", "link_lengths_m = [1e-6, 1e-6, 1e-6, 1e-6, 1e-6]"), "link_lengths_m.0: 1e-06"),
        (CASE_1, (r"^\[acceptance\]", "[faults.down]\nloss = 1.0\n[acceptance]"), "faults.down.loss: 1 given"),
        (CASE_1, (r"^\[acceptance\]", "[faults.tracker]\nloss = 1\n[acceptance]"), "faults.tracker.loss: 1 given"),
    ],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)  # fmt: skip
def test_a_plan_without_room_or_links_that_pass_nothing_are_refused(
    source: str, change: tuple[str, str], said: str, tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError, match=said):
        scenarios.load(written(tmp_path, source, change))


@pytest.mark.parametrize(
    ("waypoint", "said"),
    [
        ("[1.0, 0.0, 1.4]", r"plan.waypoints_m.0: \(1, 0, 1.4\) m is below the ground"),
        ("[1.0, 80.0, -1.4]", r"plan.waypoints_m.0: .* outside the fence"),
        ("[1.0, 0.0, -29.9]", r"plan.waypoints_m.0: .* a vehicle above it is .* outside the fence"),
    ],
)
def test_waypoints_below_the_ground_or_outside_the_fence_are_named(waypoint: str, said: str, tmp_path: Path) -> None:
    source = re.sub(r"(?ms)^\[plan\].*?(?=^\[)", "", MISSION)
    plan = f'[plan]\npath = "waypoints"\nwaypoints_m = [{waypoint}]\n\n[mission]'
    with pytest.raises(ScenarioError, match=said):
        scenarios.load(written(tmp_path, source, (r"^\[mission\]$", plan), (r"^duration_s = .*", "duration_s = 900.0")))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("[wind]\nmean_m_s = [20.0, 0.0, 0.0]\n", "wind: it has no effect, as drag_area_m2 is 0"),
        ('[[failures]]\nkind = "rotor-out"\nat_s = 99.0\n', "failures.0.at_s = 99: it never happens"),
        ('[[failures]]\nkind = "gust"\nat_s = 1.0\n', "failures.0: a gust has no effect"),
        ("[[faults.cuts]]\nfrom_s = 50.0\nto_s = 60.0\n", "faults.cuts.0.from_s = 50: it never happens"),
        ("[plan]\nradius_m = 1.0\nlaps = 2.0\n", "plan.laps, plan.radius_m: without effect where path = 'target'"),
    ],
)
def test_settings_without_effect_are_named_before_the_flight(more: str, said: str, tmp_path: Path) -> None:
    flight = scenarios.load(written(tmp_path, CASE_1, (r"^\[acceptance\]", more + "\n[acceptance]")))
    assert any(said in note for note in flight.notes), flight.notes


def test_an_offline_flight_that_strays_is_said_to_and_one_that_follows_is_not() -> None:
    assert strays(np.array([0.0, 0.3, 0.01])) == []
    assert "0.54 m from its plan in the end" in strays(np.array([0.0, 0.1, 0.54]))[0]
    assert "nowhere that is finite" in strays(np.array([0.0, np.inf, np.nan]))[0]


def test_the_stiffest_mode_is_that_of_the_poles() -> None:
    """Unequal shares of the load: the tension at rest, not an equal one."""
    for name in ("paper-case-1", "two-vehicles", "three-vehicles"):
        system = scenarios.load(name).system
        poles = max(abs(m.pole) for m in modes(system))
        assert stiffest_mode(system) == pytest.approx(poles, rel=1e-6)
        assert len(linearize(system)[0]) > 6


def test_a_part_of_a_plan_passes_nothing_and_shows_how_far_the_target_is(tmp_path: Path) -> None:
    code, out, err = cablequad(
        "fly", "--json", "--duration", "1", "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset())
    )
    s = json.loads(out)
    assert code == 1
    assert not s["passed"]
    assert s["final_position_error_m"] == pytest.approx(4.0, abs=0.1)
    assert s["criteria"] == []
    assert "flown for 1 s of a plan of 5.05 s: not judged" in err


def test_long_work_says_what_it_does_in_a_pipe(tmp_path: Path) -> None:
    code, _, err = cablequad("check", "--quick", "paper-case-1")
    assert code == 0
    assert "paper-case-1: the nominal flight" in err
    code, _, err = cablequad(
        "fly", "--duration", "6", "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset())
    )
    assert code == 0
    assert "cablequad: getting ready" in err


def test_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    path = tmp_path / "bom.toml"
    path.write_bytes(b"\xef\xbb\xbf" + CASE_1.encode())
    assert scenarios.load(str(path)).scenario.name == "paper-case-1"
    script = tmp_path / "bom.py"
    script.write_bytes(b"\xef\xbb\xbfasync def main(fleet):\n    pass\n")
    assert scenarios.load(str(script)).script is not None


def test_a_terminal_without_the_letters_of_a_folder_gets_no_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    folder = tmp_path / "möbel"
    folder.mkdir()
    key = folder / "schlüssel"
    code, out, err = cablequad("signing-key", str(key))
    assert code == 0, err
    assert "m\\xf6bel" in out
    code, _, err = cablequad("check", str(folder / "fehlt.toml"))
    assert code == 2
    assert "Traceback" not in err


def test_a_reader_of_masses_out_of_all_proportion_gets_no_traceback(tmp_path: Path) -> None:
    for value in ("1e-9",):
        changed = (r"^mass_kg = 0.755", f"mass_kg = {value}")
        code, _, err = cablequad("check", "--quick", written(tmp_path, CASE_1, changed))
        assert code in (0, 1, 2), err
        assert "Traceback" not in err
