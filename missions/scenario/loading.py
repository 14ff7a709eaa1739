"""Files -> flights, with errors that name the key and say what is allowed."""

import difflib
import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from cablequad.control.trajectory import at
from missions.scenario.course import SETTLE_S, CourseError, course_from, course_of
from missions.scenario.flights import Flight, ScenarioError, flight_of
from missions.scenario.limits import plan_limits
from missions.scenario.routes import start_of
from missions.scenario.script import ScriptError, read_script, scenario_of, script_from
from missions.scenario.tables import Scenario, TargetTable


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
        start, at_most = start_of(flight.scenario, flight.initial, flight.system), plan_limits(flight.scenario)
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
    course = course_of(script, start_of(s, flight.initial, flight.system), plan_limits(s))
    end = at(course, course.duration)
    target = TargetTable(position_m=end.x0.tolist(), yaw_deg=math.degrees(float(end.yaw[0])))
    seconds = duration_s if duration_s is not None else math.ceil(course.duration + SETTLE_S)
    changed = s.model_copy(update={"target": target, "duration_s": seconds})
    return flight._replace(scenario=changed, trajectory=course, script=script.read_text(encoding="utf-8-sig"))


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
