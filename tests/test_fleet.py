"""The bridge's protocol side against vehicles that the test plays, one message at a time."""

from typing import Any

import numpy as np
import pytest
from workbench import CMD_ARM, CMD_INTERVAL, CMD_SET_MODE

from bridge.fleet.fleet import Fleet, FleetOptions
from bridge.fleet.profiles import PROFILES
from bridge.fleet.thrust import ThrustScale, made_thrust_N
from bridge.fleet.vehicle import Request, Stage
from bridge.loop.state_assembly import LoopModel, StateAssembler
from bridge.loop.thrust_comparison import ThrustComparison
from bridge.loop.tick_barrier import TickBarrier
from bridge.mission.observation import Observation
from bridge.mission.protection.fault_detection import FaultDetector, FaultInputs
from bridge.wire.values import (
    CableShape,
    Command,
    CommandAck,
    Heartbeat,
    Imu,
    LandedState,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    PayloadState,
    StatusText,
    Timesync,
    VehicleAttitude,
    VehiclePosition,
)
from cablequad.control.estimator import estimator
from cablequad.model import lie
from cablequad.model.attitude import Airframe, Setpoint, flown
from cablequad.model.noise import Noise
from cablequad.model.state import State, positions
from cablequad.model.system import System

PX4, ARDUCOPTER = 12, 3


class Played:
    """Vehicles that do what is asked, except what the test takes from them."""

    def __init__(self, n: int = 2, autopilot: int = PX4, configure: bool = True) -> None:
        self.fleet = Fleet([25.0] * n, 0.004, FleetOptions(configure))
        self.autopilot, self.profile = autopilot, PROFILES[autopilot]
        self.parameters = {"THR_MDL_FAC": 0.0, "GUID_OPTIONS": 0.0, "ATC_ANGLE_BOOST": 1.0}
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
            self.say(i + 1, Heartbeat(2, self.autopilot, 1 | 128 * self.armed[i], self.mode[i], 4))

    def _answer(self, system: int, value: Any) -> None:
        i = system - 1
        if isinstance(value, ParamRequestRead):
            self.say(system, ParamValue(value.name, self.parameters[value.name], 9, 1, 0))
        if isinstance(value, ParamSet):
            self.parameters[value.name] = value.value
            self.say(system, ParamValue(value.name, value.value, 9, 1, 0))
        if not isinstance(value, Command) or value.command in self.deaf_to:
            return
        result, text = self.refuses.get(value.command, (0, ""))
        if text:
            self.say(system, StatusText(2, text))
        self.say(system, CommandAck(value.command, result, 250, 191))
        if result == 0 and value.command == CMD_SET_MODE:
            control = value.params[: len(self.profile.control[2])] == self.profile.control[2]
            self.mode[i] = (self.profile.control if control else self.profile.hold)[1]
        if result == 0 and value.command == CMD_ARM:
            self.armed[i] = True

    def until(self, done: Any, limit: float = 90.0) -> None:
        while not done() and self.fleet.failure is None and self.now < limit:
            self.step()

    def fly(self) -> None:
        self.beat()
        self.until(lambda: all(self.armed), self.now + 90.0)
        for i in range(self.n):
            self.say(i + 1, LandedState(2))
        self.step()


@pytest.mark.parametrize("autopilot", [PX4, ARDUCOPTER])
def test_vehicles_are_brought_up_stage_by_stage_and_fly_together(autopilot: int) -> None:
    p = Played(autopilot=autopilot)
    p.fly()
    assert p.fleet.failure is None
    assert p.fleet.flying
    kinds = [(system, v.command) for system, v in p.asked if isinstance(v, Command)]
    assert max(k for k, (_, c) in enumerate(kinds) if c == CMD_INTERVAL) < min(
        k for k, (_, c) in enumerate(kinds) if c == CMD_SET_MODE
    )
    assert max(k for k, (_, c) in enumerate(kinds) if c == CMD_SET_MODE) < min(
        k for k, (_, c) in enumerate(kinds) if c == CMD_ARM
    )


def test_every_request_names_its_vehicle_and_component_one() -> None:
    p = Played()
    p.fly()
    addressed = [(system, value) for system, value in p.asked if system is not None]
    assert {system for system, _ in addressed} == {1, 2}
    assert all((value.system, value.component) == (system, 1) for system, value in addressed)


