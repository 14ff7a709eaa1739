"""What real autopilots are known to do, and flights with that in place of what scenarios suppose of vehicles."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cablequad.model.earth import Home, density_ratio
from cablequad.model.linear import EquilibriumError, equilibrium, equilibrium_forces
from cablequad.model.system import System
from cablequad.types import Array
from missions.scenario.flights import Flight, flight_of, known_delay_ticks
from missions.scenario.tables import Scenario
from sitl.firmware.personas import PERSONAS

ATTITUDE_BYTES = 60  # of a frame
ATTITUDE_SHARE = 0.5  # of a link's bandwidth, at most


def behind(flight: Flight, firmware: Sequence[str]) -> Flight:
    """The flight as it is flown by real autopilots, `firmware` of each vehicle, with a note for every change.

    The law is designed for the response that they are known to have, or for what `cablequad identify` found and wrote
    into the scenario; rotors turn in the air of the vehicles' home; what acceptance supposes of perfect sensors is
    widened by what their estimators are known to do.
    """
    s = flight.scenario
    notes: list[str] = []
    table: dict[str, Any] = s.model_dump(mode="json")
    ratio = s.vehicle.air_density_ratio
    if "air_density_ratio" not in s.vehicle.model_fields_set:
        ratio = table["vehicle"]["air_density_ratio"] = round(density_ratio(Home().altitude_m), 4)
        notes.append(
            f"the air at {Home().altitude_m:g} m is {ratio:g} as dense as at sea level; rotors give as much less"
        )
    if not s.vehicle.identified:
        _respond(flight, firmware, table, notes)
    rate = s.control.attitude_rate
    if "attitude_rate" not in s.control.model_fields_set:
        rate = table["control"]["attitude_rate"] = attitude_rate(flight, firmware)
        if rate > 1:
            notes.append(f"attitudes are asked for at {rate * s.control.rate_hz:g} Hz (control.attitude_rate = {rate})")
    off = wandering(flight.system, firmware)
    more_of = {"e_q": float(off.sum()), "link_error_deg": math.degrees(math.sqrt(float(np.mean(off**2))))}
    for key, more in more_of.items():
        allowed = getattr(s.acceptance, key)
        if allowed is not None and more > 0.05 * allowed:
            table["acceptance"][key] = round(allowed + more, 3)
            worst = max((PERSONAS[kind].known for kind in firmware), key=lambda k: k.wander_deg)
            notes.append(
                f"acceptance.{key}: {allowed:g} becomes {allowed + more:.3g}, as {worst.name}'s attitude wanders "
                f"{worst.wander_deg:g} deg"
            )
    flown = flight_of(Scenario.model_validate(table), flight.source, external=True)
    return flown._replace(
        trajectory=flight.trajectory, script=flight.script, script_name=flight.script_name,
        notes=[*flight.notes, *notes],
    )  # fmt: skip


def _respond(flight: Flight, firmware: Sequence[str], table: dict[str, Any], notes: list[str]) -> None:
    """Put the known responses into a scenario's table."""
    air, rotors = flight.airframe, flight.scenario.vehicle.rotors
    lag_s = 0.0 if rotors is None else rotors.time_constant_s
    said = set()
    for i, kind in enumerate(firmware):
        known, own = PERSONAS[kind].known, table["vehicles"][i]
        own["attitude_bandwidth_rad_s"], own["attitude_damping"] = known.bandwidth_rad_s, known.damping
        if known.name not in said:
            said.add(known.name)
            notes.append(
                f"{known.name} is known to answer at {known.bandwidth_rad_s:g} rad/s, damping {known.damping:g}, after "
                f"{1e3 * (known.own_delay_s + lag_s):g} ms: the law is designed for that, not for "
                f"{float(air.bandwidth[i]):g} rad/s, damping {float(air.damping[i]):g} (cablequad identify finds yours)"
            )
    table["control"]["delay_ticks"] = max(known_delay_ticks(flight.scenario, kind) for kind in firmware)
    if flight.scenario.control.law == "paper":
        table["control"]["law"] = "sampled"
        notes.append("control.law: the paper's supposes that attitudes answer at once; 'sampled' is flown")


def attitude_rate(flight: Flight, firmware: Sequence[str]) -> int:
    """How many attitudes a control period are asked for: as many as the autopilots send and the links bear."""
    fastest_us = max(PERSONAS[kind].known.fastest_attitude_us for kind in firmware)
    for faults in flight.faults_down[:-1]:
        if faults.rate_bytes_s > 0.0:
            fastest_us = max(fastest_us, math.ceil(1e6 * ATTITUDE_BYTES / (ATTITUDE_SHARE * faults.rate_bytes_s)))
    rate = flight.control_us // fastest_us
    return max((k for k in range(1, max(1, rate) + 1) if flight.control_us % (1000 * k) == 0), default=1)


def wandering(system: System, firmware: Sequence[str]) -> Array:
    """(links of all cables,): what attitudes that wander add to |q - q_d| of each, where the load hangs at rest.

    A thrust of u N that is d rad off leans its cable by u d / T, T N its mean tension; 0 where nothing hangs at rest.
    """
    try:
        hung = equilibrium(system)
    except EquilibriumError:
        return np.zeros(int(system.n_links.sum()))
    forces = np.linalg.norm(equilibrium_forces(system, hung), axis=1)
    off = []
    for i, kind in enumerate(firmware):
        links = int(system.n_links[i])
        tension = float(hung.tension[i]) + 0.5 * float(system.m_link[i, :links].sum()) * system.g
        leaning = float(forces[i]) / max(tension, 1e-9) * math.radians(PERSONAS[kind].known.wander_deg)
        off += [leaning] * links
    return np.array(off)
