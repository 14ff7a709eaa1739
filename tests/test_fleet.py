"""The bridge's protocol side against vehicles that the test plays, one message at a time."""

from typing import Any

import numpy as np
import pytest

from bridge.fleet import HOLD, OFFBOARD, Fleet, Stage
from bridge.observe import Observer
from bridge.wire.values import (
    CableShape,
    Command,
    CommandAck,
    Heartbeat,
    LandedState,
    ParamRequestRead,
    ParamValue,
    PayloadState,
    StatusText,
    VehicleAttitude,
    VehiclePosition,
)
from cablequad.state import State, positions
from cablequad.system import System


class Played:
    """Vehicles that do what is asked, except what the test takes from them."""

    def __init__(self, n: int = 2) -> None:
        self.fleet = Fleet([25.0] * n, 0.004)
        self.n, self.now = n, 0.0
        self.mode, self.armed = [0] * n, [False] * n
        self.silent: set[int] = set()
        self.deaf_to: set[int] = set()  # command numbers nobody answers
        self.refuses: dict[int, tuple[int, str]] = {}
        self.asked: list[tuple[int | None, Any]] = []

    def say(self, vehicle: int, value: Any) -> None:
        if vehicle not in self.silent:
            self.fleet.feed(vehicle, 1, value, self.now)

    def step(self, dt: float = 0.02) -> None:
        self.now += dt
        self.fleet.observed(self.now, [0.0] * self.n)
        for system, value in self.fleet.due(self.now):
            self.asked.append((system, value))
            if system is not None:
                self._answer(system, value)
        if int(self.now / 0.5) != int((self.now - dt) / 0.5):
            self.beat()

    def beat(self) -> None:
        self.fleet.feed(200, 191, Heartbeat(18, 8, 0, 0, 4), self.now)
        for i in range(self.n):
            self.say(i + 1, Heartbeat(2, 12, 1 | 128 * self.armed[i], self.mode[i], 4))

    def _answer(self, system: int, value: Any) -> None:
        i = system - 1
        if isinstance(value, ParamRequestRead):
            self.say(system, ParamValue(value.name, 0.0, 9, 1, 0))
        if not isinstance(value, Command) or value.command in self.deaf_to:
            return
        result, text = self.refuses.get(value.command, (0, ""))
        if text:
            self.say(system, StatusText(2, text))
        self.say(system, CommandAck(value.command, result, 250, 191))
        if result == 0 and value.command == 176:
            self.mode[i] = OFFBOARD if value.params[1] == 6 else HOLD
        if result == 0 and value.command == 400:
            self.armed[i] = True

    def until(self, done: Any, limit: float = 30.0) -> None:
        while not done() and self.fleet.failure is None and self.now < limit:
            self.step()

    def fly(self) -> None:
        self.beat()
        self.until(lambda: all(self.armed))
        for i in range(self.n):
            self.say(i + 1, LandedState(2))
        self.step()


def test_vehicles_are_brought_up_stage_by_stage_and_fly_together() -> None:
    p = Played()
    p.fly()
    assert p.fleet.failure is None
    assert p.fleet.flying
    kinds = [(system, v.command) for system, v in p.asked if isinstance(v, Command)]
    assert max(k for k, (_, c) in enumerate(kinds) if c == 511) < min(k for k, (_, c) in enumerate(kinds) if c == 176)
    assert max(k for k, (_, c) in enumerate(kinds) if c == 176) < min(k for k, (_, c) in enumerate(kinds) if c == 400)


def test_every_request_names_its_vehicle_and_component_one() -> None:
    p = Played()
    p.fly()
    for system, value in p.asked:
        if system is not None:
            assert (value.system, value.component) == (system, 1)


def test_own_heartbeat_goes_out_once_a_second() -> None:
    p = Played()
    p.fly()
    beats = sum(isinstance(v, Heartbeat) for _, v in p.asked)
    assert beats == pytest.approx(p.now, abs=1.5)


def test_setpoints_flow_a_second_before_offboard_is_asked_for() -> None:
    p = Played()
    p.beat()
    p.until(lambda: any(isinstance(v, Command) and v.command == 176 for _, v in p.asked))
    assert p.now >= 1.0


@pytest.mark.parametrize(
    ("command", "text"),
    [(511, "its streams"), (176, "mode OFFBOARD"), (400, "arming")],
)
def test_a_request_nobody_answers_ends_with_what_was_waited_for(command: int, text: str) -> None:
    p = Played()
    p.deaf_to.add(command)
    p.fly()
    assert p.fleet.failure is not None
    assert p.fleet.failure.startswith("vehicle 1: waited 8 s for")
    assert text in p.fleet.failure


def test_a_refusal_is_told_with_the_vehicles_own_words() -> None:
    p = Played()
    p.refuses[400] = (1, "Arming denied: Resolve system health failures first")
    p.fly()
    assert "Arming denied: Resolve system health failures first" in (p.fleet.failure or "")


