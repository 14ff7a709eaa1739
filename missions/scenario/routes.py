"""The way of the load, by [initial], [plan] and [target]."""

import math

import numpy as np

from cablequad.control.trajectory import Trajectory, along, at, circle, joined, leg, lemniscate, waypoints
from cablequad.model.linear import EquilibriumError, equilibrium
from cablequad.model.state import State
from cablequad.model.system import System
from missions.scenario.limits import plan_limits
from missions.scenario.tables import Scenario


def route(s: Scenario, start: list[float], end: list[float]) -> Trajectory:
    """From x, y, z (m) and yaw (rad) to such a place by what [plan] says."""
    p = s.plan
    at_most = plan_limits(s)
    if p.path == "target":
        return leg(start, end, at_most)
    if p.path == "waypoints":
        yaws = p.waypoint_yaws_deg or [0.0] * len(p.waypoints_m)
        between = [[*x, math.radians(yaw)] for x, yaw in zip(p.waypoints_m, yaws, strict=True)]
        return waypoints([start, *between, end], at_most, p.hold_s)
    if p.path == "circle":
        curve = circle(p.centre_m or [], p.radius_m or 0.0)
    else:
        curve = lemniscate(p.centre_m or [], p.length_m or 0.0, p.width_m or 0.0)
    laps = along(curve, p.laps, p.lap_speed_m_s, at_most)
    first, last = at(laps, 0.0), at(laps, laps.duration)
    return joined([leg(start, first.x0, at_most), laps, leg(last.x0, end, at_most)])


def start_of(s: Scenario, initial: State, system: System) -> list[float]:
    """Where the load begins (m) and how it is yawed from how it hangs (rad)."""
    turned = initial.R0 @ hanging_attitude(system).T
    return [*s.initial.position_m, math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])]


def trajectory_of(s: Scenario, system: System, initial: State) -> Trajectory:
    """From where the load begins, by what [plan] says, to the target."""
    return route(s, start_of(s, initial, system), [*s.target.position_m, math.radians(s.target.yaw_deg)])


def hanging_attitude(system: System) -> np.ndarray:
    """The attitude of the load at rest; level where there is none, which the design then says."""
    try:
        return equilibrium(system).R0
    except EquilibriumError:
        return np.eye(3)
