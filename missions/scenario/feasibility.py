"""What can be said against a flight before it flies: why it cannot be flown, and which settings have no effect."""

import math
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from bridge.mission.scale import USUAL
from cablequad.control.design import TILT_DEG
from cablequad.control.formation import formation
from cablequad.control.trajectory import Trajectory, at
from cablequad.model import lie
from cablequad.model.attitude import Airframe
from cablequad.model.controllability import controllable
from cablequad.model.linear import Equilibrium, EquilibriumError, equilibrium, equilibrium_forces
from cablequad.model.state import State, positions
from cablequad.model.stiffness import LEAST_STEP_US
from cablequad.model.system import System
from cablequad.types import Array
from missions.scenario.flights import Flight
from missions.scenario.limits import plan_limits
from missions.scenario.surroundings import airborne, standing_places
from missions.scenario.tables import PlanTable, Scenario
from sitl.firmware.personas import PERSONAS

LOOKED_AT = 400  # instants of a plan
ON_ONE_TIMEOUT = 2.0  # setpoints that a vehicle must get within it
FREE_FALL = 0.05  # of gravity: the least that must be left to pull the load down
LEANS_DEG = 60.0  # of the paper's law, which has no limit of its own
STRAYS_M = 0.5  # of a load that follows its plan offline: further off it is not flown
SHOWN = 3  # of many alike


def obstacles(flight: Flight) -> list[str]:
    """Why a flight cannot be flown as it is described, one line each; empty where nothing is known against it.

    Static: what hangs at rest and along the plan within the vehicles' limits. No design is made, and nothing flown.
    """
    return [*_at_rest(flight), *_apart(flight), *_rates(flight)]


def strays(errors_m: Array) -> list[str]:
    """What an offline flight of the plan, with these distances from its reference (ticks,), says against it."""
    worst = float(np.nanmax(errors_m)) if np.isfinite(errors_m).any() else np.inf
    last = float(errors_m[-1]) if len(errors_m) else 0.0
    if np.isfinite(errors_m).all() and last <= STRAYS_M:
        return []
    far = f"{last:.2f} m from its plan in the end" if np.isfinite(last) else "nowhere that is finite"
    return [f"simulated without a wire the load is {far}, {worst:.2f} m at most: the loop does not hold this system"]


def _at_rest(flight: Flight) -> Iterator[str]:
    system, airframe = flight.system, flight.airframe
    if flight.physics_us < LEAST_STEP_US:
        yield (
            f"cable.link_lengths_m, cable.link_masses_kg: the stiffest link mode needs a physics step below "
            f"{LEAST_STEP_US} us; longer or heavier links are needed"
        )
        return
    try:
        hung = equilibrium(system)
    except EquilibriumError as error:
        yield str(error)
        return
    forces = equilibrium_forces(system, hung)
    share = -forces[:, 2] / airframe.max_thrust
    if (share > 1.0).any():
        i = int(np.argmax(share))
        yield (
            f"vehicle {i + 1} needs {100 * share[i]:.0f} % of its thrust to hold its part of the load: "
            f"{-forces[i, 2]:.1f} N, max_thrust_N = {airframe.max_thrust[i]:g}"
        )
        return
    pushed = [str(i + 1) for i in np.flatnonzero(hung.tension <= 0.0).tolist()]
    if pushed:
        yield f"cable {', '.join(pushed)} would have to push the load at rest; move its attachment_m"
        return
    missing = [motion for motion in controllable(system).missing if motion.startswith("cable")]
    if missing:
        lightest = float(np.where(system.length > 0, system.m_link, np.inf).min())
        heaviest = float(np.where(system.length > 0, system.m_link, 0.0).max())
        names = ", ".join(missing[:SHOWN]) + (" ..." if len(missing) > SHOWN else "")
        yield (
            f"cable.link_masses_kg: links from {1e3 * lightest:g} g to {1e3 * heaviest:g} g: the vehicles cannot move "
            f"{names}; masses nearer to each other are needed"
        )
        return
    yield from _along(flight, hung, forces)