def test_own_heartbeat_goes_out_once_a_second() -> None:
    p = Played()
    p.fly()
    beats = sum(isinstance(v, Heartbeat) for _, v in p.asked)
    assert beats == pytest.approx(p.now, abs=1.5)


def test_setpoints_flow_a_second_before_offboard_is_asked_for() -> None:
    p = Played()
    p.beat()
    p.until(lambda: any(isinstance(v, Command) and v.command == CMD_SET_MODE for _, v in p.asked))
    assert p.now >= 1.0


@pytest.mark.parametrize(
    ("command", "text"),
    [(511, "8 s for its streams"), (176, "8 s for mode OFFBOARD"), (400, "30 s for arming")],
)
def test_a_request_nobody_answers_ends_with_what_was_waited_for(command: int, text: str) -> None:
    p = Played()
    p.deaf_to.add(command)
    p.fly()
    assert p.fleet.failure is not None
    assert p.fleet.failure.startswith(f"vehicle 1: waited {text}")


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
        (lambda p: p.mode.__setitem__(1, p.profile.hold[1]), "vehicle 2 left OFFBOARD"),
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


@pytest.mark.parametrize("begins", [4.0, 3600.0])
def test_a_clock_that_is_heard_late_makes_nobody_silent_or_slow(begins: float) -> None:
    p = Played()
    p.fleet.feed(1, 1, Heartbeat(2, PX4, 81, 0, 3), 0.0)  # before the tracker says what time it is
    p.now = begins
    p.fleet.due(begins)
    assert p.fleet.failure is None
    p.fly()
    assert p.fleet.flying


def test_a_clock_that_pauses_makes_nobody_silent_and_who_is_silent_is_named_all_the_same() -> None:
    p = Played()
    p.fly()
    p.now += 10.0
    p.fleet.due(p.now)
    assert p.fleet.failure is None
    p.silent.add(2)
    p.until(lambda: False, p.now + 6)
    assert "vehicle 2 is silent since t =" in (p.fleet.failure or "")


@pytest.mark.parametrize("autopilot", [PX4, ARDUCOPTER])
def test_at_the_end_every_vehicle_is_asked_to_hold_until_it_does(autopilot: int) -> None:
    p = Played(autopilot=autopilot)
    p.fly()
    p.fleet.hold(p.now)
    assert not p.fleet.at_rest
    p.until(lambda: p.fleet.at_rest)
    assert p.mode == [p.profile.hold[1]] * 2
    assert p.fleet.failure is None


def test_a_vehicle_that_hangs_elsewhere_than_its_cable_says_is_not_flown() -> None:
    p = Played()
    p.beat()
    p.until(lambda: p.fleet.stages[0] is Stage.SETPOINTS)
    p.fleet.observed(p.now, [0.1, 0.9])
    assert "vehicle 2 reports a position 0.90 m from where its cable puts it" in (p.fleet.failure or "")


def test_other_autopilots_are_refused_by_name() -> None:
    p = Played()
    p.fleet.feed(1, 1, Heartbeat(2, 18, 81, 0, 3), 0.0)
    assert "vehicle 1 is autopilot type 18; PX4 (12) and ArduCopter (3) can be flown" in (p.fleet.failure or "")


def test_an_arducopter_that_reads_thrust_as_climb_rate_is_set_or_named() -> None:
    p = Played(autopilot=ARDUCOPTER)
    p.fly()
    assert p.parameters["GUID_OPTIONS"] == 8
    q = Played(autopilot=ARDUCOPTER, configure=False)
    q.fly()
    assert "vehicle 1: GUID_OPTIONS is 0, so thrust would mean climb rate; set it to 8" in (q.fleet.failure or "")


def test_an_arducopter_is_given_the_time_its_estimator_takes() -> None:
    p = Played(autopilot=ARDUCOPTER)
    p.refuses[400] = (4, "Arm: Need Position Estimate")
    p.beat()
    p.until(lambda: p.now > 40)
    assert p.fleet.failure is None
    del p.refuses[400]
    p.fly()
    assert p.fleet.flying


