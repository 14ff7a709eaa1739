"""The curves and lanes of a replay: what was flown, what a pilot looks at, what the links lost."""

from collections.abc import Callable

import numpy as np
import rerun as rr

from cablequad.types import Array
from logs.reading.reader import Run, frame_headers, missing_before
from logs.views.motion import MotionHistory, rotate, separation, thin
from logs.views.replay_layout import TIMELINE
from logs.views.vehicle_reports import DISARMED, vehicle_reports
from logs.writing.encode import color

PLOT_HZ = 250.0
AXES = [(230, 110, 20), (0, 178, 130), (60, 150, 235)]  # x, y, z
REFERENCE = [(120, 120, 120)] * 3  # wide and grey, under the curves
WIDE = 5.0
GREY, TAUT, AMBER = (90, 90, 100), (0, 120, 90), (190, 140, 40)
NEAR = 1.6  # times the largest: a limit that far away is told in words, and flattens no curve
LIMIT = (200, 60, 60)
BETWEEN = (140, 140, 140)  # seen on a dark and on a light ground
IN_CONTROL = ("OFFBOARD", "GUIDED")
_Series = Callable[[str, Array, Array, list[str], list], None]  # where, t, values, names, colours


def plots(out: rr.RecordingStream, run: Run, m: MotionHistory, mark: str) -> None:
    """Curves of one run; `mark` tells those of a second run apart, in paths and names."""
    n = m.quads.shape[1]
    vehicles = [f"{i + 1}{mark}" for i in range(n)]
    tints = [_paler(color(i)) if mark else color(i) for i in range(n)]
    axes = [_paler(c) for c in AXES] if mark else AXES

    def series(where: str, t: Array, values: Array, names: list[str], colors: list) -> None:
        _series(out, f"plots/{where}{mark}", t, values, names, colors)

    control = run.columns.get("/control/state")
    if control is not None:
        rows = thin(control["sim_time_ns"], PLOT_HZ)
        t = (control["sim_time_ns"][rows] - run.release_ns) * 1e-9
        e_x, x = control["e_x0"][rows], control["position"][rows]
        e_v, v = control["e_v0"][rows], control["velocity"][rows]
        series("position/is", t, x, [f"{a}{mark}" for a in "xyz"], axes)
        series("velocity/is", t, v, [f"v{a}{mark}" for a in "xyz"], axes)
        if not mark:
            wide = [WIDE] * 3  # "asked" sorts before "is", and what comes first is drawn below
            _series(out, "plots/position/asked", t, x - e_x, ["reference"] * 3, REFERENCE, widths=wide)
            _series(out, "plots/velocity/asked", t, v - e_v, ["reference"] * 3, REFERENCE, widths=wide)
        series("thrust/commanded", t, control["thrust"][rows], [f"f_{k}" for k in vehicles], tints)
        series("psi/vehicles", t, control["Psi"][rows], [f"Psi_{k}" for k in vehicles], tints)
        series("psi_0/load", t, control["Psi_0"][rows][:, None], [f"Psi_0{mark}"], [(120, 150, 230)])
        links = np.stack([control["e_q"][rows], control["e_w"][rows]], axis=1)
        series("links/errors", t, links, [f"e_q{mark}", f"e_omega{mark}"], [axes[0], axes[2]])
        series("age/state", t, 1e3 * control["state_age"][rows][:, None], [f"age of the state{mark}"], [(213, 94, 0)])
    _estimate(series, run, m, mark, axes)
    ends = m.t[[0, -1]]
    limit = float(min(m.model["max_thrust_N"]))
    if not mark and limit < NEAR * m.thrust.max():
        series("thrust/limit", ends, np.full((2, 1), limit), ["limit"], [LIMIT])
    slackest = np.where(m.t >= 0, m.tension.min(axis=(1, 2)), np.nan)
    seen = np.isfinite(slackest)
    series("tension/all", m.t[seen], slackest[seen, None], [f"smallest of all links{mark}"], [(120, 120, 120)])
    last = np.array(m.model["n_links"]) - 1
    at_load = m.tension[:, np.arange(n), last]
    series("tension/load", m.t[seen], at_load[seen], [f"T_{k}" for k in vehicles], tints)
    guard = dict(m.model.get("guards", {})) if not mark else {}
    if guard.get("tension_N", np.inf) < NEAR * max(1e-9, float(m.tension.max())):
        series("tension/limit", ends, np.full((2, 1), guard["tension_N"]), ["limit"], [LIMIT])
    _pilot(series, m, vehicles, tints, mark)
    _reports(out, series, run, mark, vehicles)
    _air(series, run, mark, axes)


