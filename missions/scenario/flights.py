"""A validated scenario -> a flight: the system, its vehicles, what really flies, where it begins, steps and links."""

from typing import Any, NamedTuple

import numpy as np

from bridge.wire.link_faults import Faults
from cablequad.control.trajectory import Trajectory
from cablequad.model import lie
from cablequad.model.attitude import Airframe
from cablequad.model.state import State
from cablequad.model.stiffness import STABLE, stable_substep
from cablequad.model.system import Cable, Payload, Quadrotor, System, box_inertia
from missions.scenario.routes import hanging_attitude, trajectory_of
from missions.scenario.surroundings import airborne, around, lay_out
from missions.scenario.tables import FaultTable, OneVehicleTable, Scenario
from sitl.firmware.personas import PERSONAS
from sitl.parts import Surroundings
from sitl.wind import Weather


class ScenarioError(Exception):
    """A scenario that cannot be flown; the message names the key, its value and what is allowed."""


class ActualPlant(NamedTuple):
    """What flies, where it differs from what the controller is told."""

    system: System
    airframe: Airframe
    thrust_scale: tuple[float, ...]  # N made per N asked
    around: Surroundings
    weather: Weather | None


class Flight(NamedTuple):
    """A scenario as values that the other rooms take."""

    scenario: Scenario
    source: str  # the file's text
    system: System  # as the controller is told
    airframe: Airframe
    world: ActualPlant
    trajectory: Trajectory
    initial: State
    control_us: int
    physics_us: int
    tick_us: int
    truth_us: int
    notes: list[str]  # what was chosen that the file does not say
    firmware: tuple[str, ...]  # the persona of each vehicle
    faults_up: tuple[Faults, ...]  # of what each vehicle receives
    faults_down: tuple[Faults, ...]  # of what each vehicle sends, and then of what the tracker sends
    script: str | None = None  # the text of the mission script that gave the trajectory, or that flies the mission
    script_name: str = "mission.py"  # its file's name

    def __repr__(self) -> str:
        s = self.scenario
        return f"Flight({s.name}: {s.description} {self.system}, {s.duration_s:g} s at most)"


STATED_DAMPING = 0.9  # of a response whose bandwidth alone is stated

TICK_US = 4000  # the vehicles speak at 250 Hz, or as often as control asks


def flight_of(s: Scenario, source: str, external: bool = False) -> Flight:
    """The flight that a scenario describes. Raises ValueError naming the key that cannot be.

    `external`: its vehicles are not ours, and may have any parameter.
    """
    s = _as_known(s)
    system, airframe = system_of(s), _airframe(s)
    initial = _initial(s, system)
    if not external:
        _preset(s)
    steps, notes = _steps(s, system, airframe)
    down, up = _faults(s)
    world = _world(s, system, airframe)
    firmware, way = tuple(_of(s, v, "firmware") for v in s.vehicles), trajectory_of(s, system, initial)
    return Flight(s, source, system, airframe, world, way, initial, *steps, notes, firmware, up, down)


def system_of(s: Scenario, heavier: float = 1.0) -> System:
    """The system that a scenario describes, with a load of `heavier` times the mass and inertia."""
    inertia = heavier * np.asarray(s.payload.inertia_kg_m2 or box_inertia(s.payload.mass_kg, s.payload.box_m))
    payload = Payload(heavier * s.payload.mass_kg, inertia, [v.attachment_m for v in s.vehicles])
    quadrotors = [Quadrotor(_of(s, v, "mass_kg"), _of(s, v, "inertia_kg_m2")) for v in s.vehicles]
    cables = [v.cable or s.cable for v in s.vehicles]
    chains = [Cable(c.link_masses_kg, c.link_lengths_m) for c in cables]
    return System.of(payload, quadrotors, chains, s.gravity_m_s2)


def rotation_deg(roll_pitch_yaw: list[float]) -> np.ndarray:
    """R_z(yaw) R_y(pitch) R_x(roll), (3, 3), from degrees."""
    roll, pitch, yaw = np.radians(roll_pitch_yaw)
    e = np.eye(3)
    return lie.exp(yaw * e[2]) @ lie.exp(pitch * e[1]) @ lie.exp(roll * e[0])


def parameters_of(s: Scenario, i: int) -> dict[str, float]:
    """What the scenario sets of vehicle i's (from 0) parameters, by name."""
    return {name: float(value) for name, value in {**s.vehicle.parameters, **s.vehicles[i].parameters}.items()}


