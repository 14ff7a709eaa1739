"""What surrounds a scenario's system, and where things stand on its ground."""

import numpy as np

from cablequad.environment.air import Air
from cablequad.environment.ground import box_corners
from cablequad.environment.rotors import Rotors
from cablequad.model import lie
from cablequad.model.attitude import Airframe
from cablequad.model.state import State
from cablequad.model.system import System
from missions.scenario.tables import GroundTable, RotorsTable, Scenario
from sitl.parts import Surroundings

AIR_KG_M3 = 1.225


def around(s: Scenario, system: System, airframe: Airframe, areas: list[float]) -> Surroundings:
    """What a plant has around it."""
    n, r = len(s.vehicles), s.vehicle.rotors
    rotors = None
    if r is not None or s.failures:
        r = r or RotorsTable(time_constant_s=0.0)
        arm, drag, time = np.full(n, r.arm_m), np.full(n, r.drag_torque_m), np.full(n, r.time_constant_s)
        rotors = Rotors(arm, drag, time, airframe.max_thrust / 4.0, np.ones((n, 4)))
    gusts = any(f.kind == "gust" for f in s.failures)
    air = None if s.wind is None and not gusts else _air(s, system, areas)
    half, high = s.vehicle.feet_m
    feet = np.array([(a, b, high) for a in (-half, half) for b in (-half, half)])
    x, y, z = s.payload.box_m
    return Surroundings(
        air, rotors, None if s.ground is None else s.ground.z_m, 0.0 if s.ground is None else s.ground.friction,
        box_corners((x, y, z)), feet, s.payload.downwash, airborne(s),
    )  # fmt: skip


def airborne(s: Scenario) -> bool:
    """Whether a mission begins with a load that hangs."""
    return s.mission is not None and s.mission.start == "air"


def standing_places(s: Scenario, ground: GroundTable, rho: np.ndarray) -> np.ndarray:
    """(n, 2) m: where vehicles stand around the load, in its frame."""
    out = np.empty((len(rho), 2))
    for i, v in enumerate(s.vehicles):
        size = float(np.linalg.norm(rho[i, :2]))
        away = rho[i, :2] / size if size > 1e-6 else np.array([1.0, 0.0])
        out[i] = rho[i, :2] + ground.stand_off_m * away if v.stands_m is None else v.stands_m
    return out


def standing_z(s: Scenario, ground: GroundTable, R0: np.ndarray) -> float:
    """m: the load's z where it stands on the ground with attitude R0."""
    x, y, z = s.payload.box_m
    return ground.z_m - float((box_corners((x, y, z)) @ R0.T)[:, 2].max())


def lay_out(s: Scenario, ground: GroundTable, system: System, initial: State) -> None:
    """Vehicles stand beside the load; cables bulge sideways in the air from one to the other, and fall when it begins.

    Raises ValueError where the load is not on the ground or a cable is too short.
    """
    rest = standing_z(s, ground, initial.R0)
    if abs(initial.x0[2] - rest) > 0.01:
        raise ValueError(
            f"initial.position_m: z = {initial.x0[2]:g} given; a load that stands on the ground at {ground.z_m:g} m "
            f"is at {rest:.3f} m"
        )
    places = standing_places(s, ground, system.rho)
    for i, v in enumerate(s.vehicles):
        if v.initial_link_directions is not None:
            continue
        k = int(system.n_links[i])
        end = initial.x0 + initial.R0 @ system.rho[i]
        at = initial.x0 + initial.R0 @ np.array([*places[i], 0.0])
        at[2] = ground.z_m - s.vehicle.feet_m[1]
        way = end - at
        long, far = float(system.length[i, :k].sum()), float(np.linalg.norm(way))
        if far > 0.98 * long:
            raise ValueError(
                f"vehicles.{i}: it stands {far:.2f} m from where its cable is tied; the cable is {long:.2f} m long"
            )
        initial.q[i, :k] = slack_chain(system.length[i, :k], way)


def slack_chain(lengths: np.ndarray, way: np.ndarray) -> np.ndarray:
    """(k, 3) directions of links that lead along `way` (3,) m, shorter than they are: an even bow to the side."""
    far = float(np.linalg.norm(way))
    along = way / far
    side = np.cross([0.0, 0.0, 1.0], along)
    side = side / np.linalg.norm(side) if np.linalg.norm(side) > 1e-6 else np.array([0.0, 1.0, 0.0])
    middle = (np.cumsum(lengths) - 0.5 * lengths) / lengths.sum() - 0.5

    def bow(turn: float) -> np.ndarray:
        angle = turn * middle
        return np.outer(np.cos(angle), along) + np.outer(np.sin(angle), side)

    def excess(turn: float) -> float:
        return float(np.linalg.norm(lengths @ bow(turn))) - far

    if len(lengths) == 1:
        return bow(0.0)
    from scipy import optimize  # here, as it takes longer to load than to use

    q = bow(float(optimize.brentq(excess, 0.0, 2 * np.pi)))
    ends = lengths @ q
    turned = lie.exp(lie.direction_to(ends / np.linalg.norm(ends), along))
    return q @ turned.T


def _air(s: Scenario, system: System, vehicles: list[float]) -> Air:
    links = np.zeros(system.length.shape)
    for i, cable in enumerate(v.cable or s.cable for v in s.vehicles):
        lengths = np.array(cable.link_lengths_m)
        links[i, : len(lengths)] = cable.drag_area_m2 * lengths / lengths.sum()
    density = s.wind.air_density_kg_m3 if s.wind is not None else AIR_KG_M3
    return Air(density, s.payload.drag_area_m2, np.array(vehicles), links)