def _estimate(series: _Series, run: Run, m: MotionHistory, mark: str, axes: list) -> None:
    """How far the states that were gone by are from the true ones."""
    off = run.columns.get("/control/estimate")
    if off is None:
        return
    rows = thin(off["sim_time_ns"], PLOT_HZ)
    t = (off["sim_time_ns"][rows] - run.release_ns) * 1e-9
    n_links = np.array(m.model["n_links"])
    used = (np.arange(off["link_direction"].shape[1] // len(n_links))[None, :] < n_links[:, None]).ravel()
    both = np.stack([
        100 * np.linalg.norm(off["position"][rows], axis=1),
        np.degrees(np.sqrt(np.mean(off["link_direction"][rows][:, used] ** 2, axis=1))),
    ], axis=1)  # fmt: skip
    series("estimate/errors", t, both, [f"load [cm]{mark}", f"links [deg]{mark}"], [axes[2], axes[0]])


def _air(series: _Series, run: Run, mark: str, axes: list) -> None:
    """How the air moved."""
    wind = run.columns.get("/plant/wind")
    if wind is not None:
        t = (wind["sim_time_ns"] - run.release_ns) * 1e-9
        series("wind/air", t, wind["velocity"], [f"w{a}{mark}" for a in "xyz"], axes)


def _pilot(
    series: _Series,
    m: MotionHistory,
    vehicles: list[str],
    tints: list,
    mark: str,
) -> None:
    """What a pilot looks at: heights, distance to the target, tilts, and the two vehicles that are closest."""
    n, grey = m.quads.shape[1], BETWEEN
    series("height/load", m.t, -m.x0[:, 2:], [f"load{mark}"], [grey])
    series("height/vehicles", m.t, -m.quads[:, :, 2], vehicles, tints)
    off = np.linalg.norm(m.x0 - np.array(m.model["target_m"]), axis=1)
    series("distance/load", m.t, off[:, None], [f"load to target{mark}"], [grey])
    down = np.array([[0.0, 0.0, 1.0]])
    tilts = [rotate(quats, down)[:, 0, 2] for quats in (m.quat0, *np.moveaxis(m.quats, 1, 0))]
    degrees = np.degrees(np.arccos(np.clip(np.stack(tilts, axis=1), -1.0, 1.0)))
    series("tilt/load", m.t, degrees[:, :1], [f"load{mark}"], [grey])
    series("tilt/vehicles", m.t, degrees[:, 1:], vehicles, tints)
    guard = dict(m.model.get("guards", {})) if not mark else {}
    ends = m.t[[0, -1]]
    for where, name in (
        ("tilt/limit", "tilt_deg"),
        ("tilt/limit_load", "load_tilt_deg"),
        ("separation/limit", "separation_m"),
    ):
        if name in guard:
            series(where, ends, np.full((2, 1), guard[name]), [name], [LIMIT])
    if n > 1:
        series("separation/all", m.t, separation(m.quads)[:, None], [f"closest two{mark}"], [grey])


def _reports(
    out: rr.RecordingStream,
    series: _Series,
    run: Run,
    mark: str,
    vehicles: list[str],
) -> None:
    """What vehicles said of themselves: batteries, modes and whether they are armed."""
    said = [vehicle_reports(run, i + 1) for i in range(len(vehicles))]
    for i, (_, (t, percent)) in enumerate(said):
        if len(t):
            series(f"battery/{i + 1}", t, percent[:, None], [vehicles[i]], [color(i)])
    known = sorted({mode for report in said for _, mode in report.modes})
    tints = [GREY if mode == DISARMED else TAUT if mode in IN_CONTROL else AMBER for mode in known]
    for i, (modes, _) in enumerate(said):
        if not modes or mark:
            continue
        lane = f"modes/vehicle_{i + 1}"
        out.log(lane, rr.StateConfiguration(values=known, colors=tints), static=True)
        t = np.array([when for when, _ in modes])
        out.send_columns(lane, [time_column(t)], rr.StateChange.columns(state=[mode for _, mode in modes]))


def wire(out: rr.RecordingStream, run: Run) -> None:
    """What the links lost: frames missing by their sequence numbers, each second, of every sender."""
    for topic, frames in sorted(run.frames.items()):
        who, direction = topic.split("/")[2:4]
        if direction != "rx" or len(frames) < 2:
            continue
        head = frame_headers(frames)
        ns = frames.time_ns - run.epoch_ns
        second = (ns - run.release_ns) // 10**9
        missing = np.zeros(len(ns))
        for sender in np.unique(head["sysid"] * 256 + head["compid"]):
            rows = np.flatnonzero(head["sysid"] * 256 + head["compid"] == sender)
            missing[rows] = missing_before(head["seq"][rows])
        bins = np.arange(second[0], second[-1] + 1)
        lost = np.bincount(second - second[0], missing, len(bins))
        tint = color(int(who[4:]) - 1) if who.startswith("quad") else BETWEEN
        _series(out, f"plots/lost/{who}", bins + 1.0, np.maximum(lost, 0.0)[:, None], [who], [tint])


def _paler(c: tuple[int, int, int]) -> tuple[int, int, int]:
    r, g, b = ((v + 2 * 150) // 3 for v in c)
    return r, g, b


def _series(
    out: rr.RecordingStream, entity: str, t: Array, values: Array, names: list[str], tints: list,
    widths: list[float] | None = None,
) -> None:  # fmt: skip
    out.log(entity, rr.SeriesLines(names=names, colors=tints, widths=widths or [1.6] * len(names)), static=True)
    out.send_columns(entity, [time_column(t)], rr.Scalars.columns(scalars=values))


def time_column(t: Array) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, duration=np.rint(t * 1e9).astype("timedelta64[ns]"))