def test_a_vehicle_that_disarms_while_it_waits_for_the_others_is_armed_again() -> None:
    p = Played()
    p.beat()
    p.until(lambda: all(stage is Stage.FLY for stage in p.fleet.stages))
    p.armed[0] = False
    p.beat()
    p.until(lambda: p.armed[0], p.now + 5)
    assert p.armed[0]
    assert p.fleet.failure is None


def test_a_vehicle_that_reboots_is_named_with_both_times() -> None:
    p = Played()
    p.fly()
    p.say(2, VehicleAttitude.of(54_000, np.eye(3), np.zeros(3)))
    p.say(2, VehicleAttitude.of(54_004, np.eye(3), np.zeros(3)))
    assert p.fleet.failure is None
    p.say(2, VehicleAttitude.of(120, np.eye(3), np.zeros(3)))
    assert p.fleet.failure == "vehicle 2 rebooted: its clock went back from 54.00 s to 0.12 s"


def test_a_vehicle_that_asks_for_the_time_is_told() -> None:
    p = Played()
    p.fly()
    p.say(2, Timesync(0, 77))
    p.say(2, Timesync(5, 77))  # an answer, not a question
    answers = [r for r in p.fleet.due(p.now) if isinstance(r.value, Timesync)]
    assert answers == [Request(2, Timesync(round(p.now * 1e9), 77))]


def test_acks_for_somebody_else_and_a_ground_station_on_the_port_change_nothing() -> None:
    p = Played()
    p.beat()
    for _ in range(20):
        p.fleet.feed(1, 1, CommandAck(511, 0, 255, 190), p.now)
        p.fleet.feed(255, 190, Heartbeat(6, 8, 0, 0, 4), p.now)
    assert p.fleet.stages == [Stage.STREAMS] * 2


def test_thrust_scale_is_found_in_flight_with_its_error() -> None:
    """m a = -f + pull: with rotors 10 % weak, a cable's pull and 0.2 m/s^2 of noise, 10 % are found and the error is true."""
    rng = np.random.default_rng(3)
    found = []
    for _ in range(200):
        scale = ThrustScale()
        for _ in range(250):
            asked, pull = rng.uniform(7, 12), rng.uniform(1, 3)
            felt = (pull - 0.9 * asked) / 0.755 + 0.2 * rng.normal()
            scale = scale.seen(asked, made_thrust_N(0.755, felt, pull))
        found.append((scale.scale, scale.error))
    scales, errors = np.array(found).T
    assert scales.mean() == pytest.approx(0.9, abs=2e-4)
    assert errors.mean() == pytest.approx(scales.std(), rel=0.2)


def test_unheard_lists_vehicles_and_tracker() -> None:
    p = Played()
    assert p.fleet.unheard() == ["vehicle 1", "vehicle 2", "the payload tracker"]
    p.say(2, Heartbeat(2, 12, 29, 0, 3))
    assert p.fleet.unheard() == ["vehicle 1", "the payload tracker"]


SYSTEM = System.paper(1)
AIRFRAME = Airframe(np.full(4, 40.0), np.full(4, 0.9), np.full(4, 25.0))
LOOP = LoopModel(SYSTEM, AIRFRAME, 4, 4, 0.001)


def parts(boot_ms: int, s: State) -> list[tuple[int, Any]]:
    """Everything that is said of one instant."""
    x = positions(SYSTEM, s)[:, 0]
    out: list[tuple[int, Any]] = [(200, PayloadState(boot_ms * 1000, s.x0, s.v0, s.R0, s.Omega0))]
    for i in range(4):
        out.append((i + 1, VehicleAttitude.of(boot_ms, s.R[i], s.Omega[i])))
        out.append((i + 1, VehiclePosition(boot_ms, x[i], np.zeros(3))))
        out.append((200, CableShape(boot_ms * 1000, i + 1, 5, 0, 1.2, np.hstack([s.q[i], s.omega[i]]))))
    return out


