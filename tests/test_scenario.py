"""Scenario files: what ships is valid, what is wrong is named in one line."""

from pathlib import Path

import numpy as np
import pytest
from conftest import cablequad

from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.trajectory import at
from cablequad.model import lie
from missions.scenario import laws
from missions.scenario import loading as scenario
from missions.scenario.flights import ScenarioError

CASE_1 = scenario.text("paper-case-1")


def test_every_shipped_scenario_loads_and_has_a_controller() -> None:
    for name in scenario.names():
        flight = scenario.load(name)
        assert laws.design(flight).K_x.shape[0] == 3 * len(flight.system.m)
        assert flight.scenario.name == name


def test_case_1_is_the_papers_system() -> None:
    from cablequad.model.system import System

    flight, paper = scenario.load("paper-case-1"), System.paper(1)
    for ours, theirs in zip(flight.system, paper, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-15)


WRONG = [
    ("position_m = [1.0, 4.8, 0.0]", "positon_m = [1.0, 4.8, 0.0]", "initial.positon_m: unknown key; did you mean position_m"),
    ("mass_kg = 0.5\n", "mass_kg = 0\n", "payload.mass_kg: 0 given; input should be greater than 0"),
    ("mass_kg = 0.755", "mass_kg = nan", "vehicle.mass_kg: nan given; a finite number is needed"),
    ("rate_hz = 250", "rate_hz = 300", "control: rate_hz: 300 given; the period must be whole milliseconds"),
    ("rate_hz = 1000", "rate_hz = 700", "physics: rate_hz: 700 given; the step must be whole microseconds"),
    ("link_lengths_m = [0.15, 0.15, 0.15, 0.15, 0.15]", "link_lengths_m = [0.15]", "cable: link_masses_kg has 5 values, link_lengths_m 1"),
    ("link_masses_kg = [0.01, 0.01, 0.01, 0.01, 0.01]", "link_masses_kg = []", "cable.link_masses_kg"),
    ("attachment_m = [0.3, -0.4, -0.1]", "attachment_m = [0.3, -0.4]", "vehicles.0.attachment_m"),
    ("duration_s = 10.0", "", "duration_s: missing; it must be given"),
    ("duration_s = 10.0", "duration_s = '10'", "duration_s: '10' given; a number is needed"),
    ('law = "sampled"', 'law = "magic"', "control.law: 'magic' given; input should be 'sampled' or 'paper'"),
    ("delay_ticks = 1", "delay_ticks = 0", "control.delay_ticks: 0 given; input should be greater than or equal to 1"),
    ("[target]", "[[target]]", "target"),
    ("seed = 1", "seed = = 1", "not TOML"),
    ("mass_kg = 0.755", "mass_kg = 0.755\nwheels = 4", "vehicle.wheels: unknown key; allowed: mass_kg, inertia_kg_m2"),
    ("attitude_bandwidth_rad_s = 40.0", "attitude_bandwidth_rad_s = 4000.0", "attitude_bandwidth_rad_s"),
]  # fmt: skip


@pytest.mark.parametrize(("right", "wrong", "text"), WRONG, ids=[w[2][:40] for w in WRONG])
def test_a_wrong_scenario_is_refused_in_one_line_that_names_the_key(
    right: str, wrong: str, text: str, tmp_path: Path
) -> None:
    assert right in CASE_1
    path = tmp_path / "mine.toml"
    path.write_text(CASE_1.replace(right, wrong, 1))
    with pytest.raises(ScenarioError) as error:
        laws.design(scenario.load(str(path)))
    assert text in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("fly", "paper-case-9"), "did you mean paper-case-"),
        (("fly", "no/such.toml"), "No such file"),
        (("fly", "--speed", "fast"), "--speed: 'fast' given"),
        (("fly", "--speed", "-1"), "--speed: '-1' given"),
        (("fly", "--duration", "0"), "--duration: 0.0 given"),
        (
            ("fly", "--connect", "udpin:0.0.0.0:14540"),
            "--connect udpin:0.0.0.0:14540: vehicles from beyond this machine",
        ),
        (("identify", "--connect", "udpout:10.0.0.7:14540"), "say yes with --arm"),
        (("fly", "--connect", "udpin:127.0.0.1:1", "--speed", "1"), "with --connect the vehicles set it"),
        (("fly", "--connect", "14540"), "udpin:HOST:PORT"),
        (("scenarios", "show", "nothing"), "neither a shipped scenario nor a TOML file"),
        (("sitl", "nothing"), "neither a shipped scenario nor a TOML file"),
    ],
)
def test_wrong_usage_exits_with_two_and_one_line(arguments: tuple[str, ...], text: str) -> None:
    code, out, err = cablequad(*arguments)
    assert code == 2
    assert text in err
    assert len(err.strip().splitlines()) == 1
    assert out == ""


def test_show_prints_a_scenario_that_can_be_flown_again() -> None:
    code, out, _ = cablequad("scenarios", "show", "paper-case-1")
    assert code == 0
    assert scenario.parse(out, "shown").name == "paper-case-1"


def test_help_is_quick_because_nothing_heavy_is_imported() -> None:
    import subprocess
    import sys

    code = "import sys; import missions.cli.main; print([m for m in ('numpy', 'numba', 'rerun', 'control') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_load_that_hangs_tilted_starts_as_it_hangs_and_flies(tmp_path: Path) -> None:
    """Three cables with the centre of mass outside: 40 degrees of tilt, and no number in the file says so."""
    head, tail = CASE_1[: CASE_1.index("[[vehicles]]")], CASE_1[CASE_1.index("[initial]") :]
    rho = [(0.4, -0.4, -0.1), (0.4, 0.4, -0.1), (-0.2, -0.4, -0.1)]
    vehicles = "".join(f"[[vehicles]]\nattachment_m = {list(r)}\n" for r in rho)
    path = tmp_path / "tilted.toml"
    path.write_text(head + vehicles + tail.replace("attitude_deg = [0.0, 0.0, 0.0]", ""))
    flight = scenario.load(str(path))
    design = laws.design(flight)
    plan = flight.trajectory
    samples = list(rollout(design, flight.airframe, lambda t: at(plan, t), flight.initial, LoopTiming(0.004, 4), 2500))
    assert np.degrees(np.linalg.norm(lie.log(design.hanging.R0))) > 30
    assert np.linalg.norm(samples[-1].error.x[:6]) < 0.02
    assert min(float(s.f.min()) for s in samples) > 0
