"""What Python users meet: `import cablequad`, its values, and the examples."""

import asyncio
import inspect
import os
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

import cablequad as cq
from bridge.mission.mission import MissionError
from logs.reading.extras import EXTRAS, extra
from logs.reading.reader import LogError
from logs.reading.records import entries
from logs.reading.shapes import MESSAGES, Topic, fields
from missions.analysis.replay_control import redecide
from missions.scenario.flights import ScenarioError
from missions.scenario.loading import text

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_an_example_runs(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path))
    assert len(capsys.readouterr().out.splitlines()) >= 2


@pytest.mark.parametrize("name", ["case_1", "a_log"])
def test_a_notebook_runs_and_shows_its_figures_and_its_replay(name: str, tmp_path: Path) -> None:
    notebook = nbformat.read(ROOT / "examples" / f"{name}.ipynb", 4)
    NotebookClient(notebook, timeout=280, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [kind for cell in notebook.cells for output in cell.get("outputs", []) for kind in output.get("data", {})]
    assert "image/png" in shown
    assert "application/vnd.jupyter.widget-view+json" in shown
    assert not any(cell.get("outputs") for cell in nbformat.read(ROOT / "examples" / f"{name}.ipynb", 4).cells)


def test_the_examples_are_listed() -> None:
    listed = (ROOT / "examples" / "README.md").read_text()
    assert len(EXAMPLES) >= 10
    assert all(
        f"]({path.name})" in listed for path in (ROOT / "examples").iterdir() if path.suffix in (".py", ".ipynb")
    )


def test_the_door_names_what_exists_and_imports_late() -> None:
    for name in cq.__all__:
        assert getattr(cq, name) is not None
    assert set(cq.__all__) == set(dir(cq))
    with pytest.raises(AttributeError, match="no attribute 'liftoff'"):
        _ = cq.liftoff  # type: ignore[attr-defined]
    late = "import cablequad, sys; assert not {'missions', 'sitl', 'logs', 'rerun', 'numba'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", late], check=True)


def test_a_simulation_is_arrays_of_the_shapes_that_it_says() -> None:
    sim = cq.simulate("paper-case-1", duration_s=1.0)
    assert sim["t"][[0, -1]].tolist() == [0.0, 1.0]
    assert sim["link_direction"].shape == (251, 4, 5, 3)
    assert sim["quad_position"].shape == (251, 4, 3)
    assert np.linalg.norm(sim["link_direction"], axis=-1) == pytest.approx(1.0, abs=1e-12)
    assert set(sim.units) == set(sim)
    figure = sim.plot()
    assert figure.axes[0].get_ylabel() == "payload position [m, NED]"


def test_a_log_gives_its_topics_in_shapes_and_with_units(tmp_path: Path) -> None:
    flown = cq.fly(cq.scenario("paper-case-1-50hz", duration_s=2.0), out=tmp_path)
    assert "not judged at its end" in flown.summary.reason
    log = cq.read(flown.log_path)
    state, control = log["/plant/state"], log["/control/state"]
    instants = len(state["sim_time_ns"])
    assert state["link_direction"].shape == (instants, 4, 5, 3)
    assert state["tension"].shape == (instants, 4, 5)
    assert state["quad_attitude"].shape == (instants, 4, 4)
    assert control["tension"].shape[1:] == (4,)  # the same name, and another shape there
    assert control["under_way"].shape[1:] == (1, 4, 3)
    assert log["/control/estimate"]["link_direction"].shape[1:] == (4, 5)
    assert state.says["tension"] == "N, positive pulls"
    assert set(log.figures()) == {"histories", "tensions", "snapshots"}
    assert log.replay(tmp_path / "own.rrd").stat().st_size > 10_000


def test_what_cannot_fly_is_refused_as_by_the_commands(tmp_path: Path) -> None:
    path = tmp_path / "weak.toml"
    path.write_text(text("paper-case-1").replace("max_thrust_N = 25.0", "max_thrust_N = 5.0"))
    with pytest.raises(ScenarioError, match=r"cannot fly: vehicle 1 needs 182 % of its thrust"):
        cq.fly(cq.scenario(path), out=tmp_path)


def test_arrays_become_tables(tmp_path: Path) -> None:
    sim = cq.simulate("paper-case-1", duration_s=0.1)
    table = sim.to_pandas()
    assert table.index.name == "t"
    assert table["link_direction_3_4_2"].to_numpy().tolist() == sim["link_direction"][:, 3, 4, 2].tolist()
    state = cq.fly(cq.scenario("paper-case-1-50hz", duration_s=0.5), out=tmp_path).log["/plant/state"]
    assert state["t"][0] < 0.0  # it begins before the release
    assert np.abs(state["t"]).min() < 0.01
    assert state.to_pandas()["tension_0_4"].to_numpy().tolist() == state["tension"][:, 0, 4].tolist()


@pytest.mark.parametrize("package", EXTRAS)
def test_a_package_that_is_not_there_is_named_with_its_extra(package: str) -> None:
    with pytest.raises(ImportError, match=rf"{package} is not installed.*cablequad\[{EXTRAS[package]}\]"), extra():
        raise ModuleNotFoundError(f"No module named '{package}'", name=f"{package}.figure")


def test_another_module_that_is_not_there_is_nobodys_extra() -> None:
    with pytest.raises(ImportError, match=r"^No module named 'nowhere'$"), extra():
        import nowhere  # type: ignore[import-not-found]  # noqa: F401