class TestObserver:
    """What belongs to one instant is put together, whatever the order; what is missing is predicted."""

    def at_rest(self, boot_ms: int, x0: float = 0.0) -> list[tuple[int, Any]]:
        return parts(boot_ms, State.hanging(SYSTEM, (x0, 0.0, 0.0)))

    def test_an_instant_is_complete_in_any_order(self) -> None:
        for seed in range(20):
            observer = StateAssembler(LOOP)
            said = self.at_rest(8, 1.5)
            for k in np.random.default_rng(seed).permutation(len(said)):
                observer.feed(*said[k])
            instant = observer.estimate(8)
            assert instant is not None
            assert (instant.state.x0[0], instant.age_ms) == (1.5, 0)
            np.testing.assert_allclose(instant.position_gap, 0.0, rtol=0, atol=1e-12)

    @pytest.mark.parametrize("missing", range(0, 13))
    def test_before_everything_was_measured_once_there_is_no_state(self, missing: int) -> None:
        observer = StateAssembler(LOOP)
        said = self.at_rest(8)
        for k, part in enumerate(said):
            if k != missing:
                observer.feed(*part)
        only_a_check = isinstance(said[missing][1], VehiclePosition)
        assert (observer.estimate(8) is not None) is only_a_check

    def test_foreign_cables_and_lengths_are_left_out(self) -> None:
        observer = StateAssembler(LOOP)
        for source, value in self.at_rest(8):
            if isinstance(value, CableShape) and value.cable == 2:
                value = value._replace(n_links=6)
            observer.feed(source, value)
        observer.feed(200, CableShape(8000, 9, 5, 0, 1.0, np.hstack([np.eye(3), np.eye(3)])))
        assert observer.estimate(8) is None

    def test_a_clock_that_goes_back_starts_anew(self) -> None:
        observer = StateAssembler(LOOP)
        for ms in (100_000, 4):
            for part in self.at_rest(ms):
                observer.feed(*part)
            instant = observer.estimate(ms)
            assert instant is not None
            assert instant.boot_ms == ms
        assert observer.estimate(100_004) is not None

    def flight(self, ticks: int) -> tuple[list[State], list[Any]]:
        """True states and the setpoints that were flown, a tick after they were computed."""
        rng = np.random.default_rng(8)
        state, states, commands = State.hanging(SYSTEM), [], []
        before = (np.tile(np.eye(3), (4, 1, 1)), np.full(4, 9.2))
        for _ in range(ticks):
            states.append(state)
            now = (np.stack([lie.exp(0.1 * rng.normal(size=3)) for _ in range(4)]), rng.uniform(8, 10, 4))
            commands.append(now)
            state = flown(SYSTEM, AIRFRAME, Setpoint.attitude(*before), state, 0.001, 4)
            before = now
        return states, commands

    @pytest.mark.parametrize("lost", ["vehicle 2", "tracker", "all"])
    def test_what_is_lost_is_predicted_by_the_model_exactly(self, lost: str) -> None:
        """With the true model and no noise, ten lost ticks cost nothing."""
        states, commands = self.flight(40)
        observer = StateAssembler(LOOP)
        observer.released()
        for k, state in enumerate(states):
            for source, value in parts(4 * k, state):
                gone = 20 <= k < 30 and (lost == "all" or (source == 2 if lost == "vehicle 2" else source == 200))
                if not gone:
                    observer.feed(source, value)
            instant = observer.estimate(4 * k)
            assert instant is not None
            assert (instant.age_ms > 0) is (20 <= k < 30)
            for known, true in zip(instant.state, state, strict=True):
                np.testing.assert_allclose(known, true, rtol=0, atol=1e-9)
            observer.commanded(4 * k, *commands[k])

    @pytest.mark.parametrize("late", [1, 3, 9])
    def test_what_comes_late_is_put_where_it_belongs_and_carried_to_now(self, late: int) -> None:
        states, commands = self.flight(60)
        observer = StateAssembler(LOOP)
        observer.released()
        for k in range(60):
            for j, state in ((k - late, states[k - late]),) if k >= late else ():
                for source, value in parts(4 * j, state):
                    observer.feed(source, value)
            instant = observer.estimate(4 * k)
            observer.commanded(4 * k, *commands[k])
            if k > 2 * late + 2:
                assert instant is not None
                assert instant.age_ms == 4 * late
                np.testing.assert_allclose(instant.state.x0, states[k].x0, rtol=0, atol=1e-9)
                np.testing.assert_allclose(instant.state.omega, states[k].omega, rtol=0, atol=1e-7)

    def test_before_the_release_nothing_moves(self) -> None:
        observer = StateAssembler(LOOP)
        for part in self.at_rest(4):
            observer.feed(*part)
        observer.estimate(4)
        observer.commanded(4, np.tile(np.eye(3), (4, 1, 1)), np.zeros(4))
        instant = observer.estimate(400)
        assert instant is not None
        np.testing.assert_array_equal(instant.state.v0, 0.0)


