"""The paper's figures from any log: errors and commands over time, tensions, and the system at chosen instants."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cablequad.types import Array
from logs.reading.columns import CARRYING, flown
from logs.reading.reader import LogError, Run
from logs.views.drawing import Drawing
from logs.views.motion import MotionHistory, motion_of, rotate, separation
from logs.writing.encode import color

AXES = ("#d55e00", "#009e73", "#0072b2")  # x, y, z: told apart by colour-blind readers, and by their line styles
STYLES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
PAPER_TIMES = (0.0, 0.14, 0.30, 0.68, 1.10, 1.36, 1.98, 3.48, 10.0)  # s: the paper's snapshots of Case 2
ERRORS = ("e_x0", "e_v0", "e_Omega", "Psi_0", "e_q", "e_w")
WIDTH = 10.5  # inches
COLUMN = 1.75  # inches, of a snapshot
SETTLES_S = 10.0  # most of what is worth a snapshot on the way to one place
MEAN_S, LONG_S = 0.2, 20.0  # of curves that are as long: means, and what they are means of


def _tint(i: int) -> tuple[float, float, float]:
    r, g, b = (c / 255 for c in color(i))
    return (0.75 * r, 0.72 * g, 0.2 * b) if (r, g) > (0.9, 0.85) else (r, g, b)  # yellow is too pale on paper


def histories(run: Run) -> Figure:
    """The paper's Figures 2 and 4: position, velocity, rates and attitude errors, thrusts and link errors over time.

    Raises LogError where the log holds no decisions of a flight.
    """
    c, t = _flown(run)
    figure = Drawing(figsize=(WIDTH, 11.0), layout="constrained")
    grid = figure.subplots(4, 2, sharex=True)
    x, v = c["position"], c["velocity"]
    _three(grid[0, 0], t, x, x - c["e_x0"], ("x", "y", "z"), "payload position $x_0$ [m, NED]")
    _three(grid[0, 1], t, v, v - c["e_v0"], ("x", "y", "z"), "payload velocity $\\dot x_0$ [m/s, NED]")
    _three(grid[1, 0], t, _rates(run, t), None, ("roll", "pitch", "yaw"), "payload rate $\\Omega_0$ [rad/s]")
    n = c["Psi"].shape[1]
    size = np.linalg.norm(c["e_Omega"].reshape(len(t), n, 3), axis=2)
    _vehicles(grid[1, 1], t, size, "vehicle rate error $|e_{\\Omega_i}|$ [rad/s]")
    grid[2, 0].plot(t, c["Psi_0"], color="0.15", linewidth=1.1)
    grid[2, 0].set_ylabel("payload attitude error $\\Psi_0$ [-]")
    _vehicles(grid[2, 1], t, c["Psi"], "vehicle attitude error $\\Psi_i$ [-]")
    _vehicles(grid[3, 0], t, c["thrust"], "thrust $f_i$ [N]")
    ax = grid[3, 1]
    ax.plot(t, c["e_q"], color=AXES[0], linewidth=1.1, label="$e_q$ [-]")
    ax.set_ylabel("link directions $e_q$ [-]")
    twin = ax.twinx()
    twin.plot(t, c["e_w"], color=AXES[2], linewidth=0.9, linestyle="--", label="$e_\\omega$ [rad/s]")
    twin.set_ylabel("link rates $e_\\omega$ [rad/s]")
    ax.legend(handles=[ax.lines[0], twin.lines[0]], loc="best", fontsize=8)
    for ax in grid[3]:
        ax.set_xlabel("time since the release [s]")
    for ax in grid.ravel():
        ax.grid(alpha=0.25)
        ax.margins(x=0.01)
    return figure


def tensions(run: Run) -> Figure:
    """What the cables and the links to the vehicles carried: tensions, slack, frames that came. Raises LogError."""
    c, t = _flown(run)
    m = motion_of(run, 250.0)
    figure = Drawing(figsize=(WIDTH, 8.6), layout="constrained")
    grid = figure.subplots(3, 2, sharex=True)
    own = (m.t >= 0) & (m.t <= t[-1])
    _vehicles(grid[0, 0], m.t[own], m.tension[own].max(axis=2), "largest tension in a cable [N]")
    _vehicles(grid[0, 1], m.t[own], m.tension[own].min(axis=2), "smallest tension in a cable [N]")
    grid[0, 1].axhline(0.0, color="#d55e00", linewidth=0.8)
    grid[0, 1].annotate("below: slack", (0.99, 0.02), xycoords="axes fraction", ha="right", fontsize=8, color="#d55e00")
    limit = np.array(m.model["max_thrust_N"])
    _vehicles(grid[1, 0], m.t[own], 100 * m.thrust[own] / limit, "thrust, share of the limit [%]")
    grid[1, 1].plot(m.t[own], -m.x0[own, 2], color="0.15", linewidth=1.2, label="load")
    _vehicles(grid[1, 1], m.t[own], -m.quads[own, :, 2], "height, up [m]")
    _separation(grid[2, 0], m.t[own], m.quads[own])
    _age(grid[2, 1], t, 1e3 * c["state_age"])
    for ax in grid[2]:
        ax.set_xlabel("time since the release [s]")
    for ax in grid.ravel():
        ax.grid(alpha=0.25)
        ax.margins(x=0.01)
    return figure


def _separation(ax: Axes, t: Array, x: Array) -> None:
    """Of the two vehicles that are closest."""
    ax.set_ylabel("smallest separation [m]")
    if x.shape[1] < 2:
        ax.annotate("one vehicle", (0.5, 0.5), xycoords="axes fraction", ha="center", color="0.4")
        return
    apart = separation(x)
    ax.plot(t, apart, color="0.15", linewidth=1.1)
    ax.set_ylim(0.0, 1.15 * float(apart.max()))  # a separation that never changes is not on the frame


def _age(ax: Axes, t: Array, age_ms: Array) -> None:
    ax.set_ylabel("age of the state used [ms]")
    if not age_ms.any():
        ax.set_yticks([])
        said = "every state was measured as a whole: age 0"
        ax.annotate(said, (0.5, 0.5), xycoords="axes fraction", ha="center", color="0.4")
        return
    ax.plot(t, age_ms, color="0.15", linewidth=0.9)
    oldest = 1.1 * float(age_ms.max())
    ax.set_ylim(-0.05 * oldest, oldest)  # a line at 0 is seen as well


def _chosen(run: Run, last: float) -> list[float]:
    """Nine times, s: all over a mission; crowded towards the release of a flight to one place."""
    if any(e.kind == "phase" for e in run.events) or last > 2.0 * SETTLES_S:
        return [round(s, 2) for s in np.linspace(0.0, last, 9).tolist()]
    return [round(s, 2) for s in (min(SETTLES_S, last) * np.linspace(0, 1, 9) ** 2).tolist()]


def snapshots(run: Run, times: Sequence[float] | None = None) -> Figure:
    """The paper's Figures 3 and 5: the system at chosen times (s since the release) in space, from the side and above.

    Without `times` nine of them: all over a mission, else crowded towards the release. Raises LogError.
    """
    m = motion_of(run, 250.0)
    last = float(m.t[-1])
    chosen = list(times) if times is not None else _chosen(run, last)
    chosen = [s for s in chosen if s <= last + 0.05] or [0.0]
    rows = [int(np.argmin(np.abs(m.t - s))) for s in chosen]
    low = m.nodes[rows].reshape(-1, 3).min(axis=0) - 0.25
    high = m.nodes[rows].reshape(-1, 3).max(axis=0) + 0.35
    size = high - low
    tall = [1.9, 0.45 + COLUMN * size[2] / size[0], 0.45 + COLUMN * size[1] / size[0]]  # inches
    figure = Drawing(figsize=(COLUMN * len(rows) + 0.9, sum(tall) + 0.3), layout="constrained")
    grid = figure.add_gridspec(3, len(rows), height_ratios=tall, wspace=0.02, hspace=0.02)
    for k, row in enumerate(rows):
        space = figure.add_subplot(grid[0, k], projection="3d")
        _space(space, m, row)
        space.set_title(f"{m.t[row]:.2f} s", fontsize=9)
        for which, (a, b) in ((1, (0, 2)), (2, (0, 1))):
            ax = figure.add_subplot(grid[which, k])
            _flat(ax, m, row, a, b)
            ax.set(xlim=(low[a], high[a]), ylim=(high[b], low[b]) if b == 2 else (low[b], high[b]), aspect="equal")
            ax.tick_params(labelsize=6)
            ax.grid(alpha=0.2)
            if k == 0:
                ax.set_ylabel(("side: " if b == 2 else "above: ") + f"{'xyz'[b]} [m]", fontsize=8)
            else:
                ax.set_yticklabels([])
            ax.set_xlabel("x [m]", fontsize=7)
    return figure


def save(run: Run, folder: Path, times: Sequence[float] | None = None) -> dict[str, Path]:
    """Every figure as PNG and PDF in `folder`; the PNGs by name. Raises LogError."""
    out = {}
    chosen = times if times is not None else PAPER_TIMES if "paper-case-2" in _scenario(run) else None
    drawn = {"histories": histories(run), "snapshots": snapshots(run, chosen), "tensions": tensions(run)}
    for name, figure in drawn.items():
        for form in ("png", "pdf"):
            path = folder / f"{run.path.name.removesuffix('.part').removesuffix('.mcap')}-{name}.{form}"
            metadata: dict[str, Any] = {"CreationDate": None} if form == "pdf" else {}
            figure.savefig(path, dpi=140, metadata=metadata)
            if form == "png":
                out[name] = path
    return out


def _scenario(run: Run) -> str:
    return run.metadata.get("run", {}).get("scenario", "")


def _flown(run: Run) -> tuple[dict[str, np.ndarray], Array]:
    control = run.columns.get("/control/state")
    if control is None:
        raise LogError(f"log {run.path}: no decision in it to draw")
    ended = next((e.time_ns for e in run.events if e.kind == "end"), None)
    rows = flown(control)
    if ended is not None:
        rows = rows & (control["sim_time_ns"] <= ended)
    if not rows.any():
        raise LogError(f"log {run.path}: nothing was flown; there is nothing to draw")
    c = {name: values[rows] for name, values in control.items()}
    slack = ~np.isin(c["phase"], CARRYING)
    if slack.any():  # no law of hanging loads flies then: its errors say nothing
        for name in ERRORS:
            c[name] = np.where(slack.reshape(-1, *[1] * (c[name].ndim - 1)), np.nan, c[name])
    return c, c["t"]


def _rates(run: Run, t: Array) -> Array:
    """The load's rates: the truth where it was told, else what the decisions went by."""
    plant = run.columns.get("/plant/state")
    if plant is None:
        return np.asarray(_flown(run)[0]["e_Omega0"])
    at = (plant["sim_time_ns"] - run.release_ns) * 1e-9
    return np.stack([np.interp(t, at, plant["payload_rate"][:, k]) for k in range(3)], axis=1)