def test_lost_acks_are_asked_for_again() -> None:
    p = Played()
    p.deaf_to = {176}
    p.beat()
    p.until(lambda: p.now > 3.0)
    p.deaf_to = set()
    p.fly()
    assert p.fleet.flying


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda p: p.mode.__setitem__(1, HOLD), "vehicle 2 left OFFBOARD"),
        (lambda p: p.armed.__setitem__(1, False), "vehicle 2 disarmed in flight"),
        (lambda p: p.silent.add(2), "vehicle 2 is silent since t ="),
    ],
)
def test_a_vehicle_that_leaves_in_flight_is_named(change: Any, text: str) -> None:
    p = Played()
    p.fly()
    change(p)
    p.until(lambda: False, p.now + 6)
    assert text in (p.fleet.failure or "")


def test_at_the_end_every_vehicle_is_asked_to_hold_until_it_does() -> None:
    p = Played()
    p.fly()
    p.fleet.hold(p.now)
    assert not p.fleet.at_rest
    p.until(lambda: p.fleet.at_rest)
    assert p.mode == [HOLD, HOLD]
    assert p.fleet.failure is None


def test_a_vehicle_that_hangs_elsewhere_than_its_cable_says_is_not_flown() -> None:
    p = Played()
    p.beat()
    p.until(lambda: p.fleet.stages[0] is Stage.SETPOINTS)
    p.fleet.observed(p.now, [0.1, 0.9])
    assert "vehicle 2 reports a position 0.90 m from where its cable puts it" in (p.fleet.failure or "")


def test_other_autopilots_are_refused_by_name() -> None:
    p = Played()
    p.fleet.feed(1, 1, Heartbeat(2, 3, 81, 0, 3), 0.0)
    assert "vehicle 1 is autopilot type 3" in (p.fleet.failure or "")


def test_unheard_lists_vehicles_and_tracker() -> None:
    p = Played()
    assert p.fleet.unheard() == ["vehicle 1", "vehicle 2", "the payload tracker"]
    p.say(2, Heartbeat(2, 12, 29, 0, 3))
    assert p.fleet.unheard() == ["vehicle 1", "the payload tracker"]


class TestObserver:
    """What belongs to one instant is put together, whatever the order and the gaps."""

    def parts(self, boot_ms: int, x0: float = 0.0) -> list[tuple[int, Any]]:
        system = System.paper(1)
        s = State.hanging(system, (x0, 0.0, 0.0))
        x = positions(system, s)[:, 0]
        out: list[tuple[int, Any]] = [(200, PayloadState(boot_ms * 1000, s.x0, s.v0, s.R0, s.Omega0))]
        for i in range(4):
            out.append((i + 1, VehicleAttitude(boot_ms, s.R[i], s.Omega[i])))
            out.append((i + 1, VehiclePosition(boot_ms, x[i], np.zeros(3))))
            out.append((200, CableShape(boot_ms * 1000, i + 1, 5, 0, 1.2, s.q[i], s.omega[i])))
        return out

    def test_an_instant_is_complete_in_any_order(self) -> None:
        for seed in range(20):
            observer = Observer(System.paper(1))
            parts = self.parts(8, 1.5)
            for k in np.random.default_rng(seed).permutation(len(parts)):
                observer.feed(*parts[k])
            instant = observer.take()
            assert instant is not None
            assert instant.boot_ms == 8
            assert instant.state.x0[0] == 1.5
            assert observer.take() is None

    @pytest.mark.parametrize("missing", range(0, 13))
    def test_what_is_missing_makes_no_state_except_a_vehicles_own_position(self, missing: int) -> None:
        observer = Observer(System.paper(1))
        parts = self.parts(8)
        for k, part in enumerate(parts):
            if k != missing:
                observer.feed(*part)
        only_a_check = isinstance(parts[missing][1], VehiclePosition)
        assert (observer.take() is not None) is only_a_check

    def test_the_newest_complete_instant_is_taken_and_older_ones_forgotten(self) -> None:
        observer = Observer(System.paper(1))
        for ms in (4, 8, 12):
            for part in self.parts(ms, ms):
                observer.feed(*part)
        instant = observer.take()
        assert instant is not None
        assert instant.boot_ms == 12
        for part in self.parts(8, 8):
            observer.feed(*part)
        assert observer.take() is None

    def test_foreign_cables_and_lengths_are_left_out(self) -> None:
        observer = Observer(System.paper(1))
        for source, value in self.parts(8):
            if isinstance(value, CableShape) and value.cable == 2:
                value = value._replace(n_links=6)
            observer.feed(source, value)
        observer.feed(200, CableShape(8000, 9, 5, 0, 1.0, np.eye(3), np.eye(3)))
        assert observer.take() is None

    def test_a_clock_that_goes_back_starts_anew(self) -> None:
        observer = Observer(System.paper(1))
        for ms in (100_000, 4):
            for part in self.parts(ms):
                observer.feed(*part)
            instant = observer.take()
            assert instant is not None
            assert instant.boot_ms == ms