class TestGate:
    """A tick has come when everybody who lives has spoken of it, or somebody has gone on."""

    def say(self, gate: TickBarrier, ms: int, sources: tuple[int, ...]) -> None:
        for source in sources:
            if source == 200:
                gate.feed(200, PayloadState(ms * 1000, np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3)))
            else:
                gate.feed(source, VehicleAttitude.of(ms, np.eye(3), np.zeros(3)))

    def test_it_opens_once_when_the_last_has_spoken(self) -> None:
        gate = TickBarrier(2, 200, 4)
        self.say(gate, 4, (1, 200))
        assert gate.open() is None
        self.say(gate, 4, (2,))
        assert gate.open() == 4
        assert gate.open() is None

    def test_it_opens_late_when_somebody_goes_on_and_no_longer_waits_for_who_is_silent(self) -> None:
        gate = TickBarrier(2, 200, 4)
        self.say(gate, 4, (1, 2, 200))
        gate.open()
        told = []
        for ms in range(8, 60, 4):
            self.say(gate, ms, (1, 200))
            told.append((gate.open(), ms))
        assert told[0] == (None, 8)
        assert told[1] == (8, 12)  # a tick late
        assert told[-1] == (56, 56)  # and in time again, without vehicle 2

    def test_a_trackers_own_map_messages_close_nothing(self) -> None:
        gate = TickBarrier(1, 200, 4)
        gate.feed(200, VehicleAttitude.of(4, np.eye(3), np.zeros(3)))
        self.say(gate, 4, (1,))
        assert gate.open() is None


def test_vehicles_alone_whose_streams_have_phases_of_their_own_are_put_together_all_the_same() -> None:
    """Nothing is ever said of one instant by all of them, and no tracker is listened to."""
    filter = estimator(SYSTEM, AIRFRAME, 0.02, "vehicles", Noise(0.01, 0.02, 0.002, 0.01)).filter
    assembler = StateAssembler(LoopModel(SYSTEM, AIRFRAME, 20, 20, 0.001, filter, "vehicles"))
    s = State.hanging(SYSTEM, (0.3, -0.2, -1.0))
    x = positions(SYSTEM, s)[:, 0]
    for tick in range(0, 60, 20):
        for i in range(4):
            assembler.feed(i + 1, VehicleAttitude.of(tick + 3 * i, s.R[i], s.Omega[i]))
            assembler.feed(i + 1, VehiclePosition(tick + 3 * i, x[i], np.zeros(3)))
    instant = assembler.estimate(60)
    assert instant is not None
    assert instant.state.x0 == pytest.approx(s.x0, abs=1e-3)
    assert instant.age_ms == 20  # the first of them spoke last at 40 ms


class Remembered:
    """What an assembler knows: a tension that rises by 1 N in a tick of 20 ms, and one setpoint."""

    def known(self, boot_ms: int) -> tuple[State, np.ndarray] | None:
        return (State.hanging(SYSTEM), np.full(4, boot_ms / 20)) if boot_ms % 20 == 0 else None

    def acting(self, _: int) -> tuple[np.ndarray, np.ndarray]:
        return np.tile(np.eye(3), (4, 1, 1)), np.full(4, 9.0)


def imu(boot_us: int, made_N: float) -> Imu:
    """What vehicle 1 feels at an instant under a thrust of `made_N`, and its cable."""
    links = float(SYSTEM.m_link[0, :4].sum())
    pull = boot_us / 20_000 + links * SYSTEM.g
    return Imu(boot_us, np.array([0.0, 0.0, (pull - made_N) / float(SYSTEM.m[0])]))


