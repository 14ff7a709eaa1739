"""Whatever a mission script does, the flight goes on by the rules and everything comes to stand on the ground."""

import threading
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Command, flown, next_offset
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.mission.members.members import Contingencies
from bridge.mission.mission import Mission
from bridge.mission.observation import Observation
from bridge.mission.phases import FLYING, LOADED, Phase
from bridge.mission.touch_down import TouchDown
from cablequad.control.design import Design
from cablequad.control.law import SAMPLED
from missions.scenario import laws
from missions.scenario import loading as scenarios
from missions.scenario.flights import Flight
from missions.scenario.mission_setup import plan_of
from missions.scenario.script import ScriptError, script_from
from missions.scenario.script_runner import COMPUTES_S

PERIOD_S = 0.02
LONGEST_S = 400.0  # of any mission here


class ObedientFleet:
    """Vehicles that do at once what they are asked."""

    def __init__(self, n: int) -> None:
        self.may_arm = False
        self.disarmed = False
        self.stands = True
        self.batteries = [1.0] * n
        self.departed: dict[int, tuple[float, str]] = {}
        self.astray: set[int] = set()

    flying = property(lambda self: self.may_arm and not self.disarmed)
    released_at = property(lambda self: 0.0 if self.may_arm else None)
    all_landed = property(lambda self: self.stands)
    at_rest = property(lambda self: self.disarmed)

    def disarm(self, _: float) -> None:
        assert self.stands, "disarmed in the air"
        self.disarmed = True

    def not_ready(self) -> list[str]:
        return []


class Kinematics:
    """A world without forces: vehicles are where they are to be, and the load hangs below them or stands."""

    def __init__(self, script: str, waits: bool = True) -> None:
        flight, design = world()
        plan = plan_of(flight)
        self.fleet = ObedientFleet(len(flight.system.m))
        period = flight.control_us * 1e-6
        runs = script_from(script, "m.py", waits)
        fleet: Any = self.fleet  # as much of one as a mission asks
        self.mission = Mission(plan, fleet, Contingencies(SAMPLED, {frozenset(): design}, {}), period, runs)
        self.plan, self.period, self.now = plan, period, 0.0
        self.state = flight.initial.copy()
        self.rest = self.state.x0.copy()
        self.x = self.rest + plan.stands
        self.floor = float(self.x[0, 2])
        self.sinks = True  # vehicles that land come down

    def decide(self) -> None:
        still = np.zeros_like(self.x)
        n = len(self.x)
        observation = Observation(self.state, np.ones(n), 0.0, self.x, still, np.zeros(n))
        m = self.mission
        m.answer(self.now, self.now, observation)
        self.now += self.period
        x0 = self.state.x0.copy()
        if m.phase in LOADED:
            x0 = np.minimum(np.asarray(m.reference.x0), [np.inf, np.inf, self.plan.rest_z])
            self.state = self.state._replace(x0=x0)
            self.x = m.geometry.above(self.state, 1.0)
        elif m.phase in FLYING:
            lowest = self.floor if self.sinks or m.phase is not Phase.LAND else self.floor - 0.5
            self.x = np.minimum(m.control.singles.aim, [np.inf, np.inf, lowest])
        self.fleet.stands = bool((self.x[:, 2] > self.floor - 0.02).all())

    def fly(self) -> Mission:
        """To the mission's end."""
        while not self.mission.finished:
            assert self.now < LONGEST_S, f"still in phase {self.mission.phase}"
            self.decide()
        self.mission.close()
        return self.mission

    def on_the_ground(self) -> bool:
        """Load and vehicles stand, and nobody is armed."""
        return self.fleet.stands and abs(float(self.state.x0[2]) - self.plan.rest_z) < 0.02 and not self.fleet.flying


@cache
def world() -> tuple[Flight, Design]:
    flight = scenarios.load("ground-to-ground")
    flight = flight._replace(control_us=round(PERIOD_S * 1e6))
    return flight, laws.design(flight)


def script(*lines: str) -> str:
    return "async def main(fleet):\n" + "".join(f"    {line}\n" for line in lines or ("pass",))


UP = (
    "await fleet.preflight()", "await fleet.arm()", "await fleet.take_off()", "await fleet.tension()",
    "await fleet.lift()",
)  # fmt: skip
DOWN = ("await fleet.set_down()", "await fleet.release()", "await fleet.land()", "await fleet.disarm()")


def test_the_whole_way_up_and_down_is_flown_without_a_word() -> None:
    world = Kinematics(script(*UP, "await fleet.go(1.0, 0.0, -1.4)", *DOWN))
    m = world.fly()
    assert m.failure is None
    assert m.phase is Phase.DISARM
    assert world.on_the_ground()


def test_who_is_told_to_come_down_while_it_lands_lands_first() -> None:
    world = Kinematics(script(*UP, *DOWN))
    while world.mission.phase is not Phase.LAND:
        world.decide()
    world.mission.abort("enough")
    assert world.fly().failure == "enough"
    assert world.on_the_ground()


