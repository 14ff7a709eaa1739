"""Where everything of a replay is shown: the scene and the phases, plots of the flight, a pilot's view, the wire."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from logs.views.motion import MotionHistory

TIMELINE = "sim_time"
BEHIND = np.array([-1.3, -0.3, -0.6])  # of the load, for each metre of its reach


def layout(m: MotionHistory, ended: bool = True, windy: bool = True) -> rrb.Blueprint:
    """3D and the phases on the left, plots on the right: over the whole run, where it has `ended`.

    `windy`: whether the log says how the air moved.
    """
    seen = np.concatenate(
        [m.nodes.reshape(-1, 3), m.nodes[0].reshape(-1, 3) + (np.array(m.model["target_m"]) - m.x0[0])]
    )
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle = 0.5 * (low + high)
    size = high - low
    across = np.array([1.0, 0.35, -0.5]) if size[1] >= size[0] else np.array([0.35, 1.0, -0.5])
    known = m.model.get("ground_z_m")
    floor = float(high[2]) + 0.6 if known is None else float(known)
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

    quiet = rrb.Corner2D.RightTop if known is None else rrb.Corner2D.LeftTop  # a flight from the ground begins quietly

    def plot(name: str, *entities: str, span: tuple[float, float] | None = None) -> rrb.TimeSeriesView:
        axis = None if span is None else rrb.ScalarAxis(range=span)
        whole = rrb.TimeAxis(view_range=rr.TimeRange(start=_instant(m.t[0]), end=_instant(m.t[-1])))
        return rrb.TimeSeriesView(
            name=name,
            origin="/plots",
            contents=list(entities),
            plot_legend=rrb.PlotLegend(quiet),
            axis_x=whole if ended else None,
            axis_y=axis,
        )

    guard = m.model.get("guards", {})
    pull = f", guard {guard['tension_N']:.3g} N" if "tension_N" in guard else ""

    plots = rrb.Grid(
        plot("payload position, reference grey [m, NED]", "/plots/position/**"),
        plot("payload velocity, reference grey [m/s, NED]", "/plots/velocity/**"),
        plot(f"thrust f_i [N], limit {min(m.model['max_thrust_N']):g} N", "/plots/thrust/**"),
        plot(f"tension at the load, smallest of all links grey [N]{pull}", "/plots/tension/**"),
        plot("vehicle attitude error Psi_i [-]", "/plots/psi/**"),
        plot("payload attitude error Psi_0 [-]", "/plots/psi_0/**"),
        plot("link errors e_q [-], e_omega [rad/s]", "/plots/links/**"),
        rrb.TextLogView(name="events", origin="/events"),
        grid_columns=2,
        name="flight",
    )
    wire = rrb.Vertical(
        plot("frames missing by their numbers, each second", "/plots/lost/**"),
        plot("age of the state that was answered [ms]", "/plots/age/**"),
        plot("estimate less truth: load [cm], links [deg]", "/plots/estimate/**"),
        name="wire and estimate",
    )
    reach = float(np.linalg.norm(m.nodes[0].reshape(-1, 3) - m.x0[0], axis=1).max())
    pilot = rrb.Grid(
        plot("height, up [m]", "/plots/height/**"),
        plot("load's distance to its target [m]", "/plots/distance/**"),
        plot("tilt, guards red [deg]", "/plots/tilt/**"),
        plot("separation of the two closest vehicles, guard red [m]", "/plots/separation/**"),
        plot("battery [%]", "/plots/battery/**", span=(0.0, 105.0)),
        *([plot("wind, where it blows to [m/s, NED]", "/plots/wind/**")] if windy else []),
        rrb.StateTimelineView(name="mode, where armed", origin="/modes"),
        rrb.TextDocumentView(name="key", origin="/key"),
        grid_columns=2,
        name="pilot",
    )
    views = rrb.Vertical(
        rrb.Spatial3DView(
            origin="/world",
            name="from above (north is up)",
            background=rrb.Background(color=(18, 20, 28)),
            eye_controls=rrb.EyeControls3D(
                position=middle + np.array([0.0, 0.0, -1.0 * max(3.0, float(np.linalg.norm(size)))]),
                look_target=middle,
                eye_up=(1.0, 0.0, 0.0),
            ),
        ),
        rrb.Spatial3DView(
            origin="/world",
            name="behind the load",
            background=rrb.Background(color=(18, 20, 28)),
            eye_controls=rrb.EyeControls3D(
                position=m.x0[0] + BEHIND * max(1.0, 2.0 * reach),
                eye_up=(0.0, 0.0, -1.0),
                tracking_entity="/world/payload",
            ),
        ),
        name="from above, behind",
    )
    phases = rrb.StateTimelineView(name="phases", origin="/", contents=["/phases/**", "/slack/**"])
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene, phases, row_shares=[5.0, 0.55 + 0.27 * (1 + len(m.model["n_links"]))]),
            rrb.Tabs(plots, pilot, views, wire),
            column_shares=[5, 6],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, playback_speed=1.0),
        collapse_panels=True,
    )


def _instant(t: float) -> rr.TimeRangeBoundary:
    """An instant of the timeline."""
    return rr.TimeRangeBoundary.absolute(seconds=float(t))
