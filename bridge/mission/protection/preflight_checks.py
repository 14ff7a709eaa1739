"""What keeps a mission on the ground."""

import numpy as np

from bridge.fleet.fleet import Fleet
from bridge.mission.members.cable_geometry import CableGeometry
from bridge.mission.observation import Observation
from bridge.mission.plan import MissionPlan


def preflight_faults(i: Observation, geometry: CableGeometry, plan: MissionPlan, fleet: Fleet) -> list[str]:
    """What the preflight checks find wrong, one line each."""
    silent = np.flatnonzero(~np.isfinite(i.x[:, 0])).tolist()
    if silent:
        return [f"vehicle {k + 1} tells no position" for k in silent]
    far, long = np.linalg.norm(i.x - geometry.ends(i.state), axis=1), geometry.length
    out = [
        f"vehicle {k + 1} is {far[k]:.2f} m from its end of the cable, which is {long[k]:.2f} m long"
        for k in np.flatnonzero(far > long + plan.scale.near_m).tolist()
    ]
    if not plan.airborne and abs(float(i.state.x0[2]) - plan.rest_z) > plan.scale.near_m:
        out.append(f"the load is at z = {i.state.x0[2]:.2f} m, not on the ground ({plan.rest_z:.2f} m)")
    out += [
        f"vehicle {k + 1} has {100 * level:.0f} % of its battery, {100 * plan.battery:.0f} % is needed"
        for k, level in enumerate(fleet.batteries)
        if level < plan.battery
    ]
    return out + fleet.not_ready()
