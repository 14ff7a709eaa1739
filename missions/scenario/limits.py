"""How fast a load is carried: what [plan] states, and what gravity, thrust and cables allow where it states nothing."""

import math

from cablequad.control.trajectory import Limits
from missions.scenario.tables import Scenario

USUAL_CABLE_M, USUAL_GRAVITY = 0.75, 9.81
RESERVE = 0.9  # of the greatest thrust, for the way up
SLOWEST = 0.02  # of gravity: what is left where hovering takes nearly all


def plan_limits(s: Scenario) -> Limits:
    """Of speed, acceleration, jerk and yaw rate.

    An acceleration that is left out is a share of gravity, as load and cables lean by the same angle anywhere, and no
    more than the thrust that hovering leaves gives upwards. Jerk and yaw rate are slower for cables beyond 0.75 m, as
    their pendulum is.
    """
    p, usual = s.plan, Limits()
    acceleration = p.acceleration_m_s2
    if acceleration is None:
        leans = usual.acceleration * s.gravity_m_s2 / USUAL_GRAVITY
        hover = _hover(s)
        rises = s.gravity_m_s2 * max(RESERVE / hover - 1.0, SLOWEST)
        acceleration = min(leans, rises) if hover < 1.0 else leans  # one that cannot hover is refused as that
    lengths = [sum((v.cable or s.cable).link_lengths_m) for v in s.vehicles]
    slower = math.sqrt(max(1.0, sum(lengths) / len(lengths) / USUAL_CABLE_M))
    jerk = usual.jerk * acceleration / usual.acceleration / slower if p.jerk_m_s3 is None else p.jerk_m_s3
    yaw_rate = usual.yaw_rate / slower if p.yaw_rate_deg_s is None else math.radians(p.yaw_rate_deg_s)
    return Limits(p.speed_m_s, acceleration, jerk, yaw_rate)


def _hover(s: Scenario) -> float:
    """The greatest share of its thrust that a vehicle hovers with, if each bears an equal part of the load."""
    part = s.payload.mass_kg / len(s.vehicles)
    shares = []
    for v in s.vehicles:
        mass = s.vehicle.mass_kg if v.mass_kg is None else v.mass_kg
        thrust = s.vehicle.max_thrust_N if v.max_thrust_N is None else v.max_thrust_N
        hangs = part + sum((v.cable or s.cable).link_masses_kg)
        shares.append((mass + hangs) * s.gravity_m_s2 / (thrust * s.vehicle.air_density_ratio))
    return max(shares)
