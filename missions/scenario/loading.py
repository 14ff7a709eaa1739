"""A TOML scenario -> validated values, with errors that name the key and say what is allowed."""

import difflib
import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ValidationError

from bridge.wire.link_faults import Faults
from cablequad.control.design import Design, DesignError, Weights
from cablequad.control.estimator import Estimator, Filter, estimator
from cablequad.control.law import LAWS, Controller, Loop
from cablequad.control.trajectory import Trajectory, along, at, circle, joined, leg, lemniscate, waypoints
from cablequad.model import lie
from cablequad.model.attitude import Airframe
from cablequad.model.linear import EquilibriumError, equilibrium
from cablequad.model.noise import Noise
from cablequad.model.state import State
from cablequad.model.stiffness import STABLE, stable_substep
from cablequad.model.system import Cable, Payload, Quadrotor, System, box_inertia
from missions.scenario.course import SETTLE_S, CourseError, course_from, course_of
from missions.scenario.limits import plan_limits
from missions.scenario.script import ScriptError, read_script, scenario_of, script_from
from missions.scenario.surroundings import airborne, around, lay_out
from missions.scenario.tables import FaultTable, OneVehicleTable, Scenario, TargetTable
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


def names() -> list[str]:
    """The scenarios that ship."""
    folder = resources.files("missions") / "scenarios"
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))


def text(name: str) -> str:
    """The file of a shipped scenario or of a path. Raises ScenarioError naming what is missing."""
    if name in names():
        return (resources.files("missions") / "scenarios" / f"{name}.toml").read_text(encoding="utf-8")
    path = Path(name)
    if path.suffix not in (".toml", ".json") and not path.exists():
        near = difflib.get_close_matches(name, names(), 1)
        hint = f"; did you mean {near[0]}?" if near else f"; shipped: {', '.join(names())}"
        raise ScenarioError(f"scenario {name!r}: neither a shipped scenario nor a TOML file{hint}")
    try:
        return path.read_text(encoding="utf-8-sig")  # with or without a byte order mark
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ScenarioError(f"scenario {name}: {why}; give a shipped name or the path of a TOML file") from None


def parse(source: str, name: str) -> Scenario:
    """The validated scenario. Raises ScenarioError with one line that names the key."""
    try:
        if name.endswith(".json"):  # as it is attached to a log
            return Scenario.model_validate_json(source)
        return Scenario.model_validate(tomllib.loads(source))
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"scenario {name}: not TOML: {error}") from None
    except ValidationError as error:
        raise ScenarioError(f"scenario {name}: {_explain(error)}") from None


def load(
    name: str,
    duration_s: float | None = None,
    seed: int | None = None,
    firmware: str | None = None,
    script: Path | None = None,
    external: bool = False,
) -> Flight:
    """A flight from a shipped name or a path; what is given replaces what the file says. Raises ScenarioError.

    `external`: its vehicles are not ours, and may have any parameter. A script's course replaces [plan], [target] and,
    where no duration is given, the duration.
    """
    program: str | None = None
    program_name = name
    if name.endswith(".py"):
        try:
            program = read_script(Path(name))
            script_from(program, name)
            name = scenario_of(program, name)
        except ScriptError as error:
            raise ScenarioError(str(error)) from None
    source = text(name)
    scenario = parse(source, name)
    changes: dict[str, Any] = {}
    if duration_s is not None:
        changes["duration_s"] = duration_s
    if seed is not None:
        changes["seed"] = seed
    if firmware is not None:
        changes["vehicle"] = scenario.vehicle.model_copy(update={"firmware": firmware})
        changes["vehicles"] = [v.model_copy(update={"firmware": None}) for v in scenario.vehicles]
    if changes:
        scenario = scenario.model_copy(update=changes)
    try:
        flight = flight_of(scenario, source, external)
        if program is not None:
            flight = _programmed(flight, program)._replace(script_name=Path(program_name).name)
        elif script is not None:
            flight = _by_script(flight, script, duration_s)
        return _flyable(flight, duration_s is not None)
    except CourseError as error:
        raise ScenarioError(str(error)) from None
    except ValueError as error:
        raise ScenarioError(f"scenario {name}: {error}") from None


