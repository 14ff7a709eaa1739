"""Columns -> Rerun: a scene and plots that answer where the load is against the plan, which cable pulls how much, which
vehicle is near its limit, and what happened when."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from cablequad.types import Array
from logs.reading.reader import Happening, Run
from logs.views.motion import MotionHistory, motion_of, rotate, shade
from logs.views.replay_layout import layout
from logs.views.replay_plots import TAUT, plots, time_column, wire
from logs.writing.encode import ALARMING, color

N_PER_M = 14.0  # thrust arrows: newtons a metre
ARM = 0.17  # m
LANES = {"slack": (204, 121, 167), "taut": TAUT}
PHASES = {
    "prepare": (90, 90, 100), "preflight": (110, 90, 130), "arm": (150, 90, 60), "take off": (30, 130, 150),
    "tension": (120, 100, 80), "lift": (40, 110, 190), "carry": (120, 60, 150), "fly": (120, 60, 150),
    "set down": (190, 140, 40), "release": (70, 140, 70), "land": (180, 70, 60), "disarm": (80, 90, 120),
    "hold": (90, 90, 100),
}  # fmt: skip
CARRIED_FROM, CARRIED_TO = "lift", "release"  # phases between which a slack cable is worth a warning
SLACK = (255, 0, 255)
ASKED_M = 0.45  # length of a commanded thrust axis
GHOST = "'"  # marks the curves of a second run


def save(run: Run, path: Path, other: Run | None = None) -> None:
    """Write the replay of `run` as an .rrd with its layout inside; `other` goes beside it as a ghost on the same clock.

    Raises LogError where a log holds no motion.
    """
    out, motion, blueprint = _begun(run)
    out.save(path, default_blueprint=blueprint)
    log(out, run, motion, None if other is None else (other, motion_of(other)))
    out.flush()
    out.disconnect()


def show(run: Run, width: int, height: int) -> None:
    """The replay of `run` as the widget of the notebook's cell that calls it. Raises LogError as `save` does."""
    import rerun_notebook  # noqa: F401  rerun without it only warns

    out, motion, blueprint = _begun(run)
    log(out, run, motion)
    rr.notebook_show(width=width, height=height, blueprint=blueprint, recording=out)


def _begun(run: Run) -> tuple[rr.RecordingStream, MotionHistory, rrb.Blueprint]:
    motion = motion_of(run)
    out = rr.RecordingStream("cablequad", recording_id=run.path.stem)
    return out, motion, layout(motion, windy="/plant/wind" in run.columns)


def log(
    out: rr.RecordingStream, run: Run, m: MotionHistory, other: tuple[Run, MotionHistory] | None = None, told: int = 0
) -> None:
    """Send everything, but for the first `told` events."""
    _bodies(out, m)
    _cables(out, m)
    _intentions(out, m)
    plots(out, run, m, "")
    wire(out, run)
    _events(out, run, told)
    if other is not None:
        _ghost(out, other[1])
        plots(out, *other, GHOST)


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
    when, model = [time_column(m.t)], m.model
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
    when = [time_column(m.t)]
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
        when = [time_column(m.t[known])]
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
            out.send_columns(name, [time_column(m.t[known])], rr.LineStrips3D.columns(strips=strips))


def _ghost(out: rr.RecordingStream, m: MotionHistory) -> None:
    """Another run in the same scene, grey: its load, cables and vehicles."""
    when, grey = [time_column(m.t)], (165, 165, 175, 120)
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
    out.send_columns("phases/mission", [time_column(t)], rr.StateChange.columns(state=[name for _, name in marks]))
    for cable in sorted({e.subject for e in events if e.kind in ("slack", "taut")}):
        marks = [(e.time_ns, e.kind) for e in events if e.subject == cable and e.kind in ("slack", "taut")]
        if told == 0 and marks[0][0] > run.release_ns:  # nothing was said of it before: it was as it begins
            marks.insert(0, (run.release_ns, "taut" if marks[0][1] == "slack" else "slack"))
        t = np.array([(ns - run.release_ns) * 1e-9 for ns, _ in marks])
        lane = f"slack/{cable.replace(' ', '_')}"
        out.log(lane, rr.StateConfiguration(values=list(LANES), colors=list(LANES.values())), static=True)
        out.send_columns(lane, [time_column(t)], rr.StateChange.columns(state=[name for _, name in marks]))
    if events:
        t = np.array([(e.time_ns - run.release_ns) * 1e-9 for e in events])
        text = [f"{e.subject}: {e.text}" for e in events]
        level = ["WARN" if e.kind in ALARMING and _matters(run, e) else "INFO" for e in events]
        out.send_columns("events", [time_column(t)], rr.TextLog.columns(text=text, level=level))


def _matters(run: Run, event: Happening) -> bool:
    """Whether a slack cable is worth a warning: while it is to carry; everything else is."""
    if event.kind != "slack":
        return True
    phases = [e.text for e in run.events if e.kind == "phase" and e.time_ns <= event.time_ns]
    return CARRIED_FROM in phases and CARRIED_TO not in phases if phases else True


def _xyzw(quat_wxyz: Array) -> Array:
    return np.roll(quat_wxyz, -1, axis=-1)
