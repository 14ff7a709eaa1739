"""A scenario's [mission] as the bridge takes it: plan, designs for every vehicle that may be lost, the usual script."""

import math

import numpy as np

from bridge.fleet.fleet import Fleet
from bridge.mission.members.members import Contingencies
from bridge.mission.mission import Mission, Script
from bridge.mission.phases import ORDER, Phase
from bridge.mission.plan import MissionPlan
from bridge.mission.protection.guards import Guard
from bridge.mission.scale import ARM_M, Scale, scale_of
from cablequad.control.design import Design, DesignError
from cablequad.control.estimator import Filter
from cablequad.control.trajectory import Trajectory
from cablequad.model.attitude import Airframe
from cablequad.model.linear import EquilibriumError, equilibrium
from cablequad.model.system import without
from missions.scenario import laws, routes
from missions.scenario.flights import Flight
from missions.scenario.limits import plan_limits
from missions.scenario.metrics import Grounded, Standing
from missions.scenario.script import script_from
from missions.scenario.surroundings import standing_places, standing_z

PULL = 0.9  # of a vehicle's greatest thrust: the most that a cable may bear where nothing is said


ON_THE_GROUND = (Phase.TAKE_OFF, Phase.TENSION)  # what a mission that begins in the air leaves out


async def usual(mission: Mission) -> None:
    """Every phase after the other."""
    for phase in ORDER:
        if not (mission.plan.airborne and phase in ON_THE_GROUND):
            await mission.begin(phase)
        if phase is Phase.LIFT:
            await mission.wait(mission.plan.hold_s)


def script_of(flight: Flight, waits: bool) -> Script:
    """What a flight's mission runs: its own script, or every phase after the other.

    `waits`: the vehicles' clock stands still while a script runs.
    """
    return usual if flight.script is None else script_from(flight.script, flight.script_name, waits)


def standing(flight: Flight) -> Standing | None:
    """Where load and vehicles stand on the ground; None without ground."""
    s = flight.scenario
    if s.ground is None:
        return None
    airborne = s.mission is not None and s.mission.start == "air"
    R0 = _hangs(flight) if airborne else flight.initial.R0
    return Standing(standing_z(s, s.ground, R0), s.ground.z_m - s.vehicle.feet_m[1], scale_of_flight(flight).hit_m)


def reported_figures(mission: Mission) -> Grounded | None:
    """A mission's figures as its vehicles and the tracker told them, where no simulator knows better."""
    where = mission.load_m
    if where is None:
        return None
    tension, separation = mission.figures.largest_tension_N, mission.figures.smallest_separation_m
    return Grounded(where, mission.figures.touch_down_m_s, tension, separation, None)


def _hangs(flight: Flight) -> np.ndarray:
    try:
        return np.asarray(equilibrium(flight.system).R0)
    except EquilibriumError:
        return np.eye(3)


def contingencies(flight: Flight, design: Design) -> Contingencies:
    """Designs and filters by the vehicles lost, at most one; who cannot be spared is not among them."""
    blur = laws.filter(flight)
    designs: dict[frozenset[int], Design] = {frozenset(): design}
    filters: dict[frozenset[int], Filter] = {} if blur is None else {frozenset(): blur}
    whole, s, law = flight.system, flight.scenario, laws.law_of(flight)
    n = len(whole.m)
    if n == 1 or s.mission is None or not s.mission.protect:
        return Contingencies(law, designs, filters)
    for i in range(n):
        rest = [k for k in range(n) if k != i]
        system = without(whole, [i])
        air = Airframe(*(np.ascontiguousarray(field[rest]) for field in flight.airframe))
        try:
            spared = laws.design_for(flight, system, air)
            seen = laws.estimator_for(flight, system, air) if blur is not None else None
        except (DesignError, EquilibriumError, np.linalg.LinAlgError):
            continue
        designs[frozenset({i})] = spared
        if seen is not None:
            filters[frozenset({i})] = seen.filter
    return Contingencies(law, designs, filters)


