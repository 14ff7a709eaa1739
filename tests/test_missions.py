"""Missions: phases, guards, scripts, what is lost, and drills that end worse without protection."""

import json
import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from conftest import Command, cablequad, flown, next_offset

from bridge.guards import Guard, Watch, separation
from bridge.phases import ORDER, RULES, Phase
from logs.reader import read
from missions import scenario as scenarios
from missions.drills import drills, rehearsal
from missions.script import ScriptError, script_from

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


def test_a_guard_tells_once_when_it_breaks_and_once_when_it_holds_again() -> None:
    watch = Watch((Guard("tilt_deg", 30.0, "pause", 0.2),))
    told = [watch.look(0.1 * k, {"tilt_deg": v}) for k, v in enumerate([10, 40, 40, 40, 40, 10, 10])]
    assert [len(broken) for broken, _ in told] == [0, 0, 0, 1, 0, 0, 0]
    assert [len(healed) for _, healed in told] == [0, 0, 0, 0, 0, 1, 0]


def test_separation_is_that_of_the_closest_pair() -> None:
    assert separation(np.array([[0.0, 0, 0], [3, 0, 0], [3, 0.5, 0]])) == pytest.approx(0.5)
    assert separation(np.zeros((1, 3))) == np.inf


@pytest.mark.parametrize(
    "name", [s for s in SCRIPTS if "async def main" in (resources.files("missions") / "scripts" / s).read_text()]
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


@pytest.mark.parametrize("which", ["cable cut", "rotor out"])
def test_a_drill_with_protection_sets_the_load_down_softly(which: str, tmp_path: Path) -> None:
    base = rehearsal(scenarios.load("ground-to-ground"))
    drill = next(d for d in drills(4) if d.name == which)
    source = base.scenario.model_copy(update={"failures": list(drill.failures), "name": "drill"})
    file = tmp_path / "drill.json"
    file.write_text(source.model_dump_json())
    s = flown(str(file), "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset()))
    assert s["touch_down_m_s"] < 0.5
    assert s["vehicles_crashed"] <= (0 if which == "cable cut" else 1)
    run = read(Path(s["log"]))
    assert run.complete
    assert all(np.isfinite(run.columns["/control/state"][k]).all() for k in ("thrust", "attitude", "position"))
    kinds = {e.kind for e in run.events}
    assert "abort" in kinds


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
    drill = next(d for d in drills(6) if d.name == "vehicle out")
    file = tmp_path / "six.json"
    file.write_text(air.scenario.model_copy(update={"failures": list(drill.failures), "name": "six"}).model_dump_json())
    s = flown(str(file), "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset()))
    assert s["exit_code"] == 0, s["reason"]
    events = read(Path(s["log"])).events
    assert any(e.kind == "crew" and "5 vehicles carry the load on" in e.text for e in events)
    assert s["vehicles_crashed"] == 1