@pytest.mark.parametrize("phase_us", [0, 3_000, 8_000, 19_000])
def test_thrust_is_compared_at_accelerometers_of_any_phase(phase_us: int) -> None:
    comparison = ThrustComparison(LoopModel(SYSTEM, AIRFRAME, 20, 20, 0.001), 4)
    known: Any = Remembered()
    for tick in range(20_000, 400_000, 20_000):
        comparison.take(0, imu(tick + phase_us, 9.0 * 1.02))
        comparison.settle(tick, known, True)
    assert comparison.scales[0].pairs >= 17
    assert comparison.scales[0].scale == pytest.approx(1.02, abs=1e-9)
    assert comparison.scales[1].pairs == 0


def test_an_accelerometer_from_far_ahead_is_not_waited_for() -> None:
    comparison = ThrustComparison(LoopModel(SYSTEM, AIRFRAME, 20, 20, 0.001), 4)
    known: Any = Remembered()
    for _ in range(1000):
        comparison.take(0, imu(2**40, 9.0))
    comparison.settle(20_000, known, True)
    assert not comparison._waiting


@pytest.mark.parametrize(("touches", "hangs", "lost"), [(False, 0.4, True), (True, 0.4, False), (True, 0.1, True)])
def test_a_slack_cable_is_no_loss_while_the_load_touches_the_ground(touches: bool, hangs: float, lost: bool) -> None:
    """A pole that was set down end first left a cable slack, and its vehicle was told to stop its motors in the air."""
    s = State.hanging(SYSTEM)
    ends, lengths = s.x0 + SYSTEM.rho @ s.R0.T, SYSTEM.length.sum(axis=1)
    x = positions(SYSTEM, s)[:, 0].copy()
    x[2, 2] = ends[2, 2] - hangs * lengths[2]  # above its end of the cable
    seen = Observation(s, np.full(4, 1.0), 0.0, x, np.zeros((4, 3)), np.zeros(4))
    detector = FaultDetector()
    inputs = FaultInputs([0, 1, 2, 3], seen, ends, lengths, None, True, {}, set(), touches)
    assert any(detector.look(0.02 * k, inputs) is not None for k in range(200)) is lost


def test_a_load_that_has_lost_a_vehicle_swings_and_leaves_cables_slack() -> None:
    """The next vehicle was given up 0.1 s after its cable went slack; a load that hangs still gives nobody that long."""
    s = State.hanging(SYSTEM)
    ends, lengths = s.x0 + SYSTEM.rho @ s.R0.T, SYSTEM.length.sum(axis=1)
    x = positions(SYSTEM, s)[:, 0].copy()
    x[2, 2] = ends[2, 2] - 0.4 * lengths[2]
    seen = Observation(s, np.full(4, 1.0), 0.0, x, np.zeros((4, 3)), np.zeros(4))
    inputs = FaultInputs([0, 1, 2, 3], seen, ends, lengths, None, True, {}, set())
    detector, waited = FaultDetector(), []
    for begins in (0.0, 1.0, 20.0):  # in the swing that the first loss begins; and once it is over
        detector._since.clear()
        at = next(t for k in range(200) if detector.look(t := begins + 0.02 * k, inputs) is not None)
        waited.append(at - begins)
    assert waited == [pytest.approx(0.08, abs=0.021), pytest.approx(1.5, abs=0.021), pytest.approx(0.08, abs=0.021)]


@pytest.mark.parametrize(("taut", "after_s"), [(True, 0.08), (False, 1.5)])
def test_who_seems_to_be_off_its_cable_must_seem_so_for_longer_while_a_load_topples(taut: bool, after_s: float) -> None:
    """A load that lost one of its vehicles turned over, and another was given up 0.1 s after its cable seemed off."""
    s = State.hanging(SYSTEM)
    x = positions(SYSTEM, s)[:, 0].copy()
    x[2, 2] -= 0.4  # further than its cable is long
    seen = Observation(s, np.full(4, 1.0), 0.0, x, np.zeros((4, 3)), np.zeros(4))
    ends, lengths = s.x0 + SYSTEM.rho @ s.R0.T, SYSTEM.length.sum(axis=1)
    detector, lost_at = FaultDetector(), None
    for k in range(200):
        loss = detector.look(0.02 * k, FaultInputs([0, 1, 2, 3], seen, ends, lengths, None, taut, {}, set()))
        if loss is not None:
            assert loss.member == 2
            lost_at = 0.02 * k
            break
    assert lost_at == pytest.approx(after_s, abs=0.021)