def scale_of_flight(flight: Flight) -> Scale:
    """What is near, slow or long for what flies."""
    s, system = flight.scenario, flight.system
    cables = [float(system.length[i, :k].sum()) for i, k in enumerate(system.n_links.tolist())]
    return scale_of(sum(cables) / len(cables), s.vehicle.rotors.arm_m if s.vehicle.rotors is not None else ARM_M)


def plan_of(flight: Flight) -> MissionPlan:
    """The mission plan of a flight with [mission]."""
    s = flight.scenario
    m, ground = s.mission, s.ground
    assert m is not None
    assert ground is not None
    places = standing(flight)
    assert places is not None
    rest = places.load_z
    flat = standing_places(s, ground, flight.system.rho)
    stands = np.column_stack([flat, np.full(len(flat), places.vehicle_z - rest)])
    hangs = _hangs(flight)
    lifted = rest - m.lift_m

    def route(start: list[float], end: list[float]) -> Trajectory:
        return routes.route(s, start, end)

    target = [*s.target.position_m[:2], lifted, math.radians(s.target.yaw_deg)]
    limits = {phase: m.limits_s[phase.value] for phase in Phase if phase.value in m.limits_s}
    scale = scale_of_flight(flight)
    return MissionPlan(
        rest, stands, hangs, target, route, plan_limits(s), m.lift_m, m.slack, m.pretension,
        m.lift_speed_m_s or scale.lift_m_s, m.set_down_speed_m_s or scale.set_down_m_s,
        m.take_off_speed_m_s or scale.take_off_m_s, limits, guards(flight), fence(flight), m.battery,
        m.hooks, m.protect, m.start == "air", m.hold_s, scale,
    )  # fmt: skip


def fence(flight: Flight) -> np.ndarray:
    """(2, 3) m: the lowest and the highest corner of where load and vehicles may be."""
    mission = flight.scenario.mission
    given = None if mission is None else mission.fence_m
    if given is not None:
        corners = np.array(given)
        return np.array([corners.min(axis=0), corners.max(axis=0)])
    ground = flight.scenario.ground
    assert ground is not None
    (x, y, _), scale = flight.scenario.initial.position_m, scale_of_flight(flight)
    around, up = scale.around_m, scale.above_m
    return np.array([[x - around, y - around, ground.z_m - up], [x + around, y + around, ground.z_m + 1.0]])


def guards(flight: Flight) -> tuple[Guard, ...]:
    """The guards of a mission, each with what is done where it is broken."""
    m = flight.scenario.mission
    assert m is not None
    g, scale = m.guards, scale_of_flight(flight)
    separation = scale.separation_m if g.separation_m is None else g.separation_m
    weight = flight.system.m * flight.system.g
    tension = g.tension_N if g.tension_N is not None else PULL * float((flight.airframe.max_thrust - weight).min())
    return (
        Guard("tension_N", tension, "set-down", 0.2),
        Guard("separation_m", separation, "set-down", 0.1),
        Guard("tilt_deg", g.tilt_deg, "pause", 0.3),
        Guard("load_tilt_deg", g.load_tilt_deg, "set-down", 1.0),
        Guard("outside_fence_m", g.outside_fence_m, "set-down", 0.2),
        Guard("thrust_reserve", g.thrust_reserve, "pause", 0.3),
        Guard("state_age_s", g.state_age_s, "pause", 0.0),
        Guard("off_plan_m", g.off_plan_m or scale.off_plan_m, "pause", 0.1),
        Guard("battery", g.battery, "set-down", 1.0),
    )


def mission_of(flight: Flight, fleet: Fleet, design: Design, script: Script = usual) -> Mission:
    """The mission of a flight, ready to be flown."""
    plan = plan_of(flight)
    planned = contingencies(flight, design)
    if not plan.protect:  # nothing finds out what lasts, either
        blind = {lost: d._replace(integrated=0.0 * d.integrated) for lost, d in planned.designs.items()}
        planned = planned._replace(designs=blind)
    return Mission(plan, fleet, planned, flight.control_us * 1e-6, script)
