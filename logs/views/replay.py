"""Columns -> Rerun: a scene and plots that answer where the load is against the plan, which cable pulls how much, which
vehicle is near its limit, and what happened when."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr

from cablequad.types import Array
from logs.reading.reader import Happening, Run, frame_headers, missing_before
from logs.views.motion import MotionHistory, motion_of, rotate, separation, shade, thin
from logs.views.replay_layout import TIMELINE, layout
from logs.views.vehicle_reports import DISARMED, vehicle_reports
from logs.writing.encode import ALARMING, color

PLOT_HZ = 250.0
N_PER_M = 14.0  # thrust arrows: newtons a metre
ARM = 0.17  # m
AXES = [(230, 110, 20), (0, 178, 130), (60, 150, 235)]  # x, y, z
REFERENCE = [(120, 120, 120)] * 3  # wide and grey, under the curves
WIDE = 5.0
GREY, TAUT, AMBER = (90, 90, 100), (0, 120, 90), (190, 140, 40)
LANES = {"slack": (204, 121, 167), "taut": TAUT}
PHASES = {
    "prepare": (90, 90, 100), "preflight": (110, 90, 130), "arm": (150, 90, 60), "take off": (30, 130, 150),
    "tension": (120, 100, 80), "lift": (40, 110, 190), "carry": (120, 60, 150), "fly": (120, 60, 150),
    "set down": (190, 140, 40), "release": (70, 140, 70), "land": (180, 70, 60), "disarm": (80, 90, 120),
    "hold": (90, 90, 100),
}  # fmt: skip
CARRIED_FROM, CARRIED_TO = "lift", "release"  # phases between which a slack cable is worth a warning
NEAR = 1.6  # times the largest: a limit that far away is told in words, and flattens no curve
SLACK = (255, 0, 255)
LIMIT = (200, 60, 60)
BETWEEN = (140, 140, 140)  # seen on a dark and on a light ground
IN_CONTROL = ("OFFBOARD", "GUIDED")
ASKED_M = 0.45  # length of a commanded thrust axis
_Series = Callable[[str, Array, Array, list[str], list], None]  # where, t, values, names, colours
GHOST = "'"  # marks the curves of a second run


def save(run: Run, path: Path, other: Run | None = None) -> None:
    """Write the replay of `run` as an .rrd with its layout inside; `other` goes beside it as a ghost on the same clock.

    Raises LogError where a log holds no motion.
    """
    out = rr.RecordingStream("cablequad", recording_id=run.path.stem)
    motion = motion_of(run)
    out.save(path, default_blueprint=layout(motion, windy="/plant/wind" in run.columns))
    log(out, run, motion, None if other is None else (other, motion_of(other)))
    out.flush()
    out.disconnect()


def log(
    out: rr.RecordingStream, run: Run, m: MotionHistory, other: tuple[Run, MotionHistory] | None = None, told: int = 0
) -> None:
    """Send everything, but for the first `told` events."""
    _bodies(out, m)
    _cables(out, m)
    _intentions(out, m)
    _plots(out, run, m, "")
    _wire(out, run)
    _events(out, run, told)
    if other is not None:
        _ghost(out, other[1])
        _plots(out, *other, GHOST)


KEY = """
| what | means |
|---|---|
| cable, dark to bright | tension of each link, from 0 to the largest of the run |
| cable, magenta and thick | a link that pushes: the cable is slack |
| coloured arrow on a vehicle | its thrust, {newtons:g} N a metre |
| thin white arrow, thin white cable | what was commanded, what the controller took the cable to be |
| bright nose | the front of a vehicle |
| white arrow at the beginning | north, one metre long |
| green box | the target of the load |
| blue-grey line | where the load has been |
"""


def _key(out: rr.RecordingStream, m: MotionHistory) -> None:
    """What colours and lines mean, north, and a metre."""
    out.log("key", rr.TextDocument(KEY.format(newtons=N_PER_M), media_type="text/markdown"), static=True)
    ground = m.model.get("ground_z_m")
    start = m.x0[0] + np.array([0.0, 0.0, 0.0 if ground is None else float(ground) - m.x0[0, 2]])
    north = rr.Arrows3D(
        vectors=[(1, 0, 0)], origins=[start], colors=[(235, 235, 235)], radii=[0.012], labels=["north, 1 m"]
    )
    out.log("world/north", north, static=True)


def _bodies(out: rr.RecordingStream, m: MotionHistory) -> None:
    when, model = [_time(m.t)], m.model
    _key(out, m)
    out.log("world", rr.ViewCoordinates.FRD, static=True)
    half = 0.5 * np.array(model["box_m"])
    out.log("world/payload/box", rr.Boxes3D(half_sizes=[half], colors=[(86, 116, 190)], fill_mode="solid"), static=True)
    out.log("world/payload/axes", rr.TransformAxes3D(0.35), static=True)
    out.send_columns("world/payload", when, rr.Transform3D.columns(translation=m.x0, quaternion=_xyzw(m.quat0)))
    log_trail(out, m.x0)
    target = np.array(model["target_m"])
    turned = rr.Quaternion(xyzw=_xyzw(np.array(model["target_quat_wxyz"])))
    out.log(
        "world/target",
        rr.Boxes3D(
            half_sizes=[half],
            centers=[target],
            quaternions=[turned],
            colors=[(120, 220, 120)],
            radii=[0.006],
            labels=["target"],
        ),
        static=True,
    )
    for i in range(m.quads.shape[1]):
        name = f"world/quad{i + 1}"
        rgb = color(i)
        tips = np.concatenate(_arms())
        out.log(f"{name}/arms", rr.LineStrips3D(_arms(), colors=[rgb], radii=[0.012]), static=True)
        nose = rr.LineStrips3D([[(0, 0, 0), (ARM, 0, 0)]], colors=[(245, 245, 245)], radii=[0.012])
        out.log(f"{name}/nose", nose, static=True)
        out.log(
            f"{name}/rotors",
            rr.Ellipsoids3D(
                half_sizes=[(0.085, 0.085, 0.006)] * 4, centers=tips - [0.0, 0.0, 0.02], colors=[rgb], fill_mode="solid"
            ),
            static=True,
        )
        out.log(
            f"{name}/label", rr.Points3D([(0, 0, -0.12)], radii=[0.0], labels=[f"{i + 1}"], colors=[rgb]), static=True
        )
        out.send_columns(name, when, rr.Transform3D.columns(translation=m.quads[:, i], quaternion=_xyzw(m.quats[:, i])))
        up = rotate(m.quats[:, i], np.array([[0.0, 0.0, -1.0]]))[:, 0]
        out.log(f"world/thrust/{i + 1}", rr.Arrows3D.from_fields(colors=[rgb], radii=[0.012]), static=True)
        out.send_columns(
            f"world/thrust/{i + 1}",
            when,
            rr.Arrows3D.columns(vectors=up * m.thrust[:, i, None] / N_PER_M, origins=m.quads[:, i]),
        )


def log_trail(out: rr.RecordingStream, x0: Array) -> None:
    """Where the load has been, x0 (T, 3) m."""
    out.log("world/trail", rr.LineStrips3D([x0], colors=[(170, 175, 205)], radii=[0.006]), static=True)


def _cables(out: rr.RecordingStream, m: MotionHistory) -> None:
    """Every link as a strip of its own, coloured by its tension; a link that pushes is magenta and thick."""
    when = [_time(m.t)]
    released = m.t >= 0
    full = max(1e-6, float(np.percentile(m.tension[released], 99.5)) if released.any() else float(m.tension.max()))
    for i, k in enumerate(m.model["n_links"]):
        strips = np.stack([m.nodes[:, i, :k], m.nodes[:, i, 1 : k + 1]], axis=2).reshape(-1, 2, 3)
        pull = m.tension[:, i, :k].reshape(-1)
        tint = shade(np.clip(pull / full, 0.0, 1.0))
        tint[pull < 0] = SLACK
        radii = np.where(pull < 0, 0.016, 0.009)
        out.send_columns(
            f"world/cables/{i + 1}",
            when,
            rr.LineStrips3D.columns(strips=strips.astype(np.float32), colors=tint, radii=radii).partition(
                [k] * len(m.t)
            ),
        )


def _intentions(out: rr.RecordingStream, m: MotionHistory) -> None:
    """What was asked and believed beside what was: commanded thrust axes, and cables as the controller took them."""
    if m.commanded is not None:
        known = np.isfinite(m.commanded[:, 0, 0])
        when = [_time(m.t[known])]
        for i in range(m.quads.shape[1]):
            up = rotate(m.commanded[known, i], np.array([[0.0, 0.0, -ASKED_M]]))[:, 0]
            name = f"world/asked/{i + 1}"
            out.log(name, rr.Arrows3D.from_fields(colors=[(235, 235, 235, 150)], radii=[0.006]), static=True)
            out.send_columns(name, when, rr.Arrows3D.columns(vectors=up, origins=m.quads[known, i]))
    if m.believed is not None:
        known = np.isfinite(m.believed[:, 0, 0, 0])
        for i, k in enumerate(m.model["n_links"]):
            name = f"world/believed/{i + 1}"
            out.log(name, rr.LineStrips3D.from_fields(colors=[(250, 250, 250, 170)], radii=[0.003]), static=True)
            strips = m.believed[known, i, : k + 1].astype(np.float32)
            out.send_columns(name, [_time(m.t[known])], rr.LineStrips3D.columns(strips=strips))


def _ghost(out: rr.RecordingStream, m: MotionHistory) -> None:
    """Another run in the same scene, grey: its load, cables and vehicles."""
    when, grey = [_time(m.t)], (165, 165, 175, 120)
    half = 0.5 * np.array(m.model["box_m"])
    out.log("world/ghost/load/box", rr.Boxes3D(half_sizes=[half], colors=[grey], radii=[0.004]), static=True)
    out.send_columns("world/ghost/load", when, rr.Transform3D.columns(translation=m.x0, quaternion=_xyzw(m.quat0)))
    out.log("world/ghost/trail", rr.LineStrips3D([m.x0], colors=[grey], radii=[0.003]), static=True)
    for i, k in enumerate(m.model["n_links"]):
        cable, body = f"world/ghost/cables/{i + 1}", f"world/ghost/quad{i + 1}"
        out.log(cable, rr.LineStrips3D.from_fields(colors=[grey], radii=[0.004]), static=True)
        out.send_columns(cable, when, rr.LineStrips3D.columns(strips=m.nodes[:, i, : k + 1].astype(np.float32)))
        out.log(f"{body}/arms", rr.LineStrips3D(_arms(), colors=[grey], radii=[0.008]), static=True)
        out.send_columns(body, when, rr.Transform3D.columns(translation=m.quads[:, i], quaternion=_xyzw(m.quats[:, i])))


def _arms() -> list[Array]:
    tips = ARM * np.array([(1, 1, 0), (-1, -1, 0), (1, -1, 0), (-1, 1, 0)]) / np.sqrt(2)
    return [tips[:2], tips[2:]]


def _plots(out: rr.RecordingStream, run: Run, m: MotionHistory, mark: str) -> None:
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
        out.send_columns(lane, [_time(t)], rr.StateChange.columns(state=[mode for _, mode in modes]))


def _wire(out: rr.RecordingStream, run: Run) -> None:
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


def _events(out: rr.RecordingStream, run: Run, told: int) -> None:
    events = run.events[told:]
    marks = [(run.release_ns, "fly")] if any(e.kind == "release" for e in events) else []
    if told == 0:
        first = min((int(c["sim_time_ns"][0]) for c in run.columns.values() if "sim_time_ns" in c), default=0)
        marks.insert(0, (first, "prepare"))
    marks += [(e.time_ns, e.text) for e in events if e.kind == "phase"]
    marks = [m for m in marks if m[1] != "fly" or not any(e.kind == "phase" for e in run.events)]
    marks += [(e.time_ns, "hold") for e in events if e.kind == "end"]
    t = np.array([(ns - run.release_ns) * 1e-9 for ns, _ in marks])
    out.log("phases/mission", rr.StateConfiguration(values=list(PHASES), colors=list(PHASES.values())), static=True)
    out.send_columns("phases/mission", [_time(t)], rr.StateChange.columns(state=[name for _, name in marks]))
    for cable in sorted({e.subject for e in events if e.kind in ("slack", "taut")}):
        marks = [(e.time_ns, e.kind) for e in events if e.subject == cable and e.kind in ("slack", "taut")]
        if told == 0 and marks[0][0] > run.release_ns:  # nothing was said of it before: it was as it begins
            marks.insert(0, (run.release_ns, "taut" if marks[0][1] == "slack" else "slack"))
        t = np.array([(ns - run.release_ns) * 1e-9 for ns, _ in marks])
        lane = f"slack/{cable.replace(' ', '_')}"
        out.log(lane, rr.StateConfiguration(values=list(LANES), colors=list(LANES.values())), static=True)
        out.send_columns(lane, [_time(t)], rr.StateChange.columns(state=[name for _, name in marks]))
    if events:
        t = np.array([(e.time_ns - run.release_ns) * 1e-9 for e in events])
        text = [f"{e.subject}: {e.text}" for e in events]
        level = ["WARN" if e.kind in ALARMING and _matters(run, e) else "INFO" for e in events]
        out.send_columns("events", [_time(t)], rr.TextLog.columns(text=text, level=level))


def _matters(run: Run, event: Happening) -> bool:
    """Whether a slack cable is worth a warning: while it is to carry; everything else is."""
    if event.kind != "slack":
        return True
    phases = [e.text for e in run.events if e.kind == "phase" and e.time_ns <= event.time_ns]
    return CARRIED_FROM in phases and CARRIED_TO not in phases if phases else True


def _series(
    out: rr.RecordingStream, entity: str, t: Array, values: Array, names: list[str], tints: list,
    widths: list[float] | None = None,
) -> None:  # fmt: skip
    out.log(entity, rr.SeriesLines(names=names, colors=tints, widths=widths or [1.6] * len(names)), static=True)
    out.send_columns(entity, [_time(t)], rr.Scalars.columns(scalars=values))


def _time(t: Array) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, duration=np.rint(t * 1e9).astype("timedelta64[ns]"))


def _xyzw(quat_wxyz: Array) -> Array:
    return np.roll(quat_wxyz, -1, axis=-1)
