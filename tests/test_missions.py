"""Missions: phases, guards, scripts, what is lost, and drills that end worse without protection."""

import json
import math
import time
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from conftest import Command, cablequad, flown, next_offset

from bridge.mission.members.per_vehicle import clear_of
from bridge.mission.phases import ORDER, RULES, Phase
from bridge.mission.plan_clock import PlanClock
from bridge.mission.protection.guards import Guard, GuardMonitor, separation
from bridge.mission.touch_down import TouchDown
from logs.reading.reader import Run, read
from missions.analysis.drills import compared, drills, harm, rehearsal
from missions.flight.summary import Summary
from missions.scenario import loading as scenarios
from missions.scenario.script import ScriptError, script_from
from missions.scenario.tables import FailureTable
from sitl.failures import ActiveFailures, Failure
from sitl.firmware.autopilot import Actuation
from sitl.plant import Plant

SCRIPTS = sorted(p.name for p in (resources.files("missions") / "scripts").iterdir() if p.name.endswith(".py"))


def test_every_phase_has_a_rule_and_can_be_reached() -> None:
    reached: set[Phase | None] = {None}
    for _ in ORDER:
        reached |= {phase for phase, rule in RULES.items() if rule.after & reached}
    assert reached == {None, *Phase}
    assert all(rule.limit_s > 0 for rule in RULES.values())


def test_the_usual_order_is_allowed_by_the_rules() -> None:
    before: Phase | None = None
    for phase in ORDER:
        assert before in RULES[phase].after
        before = phase


def test_the_plans_clock_stands_until_nobody_stops_it() -> None:
    """A guard that holds again does not undo what an operator asked, nor the other way round."""
    clock = PlanClock(0.1)
    assert clock.stop("operator")
    assert not clock.stop("tilt_deg")
    assert not clock.go("tilt_deg")
    stood = sum(clock.tick() for _ in range(50))
    assert (clock.stopped, clock.rate) == (True, 0.0)
    assert clock.time + stood == pytest.approx(5.0)
    assert clock.go("operator")
    assert not clock.go("operator")
    for _ in range(20):
        clock.tick()
    assert clock.rate == 1.0


@pytest.mark.parametrize("ground_m", [0.0, -0.2, 0.15, math.inf])
@pytest.mark.parametrize(("period_s", "lag_s", "scale"), [(0.02, 0.6, 1.0), (0.004, 0.3, 0.5), (0.02, 0.9, 2.0)])
@pytest.mark.parametrize("speed", [0.1, 0.25])
def test_vehicles_stand_when_they_do_not_follow_and_never_in_the_air(
    ground_m: float, period_s: float, lag_s: float, scale: float, speed: float
) -> None:
    """Led down through where the ground is thought to be; the ground is somewhere else, and positions are noisy."""
    rng = np.random.default_rng(5)
    landing = TouchDown(0.05 * scale)
    z, led = np.full(6, -1.0), np.full(6, -1.0)  # m, down: they hover at first
    stands_at = None
    for k in range(round(20.0 / period_s)):
        led = np.minimum(led + speed * period_s * (k * period_s > 1.0), 0.15 * scale)
        z = np.minimum(z + (led - z) * period_s / lag_s, ground_m)
        if landing.stands(k * period_s, z + 0.02 * rng.normal(size=6), led):
            stands_at = k * period_s if stands_at is None else stands_at
            assert (z == ground_m).all(), "in the air"
    assert (stands_at is None) == (not np.isfinite(ground_m) or ground_m > 0.1 * scale)
    if stands_at is not None:
        assert stands_at < 1.0 + (1.0 + ground_m + 0.05 * scale) / speed + 4.0  # soon after its reference passed it


