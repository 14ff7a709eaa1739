"""What `import cablequad` offers to Python users: scenarios, flights, simulations and logs as values."""

import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.design import Design
from cablequad.control.trajectory import at
from cablequad.model.state import positions
from cablequad.types import Array
from logs.reading.extras import extra
from logs.reading.reader import Run
from logs.reading.reader import read as _read
from logs.reading.shapes import Arrays, Topic, topics
from missions.flight import compiled
from missions.flight.live_script import Flying
from missions.flight.options import Options, Progress
from missions.flight.run import run
from missions.flight.summary import Summary
from missions.scenario import flights, laws, loading
from missions.scenario.feasibility import obstacles
from missions.scenario.flights import Flight

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNITS = {
    "t": "s since the release", "payload_position": "m, NED", "payload_velocity": "m/s, NED",
    "payload_attitude": "payload -> NED", "payload_rate": "rad/s, payload frame", "quad_position": "m, NED",
    "quad_attitude": "body -> NED", "link_direction": "unit, quadrotor -> payload, NED", "link_rate": "rad/s, NED",
    "thrust": "N", "target_position": "m, NED", "Psi": "1/2 tr(I - R_c'R)", "Psi_0": "1/2 tr(I - R_0d'R_0)",
    "e_q": "sum |q_ij - q_ijd|",
}  # fmt: skip


class Simulation(Arrays):
    """A flight without a wire as arrays over time; `UNITS` says what each holds."""

    def __init__(self, name: str, arrays: Mapping[str, Array]) -> None:
        super().__init__(arrays)
        self.name = name
        self.units = {key: UNITS[key] for key in arrays}

    def __repr__(self) -> str:
        t = self._arrays["t"]
        inside = ", ".join(f"{key} {tuple(a.shape[1:])}" for key, a in self._arrays.items())
        return f"Simulation({self.name}, {len(t)} instants over {t[-1] - t[0]:g} s: {inside})"

    def plot(self) -> "Figure":
        """Position, velocity, thrust and attitude and link errors over time."""
        with extra():
            from logs.views.drawing import Drawing

        figure = Drawing(figsize=(10.5, 6.0), layout="constrained")
        grid = figure.subplots(2, 2, sharex=True)
        shown = (
            ("payload_position", "payload position [m, NED]"), ("payload_velocity", "payload velocity [m/s, NED]"),
            ("thrust", "thrust [N]"), ("e_q", "link directions $e_q$ [-]"),
        )  # fmt: skip
        for ax, (key, label) in zip(grid.ravel(), shown, strict=True):
            ax.plot(self["t"], self[key], linewidth=1.1)
            ax.set_ylabel(label)
            ax.grid(alpha=0.25)
            if key == "payload_position":
                ax.legend(["x", "y", "z"], fontsize=8)
        for ax in grid[1]:
            ax.set_xlabel("time since the release [s]")
        return figure


class Log:
    """A recorded flight: its topics as shaped arrays, its events and result, its figures and its replay."""

    def __init__(self, path: Path) -> None:
        """Raises LogError where nothing can be read."""
        self.path = path
        self.run: Run = _read(path)

    @cached_property
    def topics(self) -> dict[str, Topic]:
        """By name, as `log["/plant/state"]["link_direction"]`, (t, n, L, 3)."""
        return topics(self.run)

    def __getitem__(self, topic: str) -> Topic:
        return self.topics[topic]

    def __repr__(self) -> str:
        whole = "" if self.run.complete else ", not whole"
        return f"Log({self.path.name}{whole}: {', '.join(self.topics)}; {len(self.run.events)} events)"

    def figures(self) -> dict[str, "Figure"]:
        """The paper's figures for this flight: `histories` (2 and 4), `tensions`, `snapshots` (3 and 5)."""
        with extra():
            from logs.views import figures

        return {
            "histories": figures.histories(self.run), "tensions": figures.tensions(self.run),
            "snapshots": figures.snapshots(self.run),
        }  # fmt: skip

    def replay(self, path: str | Path | None = None) -> Path:
        """Write the replay as an .rrd for Rerun, beside the log where no path is given; where it is."""
        from logs.views.replay import save

        written = self.path.with_suffix(".rrd") if path is None else Path(path)
        save(self.run, written)
        return written

    def show(self, width: int = 960, height: int = 600) -> None:
        """Show the replay in the notebook, pixels large. Raises ImportError where rerun-notebook is not installed."""
        from logs.views.replay import show

        with extra():
            show(self.run, width, height)