UP = ("preflight", "arm", "take_off", "tension", "lift")
DOWN = ("set_down", "release", "land", "disarm")


async def there_and_back(fleet: Any) -> None:
    for ask in UP:
        await getattr(fleet, ask)()
    x, y, _ = fleet.load_m
    await fleet.go(x + 0.5, y, -1.2)
    fleet.say(f"{fleet.time_s:.2f} s: {fleet.phase}")
    for ask in DOWN:
        await getattr(fleet, ask)()


def messages(path: str | Path | None) -> list[tuple[str, int, bytes]]:
    assert path is not None
    return [(e.topic, e.log_time, e.data) for e in entries(Path(path)) if not e.topic.startswith("/perf")]


def test_a_program_flies_what_a_mission_script_flies(tmp_path: Path) -> None:
    async def program() -> Any:
        async with cq.flying("ground-to-ground", out=tmp_path) as fleet:
            await there_and_back(fleet)
        return fleet

    live = asyncio.run(program())
    assert live.summary.passed, live.summary.reason
    path = tmp_path / "same.py"
    body = inspect.getsource(there_and_back).replace("there_and_back(fleet: Any) -> None", "main(fleet)")
    path.write_text(f"UP, DOWN = {UP}, {DOWN}\n{body}")
    scripted = cq.fly(cq.scenario(path), out=tmp_path)
    assert messages(live.summary.log) == messages(scripted.log_path)
    with pytest.raises(MissionError, match="the flight is over"):
        _ = live.load_m
    with pytest.raises(LogError, match="flown by a program that the log does not hold"):
        redecide(Path(live.summary.log))


def test_a_program_that_fails_or_gives_up_in_the_air_has_its_load_set_down(tmp_path: Path) -> None:
    async def fails() -> None:
        async with cq.flying("ground-to-ground", out=tmp_path) as fleet:
            for ask in UP:
                await getattr(fleet, ask)()
            seen.append(fleet)
            raise KeyError("no such place")

    async def gives_up() -> None:
        async with cq.flying("ground-to-ground", out=tmp_path) as fleet:
            seen.append(fleet)
            await fleet.preflight()
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(fleet.wait(3600.0), 0.05)
            await fleet.arm()
            fleet.abort("enough seen")

    seen: list[Any] = []
    with pytest.raises(KeyError, match="no such place"):
        asyncio.run(fails())
    summary = seen[0].summary
    assert not summary.passed
    assert "KeyError: 'no such place'" in summary.reason
    assert summary.touch_down_m_s < 0.5
    asyncio.run(gives_up())
    assert "enough seen" in seen[1].summary.reason
    with pytest.raises(ScenarioError, match=r"no \[mission\]"):
        cq.flying("paper-case-1")


USERS = """import asyncio
import numpy as np
import cablequad as cq

flight = cq.scenario("paper-case-1", duration_s=2.0)
sim = cq.simulate(flight)
q: np.ndarray = sim["link_direction"]
worst: float = float(np.degrees(np.arccos(q[..., 2].min())))
flown = cq.fly(flight, out="runs")
tension = flown.log["/plant/state"]["tension"]
print(flown.summary.passed, flown.log_path.name, tension.shape, worst)
system = cq.System.paper(1)
M, G, B = cq.linearize(system)
state: cq.State = cq.State.hanging(system)

async def main() -> None:
    async with cq.flying("ground-to-ground") as fleet:
        await fleet.preflight()
        x, y, z = fleet.load_m
        print(x + y + z, M @ G, B.shape, state.x0)

asyncio.run(main())
"""


@pytest.mark.parametrize(
    ("wrong", "says"), [("", ""), ("cq.simulate(3)", "arg-type"), ("cq.liftoff()", "attr-defined")]
)
def test_what_users_write_is_typed(wrong: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "users.py"
    path.write_text(f"{USERS}{wrong}\n")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file=", str(path)],
        cwd=tmp_path, env={**os.environ, "MYPYPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode == 0) is (not wrong), done.stdout
    assert says in done.stdout


def test_every_table_of_a_log_has_its_fields_in_the_schema() -> None:
    for message in MESSAGES.values():
        assert fields()[message]["sim_time_ns"].says.startswith("vehicles' clock")
    assert fields()["PlantState"]["link_direction"] == (("n", "L", "3"), "unit, quadrotor -> payload")


def test_a_column_that_does_not_fit_stays_flat() -> None:
    stamps = {"sim_time_ns": np.arange(3)}
    flat = Topic("/plant/state", {**stamps, "link_direction": np.zeros((3, 59))}, {"n": 4, "L": 5}, 0)
    assert flat["link_direction"].shape == (3, 59)
    unknown = Topic("/plant/state", {**stamps, "tension": np.zeros((3, 20))}, {"n": 0, "L": 0}, 0)
    assert unknown["tension"].shape == (3, 20)


def test_values_are_short_to_look_at() -> None:
    flight = cq.scenario("paper-case-1")
    sim = cq.simulate(flight, duration_s=0.1)
    for value in (flight, cq.design(flight), flight.system, flight.initial, sim):
        assert len(repr(value)) < 700, type(value)
    assert repr(flight.system) == "System(4 vehicles, cables of 5 links, load 0.5 kg of 3.72 kg)"