@pytest.mark.parametrize(
    ("kind", "shown"),
    [
        ("vehicle-out", lambda p, _: (p._parts.main.world.rotors.works[1] == 0.0).all()),
        ("rotor-out", lambda p, _: p._parts.main.world.rotors.works[1].tolist() == [1.0, 1.0, 0.0, 1.0]),
        ("cable-cut", lambda p, _: p.truth(0).motion.tension[1].max() < 0.2),
        ("payload-shift", lambda p, _: np.allclose(p._parts.main.system.rho, p.system.rho - [0.0, 0.1, 0.0])),
        ("gust", lambda p, _: np.linalg.norm(p._air.next(500, True)[-1] - p._air.next(1, True)[0]) > 0.0),
        ("gps-loss", lambda _, b: b.astray(1, 3_000_000) is not None and b.astray(0, 3_000_000) is None),
        ("low-battery", lambda _, b: b.battery[1] < 0.2 and b.battery[0] == 1.0),
    ],
)
def test_what_breaks_is_broken_when_it_is_due_and_not_before(kind: str, shown: Callable[..., bool]) -> None:
    flight = rehearsal(scenarios.load("ground-to-ground"))
    around = flight.world.around._replace(air=None)
    plant = Plant(flight.world.system, flight.world.airframe, flight.initial, 1e-3, None, around, None)
    plant.restrained = False
    x_before = plant.kinematics()[0]
    offset, wind = np.array([0.0, 0.1, 0.0]), np.array([8.0, 0.0, 0.0])
    broken = ActiveFailures((Failure(1_000_000, kind, 1, 2, offset, wind),), 4)
    assert broken.act(1_900_000, 1_000_000, plant, []) == []
    told = broken.act(2_000_000, 1_000_000, plant, [])
    broken.act(2_100_000, 1_000_000, plant, [])
    assert len(told) == 1
    assert plant.kinematics()[0] == pytest.approx(x_before, abs=1e-9)  # nothing jumps
    assert plant.state.x0 == pytest.approx(flight.initial.x0, abs=1e-9)
    plant.command([Actuation(np.eye(3), np.zeros(3), 0.6, False)] * 4)
    plant.advance(5)
    assert shown(plant, broken)


def test_a_guard_tells_once_when_it_breaks_and_once_when_it_holds_again() -> None:
    watch = GuardMonitor((Guard("tilt_deg", 30.0, "pause", 0.2),))
    told = [watch.look(0.1 * k, {"tilt_deg": v}) for k, v in enumerate([10, 40, 40, 40, 40, 10, 10])]
    assert [len(broken) for broken, _ in told] == [0, 0, 0, 1, 0, 0, 0]
    assert [len(healed) for _, healed in told] == [0, 0, 0, 0, 0, 1, 0]


def test_separation_is_that_of_the_closest_pair() -> None:
    assert separation(np.array([[0.0, 0, 0], [3, 0, 0], [3, 0.5, 0]])) == pytest.approx(0.5)
    assert separation(np.zeros((1, 3))) == np.inf


@pytest.mark.parametrize(
    "name",
    [
        s
        for s in SCRIPTS
        if "async def main" in (resources.files("missions") / "scripts" / s).read_text()
        and s != "tilt_steps.py"  # flown by the test of `cablequad identify`
    ],
)
def test_a_shipped_script_flies_and_is_short(name: str, tmp_path: Path) -> None:
    path = resources.files("missions") / "scripts" / name
    assert len(path.read_text().splitlines()) < 40
    s = flown(str(path), "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset()))
    assert s["exit_code"] == 0, s["reason"]
    assert s["vehicles_crashed"] == 0


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("def main(fleet):\n    pass\n", "no async def main"),
        ("async def main(fleet:\n", "line 1"),
        ("x = 1 / 0\n", "line 1: ZeroDivisionError"),
    ],
)
def test_a_script_that_cannot_run_is_named_with_its_line(body: str, said: str) -> None:
    with pytest.raises(ScriptError, match=said):
        script_from(body, "m.py")