class Flown:
    """What came of a flight."""

    def __init__(self, summary: Summary, path: Path) -> None:
        self.summary, self.log_path = summary, path

    @cached_property
    def log(self) -> Log:
        """Its log."""
        return Log(self.log_path)

    def __repr__(self) -> str:
        return f"Flown({self.summary.scenario}: {'passed' if self.summary.passed else 'FAILED'}, {self.summary.reason})"


def scenario(name: str | Path, *, duration_s: float | None = None, seed: int | None = None) -> Flight:
    """A scenario that ships, by name, or a file's. Raises ScenarioError naming what is wrong in it."""
    return loading.load(str(name), duration_s=duration_s, seed=seed)


def design(flight: Flight | str) -> Design:
    """The controller of a scenario. Raises ScenarioError where there are no stabilising gains."""
    return laws.design(_flight(flight))


def simulate(flight: Flight | str, duration_s: float | None = None) -> Simulation:
    """The scenario's plan flown by its law without a wire, sensors or wind: the model alone.

    Arrays over n vehicles and L links of the longest cable. Raises ScenarioError.
    """
    f = _flight(flight)
    law = design(f)
    period = f.control_us * 1e-6
    timing = LoopTiming(period, f.control_us // f.physics_us, f.scenario.control.delay_ticks)
    ticks = math.floor((f.scenario.duration_s if duration_s is None else duration_s) / period + 1e-9)
    plan = f.trajectory
    samples = list(rollout(law, f.airframe, lambda t: at(plan, t), f.initial, timing, ticks, law=laws.law_of(f)))

    def over(value: Any) -> Array:
        return np.array([value(s) for s in samples])

    arrays = {
        "t": over(lambda s: s.t), "payload_position": over(lambda s: s.state.x0),
        "payload_velocity": over(lambda s: s.state.v0), "payload_attitude": over(lambda s: s.state.R0),
        "payload_rate": over(lambda s: s.state.Omega0),
        "quad_position": over(lambda s: positions(f.system, s.state)[:, 0]),
        "quad_attitude": over(lambda s: s.state.R), "link_direction": over(lambda s: s.state.q),
        "link_rate": over(lambda s: s.state.omega), "thrust": over(lambda s: s.f),
        "target_position": over(lambda s: s.reference.x0), "Psi": over(lambda s: s.Psi),
        "Psi_0": over(lambda s: s.Psi_0), "e_q": over(lambda s: s.e_q),
    }  # fmt: skip
    return Simulation(f.scenario.name, arrays)


def fly(flight: Flight | str, out: str | Path = "runs", sockets: bool = False) -> Flown:
    """Fly a scenario with built-in vehicles, everything recorded, in lockstep.

    `sockets`: over UDP between processes, as `cablequad fly` does; else the same bytes in this process, and the same
    log. Raises ScenarioError where it cannot fly as well, and LinkError where a port is taken.
    """
    f = _flyable(flight)
    summary, _ = run(f, Options(out=Path(out), in_process=not sockets), Progress())
    assert summary.log is not None
    return Flown(summary, Path(summary.log))


def flying(flight: Flight | str, out: str | Path = "runs", sockets: bool = False) -> Flying:
    """A mission flown by the program that awaits it: `async with cq.flying("ground-to-ground") as fleet`.

    `fleet` has what a mission script has. The vehicles' clock stands still while nothing of the fleet is awaited. An
    error that leaves the `async with` brings the load to the ground first. Raises ScenarioError where it cannot fly.
    """
    f = _flyable(flight)
    return Flying(f, Options(out=Path(out), in_process=not sockets), Progress())


def read(path: str | Path) -> Log:
    """A log on disk. Raises LogError where nothing can be read."""
    return Log(Path(path))


def _flyable(flight: Flight | str) -> Flight:
    compiled.ensure()
    f = _flight(flight)
    if found := obstacles(f):
        raise flights.ScenarioError(f"{f.scenario.name}: cannot fly: {'; '.join(found)}")
    return f


def _flight(flight: Flight | str) -> Flight:
    return scenario(flight) if isinstance(flight, str) else flight