def _flyable(flight: Flight, asked: bool) -> Flight:
    """The flight, with a note for every setting without effect. Raises ValueError where its plan has no room.

    `asked`: its duration was asked for beside the scenario, and may cut the plan short.
    """
    from missions.scenario.feasibility import misplaced, without_effect  # here, as it looks at flights

    s, plan = flight.scenario, flight.trajectory.duration
    if flight.script is None or s.mission is None:
        for line in misplaced(flight):
            raise ValueError(line)
        if plan > s.duration_s and not asked:
            raise ValueError(
                f"duration_s: {s.duration_s:g} given; [plan] takes {plan:.3g} s to its end, within speed_m_s = "
                f"{s.plan.speed_m_s:g} and the other limits"
            )
    return flight._replace(notes=[*flight.notes, *without_effect(s)])


def restored(resolved: str, source: str, script: str | None) -> Flight:
    """The flight that a log was written of: its resolved scenario (JSON), its file and its mission script's text.

    Raises ScenarioError where today's tables do not take it.
    """
    try:
        flight = flight_of(Scenario.model_validate_json(resolved), source, external=True)
        if script is None:
            return flight
        if flight.scenario.mission is not None:
            return _programmed(flight, script)
        start, at_most = _start(flight.scenario, flight.initial, flight.system), plan_limits(flight.scenario)
        return flight._replace(trajectory=course_from(script, "mission.py", start, at_most), script=script)
    except ValidationError as error:
        raise ScenarioError(_explain(error)) from None
    except ValueError as error:
        raise ScenarioError(str(error)) from None


def _programmed(flight: Flight, program: str) -> Flight:
    """The flight with an async mission script."""
    if flight.scenario.mission is None:
        raise ValueError("[mission]: missing; an async script flies from the ground to the ground")
    return flight._replace(script=program)


def _by_script(flight: Flight, script: Path, duration_s: float | None) -> Flight:
    s = flight.scenario
    course = course_of(script, _start(s, flight.initial, flight.system), plan_limits(s))
    end = at(course, course.duration)
    target = TargetTable(position_m=end.x0.tolist(), yaw_deg=math.degrees(float(end.yaw[0])))
    seconds = duration_s if duration_s is not None else math.ceil(course.duration + SETTLE_S)
    changed = s.model_copy(update={"target": target, "duration_s": seconds})
    return flight._replace(scenario=changed, trajectory=course, script=script.read_text(encoding="utf-8-sig"))


def weights(flight: Flight) -> Weights:
    """The weights of the scenario's quadratic cost."""
    w = flight.scenario.control.weights
    return Weights(w.position, w.velocity, w.attitude, w.body_rate, w.link_direction, w.link_rate, w.force, w.lasting)


def estimator_of(flight: Flight) -> Estimator:
    """The observer of what the scenario's sensing leaves or blurs, told how noisy the sensors are."""
    period, sensing = flight.control_us * 1e-6, flight.scenario.control.sensing
    return estimator(flight.system, flight.airframe, period, sensing, noise(flight))


def filter(flight: Flight) -> Filter | None:
    """The observer's filter; None where everything is measured without noise."""
    if flight.scenario.control.sensing == "full" and noise(flight) == Noise():
        return None
    return estimator_of(flight).filter


def noise(flight: Flight) -> Noise:
    """The noise of the scenario's sensors."""
    s = flight.scenario.sensors
    degrees = np.radians([s.attitude_deg, s.rate_deg_s, s.link_direction_deg, s.link_rate_deg_s]).tolist()
    return Noise(s.position_m, s.velocity_m_s, *degrees)


def law_of(flight: Flight) -> Controller:
    """What decides."""
    return LAWS[flight.scenario.control.law]


def designed_for(flight: Flight, airframe: Airframe) -> Loop:
    """What its law is designed for, with these vehicles."""
    return Loop(airframe, weights(flight), flight.control_us * 1e-6, flight.scenario.control.delay_ticks)