def test_a_script_that_lifts_before_it_tensions_ends_in_order(tmp_path: Path) -> None:
    script = tmp_path / "wrong.py"
    script.write_text("async def main(fleet):\n    await fleet.preflight()\n    await fleet.lift()\n")
    s = flown(str(script), "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset()))
    assert s["exit_code"] == 1
    assert "lift may not follow phase preflight" in s["reason"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("[ground]\n", "ground: vehicles that stand on it need a"),
        ("[mission]\n", "mission: it begins and ends on the ground"),
        ("[[failures]]\nkind = 'rotor-out'\nat_s = 1.0\nvehicle = 9\n", "failures.0.vehicle: 9 given"),
        ("[[failures]]\nkind = 'meteor'\nat_s = 1.0\n", "failures.0.kind"),
    ],
)
def test_a_scenario_that_makes_no_sense_is_named(change: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text(scenarios.text("paper-case-1") + "\n" + change)
    code, _, err = cablequad("fly", str(file))
    assert code == 2
    assert said in err


def drilled(tmp_path: Path, failures: list[FailureTable], protect: bool, seconds: float = 50.0) -> Summary:
    """The rehearsal of ground-to-ground with these failures."""
    base = rehearsal(scenarios.load("ground-to-ground")).scenario
    mission = base.mission.model_copy(update={"protect": protect}) if base.mission is not None else None
    changes = {"failures": failures, "mission": mission, "name": "drill", "duration_s": seconds}
    file = tmp_path / "drill.json"
    file.write_text(base.model_copy(update=changes).model_dump_json())
    s = flown(str(file), "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset()))
    s.pop("exit_code")
    return Summary(**s)


def sound(log: str) -> Run:
    """A log that is complete and holds no decision that is not finite."""
    run = read(Path(log))
    assert run.complete
    assert all(np.isfinite(run.columns["/control/state"][k]).all() for k in ("thrust", "attitude", "position"))
    return run


def test_a_cable_that_comes_off_ends_in_the_load_set_down_softly_and_nobody_hurt(tmp_path: Path) -> None:
    s = drilled(tmp_path, [FailureTable(kind="cable-cut", at_s=6.0, vehicle=4)], True)
    assert s.touch_down_m_s is not None
    assert s.touch_down_m_s < 0.5
    assert s.vehicles_crashed == 0
    assert {"lost", "crew", "abort"} <= {e.kind for e in sound(s.log or "").events}


def test_a_rotor_out_ends_worse_without_protection(tmp_path: Path) -> None:
    drill = next(d for d in drills(scenarios.load("ground-to-ground")) if d.name == "rotor out")
    protected = drilled(tmp_path, list(drill.failures), True)
    bare = drilled(tmp_path, list(drill.failures), False, 25.0)
    assert compared(drill, protected, bare).verdict == "go"
    assert protected.vehicles_crashed == 1
    assert harm(bare) > 2 * harm(protected)  # measured 40 and more against 10
    sound(protected.log or "")
    sound(bare.log or "")


def test_two_vehicles_that_are_lost_one_after_the_other_end_in_order(tmp_path: Path) -> None:
    """Nobody designs for two; those that are left come down each by itself."""
    lost = [FailureTable(kind="vehicle-out", at_s=at, vehicle=k) for at, k in ((6.0, 4), (7.0, 1))]
    s = drilled(tmp_path, lost, True)
    run = sound(s.log or "")
    assert "the load is set down here" in s.reason
    assert [e.subject for e in run.events if e.kind == "lost"] == ["vehicle 4", "vehicle 1"]
    assert s.touch_down_m_s is not None


@pytest.mark.alone
def test_an_operator_pauses_resumes_and_aborts_by_command(tmp_path: Path) -> None:
    port = str(next_offset())
    flight = Command(
        "fly",
        "ground-to-ground",
        "--speed",
        "2",
        "--json",
        "--no-replay",
        "--out",
        str(tmp_path),
        "--port-offset",
        port,
    )
    end = time.monotonic() + 120
    while cablequad("tell", "pause", "--port-offset", port)[0] != 0:
        assert time.monotonic() < end
        assert flight.process.poll() is None
    assert cablequad("tell", "resume", "--port-offset", port)[0] == 0
    code, out, _ = cablequad("tell", "abort", "--port-offset", port)
    assert (code, out.strip()) == (0, "abort: obeyed")
    code, out, _ = flight.wait()
    assert code == 1
    summary = json.loads(out)
    assert "told to come down" in summary["reason"]
    kinds = [e.kind for e in read(Path(summary["log"])).events]
    assert {"pause", "resume", "abort"} <= set(kinds)


def test_telling_nobody_says_so() -> None:
    code, _, err = cablequad("tell", "pause", "--port-offset", str(next_offset()))
    assert code == 1
    assert "no answer" in err
    assert cablequad("tell", "stop")[0] == 2


def test_six_vehicles_go_on_with_five(tmp_path: Path) -> None:
    base = scenarios.load("six-vehicles")
    air = rehearsal(base)
    drill = next(d for d in drills(base) if d.name == "vehicle out")
    file = tmp_path / "six.json"
    file.write_text(air.scenario.model_copy(update={"failures": list(drill.failures), "name": "six"}).model_dump_json())
    s = flown(str(file), "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset()))
    assert s["exit_code"] == 0, s["reason"]
    events = read(Path(s["log"])).events
    assert any(e.kind == "crew" and "5 vehicles carry the load on" in e.text for e in events)
    assert s["vehicles_crashed"] == 1


def test_landing_places_keep_clear_of_a_wreck_and_of_each_other() -> None:
    middle = np.array([3.0, 1.0, 0.0])
    stands = np.array([[1.0, 0.8, -0.1], [1.0, -0.8, -0.1], [-1.0, 0.8, -0.1], [-1.0, -0.8, -0.1]])
    spots = middle + stands
    wreck = spots[0] + np.array([0.2, 0.1, 0.3])
    moved = clear_of([wreck], spots, middle)
    assert (moved[1:] == spots[1:]).all()  # nobody moves who need not
    assert math.hypot(*(moved[0] - wreck)[:2]) >= 0.69
    assert min(math.dist(moved[i], moved[k]) for i in range(4) for k in range(i)) >= 0.5
    assert np.linalg.norm(moved[0] - middle) < 1.31 * np.linalg.norm(stands[0])
    assert (clear_of([], spots, middle) == spots).all()
