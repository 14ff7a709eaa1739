"""Mission scripts that say where the load goes."""

from pathlib import Path

import numpy as np
import pytest
from conftest import cablequad, flown

from cablequad.control.trajectory import Limits, at
from missions.scenario import course
from missions.scenario import loading as scenario

SCRIPTS = Path(course.__file__).parents[1] / "scripts"


def script(tmp_path: Path, body: str) -> Path:
    path = tmp_path / "mission.py"
    path.write_text(body)
    return path


def test_a_course_is_one_smooth_reference_through_its_places(tmp_path: Path) -> None:
    body = """
def mission(course):
    course.go(1, 0, -1, yaw_deg=90)
    course.wait(2)
    course.circle(radius_m=1, laps=1.5)
    course.lemniscate(4, 2)
    course.go(0, 0, -0.5)
    assert course.yaw_deg == 90
"""
    way = course.course_of(script(tmp_path, body), [0.0, 0.0, 0.0, 0.0], Limits())
    t = np.arange(0, way.duration, 0.002)
    x = np.array([at(way, s).x0 for s in t])
    v = np.array([at(way, s).v0 for s in t])
    assert np.abs(np.diff(x, axis=0) / 0.002 - 0.5 * (v[1:] + v[:-1])).max() < 1e-3
    assert np.linalg.norm(np.diff(v, axis=0), axis=1).max() < 0.002 * 3.0  # no step in velocity anywhere
    assert np.abs(x - [1, 0, -1]).sum(axis=1).min() < 1e-6
    assert np.allclose(at(way, way.duration).x0, [0, 0, -0.5])


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("def mission(course):\n    course.go(1, 0)\n", "line 2: TypeError"),
        ("def mission(course):\n    course.wait(-1)\n", "line 2: seconds: -1 given"),
        ("def mission(course:\n", "line 1: SyntaxError"),
        ("x = 1 / 0\n", "line 1: ZeroDivisionError"),
        ("def mission(course):\n    pass\n", "goes nowhere"),
        ("x = 1\n", "no function mission"),
        ("def mission(course):\n    course.go(float('nan'), 0, 0)\n", "x: nan given"),
        (None, "give a Python file"),
    ],
)
def test_a_script_that_cannot_be_flown_is_named_with_its_line(tmp_path: Path, body: str | None, said: str) -> None:
    path = tmp_path / "none.py" if body is None else script(tmp_path, body)
    code, out, err = cablequad("fly", "--script", str(path))
    assert code == 2
    assert said in err
    assert str(path) in err
    assert len(err.strip().splitlines()) == 1
    assert out == ""


COURSES = sorted(p for p in SCRIPTS.glob("*.py") if "def mission(" in p.read_text())


@pytest.mark.parametrize("path", COURSES, ids=lambda p: p.stem)
def test_scripts_that_ship_are_flown_and_stay_on_their_course(path: Path, tmp_path: Path, offset: int) -> None:
    assert len(path.read_text().splitlines()) <= 40
    summary = flown("--script", str(path), "--no-replay", "--out", str(tmp_path), "--port-offset", str(offset))
    assert summary["passed"], summary["reason"]
    assert summary["largest_tracking_error_m"] < 0.1
    assert summary["flown_s"] > scenario.load("paper-case-1").scenario.duration_s
