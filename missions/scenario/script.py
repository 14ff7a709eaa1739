"""Mission scripts: a Python file with `async def main(fleet)`, flown by `cablequad fly script.py`.

    SCENARIO = "ground-to-ground"

    async def main(fleet):
        await fleet.preflight()
        await fleet.arm()
        ...

It runs while the vehicles fly, on their clock: waiting costs no wall time beyond what the flight takes. `SCENARIO`
names the scenario, shipped or a path, that says what flies.
"""

import inspect
import math
from collections.abc import Callable, Coroutine, Generator
from pathlib import Path
from typing import Any, NoReturn, Protocol, TypeVar

import numpy as np

from bridge.mission.mission import Mission, MissionError, Script, Until, Wait
from bridge.mission.phases import Phase
from missions.scenario.course import where
from missions.scenario.script_runner import Ended, ScriptRunner, ScriptStopped

DEFAULT = "ground-to-ground"
MOST_TILT_DEG = 30.0
OUTSIDE = '"""Flown by a program that is no part of this log, by cablequad.flying."""\n'  # in the place of a script

T = TypeVar("T")


class ScriptError(ValueError):
    """A script that cannot be run; the message says which line and why."""


class Caller(Protocol):
    """Has things done by the control loop, between two decisions."""

    def call(self, job: Callable[[], T]) -> T:
        """What `job` returns, or raises."""


class FleetOf:
    """The fleet and its load, as a script sees and commands them. Positions are m, NED.

    What is asked for and cannot be raises ValueError (an argument) or MissionError (not now, not there) at its line.
    """

    def __init__(self, mission: Mission, caller: Caller) -> None:
        self._mission, self._caller = mission, caller

    # what is known

    @property
    def time_s(self) -> float:
        """The vehicles' clock."""
        return self._caller.call(lambda: self._mission.now)

    @property
    def phase(self) -> str:
        """The phase of the mission."""
        return self._caller.call(lambda: str(self._mission.phase or ""))

    @property
    def load_m(self) -> tuple[float, float, float]:
        """Where the load is."""
        where = self._caller.call(lambda: self._mission.load_m)
        assert where is not None  # a script begins with the first decision
        return where

    @property
    def vehicles_m(self) -> list[tuple[float, float, float]]:
        """Where the vehicles are that are not lost."""
        return [(x, y, z) for x, y, z in self._caller.call(lambda: self._mission.here.x.tolist())]

    @property
    def tensions_N(self) -> list[float]:
        """What the cables bear at the load, told by the tracker or, where it tells none, by what vehicles give."""
        return self._caller.call(lambda: self._mission.tensions(self._mission.here).tolist())

    @property
    def batteries(self) -> list[float]:
        """0 .. 1, of every vehicle."""
        return self._caller.call(lambda: list(self._mission.fleet.batteries))

    @property
    def lost(self) -> dict[int, str]:
        """Vehicles (from 1) that were lost, and why."""
        return self._caller.call(lambda: {k + 1: why for k, why in self._mission.lost.items()})

    # what is asked; each begins at once, and is awaited for its end

    def preflight(self) -> Wait:
        """Until every check holds."""
        return self._begin(Phase.PREFLIGHT)

    def arm(self) -> Wait:
        """Until all are armed and obey."""
        return self._begin(Phase.ARM)

    def take_off(self) -> Wait:
        """Until all hover above their ends of the cables, slack."""
        return self._begin(Phase.TAKE_OFF)

    def tension(self) -> Wait:
        """Until every cable is straight and bears its share."""
        return self._begin(Phase.TENSION)

    def lift(self) -> Wait:
        """Until the load hangs still at the scenario's mission.lift_m."""
        return self._begin(Phase.LIFT)

    def carry(self) -> Wait:
        """Along the scenario's [plan] to above its target."""
        return self._begin(Phase.CARRY)

    def go(self, x: float, y: float, z: float, yaw_deg: float | None = None) -> Wait:
        """Straight to a place, within the limits of [plan]; without `yaw_deg` the load keeps its yaw."""
        return self._begin(Phase.CARRY, self._place(x, y, z, yaw_deg))

    def set_down(self, x: float | None = None, y: float | None = None, yaw_deg: float | None = None) -> Wait:
        """Here, or at a place."""
        if x is None and y is None and yaw_deg is None:
            return self._begin(Phase.SET_DOWN)
        at = self._caller.call(lambda: self._mission.led)
        to = self._place(at[0] if x is None else x, at[1] if y is None else y, at[2], yaw_deg)
        return self._begin(Phase.SET_DOWN, to)

    def release(self) -> Wait:
        """Until all hover on slack cables."""
        return self._begin(Phase.RELEASE)

    def land(self) -> Wait:
        """Until all stand beside the load."""
        return self._begin(Phase.LAND)

    def disarm(self) -> Wait:
        """Until all are disarmed."""
        return self._begin(Phase.DISARM)

    def wait(self, seconds: float) -> Wait:
        """For a while, on the vehicles' clock."""
        return self._for(lambda s: self._mission.wait(s), seconds)

    def tilt(self, roll_deg: float, pitch_deg: float, seconds: float) -> Wait:
        """Every vehicle further over than it flies by itself, for a while; while all hover on slack cables."""
        turn = [math.radians(_tilt("roll_deg", roll_deg)), math.radians(_tilt("pitch_deg", pitch_deg)), 0.0]
        return self._for(lambda s: self._mission.tilt(turn, s), seconds)

    def pause(self) -> None:
        """Stop the load on its way."""
        self._caller.call(self._mission.pause)

    def resume(self) -> None:
        """Let it go on."""
        self._caller.call(self._mission.resume)

    def abort(self, why: str = "the script gave up") -> NoReturn:
        """Come to the ground from here, in order; the script ends."""
        self._caller.call(lambda: self._mission.abort(str(why)))
        raise ScriptStopped

    def say(self, text: object) -> None:
        """A line for the user, and in the log."""
        line = str(text)
        self._caller.call(lambda: self._mission.events.append(("script", "all", line)))

    def _begin(self, phase: Phase, to: list[float] | None = None) -> Wait:
        return self._caller.call(lambda: self._mission.begin(phase, to))

    def _for(self, what: Callable[[float], Wait], seconds: float) -> Wait:
        duration = _finite("seconds", seconds)
        if duration < 0.0:
            raise ValueError(f"seconds: {seconds!r} given; 0 or more are needed")
        return self._caller.call(lambda: what(duration))

    def _place(self, x: float, y: float, z: float, yaw_deg: float | None) -> list[float]:
        place = [_finite("x", x), _finite("y", y), _finite("z", z)]
        if yaw_deg is None:
            return [*place, self._caller.call(lambda: self._mission.led[3])]
        return [*place, math.radians(_finite("yaw_deg", yaw_deg))]