def _along(flight: Flight, hung: Equilibrium, forces: Array) -> Iterator[str]:
    """The plan: the load and all cables in step with it, within what vehicles give."""
    law = flight.scenario.control.law
    for t, what in _worst(flight.system, flight.airframe, flight.trajectory, hung, forces, law):
        lap, g = flight.scenario.plan.lap_speed_m_s, flight.system.g
        speed, acceleration, *_ = plan_limits(flight.scenario)
        yield (
            f"plan: at t = {t:.1f} s {what}; speed_m_s = {speed:g}, acceleration_m_s2 = {acceleration:g} and "
            f"lap_speed_m_s = {lap:g} are more than gravity ({g:g} m/s^2) or thrust allow"
        )
        return


def _worst(
    system: System, airframe: Airframe, plan: Trajectory, hung: Equilibrium, forces: Array, law: str
) -> Iterator[tuple[float, str]]:
    hanging = State.hanging(system)._replace(R0=hung.R0).copy()
    leans_at_most = LEANS_DEG if law == "paper" else TILT_DEG
    for t in np.linspace(0.0, plan.duration, LOOKED_AT).tolist():
        r = at(plan, t)
        left = float(system.g - r.a0[2])
        if left < FREE_FALL * system.g:
            yield t, f"the load would have to be pushed down (its acceleration is {r.a0[2]:.2f} m/s^2)"
            continue
        leans = math.degrees(math.atan2(math.hypot(r.a0[0], r.a0[1]), left))
        if leans > leans_at_most:
            yield t, f"load, cables and vehicles would lean by {leans:.0f} deg, {leans_at_most:g} at most are flown"
            continue
        asked = np.linalg.norm(formation(system, hanging, forces, airframe, 0.0, r).u, axis=1)
        over = asked / airframe.max_thrust
        if (over > 1.0).any():
            i = int(np.argmax(over))
            yield t, f"vehicle {i + 1} would need {asked[i]:.1f} N of {airframe.max_thrust[i]:g} N"


def _apart(flight: Flight) -> Iterator[str]:
    """Vehicles that would be in one another: above a load that hangs, and on the ground."""
    s, system = flight.scenario, flight.system
    if len(s.vehicles) < 2:
        return
    try:
        R0 = equilibrium(system).R0
    except EquilibriumError:
        return
    at_rest = State.hanging(system)._replace(R0=R0)
    yield from _too_near(s, positions(system, at_rest.copy())[:, 0], "where the load hangs")
    if s.ground is not None and not airborne(s):
        flat = standing_places(s, s.ground, system.rho)
        yield from _too_near(s, np.column_stack([flat, np.zeros(len(flat))]), "on the ground")


def _too_near(s: Scenario, x: Array, where: str) -> Iterator[str]:
    rotors = s.vehicle.rotors
    least = USUAL.hit_m if rotors is None else 2.0 * rotors.arm_m
    pairs = [(float(np.linalg.norm(x[i] - x[k])), i + 1, k + 1) for i, k in combinations(range(len(x)), 2)]
    near = min(pairs)
    if near[0] < least:
        yield (
            f"vehicles {near[1]} and {near[2]} would be {near[0]:.2f} m apart {where}, and need {least:.2f} m; move "
            "their attachment_m or stands_m"
        )


def _rates(flight: Flight) -> Iterator[str]:
    s = flight.scenario
    for i, v in enumerate(s.vehicles):
        name, usual = PERSONAS[flight.firmware[i]].setpoint_timeout
        timeout = {**s.vehicle.parameters, **v.parameters}.get(name, usual)
        if timeout > 0.0 and flight.control_us * 1e-6 * ON_ONE_TIMEOUT > timeout:
            yield (
                f"control.rate_hz = {s.control.rate_hz:g}: vehicle {i + 1} ({flight.firmware[i]}) takes setpoints "
                f"{flight.control_us * 1e-6:g} s apart for a lost link ({name} = {timeout:g} s); at least "
                f"{ON_ONE_TIMEOUT / timeout:g} Hz is needed"
            )
            return


