"""Where everything of a replay is shown: the scene and the phases, plots of the flight, a pilot's view, the wire."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from logs.views.motion import MotionHistory

TIMELINE = "sim_time"


def layout(m: MotionHistory) -> rrb.Blueprint:
    """3D and the phases on the left, plots on the right."""
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

    def plot(name: str, *entities: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            name=name, origin="/plots", contents=list(entities), plot_legend=rrb.PlotLegend(quiet)
        )

    plots = rrb.Grid(
        plot("payload position, reference grey [m, NED]", "/plots/position/**"),
        plot("payload velocity, reference grey [m/s, NED]", "/plots/velocity/**"),
        plot(f"thrust f_i [N], limit {min(m.model['max_thrust_N']):g} N", "/plots/thrust/**"),
        plot("tension at the load, smallest of all links grey [N]", "/plots/tension/**"),
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
    pilot = rrb.Grid(
        plot("height, up [m]", "/plots/height/**"),
        plot("load's distance to its target [m]", "/plots/distance/**"),
        plot("tilt [deg]", "/plots/tilt/**"),
        plot("separation of the two closest vehicles [m]", "/plots/separation/**"),
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
        rrb.TextDocumentView(name="key", origin="/key"),
        grid_columns=2,
        name="pilot",
    )
    phases = rrb.StateTimelineView(name="phases", origin="/", contents=["/phases/**", "/slack/**"])
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene, phases, row_shares=[5.0, 0.55 + 0.27 * (1 + len(m.model["n_links"]))]),
            rrb.Tabs(plots, pilot, wire),
            column_shares=[5, 6],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, playback_speed=1.0),
        collapse_panels=True,
    )