def design(flight: Flight) -> Design:
    """The controller of a flight. Raises ScenarioError where the system has no equilibrium or no stabilising gains."""
    try:
        return law_of(flight).design(flight.system, designed_for(flight, flight.airframe))
    except (EquilibriumError, DesignError) as error:
        raise ScenarioError(f"scenario {flight.scenario.name}: {error}") from None
    except (np.linalg.LinAlgError, ArithmeticError) as error:
        raise ScenarioError(
            f"scenario {flight.scenario.name}: control: no gains can be computed ({error}); masses, lengths or rates "
            "are out of proportion"
        ) from None


def rotation_deg(roll_pitch_yaw: list[float]) -> np.ndarray:
    """R_z(yaw) R_y(pitch) R_x(roll), (3, 3), from degrees."""
    roll, pitch, yaw = np.radians(roll_pitch_yaw)
    e = np.eye(3)
    return lie.exp(yaw * e[2]) @ lie.exp(pitch * e[1]) @ lie.exp(roll * e[0])


def _of(s: Scenario, vehicle: OneVehicleTable, key: str) -> Any:
    """A vehicle's own value of a key, or what all have in common."""
    own = getattr(vehicle, key)
    return getattr(s.vehicle, key) if own is None else own


def system_of(s: Scenario, heavier: float = 1.0) -> System:
    """The system that a scenario describes, with a load of `heavier` times the mass and inertia."""
    inertia = heavier * np.asarray(s.payload.inertia_kg_m2 or box_inertia(s.payload.mass_kg, s.payload.box_m))
    payload = Payload(heavier * s.payload.mass_kg, inertia, [v.attachment_m for v in s.vehicles])
    quadrotors = [Quadrotor(_of(s, v, "mass_kg"), _of(s, v, "inertia_kg_m2")) for v in s.vehicles]
    cables = [v.cable or s.cable for v in s.vehicles]
    chains = [Cable(c.link_masses_kg, c.link_lengths_m) for c in cables]
    return System.of(payload, quadrotors, chains, s.gravity_m_s2)


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
    firmware = tuple(_of(s, v, "firmware") for v in s.vehicles)
    return Flight(
        s, source, system, airframe, world, _trajectory(s, system, initial), initial, *steps, notes, firmware, up, down
    )


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
        R0=_hanging(system) if s.initial.attitude_deg is None else rotation_deg(s.initial.attitude_deg),
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


def _start(s: Scenario, initial: State, system: System) -> list[float]:
    """Where the load begins (m) and how it is yawed from how it hangs (rad)."""
    turned = initial.R0 @ _hanging(system).T
    return [*s.initial.position_m, math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])]


def _trajectory(s: Scenario, system: System, initial: State) -> Trajectory:
    """From where the load begins, by what [plan] says, to the target."""
    return route(s, _start(s, initial, system), [*s.target.position_m, math.radians(s.target.yaw_deg)])


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


def _hanging(system: System) -> np.ndarray:
    """The attitude of the load at rest; level where there is none, which the design then says."""
    try:
        return equilibrium(system).R0
    except EquilibriumError:
        return np.eye(3)


def _explain(error: ValidationError) -> str:
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")  # a misspelt key explains a missing one
    key = ".".join(str(part) for part in first["loc"])
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    kind, given = first["type"], first.get("input")
    if kind == "extra_forbidden":
        allowed = _keys_at(first["loc"][:-1])
        near = difflib.get_close_matches(str(first["loc"][-1]), allowed, 1)
        hint = f"did you mean {near[0]}?" if near else f"allowed: {', '.join(allowed)}"
        return f"{key}: unknown key; {hint}{more}"
    if kind == "missing":
        return f"{key}: missing; it must be given{more}"
    message = first["msg"].removeprefix("Value error, ")
    if kind == "value_error" and isinstance(given, dict):
        return f"{key + ': ' if key else ''}{message}{more}"
    shown = f"{given!r:.60} given; " if not isinstance(given, dict) else ""
    return f"{key}: {shown}{message[0].lower() + message[1:]}{more}"


def _keys_at(path: tuple[int | str, ...]) -> list[str]:
    """The keys that a table of a scenario may have."""
    model: Any = Scenario
    for part in path:
        if isinstance(part, int):
            continue
        annotation = model.model_fields[part].annotation
        arguments = [a for a in [annotation, *getattr(annotation, "__args__", ())] if isinstance(a, type)]
        model = next((a for a in arguments if issubclass(a, BaseModel)), model)
    return list(model.model_fields)