def scenario_of(source: str, name: str) -> str:
    """The scenario that a script is for. Raises ScriptError naming the line and what is wrong."""
    return str(_loaded(source, name).get("SCENARIO", DEFAULT))


def script_from(source: str, name: str, waits: bool = True) -> Script:
    """What a mission runs. Raises ScriptError naming the line and what is wrong.

    `waits`: the vehicles' clock stands still while the script runs, as it does in lockstep.
    """
    main = _loaded(source, name).get("main")
    if not inspect.iscoroutinefunction(main):
        raise ScriptError(f"script {name}: no async def main(fleet) in it")

    async def run(mission: Mission) -> None:
        runner = ScriptRunner(main, name, waits, lambda: mission.now)
        ended = await _Driven(runner.run(FleetOf(mission, runner)))
        if isinstance(ended.error, ScriptStopped):
            return
        at = f"script {name}" + (f", line {ended.line}" if ended.line else "")
        if ended.stuck:
            raise MissionError(f"{at}: {ended.stuck}")
        if ended.error is not None:
            raise MissionError(_where(name, ended.error))
        await ended_in_order(mission, f"{at}: main(fleet) returned after this line")

    def started(mission: Mission) -> Coroutine[Any, Any, None]:
        return run(mission)

    return started


async def ended_in_order(mission: Mission, what: str) -> None:
    """What is left to do once nobody asks for more. Raises MissionError, beginning with `what`, where it flies."""
    if mission.phase is Phase.DISARM:  # asked for, perhaps not awaited
        await Wait(lambda: mission.phase_done)
    elif mission.phase is Phase.LAND and mission.phase_done:
        await mission.begin(Phase.DISARM)
    elif mission.phase not in (None, Phase.PREFLIGHT):
        raise MissionError(f"{what}, in phase {mission.phase}")


class _Driven:
    """Awaits a generator of what is to be waited for."""

    def __init__(self, steps: Generator[Until, None, Ended]) -> None:
        self._steps = steps

    def __await__(self) -> Generator[Until, None, Ended]:
        return (yield from self._steps)


def read_script(path: Path) -> str:
    """A script's text. Raises ScriptError."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ScriptError(f"script {path}: {why}; give a Python file with async def main(fleet)") from None


def _loaded(source: str, name: str) -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "mission", "__file__": name}
    try:
        exec(compile(source, name, "exec"), names)
    except (Exception, SystemExit) as error:
        raise ScriptError(_where(name, error)) from None
    return names


def _where(name: str, error: BaseException) -> str:
    kind, text = type(error).__name__, str(error)
    if isinstance(error, SystemExit):
        kind, text = "sys.exit", f"exit code {error.code}; a script ends by returning from main(fleet)"
    told = text if isinstance(error, MissionError) else f"{kind}: {text}"
    return (f"{where(name, error)}: {told}".splitlines() or [""])[0]


def _finite(name: str, value: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
        raise ValueError(f"{name}: {value!r:.60} given; a number is needed")
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{name}: {value!r:.60} given; a finite number is needed")
    return number


def _tilt(name: str, value: float) -> float:
    if abs(angle := _finite(name, value)) > MOST_TILT_DEG:
        raise ValueError(f"{name}: {value!r} given; at most {MOST_TILT_DEG:g} degrees either way")
    return angle
