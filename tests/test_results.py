"""What a run is judged by, shown alike everywhere; which cables are slack; what a page shows of a whole mission."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from bridge.loop.fly import Outcome
from cablequad.model.state import State
from cablequad.model.system import System
from logs.reading.reader import read
from logs.views import figures
from logs.views.results import FIGURES, LED_ON, rows
from logs.views.vehicle_reports import vehicle_reports
from missions.flight.options import Options, Progress
from missions.flight.recording.slack import LASTS_US, SlackCables
from missions.flight.run import NO_TIME
from missions.flight.run import run as run_flight
from missions.flight.summary import Asked, Known, Summary, Track, summarize
from missions.scenario.loading import load
from missions.scenario.metrics import Grounded
from missions.scenario.tables import AcceptanceTable

RESULT: dict[str, Any] = {
    "final_position_error_m": 0.0624, "max_tension_N": 3.0, "touch_down_m_s": 0.087, "set_down_error_m": 0.015,
    "min_separation_m": 0.59, "messages_sent": 15224, "state_age_ms": 0.0, "vehicles_crashed": 0,
    "criteria": [
        {"name": "touch_down_m_s", "limit": 0.3, "value": 0.087, "holds": True},
        {"name": "set_down_error_m", "limit": 0.01, "value": 0.015, "holds": False},
        {"name": "min_separation_m", "limit": 0.3, "value": 0.59, "holds": True},
    ],
}  # fmt: skip


def test_a_missions_figures_stand_beside_what_was_asked_of_them() -> None:
    shown = {row.label: row for row in rows(RESULT)}
    assert shown["touch-down"][1:] == ("0.087 m/s", "<= 0.3 ok")
    assert shown["set down from its mark"][1:] == ("0.015 m", "<= 0.01 MISSED")
    assert shown["smallest separation"][1:] == ("0.59 m", ">= 0.3 ok")
    assert shown["messages sent"].value == "15224"
    assert shown["last error to its reference"].asked == LED_ON  # not beside "set down" as a second truth
    assert not any(label.startswith("age of") for label in shown)  # all was measured at once


@pytest.mark.parametrize(("crashed", "broken", "passes"), [(0, 0, True), (4, 0, False), (1, 1, True), (2, 1, False)])
def test_a_mission_whose_vehicles_crash_does_not_pass(crashed: int, broken: int, passes: bool) -> None:
    """Four vehicles were dropped from 13 m after the load stood on its mark, and the flight had passed."""
    grounded = Grounded((0.0, 0.0, -0.1), 0.1, 3.0, 0.6, crashed)
    known = Known(Track((0.0, 0.0, -0.1), False, [5] * 4), Outcome(True, False, "flown"), NO_TIME, grounded=grounded)
    s = summarize(Asked("x", AcceptanceTable(), broken=broken), known)
    assert s.passed is passes
    assert ("crashed" in s.reason) is not passes


def test_every_criterion_of_a_scenario_has_its_figure() -> None:
    known = {figure.criterion or figure.key for figure in FIGURES}
    assert set(AcceptanceTable.model_fields) <= known
    assert {figure.key for figure in FIGURES} <= set(Summary._fields)


def test_a_page_shows_a_mission_to_its_end_and_a_transport_crowded_towards_its_release() -> None:
    mission: Any = SimpleNamespace(events=[SimpleNamespace(kind="phase")])
    transport: Any = SimpleNamespace(events=[])
    assert figures._chosen(mission, 59.0)[-1] == 59.0
    assert figures._chosen(transport, 12.0)[1] < 0.2
    assert figures._chosen(transport, 60.0)[-1] == 60.0


def hanging(system: System, bend: float = 0.0) -> np.ndarray:
    """(n, L, 3) link directions: straight down, or bent from one link to the next by `bend` rad."""
    q = State.hanging(system).q.copy()
    angle = bend * np.arange(q.shape[1]) * (-1.0) ** np.arange(q.shape[1])
    q[:, :, 0], q[:, :, 2] = np.sin(angle), np.cos(angle)
    return q


def test_a_cable_that_rings_is_told_once_and_is_taut_when_it_has_pulled_for_a_while() -> None:
    """A nominal flight had 160 events: links that swing pull and push a few millinewtons, many times a second."""
    system = System.paper(1)
    cables, q = SlackCables(system), hanging(system)
    pull = np.full(q.shape[:2], 1.0)
    told = []
    for k in range(500):
        now = pull.copy()
        now[1, 2] += 1.02 * np.sin(0.5 * k)  # down to -0.02 N: nothing
        told += cables.look(4000 * k, now, q)
    assert told == []
    for k in range(500, 700):
        now = pull.copy()
        now[1, 2] += 1.5 * np.sin(0.5 * k)
        told += cables.look(4000 * k, now, q)
    assert [(change.kind, change.cable) for change in told] == [("slack", 2)]
    assert "link 3 pushes with 0." in told[0].text
    told = [change for k in range(700, 900) for change in cables.look(4000 * k, pull, q)]
    assert [(change.kind, change.cable) for change in told] == [("taut", 2)]


def test_a_curled_cable_is_slack_though_its_links_pull() -> None:
    system = System.paper(1)
    cables, curled = SlackCables(system), hanging(system, 0.4)
    pull = np.full(curled.shape[:2], 0.2)
    assert cables.suspects(pull[None], curled[None]).all()
    told = cables.look(0, pull, curled)
    assert [change.kind for change in told] == ["slack"] * 4
    assert "curled" in told[0].text
    assert cables.look(4000, pull, hanging(system)) == []
    assert [change.kind for change in cables.look(4000 + LASTS_US, pull, hanging(system))] == ["taut"] * 4


@pytest.mark.parametrize("bins", [1, 7])
def test_means_of_a_curve_keep_its_extremes(bins: int) -> None:
    t = np.linspace(0.0, 20.0 * bins, 5000 * bins)
    values = np.sin(3.0 * t)
    at, least, mean, most = figures._bins(t, values)
    assert len(at) == len(mean) < 5000 * bins
    assert (least <= mean).all()
    assert (mean <= most).all()
    assert least.min() == pytest.approx(-1.0, abs=1e-3)


def test_a_log_tells_how_the_air_moved_and_what_vehicles_said_of_themselves(tmp_path: Path) -> None:
    options = Options(out=tmp_path, in_process=True)
    summary, _ = run_flight(load("wrong-model-in-wind", duration_s=3.0), options, Progress())
    run = read(Path(str(summary.log)))
    wind = run.columns["/plant/wind"]
    assert np.diff(wind["sim_time_ns"]) == pytest.approx(1e8)
    assert np.linalg.norm(wind["velocity"].mean(axis=0) - (2.4, 1.8, 0.0)) < 1.5  # gusts of a second or two
    for vehicle in (1, 2, 3, 4):
        said = vehicle_reports(run, vehicle)
        assert [mode for _, mode in said.modes] == ["disarmed", "OFFBOARD", "LOITER"]  # it holds at the end
        assert said.modes[1][0] == pytest.approx(0.0, abs=1.5)
        assert said.battery[1] == pytest.approx(100.0)
    assert vehicle_reports(run, 9).modes == []


def test_a_calm_log_has_no_wind(tmp_path: Path) -> None:
    options = Options(out=tmp_path, in_process=True)
    summary, _ = run_flight(load("paper-case-1-50hz", duration_s=1.0), options, Progress())
    assert "/plant/wind" not in read(Path(str(summary.log))).columns


def test_a_separation_that_never_changes_is_seen() -> None:
    drawn = Figure()
    ax = drawn.subplots()
    still = np.tile(np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]]), (5, 1, 1))
    figures._separation(ax, np.arange(5.0), still)
    low, high = ax.get_ylim()
    assert low + 0.05 < 0.6 < high - 0.05