def response(s: Scenario, i: int) -> tuple[float, float]:
    """Bandwidth (rad/s) and damping of vehicle i's (from 0) attitude response: stated, or as its firmware is known."""
    v = s.vehicles[i]
    bandwidth, damping = _of(s, v, "attitude_bandwidth_rad_s"), _of(s, v, "attitude_damping")
    known = PERSONAS[_of(s, v, "firmware")].known
    if bandwidth is None:
        return known.bandwidth_rad_s, known.damping if damping is None else damping
    return bandwidth, STATED_DAMPING if damping is None else damping


def known_delay_ticks(s: Scenario, firmware: str) -> int:
    """The delay that a law is designed for: the known one, with as much of the rotors' lag as the scenario's have."""
    lag = 0.0 if s.vehicle.rotors is None else s.vehicle.rotors.time_constant_s
    known = PERSONAS[firmware].known
    return max(1, round((known.own_delay_s + lag) * s.control.rate_hz))


def delays_us(flight: Flight) -> tuple[int, ...]:
    """From a state to the effect of the setpoint that answers it, for each vehicle, in whole ticks."""
    s, out = flight.scenario, []
    for v in s.vehicles:
        wish = s.vehicle.delay_ms
        if wish is None and _of(s, v, "attitude_bandwidth_rad_s") is None:
            wish = 1e3 * PERSONAS[_of(s, v, "firmware")].known.own_delay_s  # its rotors are in the plant
        ticks = None if wish is None else max(1, round(1e3 * wish / flight.tick_us))
        out.append(s.control.delay_ticks * flight.control_us if ticks is None else ticks * flight.tick_us)
    return tuple(out)


def phases_us(flight: Flight) -> tuple[int, ...]:
    """When each vehicle's streams are due beyond whole intervals, in whole ticks."""
    s, out = flight.scenario, []
    for v in s.vehicles:
        wish = s.vehicle.stream_phase_ms
        if wish is None:
            unstated = _of(s, v, "attitude_bandwidth_rad_s") is None
            wish = PERSONAS[_of(s, v, "firmware")].known.phase_ms if unstated else 0.0
        out.append(round(1e3 * wish / flight.tick_us) * flight.tick_us)
    return tuple(out)


def _of(s: Scenario, vehicle: OneVehicleTable, key: str) -> Any:
    """A vehicle's own value of a key, or what all have in common."""
    own = getattr(vehicle, key)
    return getattr(s.vehicle, key) if own is None else own


def _as_known(s: Scenario) -> Scenario:
    """What is left out of vehicles that state no response, by what their firmware is known to do."""
    unstated = {_of(s, v, "firmware") for v in s.vehicles if _of(s, v, "attitude_bandwidth_rad_s") is None}
    if not unstated:
        return s
    changes: dict[str, Any] = {}
    if "delay_ticks" not in s.control.model_fields_set:
        ticks = max(known_delay_ticks(s, kind) for kind in unstated)
        changes["control"] = s.control.model_copy(update={"delay_ticks": ticks})
    worst = max((PERSONAS[kind].known for kind in unstated), key=lambda k: k.bias_deg)
    errors = {
        "attitude_bias_deg": worst.bias_deg, "position_offset_m": list(worst.position_offset_m),
        "attitude_offset_deg": list(worst.attitude_offset_deg),
    }  # fmt: skip
    left_out = {key: value for key, value in errors.items() if key not in s.sensors.model_fields_set}
    if left_out:
        changes["sensors"] = s.sensors.model_copy(update=left_out)
    return s.model_copy(update=changes)


def _preset(s: Scenario) -> None:
    """Raise ValueError where a built-in vehicle has no such parameter, or cannot take its value."""
    for i, v in enumerate(s.vehicles):
        table = PERSONAS[_of(s, v, "firmware")].parameters(i + 1, 0.5)
        for name, value in parameters_of(s, i).items():
            table.preset(name, value)


def _airframe(s: Scenario) -> Airframe:
    """How the vehicles answer, as the controller is told."""
    answers = [response(s, i) for i in range(len(s.vehicles))]
    return Airframe(
        np.array([bandwidth for bandwidth, *_ in answers], dtype=float),
        np.array([damping for _, damping, *_ in answers], dtype=float),
        np.array([_of(s, v, "max_thrust_N") for v in s.vehicles], dtype=float) * s.vehicle.air_density_ratio,
    )


def _initial(s: Scenario, system: System) -> State:
    """Where everything is at first."""
    initial = State.hanging(system, (0.0, 0.0, 0.0))._replace(
        x0=np.array(s.initial.position_m),
        v0=np.array(s.initial.velocity_m_s),
        R0=hanging_attitude(system) if s.initial.attitude_deg is None else rotation_deg(s.initial.attitude_deg),
        R=np.stack([rotation_deg(v.initial_attitude_deg) for v in s.vehicles]),
    )
    for i, v in enumerate(s.vehicles):
        if v.initial_link_directions is not None:
            q = np.array(v.initial_link_directions)
            initial.q[i, : len(q)] = q / np.linalg.norm(q, axis=1, keepdims=True)
    if s.ground is not None and not airborne(s):
        lay_out(s, s.ground, system, initial)
    return initial.copy()  # arrays of one layout, as compiled code is compiled for each