def misplaced(flight: Flight) -> Iterator[str]:
    """Places of the plan that are below the ground, or outside the fence of a mission, each with its key."""
    s, system = flight.scenario, flight.system
    if s.ground is None:
        return
    from missions.scenario.mission_setup import fence, standing  # here, as a mission is made of a flight

    stands = standing(flight)
    assert stands is not None
    try:
        R0 = equilibrium(system).R0
    except EquilibriumError:
        R0 = np.eye(3)
    box = fence(flight)
    lifted = stands.load_z - (s.mission.lift_m if s.mission is not None else 0.0)
    target = [*s.target.position_m[:2], lifted]
    p = s.plan
    places = [("target.position_m", target, s.target.yaw_deg)]
    if p.path == "waypoints":
        yaws = p.waypoint_yaws_deg or [0.0] * len(p.waypoints_m)
        places += [
            (f"plan.waypoints_m.{k}", x, yaw) for k, (x, yaw) in enumerate(zip(p.waypoints_m, yaws, strict=True))
        ]
    elif p.path != "target":
        t = flight.trajectory
        instants = np.linspace(0.0, t.duration, LOOKED_AT).tolist()
        places += [(f"plan ({p.path})", at(t, instant).x0.tolist(), 0.0) for instant in instants]
    hanging = State.hanging(system)
    for key, x, yaw in places:
        where = "({:g}, {:g}, {:g}) m".format(*x)
        if x[2] > stands.load_z + 1e-3 and key != "target.position_m":
            yield (
                f"{key}: {where} is below the ground: the load stands at z = {stands.load_z:.2f} m, and up is negative"
            )
            return
        turned = lie.exp(np.array([0.0, 0.0, np.radians(yaw)])) @ R0
        hung = hanging._replace(x0=np.array(x, dtype=float), R0=turned).copy()
        corners = np.vstack([hung.x0[None], positions(system, hung)[:, 0]])
        outside = float(np.maximum(box[0] - corners, corners - box[1]).max())
        if outside > 0.0:
            yield (
                f"{key}: at {where} the load or a vehicle above it is {outside:.1f} m outside the fence "
                f"({_corner(box[0])} to {_corner(box[1])}, mission.fence_m)"
            )
            return


def _corner(x: Array) -> str:
    return "({:g}, {:g}, {:g})".format(*x.tolist())


def without_effect(s: Scenario) -> list[str]:
    """Settings that change nothing in this scenario, one line each."""
    out = []
    if s.wind is not None and any(s.wind.mean_m_s) and not _drags(s):
        out.append("wind: it has no effect, as drag_area_m2 is 0 for payload, vehicles and cables")
    for k, failure in enumerate(s.failures):
        if failure.at_s >= s.duration_s:
            out.append(
                f"failures.{k}.at_s = {failure.at_s:g}: it never happens, as the flight ends at {s.duration_s:g} s"
            )
        if failure.kind == "gust" and not _drags(s):
            out.append(f"failures.{k}: a gust has no effect, as drag_area_m2 is 0 for payload, vehicles and cables")
    for k, cut in enumerate(s.faults.cuts):
        if cut.from_s >= s.duration_s:
            out.append(
                f"faults.cuts.{k}.from_s = {cut.from_s:g}: it never happens, as the flight ends at {s.duration_s:g} s"
            )
    used = _PATH_KEYS[s.plan.path]
    idle = sorted((s.plan.model_fields_set & set(_ALL_PATH_KEYS)) - used)
    if idle:
        out.append(f"plan.{', plan.'.join(idle)}: without effect where path = {s.plan.path!r}")
    if s.mission is None and s.control.law == "paper" and s.control.weights.model_fields_set & {"lasting"}:
        out.append("control.weights.lasting: without effect where law = 'paper', which has no integrals")
    if s.vehicle.battery is None and s.mission is not None and s.mission.guards.model_fields_set & {"battery"}:
        out.append("mission.guards.battery: without effect, as no vehicle.battery empties")
    if s.ground is not None and not airborne(s) and any(s.initial.velocity_m_s):
        out.append("initial.velocity_m_s: without effect, as a load that stands on the ground does not move")
    return out


_PATH_KEYS: dict[str, set[str]] = {
    "target": set(),
    "waypoints": {"waypoints_m", "waypoint_yaws_deg", "hold_s"},
    "circle": {"centre_m", "radius_m", "laps", "lap_speed_m_s"},
    "lemniscate": {"centre_m", "length_m", "width_m", "laps", "lap_speed_m_s"},
}
_ALL_PATH_KEYS = set.union(*_PATH_KEYS.values())
assert set(PlanTable.model_fields) >= _ALL_PATH_KEYS


def _drags(s: Scenario) -> bool:
    vehicles = [v.drag_area_m2 if v.drag_area_m2 is not None else s.vehicle.drag_area_m2 for v in s.vehicles]
    cables = [(v.cable or s.cable).drag_area_m2 for v in s.vehicles]
    return any((s.payload.drag_area_m2, *vehicles, *cables))