def _three(ax: Axes, t: Array, values: Array, wanted: Array | None, names: Sequence[str], label: str) -> None:
    for k, name in enumerate(names):
        ax.plot(t, values[:, k], color=AXES[k], linestyle=STYLES[k], linewidth=1.2, label=name)
        if wanted is not None:
            ax.plot(t, wanted[:, k], color="0.55", linewidth=0.7, label="reference" if k == 2 else None)
    ax.set_ylabel(label)
    ax.legend(fontsize=8, ncols=2, loc="best")


def _vehicles(ax: Axes, t: Array, values: Array, label: str) -> None:
    for i in range(values.shape[1]):
        at, mean = t, values[:, i]
        if len(t) > 1 and t[-1] - t[0] > LONG_S:
            at, least, mean, most = _bins(t, values[:, i])
            ax.fill_between(at, least, most, color=_tint(i), alpha=0.15, linewidth=0.0)
        ax.plot(at, mean, color=_tint(i), linestyle=STYLES[i % len(STYLES)], linewidth=1.0, label=f"{i + 1}")
    ax.set_ylabel(label)
    ax.legend(fontsize=8, ncols=2, title="vehicle", title_fontsize=8, loc="best")


def _bins(t: Array, values: Array) -> tuple[Array, Array, Array, Array]:
    """Times, least, mean and greatest of `values` in stretches of MEAN_S; the rest of the last one is left out."""
    size = max(1, round(MEAN_S * (len(t) - 1) / float(t[-1] - t[0])))
    whole = len(t) // size * size
    parts = values[:whole].reshape(-1, size)
    return t[:whole].reshape(-1, size).mean(axis=1), parts.min(axis=1), parts.mean(axis=1), parts.max(axis=1)