def test_who_does_not_come_down_in_time_is_not_disarmed_in_the_air(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TouchDown, "stands", lambda *_: False)  # whoever hangs in the air
    world = Kinematics(script(*UP, *DOWN))
    world.sinks = False
    m = world.fly()
    assert m.failure is not None
    assert m.failure.startswith("phase land took more than")
    assert m.phase is Phase.LAND
    assert [text for kind, _, text in m.events if kind == "abort"][-1].endswith("as they may be in the air")
    assert not world.fleet.disarmed


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ((*UP, "return"), "line 7: main(fleet) returned"),
        ((*UP, "return 5"), "line 7: main(fleet) returned"),
        ((*UP,), "line 6: main(fleet) returned after this line, in phase lift"),
        ((*UP, "raise SystemExit(3)"), "line 7: sys.exit: exit code 3"),
        ((*UP, "import sys", "sys.exit('no')"), "line 8: sys.exit: exit code no"),
        ((*UP, "raise KeyboardInterrupt"), "line 7: KeyboardInterrupt"),
        ((*UP, "raise BaseException('b')"), "line 7: BaseException: b"),
        ((*UP, "1 / 0"), "line 7: ZeroDivisionError"),
        (("await fleet.lift()",), "line 2: lift may not follow the start"),
        ((*UP[:2], "fleet.take_off()", "await fleet.tension()"), "line 5: tension may not begin while phase take off"),
        ((*UP, "await fleet.wait(-5)"), "line 7: ValueError: seconds: -5 given"),
        ((*UP, "await fleet.wait('5')"), "line 7: ValueError: seconds: '5' given; a number is needed"),
        ((*UP, "await fleet.wait(float('nan'))"), "seconds: nan given; a finite number"),
        ((*UP, "await fleet.go(1.0, 0.0, 2.0)"), "line 7: carry to (1, 0, 2) m: below the ground"),
        ((*UP, "await fleet.go(1e6, 0.0, -1.4)"), "outside the fence"),
        ((*UP, "await fleet.go(True, 0.0, -1.4)"), "x: True given; a number is needed"),
        ((*UP, "await fleet.go()"), "line 7: TypeError"),
        ((*UP, "await fleet.set_down(1e3, 0.0)"), "outside the fence"),
        ((*UP, "await fleet.fly_away()"), "line 7: AttributeError"),
        ((*UP, "await 5"), "line 7: TypeError"),
        ((*UP, "import asyncio", "await asyncio.sleep(1)"), "line 8: RuntimeError"),
        ((*UP, "class Odd:", "    def __await__(self): yield 5", "await Odd()"), "TypeError: only what the fleet gives"),
        ((*UP, "fleet.abort('enough')"), "enough"),
        ((*UP, "def again(): again()", "again()"), "line 7: RecursionError"),
        ((*UP, "await fleet.tilt(80.0, 0.0, 1.0)"), "roll_deg: 80.0 given; at most 30 degrees"),
        (("await fleet.preflight()", "await fleet.arm()"), "line 3: main(fleet) returned after this line, in phase arm"),
    ],
    ids=str,
)  # fmt: skip
def test_a_script_that_goes_wrong_is_named_with_its_line_and_all_comes_down(lines: tuple[str, ...], said: str) -> None:
    world = Kinematics(script(*lines))
    m = world.fly()
    assert said in (m.failure or "")
    assert world.on_the_ground()


@pytest.mark.parametrize("lines", [(), ("return 7",), ("await fleet.preflight()",), (*UP[:3], "await fleet.land()")])
def test_a_script_that_leaves_nothing_in_the_air_is_no_failure(lines: tuple[str, ...]) -> None:
    world = Kinematics(script(*lines))
    assert world.fly().failure is None
    assert world.on_the_ground()


