"""Mission scripts that say where the load goes: a file with `mission(course)`, flown by `cablequad fly --script`.

    def mission(course):
        course.go(1.0, 0.0, -1.5)
        course.circle(radius_m=1.0, laps=2)
        course.wait(3.0)
        course.go(0.0, 0.0, -0.5, yaw_deg=90)

The script runs before anything flies; what it describes is flown as one smooth reference.
"""

import math
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cablequad.control.trajectory import (
    Limits,
    Trajectory,
    along,
    at,
    circle,
    joined,
    leg,
    lemniscate,
    wait,
)
from cablequad.types import Array

SETTLE_S = 8.0  # flown on after the end of a script's course, so that its end is judged at rest


class CourseError(ValueError):
    """A script that cannot be flown; the message says which line and why."""


class Course:
    """Where the load goes, put together leg by leg. Positions are m, NED; every leg begins and ends at rest."""

    def __init__(self, start: list[float], limits: Limits) -> None:
        """`start` is x, y, z (m) and yaw (rad)."""
        self._here = list(start)
        self.limits = limits
        self._parts: list[Trajectory] = []

    @property
    def position_m(self) -> tuple[float, float, float]:
        """Where the course has come to."""
        return self._here[0], self._here[1], self._here[2]

    @property
    def yaw_deg(self) -> float:
        """Where the load points by then, from how it hangs at rest."""
        return math.degrees(self._here[3])

    def limit(self, speed_m_s: float | None = None, acceleration_m_s2: float | None = None) -> None:
        """Carry more slowly or faster from here on."""
        for name, value in (("speed", speed_m_s), ("acceleration", acceleration_m_s2)):
            if value is not None:
                self.limits = self.limits._replace(**{name: _above_zero(name, value)})

    def go(self, x: float, y: float, z: float, yaw_deg: float | None = None) -> None:
        """Straight to a place, turning on the way; without `yaw_deg` the load keeps its yaw."""
        yaw = self._here[3] if yaw_deg is None else math.radians(_finite("yaw_deg", yaw_deg))
        end = [_finite("x", x), _finite("y", y), _finite("z", z), yaw]
        self._add(leg(self._here, end, self.limits), end)

    def wait(self, seconds: float) -> None:
        """Stay."""
        self._add(wait(self._here, _above_zero("seconds", seconds)), self._here)

    def circle(self, radius_m: float, laps: float = 1.0, speed_m_s: float = 1.0) -> None:
        """Level laps around a circle that begins here, with its centre towards -x."""
        radius = _above_zero("radius_m", radius_m)
        centre = [self._here[0] - radius, *self._here[1:]]
        self._path(circle(centre, radius), laps, speed_m_s)

    def lemniscate(self, length_m: float, width_m: float, laps: float = 1.0, speed_m_s: float = 1.0) -> None:
        """A level figure of eight through here, `length_m` along x and `width_m` along y."""
        curve = lemniscate(self._here, _above_zero("length_m", length_m), _above_zero("width_m", width_m))
        self._path(curve, laps, speed_m_s)

    def trajectory(self) -> Trajectory:
        """The whole course. Raises CourseError where it is empty."""
        if not self._parts:
            raise CourseError("the script's mission() goes nowhere; call course.go, wait, circle or lemniscate")
        return joined(self._parts)

    def _path(self, curve: Callable[[Array], Array], laps: float, speed_m_s: float) -> None:
        part = along(curve, _above_zero("laps", laps), _above_zero("speed_m_s", speed_m_s), self.limits)
        end = at(part, part.duration).x0.tolist()
        self._add(part, [*end, self._here[3]])

    def _add(self, part: Trajectory, end: list[float]) -> None:
        self._parts.append(part)
        self._here = list(end)


def course_of(script: Path, start: list[float], limits: Limits) -> Trajectory:
    """What a script's `mission(course)` describes. Raises CourseError naming the script, the line and what is wrong."""
    try:
        source = script.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise CourseError(f"script {script}: {why}; give a Python file with mission(course)") from None
    return course_from(source, str(script), start, limits)


def course_from(source: str, name: str, start: list[float], limits: Limits) -> Trajectory:
    """The same from a script's text. Raises CourseError naming the line and what is wrong."""
    course = Course(start, limits)
    names: dict[str, Any] = {"__name__": "mission", "__file__": name}
    try:
        exec(compile(source, name, "exec"), names)
        mission = names.get("mission")
        if not callable(mission):
            raise CourseError("no function mission(course) in it")
        mission(course)
        return course.trajectory()
    except (Exception, SystemExit) as error:
        kind = "" if isinstance(error, CourseError) else f"{type(error).__name__}: "
        raise CourseError(f"{where(name, error)}: {kind}{error}".splitlines()[0]) from None


def where(name: str, error: BaseException) -> str:
    """Which script, and which of its lines an error is about."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == name]
    line = error.lineno if isinstance(error, SyntaxError) else frames[-1].lineno if frames else None
    return f"script {name}" + (f", line {line}" if line else "")


def _finite(name: str, value: float) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise CourseError(f"{name}: {value} given; a finite number is needed")
    return number


def _above_zero(name: str, value: float) -> float:
    if not _finite(name, value) > 0:
        raise CourseError(f"{name}: {value} given; a number above 0 is needed")
    return float(value)
