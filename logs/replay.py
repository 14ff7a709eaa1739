"""Columns -> Rerun: a scene and plots that answer where the load is against the plan, which cable pulls how much, which
vehicle is near its limit, and what happened when."""

import json
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from cablequad.types import Array
from logs.encode import color
from logs.motion import Motion, motion_of, rotate, shade, thin
from logs.reader import Run

TIMELINE = "sim_time"
PLOT_HZ = 250.0
N_PER_M = 14.0  # thrust arrows: newtons a metre
ARM = 0.17  # m
AXES = [(213, 94, 0), (0, 158, 115), (0, 114, 178)]  # x, y, z
FAINT = [(240, 180, 140), (150, 210, 190), (150, 190, 225)]  # their targets
SLACK = (255, 0, 255)


def save(run: Run, path: Path) -> None:
    """Write the replay of `run` as an .rrd with its layout inside. Raises LogError where the log holds no motion."""
    out = rr.RecordingStream("cablequad", recording_id=run.path.stem)
    motion = motion_of(run)
    out.save(path, default_blueprint=layout(motion))
    log(out, run, motion)
    out.flush()
    out.disconnect()


def log(out: rr.RecordingStream, run: Run, m: Motion) -> None:
    """Send everything."""
    model = {key: json.loads(value) for key, value in run.metadata["model"].items()}
    _bodies(out, m, model)
    _cables(out, m, np.array(model["n_links"]))
    _plots(out, run, m, np.array(model["max_thrust_N"]))
    _events(out, run)


def layout(m: Motion) -> rrb.Blueprint:
    """3D and the phases on the left, plots on the right."""
    low, high = m.nodes.reshape(-1, 3).min(axis=0), m.nodes.reshape(-1, 3).max(axis=0)
    middle = 0.5 * (low + high)
    size = high - low
    across = np.array([1.0, 0.35, -0.5]) if size[1] >= size[0] else np.array([0.35, 1.0, -0.5])
    floor = float(high[2]) + 0.6
    eye = middle + max(3.0, 1.15 * float(np.linalg.norm(size))) * across / np.linalg.norm(across)
    scene = rrb.Spatial3DView(
        origin="/world",
        name="load, cables, vehicles (NED)",
        background=rrb.Background(color=(18, 20, 28)),
        line_grid=rrb.LineGrid3D(
            visible=True, spacing=0.5, plane=rr.components.Plane3D.XY.with_distance(floor), color=(110, 120, 140, 90)
        ),
        eye_controls=rrb.EyeControls3D(position=eye, look_target=middle, eye_up=(0.0, 0.0, -1.0)),
    )

    def plot(name: str, *entities: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            name=name, origin="/plots", contents=list(entities), plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop)
        )

    plots = rrb.Grid(
        plot("payload position and target [m]", "/plots/position", "/plots/target"),
        plot("payload velocity and target [m/s]", "/plots/velocity", "/plots/target_velocity"),
        plot("thrust f_i and limit [N]", "/plots/thrust/**"),
        plot("tension at the load, smallest of all links [N]", "/plots/tension/**"),
        plot("vehicle attitude error Psi_i [-]", "/plots/psi/**"),
        plot("payload attitude error Psi_0 [-]", "/plots/psi_0"),
        plot("link errors e_q [-], e_omega [rad/s]", "/plots/links/**"),
        rrb.TextLogView(name="events", origin="/events"),
        grid_columns=2,
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene, rrb.StateTimelineView(name="phases", origin="/phases"), row_shares=[6, 1]),
            plots,
            column_shares=[5, 6],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, playback_speed=1.0),
        collapse_panels=True,
    )


def _bodies(out: rr.RecordingStream, m: Motion, model: dict) -> None:
    when = [_time(m.t)]
    out.log("world", rr.ViewCoordinates.FRD, static=True)
    half = 0.5 * np.array(model["box_m"])
    out.log("world/payload/box", rr.Boxes3D(half_sizes=[half], colors=[(86, 116, 190)], fill_mode="solid"), static=True)
    out.log("world/payload/axes", rr.TransformAxes3D(0.35), static=True)
    out.send_columns("world/payload", when, rr.Transform3D.columns(translation=m.x0, quaternion=_xyzw(m.quat0)))
    out.log("world/trail", rr.LineStrips3D([m.x0], colors=[(170, 175, 205)], radii=[0.006]), static=True)
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
        tips = ARM * np.array([(1, 1, 0), (-1, -1, 0), (1, -1, 0), (-1, 1, 0)]) / np.sqrt(2)
        out.log(
            f"{name}/arms",
            rr.LineStrips3D([[tips[0], tips[1]], [tips[2], tips[3]]], colors=[rgb], radii=[0.012]),
            static=True,
        )
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