@pytest.mark.parametrize(
    "lines",
    [
        (*UP, "while True: pass"),
        (*UP, "import time", "time.sleep(1e6)"),
        (*UP, "while True:", "    try:", "        while True: pass", "    except BaseException: pass"),
    ],
    ids=["computes", "sleeps", "computes and swallows every exception"],
)
def test_a_script_that_never_awaits_is_given_up(lines: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("missions.scenario.script_runner.COMPUTES_S", 0.3)
    monkeypatch.setattr("missions.scenario.script_runner.BLOCKS_S", 0.6)
    world = Kinematics(script(*lines))
    m = world.fly()
    assert "without awaiting anything" in (m.failure or "")
    assert "script m.py, line" in (m.failure or "")
    assert world.on_the_ground()


def test_where_the_clock_does_not_wait_the_vehicles_fly_on_while_a_script_computes() -> None:
    begun, ended = threading.Event(), threading.Event()
    builtins: Any = __builtins__
    names = builtins if isinstance(builtins, dict) else vars(builtins)
    names["_begun"], names["_ended"] = begun, ended
    try:
        world = Kinematics(script(*UP, "_begun.set()", "_ended.wait(20)", "fleet.say('on')", *DOWN), waits=False)
        while not begun.is_set():
            world.decide()
            time.sleep(0.0001)
        before = world.now
        for _ in range(50):
            world.decide()
        assert world.now > before + 0.9
        assert world.mission.phase is Phase.LIFT
        ended.set()
        while not world.mission.finished:
            world.decide()
            time.sleep(0.0002)
        assert world.mission.failure is None
    finally:
        del names["_begun"], names["_ended"]


def test_what_the_loop_does_for_a_script_is_done_by_the_loops_thread() -> None:
    world = Kinematics(script(*UP[:1], "fleet.say('x')"))
    seen: list[str] = []

    class Events(list):
        def append(self, item: Any) -> None:
            if item[0] == "script":
                seen.append(threading.current_thread().name)
            super().append(item)

    world.mission.events = Events()
    world.fly()
    assert seen == [threading.current_thread().name]


@pytest.mark.parametrize("body", ["import sys\nsys.exit(3)\n", "raise SystemExit\n", "exit()\n"])
def test_a_script_that_exits_when_it_is_read_is_refused_with_its_line(body: str) -> None:
    with pytest.raises(ScriptError, match=r"line \d: sys.exit"):
        script_from(body, "m.py")


NUMBERS = st.one_of(
    st.floats(), st.floats(-3.0, 3.0), st.integers(-(10**12), 10**12), st.booleans(), st.none(), st.just("5")
).map(lambda v: f"float({str(v)!r})" if isinstance(v, float) else repr(v))
CALLS = st.one_of(
    st.sampled_from([p.value.replace(" ", "_") for p in Phase]).map(lambda name: f"fleet.{name}()"),
    st.builds(lambda x, y, z: f"fleet.go({x}, {y}, {z})", NUMBERS, NUMBERS, NUMBERS),
    st.builds(lambda x, y: f"fleet.set_down({x}, {y})", NUMBERS, NUMBERS),
    st.builds(lambda s: f"fleet.wait({s})", NUMBERS),
    st.builds(lambda s: f"fleet.tilt(5.0, 0.0, {s})", NUMBERS),
)
LINES = st.one_of(
    CALLS.map(lambda c: f"await {c}"),
    CALLS,
    st.sampled_from(["fleet.pause()", "fleet.resume()", "fleet.say(fleet.load_m)", "return", "return 1", "fleet.lost",
                     "raise ValueError", "raise SystemExit", "fleet.abort('x')", "await None", "fleet.phase = 1"]),
    CALLS.map(lambda c: f"try: await {c}\n    except Exception: pass"),
)  # fmt: skip
STARTS = st.sampled_from([UP[:k] for k in range(len(UP) + 1)])


@settings(max_examples=60)
@given(STARTS, st.lists(LINES, max_size=8), st.sampled_from([(), DOWN]))
def test_any_script_at_all_ends_with_everything_on_the_ground(
    start: tuple[str, ...], lines: list[str], end: tuple[str, ...]
) -> None:
    world = Kinematics(script(*start, *lines, *end))
    m = world.mission
    while not m.finished and world.now < LONGEST_S:
        world.decide()
        if world.now > 200.0:  # a pause without end, or a wait of years: the flight's time is up
            m.abort("not over in time")
    m.close()
    assert m.finished
    assert world.on_the_ground()
    assert (
        m.failure is None or "script m.py" in m.failure or m.failure in ("x", "not over in time") or "took" in m.failure
    )


CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ((*UP, "await fleet.go(1.0, 0.0, -1.4)"), "line 8: main(fleet) returned"),
        ((*UP, "import sys", "sys.exit(3)"), "line 9: sys.exit"),
        ((*UP, "while True: pass"), f"line 8: computes for more than {COMPUTES_S:g} s"),
    ],
)
def test_over_the_wire_the_load_is_set_down_in_order(lines: tuple[str, ...], said: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.py"
    path.write_text('SCENARIO = "ground-to-ground"\n' + script(*lines))
    s = flown(str(path), "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset()))
    assert s["exit_code"] == 1
    assert f"script wrong.py, {said}" in s["reason"]
    assert s["touch_down_m_s"] < 0.3
    assert s["vehicles_crashed"] == 0


@pytest.mark.parametrize("stop", [Command.interrupt, lambda c: c.process.terminate()], ids=["Ctrl-C", "SIGTERM"])
def test_a_busy_script_keeps_nobody_from_ending_the_flight(stop: Callable[[Command], None], tmp_path: Path) -> None:
    path = tmp_path / "busy.py"
    path.write_text(script("import time", "t = time.monotonic()", "while True: pass"))
    flying = Command("fly", str(path), "--no-replay", "--out", str(tmp_path), "--port-offset", str(next_offset()))
    until = time.monotonic() + 60
    while not list(tmp_path.glob("*.part")) and time.monotonic() < until:
        time.sleep(0.1)
    time.sleep(2.0)
    stop(flying)
    code, out, err = flying.wait(30)
    assert code in (1, 130)
    assert "Traceback" not in out + err