def _steps(s: Scenario, system: System, airframe: Airframe) -> tuple[tuple[int, int, int, int], list[str]]:
    """Microseconds of control, physics, a tick and truth, and what was chosen that the file does not say."""
    control_us = round(1e6 / s.control.rate_hz)
    tick_us = TICK_US if control_us % TICK_US == 0 else control_us
    asked_us = round(1e6 / s.physics.rate_hz)
    physics_us = stable_substep(system, asked_us, tick_us)
    truth_us = _truth_us(s, physics_us, tick_us)
    stiff = f"physics step {physics_us} us instead of {asked_us} us: the stiffest link mode needs it"
    notes = [stiff] if physics_us != asked_us else []
    chains = [(v.cable or s.cable).link_masses_kg for v in s.vehicles]
    lighter = {flown for i, c in enumerate(chains) for m, flown in zip(c, system.m_link[i], strict=False) if m < flown}
    if lighter:
        notes.append(f"links lighter than {1e3 * max(lighter):.2g} g are flown as that: as good as without mass")
    fastest = float(airframe.bandwidth.max())
    if fastest * physics_us * 1e-6 > STABLE:
        raise ValueError(
            f"attitude_bandwidth_rad_s: {fastest:g} given; with a physics step of {physics_us} us at most "
            f"{STABLE / (physics_us * 1e-6):g} can be simulated"
        )
    return (control_us, physics_us, tick_us, truth_us), notes


def _world(s: Scenario, system: System, airframe: Airframe) -> ActualPlant:
    """What flies."""
    heavier = 1.0 if s.real.payload_mass_kg is None else s.real.payload_mass_kg / s.payload.mass_kg
    scale = s.real.thrust_scale
    return ActualPlant(
        system_of(s, heavier),
        _really(airframe, s),
        tuple(scale) if isinstance(scale, list) else (scale,) * len(s.vehicles),
        around(s, system, airframe, [_of(s, v, "drag_area_m2") for v in s.vehicles]),
        None if s.wind is None else Weather(np.array(s.wind.mean_m_s), s.wind.gusts, s.wind.height_m),
    )


def _really(airframe: Airframe, s: Scenario) -> Airframe:
    """The vehicles that really fly, where [real] says that they answer otherwise than the controller is told."""
    n, bandwidth, damping = len(s.vehicles), s.real.attitude_bandwidth_rad_s, s.real.attitude_damping
    if bandwidth is not None:
        airframe = airframe._replace(bandwidth=np.full(n, bandwidth))
    return airframe if damping is None else airframe._replace(damping=np.full(n, damping))


def _truth_us(s: Scenario, physics_us: int, tick_us: int) -> int:
    """How often truth is told between ticks: whole physics steps, a whole number of times a tick."""
    if s.record.truth_rate_hz is None:
        return tick_us
    asked = 1e6 / s.record.truth_rate_hz
    if abs(asked - round(asked)) > 1e-6 or tick_us % round(asked) or round(asked) % physics_us:
        raise ValueError(
            f"record.truth_rate_hz: {s.record.truth_rate_hz:g} given; it must be {1e6 / tick_us:g} or a whole multiple "
            f"of it that divides the physics rate ({1e6 / physics_us:g})"
        )
    return round(asked)


def _faults(s: Scenario) -> tuple[tuple[Faults, ...], tuple[Faults, ...]]:
    """What each vehicle's link and the tracker's do (down), and what each vehicle's does the other way (up)."""
    own = {entry.vehicle: entry for entry in s.faults.vehicles}

    def of(table: FaultTable, number: int, direction: str) -> Faults:
        cuts = tuple(
            (round(c.from_s * 1e6), round(c.to_s * 1e6))
            for c in s.faults.cuts
            if c.vehicle in (None, number) and c.direction in (direction, "both")
        )
        return Faults(
            round(table.delay_ms * 1e3), round(table.jitter_ms * 1e3), table.loss, table.burst_loss,
            table.burst_frames, table.duplicate, table.reorder, table.rate_bytes_s, cuts,
        )  # fmt: skip

    down, up = [], []
    for i in range(len(s.vehicles)):
        entry = own.get(i + 1)
        down.append(of((entry and entry.down) or s.faults.down, i + 1, "down"))
        up.append(of((entry and entry.up) or s.faults.up, i + 1, "up"))
    tracker = of(s.faults.tracker, -1, "down")
    return (*down, tracker._replace(cuts_us=())), tuple(up)