def _box(m: MotionHistory, row: int) -> Array:
    """(8, 3) m: the load's corners."""
    half = 0.5 * np.array(m.model["box_m"])
    corners = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]) * half
    return m.x0[row] + rotate(m.quat0[row : row + 1], corners)[0]


EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]


def _arms(m: MotionHistory, row: int, i: int) -> Array:
    """(4, 3) m: the rotors of vehicle i."""
    tips = 0.17 * np.array([(1, 1, 0), (-1, -1, 0), (1, -1, 0), (-1, 1, 0)]) / np.sqrt(2)
    return m.quads[row, i] + rotate(m.quats[row, i][None], tips)[0]


def _segments(m: MotionHistory, row: int) -> list[tuple[Array, Any, float]]:
    """Lines (k, 3) with colour and width: the load's edges, cables, arms."""
    corners = _box(m, row)
    lines: list[tuple[Array, Any, float]] = [(corners[list(edge)], "#3b5b9d", 1.0) for edge in EDGES]
    for i, k in enumerate(m.model["n_links"]):
        lines.append((m.nodes[row, i, : k + 1], "0.3", 1.1))
        arms = _arms(m, row, i)
        lines += [(arms[:2], _tint(i), 2.0), (arms[2:], _tint(i), 2.0)]
    return lines


def _space(ax: Any, m: MotionHistory, row: int) -> None:
    """One instant, as large as it fits."""
    here = m.nodes[row].reshape(-1, 3)
    middle, reach = here.mean(axis=0), 0.62 * float(np.ptp(here, axis=0).max())
    draw_space(ax, m, row, middle - reach, middle + reach)


def draw_space(ax: Any, m: MotionHistory, row: int, low: Array, high: Array) -> None:
    """One instant in a 3D axes that shows `low` to `high` (3,) m, z pointing down."""
    for points, shade, width in _segments(m, row):
        ax.plot(points[:, 0], points[:, 1], points[:, 2], color=shade, linewidth=width)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    ax.set_zlim(high[2], low[2])
    ax.set_box_aspect(high - low, zoom=1.12)
    ax.view_init(elev=22, azim=-62)
    ax.set_axis_off()


def _flat(ax: Axes, m: MotionHistory, row: int, a: int, b: int) -> None:
    for points, shade, width in _segments(m, row):
        ax.plot(points[:, a], points[:, b], color=shade, linewidth=0.8 * width)
    ax.plot(*np.array(m.model["target_m"])[[a, b]], "+", color="#d55e00", markersize=6)
