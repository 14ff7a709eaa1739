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
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

from bridge.mission import Mission, MissionError, Script, Waiting
from bridge.phases import Phase
from missions.course import where

DEFAULT = "ground-to-ground"


class ScriptError(ValueError):
    """A script that cannot be run; the message says which line and why."""


class FleetOf:
    """The fleet and its load, as a script sees and commands them. Positions are m, NED."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission

    # what is known

    @property
    def time_s(self) -> float:
        """The vehicles' clock."""
        return self._mission.now

    @property
    def phase(self) -> str:
        """The phase of the mission."""
        return str(self._mission.phase or "")

    @property
    def load_m(self) -> tuple[float, float, float]:
        """Where the load is."""
        where = self._mission.load_m
        assert where is not None  # a script begins with the first decision
        return where

    @property
    def vehicles_m(self) -> list[tuple[float, float, float]]:
        """Where the vehicles are that are not lost."""
        return [(x, y, z) for x, y, z in self._mission.here.x.tolist()]

    @property
    def tensions_N(self) -> list[float]:
        """What the cables bear at the load, told by the tracker or, where it tells none, by what vehicles give."""
        return self._mission.tensions(self._mission.here).tolist()

    @property
    def batteries(self) -> list[float]:
        """0 .. 1, of every vehicle."""
        return list(self._mission.fleet.batteries)

    @property
    def lost(self) -> dict[int, str]:
        """Vehicles (from 1) that were lost, and why."""
        return {k + 1: why for k, why in self._mission.lost.items()}

    # what is asked; each begins at once, and is awaited for its end

    def preflight(self) -> Waiting:
        """Until every check holds."""
        return self._mission.begin(Phase.PREFLIGHT)

    def arm(self) -> Waiting:
        """Until all are armed and obey."""
        return self._mission.begin(Phase.ARM)

    def take_off(self) -> Waiting:
        """Until all hover above their ends of the cables, slack."""
        return self._mission.begin(Phase.TAKE_OFF)

    def tension(self) -> Waiting:
        """Until every cable is straight and bears its share."""
        return self._mission.begin(Phase.TENSION)

    def lift(self) -> Waiting:
        """Until the load hangs still at the scenario's mission.lift_m."""
        return self._mission.begin(Phase.LIFT)

    def carry(self) -> Waiting:
        """Along the scenario's [plan] to above its target."""
        return self._mission.begin(Phase.CARRY)

    def go(self, x: float, y: float, z: float, yaw_deg: float | None = None) -> Waiting:
        """Straight to a place, within the limits of [plan]; without `yaw_deg` the load keeps its yaw."""
        return self._mission.begin(Phase.CARRY, self._place(x, y, z, yaw_deg))

    def set_down(self, x: float | None = None, y: float | None = None, yaw_deg: float | None = None) -> Waiting:
        """Here, or at a place."""
        at = self._mission.led
        if x is None and y is None and yaw_deg is None:
            return self._mission.begin(Phase.SET_DOWN)
        to = self._place(at[0] if x is None else x, at[1] if y is None else y, at[2], yaw_deg)
        return self._mission.begin(Phase.SET_DOWN, to)

    def release(self) -> Waiting:
        """Until all hover on slack cables."""
        return self._mission.begin(Phase.RELEASE)

    def land(self) -> Waiting:
        """Until all stand beside the load."""
        return self._mission.begin(Phase.LAND)

    def disarm(self) -> Waiting:
        """Until all are disarmed."""
        return self._mission.begin(Phase.DISARM)

    def wait(self, seconds: float) -> Waiting:
        """For a while, on the vehicles' clock."""
        return self._mission.wait(_finite("seconds", seconds))

    def tilt(self, roll_deg: float, pitch_deg: float, seconds: float) -> Waiting:
        """Every vehicle further over than it flies by itself, for a while; while all hover on slack cables."""
        turn = [math.radians(_finite("roll_deg", roll_deg)), math.radians(_finite("pitch_deg", pitch_deg)), 0.0]
        return self._mission.tilt(turn, _finite("seconds", seconds))

    def pause(self) -> None:
        """Stop the load on its way."""
        self._mission.pause()

    def resume(self) -> None:
        """Let it go on."""
        self._mission.resume()

    def abort(self, why: str) -> None:
        """Come to the ground from here, in order; the script ends."""
        self._mission.abort(why)

    def say(self, text: str) -> None:
        """A line in the log."""
        self._mission.events.append(("script", "all", str(text)))

    def _place(self, x: float, y: float, z: float, yaw_deg: float | None) -> list[float]:
        yaw = self._mission.led[3] if yaw_deg is None else math.radians(_finite("yaw_deg", yaw_deg))
        return [_finite("x", x), _finite("y", y), _finite("z", z), yaw]


def scenario_of(source: str, name: str) -> str:
    """The scenario that a script is for. Raises ScriptError naming the line and what is wrong."""
    return str(_loaded(source, name).get("SCENARIO", DEFAULT))


def script_from(source: str, name: str) -> Script:
    """What a mission runs. Raises ScriptError naming the line and what is wrong."""
    main = _loaded(source, name).get("main")
    if not inspect.iscoroutinefunction(main):
        raise ScriptError(f"script {name}: no async def main(fleet) in it")

    async def run(mission: Mission) -> None:
        try:
            await main(FleetOf(mission))
        except (GeneratorExit, MissionError):
            raise
        except Exception as error:
            raise MissionError(_where(name, error)) from None

    def started(mission: Mission) -> Coroutine[Any, Any, None]:
        return run(mission)

    return started


def read_script(path: Path) -> str:
    """A script's text. Raises ScriptError."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ScriptError(f"script {path}: {why}; give a Python file with async def main(fleet)") from None


def _loaded(source: str, name: str) -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "mission", "__file__": name}
    try:
        exec(compile(source, name, "exec"), names)
    except Exception as error:
        raise ScriptError(_where(name, error)) from None
    return names


def _where(name: str, error: Exception) -> str:
    return f"{where(name, error)}: {type(error).__name__}: {error}".splitlines()[0]


def _finite(name: str, value: float) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{name}: {value} given; a finite number is needed")
    return number
