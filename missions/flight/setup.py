"""What a flight needs and no clock has to wait for: fleet, decider, and what the observer is told of the loop."""

from collections.abc import Mapping
from typing import NamedTuple

from bridge.fleet.fleet import Fleet, FleetOptions
from bridge.loop.deciders import Decider, MissionDecider, Plan, PlanDecider
from bridge.loop.state_assembly import LoopModel
from bridge.mission.mission import Mission, Script
from cablequad.control.design import Design
from cablequad.control.trajectory import at
from missions.scenario import laws
from missions.scenario.flights import Flight
from missions.scenario.mission_setup import mission_of, script_of


class FlightSetup(NamedTuple):
    """Made before any clock runs."""

    fleet: Fleet
    decider: Decider
    loop: LoopModel
    mission: Mission | None


def set_up(
    flight: Flight, design: Design, configure: bool, waits: bool = True,
    expected: tuple[Mapping[str, float], ...] = (), script: Script | None = None,
) -> FlightSetup:  # fmt: skip
    """What flies the flight; `configure`: parameters that a vehicle needs to be flown are set.

    `waits`: the vehicles' clock waits for the controller, and so for a script. `expected`: parameters that each vehicle
    was started with, to be read back. `script`: what flies a mission, instead of the flight's own.
    """
    s, loop = flight.scenario, loop_of(flight)
    grounded, airborne = s.mission is not None, s.mission is not None and s.mission.start == "air"
    period_s, sensing = flight.control_us * 1e-6, s.control.sensing
    options = FleetOptions(
        configure, sensing, grounded, airborne, s.vehicle.air_density_ratio, s.control.attitude_rate, expected
    )
    fleet = Fleet(flight.airframe.max_thrust.tolist(), period_s, options)
    if not grounded:
        plan = Plan(lambda t: at(flight.trajectory, t), s.duration_s, flight.trajectory.duration)
        return FlightSetup(fleet, PlanDecider(plan, fleet, loop, laws.law_of(flight), design), loop, None)
    mission = mission_of(flight, fleet, design, script or script_of(flight, waits))
    return FlightSetup(fleet, MissionDecider(mission, loop, design), loop, mission)


def loop_of(flight: Flight) -> LoopModel:
    """What the observer of a flight is told of its loop."""
    c = flight.scenario.control
    period_ms = flight.control_us // 1000
    return LoopModel(
        flight.system, flight.airframe, period_ms, c.delay_ticks * period_ms, flight.physics_us * 1e-6,
        laws.filter(flight), c.sensing, c.attitude_rate,
    )  # fmt: skip