def _cables(out: rr.RecordingStream, m: Motion, n_links: np.ndarray) -> None:
    """Every link as a strip of its own, coloured by its tension; a link that pushes is magenta and thick."""
    when = [_time(m.t)]
    released = m.t >= 0
    full = max(1e-6, float(np.percentile(m.tension[released], 99.5)) if released.any() else float(m.tension.max()))
    for i in range(m.quads.shape[1]):
        k = int(n_links[i])
        strips = np.stack([m.nodes[:, i, :k], m.nodes[:, i, 1 : k + 1]], axis=2).reshape(-1, 2, 3)
        pull = m.tension[:, i, :k].reshape(-1)
        shade = shade(np.clip(pull / full, 0.0, 1.0))
        shade[pull < 0] = SLACK
        radii = np.where(pull < 0, 0.016, 0.009)
        out.send_columns(
            f"world/cables/{i + 1}",
            when,
            rr.LineStrips3D.columns(strips=strips.astype(np.float32), colors=shade, radii=radii).partition(
                [k] * len(m.t)
            ),
        )


def _plots(out: rr.RecordingStream, run: Run, m: Motion, max_thrust: Array) -> None:
    n = m.quads.shape[1]
    vehicles = [f"{i + 1}" for i in range(n)]
    tints = [color(i) for i in range(n)]
    control = run.columns.get("/control/state")
    if control is not None:
        rows = thin(control["sim_time_ns"], PLOT_HZ)
        t = (control["sim_time_ns"][rows] - run.release_ns) * 1e-9
        e_x, x = control["e_x0"][rows], control["position"][rows]
        e_v, v = control["e_v0"][rows], control["velocity"][rows]
        _series(out, "plots/position", t, x, ["x", "y", "z"], AXES)
        _series(out, "plots/target", t, x - e_x, ["x target", "y target", "z target"], FAINT)
        _series(out, "plots/velocity", t, v, ["vx", "vy", "vz"], AXES)
        _series(out, "plots/target_velocity", t, v - e_v, ["vx target", "vy target", "vz target"], FAINT)
        _series(out, "plots/thrust/commanded", t, control["thrust"][rows], [f"f_{k}" for k in vehicles], tints)
        _series(out, "plots/psi/vehicles", t, control["Psi"][rows], [f"Psi_{k}" for k in vehicles], tints)
        _series(out, "plots/psi_0", t, control["Psi_0"][rows][:, None], ["Psi_0"], [(120, 150, 230)])
        links = np.stack([control["e_q"][rows], control["e_w"][rows]], axis=1)
        _series(out, "plots/links/errors", t, links, ["e_q", "e_omega"], [AXES[0], AXES[2]])
        _series(out, "plots/tension/load", t, control["tension"][rows], [f"T_{k}" for k in vehicles], tints)
    ends = m.t[[0, -1]]
    limit = float(max_thrust.min())
    if m.thrust.max() > 0.6 * limit:
        _series(out, "plots/thrust/limit", ends, np.full((2, 1), limit), ["limit"], [(200, 60, 60)])
    slackest = np.where(m.t >= 0, m.tension.min(axis=(1, 2)), np.nan)
    seen = np.isfinite(slackest)
    _series(out, "plots/tension/smallest", m.t[seen], slackest[seen, None], ["smallest"], [(220, 220, 220)])


def _events(out: rr.RecordingStream, run: Run) -> None:
    marks = [(run.release_ns, "fly")] if any(e.kind == "release" for e in run.events) else []
    first = min((int(c["sim_time_ns"][0]) for c in run.columns.values() if "sim_time_ns" in c), default=0)
    marks.insert(0, (first, "prepare"))
    marks += [(e.time_ns, "hold") for e in run.events if e.kind == "end"]
    t = np.array([(ns - run.release_ns) * 1e-9 for ns, _ in marks])
    out.send_columns("phases/mission", [_time(t)], rr.StateChange.columns(state=[name for _, name in marks]))
    if run.events:
        t = np.array([(e.time_ns - run.release_ns) * 1e-9 for e in run.events])
        text = [f"{e.subject}: {e.text}" for e in run.events]
        level = ["WARN" if e.kind in ("sitl-answer-missing", "slack") else "INFO" for e in run.events]
        out.send_columns("events", [_time(t)], rr.TextLog.columns(text=text, level=level))


def _series(out: rr.RecordingStream, entity: str, t: Array, values: Array, names: list[str], tints: list) -> None:
    out.log(entity, rr.SeriesLines(names=names, colors=tints, widths=[1.6] * len(names)), static=True)
    out.send_columns(entity, [_time(t)], rr.Scalars.columns(scalars=values))


def _time(t: Array) -> rr.TimeColumn:
    return rr.TimeColumn(TIMELINE, duration=np.rint(t * 1e9).astype("timedelta64[ns]"))


def _xyzw(quat_wxyz: Array) -> Array:
    return np.roll(quat_wxyz, -1, axis=-1)
