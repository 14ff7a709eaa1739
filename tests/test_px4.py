"""The PX4 persona: one table a behaviour, against messages and a clock that the test turns."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.wire.dialect import mavlink
from bridge.wire.messages import param_bits, param_int, reread
from bridge.wire.telemetry import Home, Snapshot
from bridge.wire.values import (
    IN_AIR,
    AttitudeTarget,
    Command,
    CommandAck,
    Heartbeat,
    MissionRequestList,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    Ping,
    ServerVersion,
    SetMode,
    StatusText,
    Timesync,
)
from cablequad import lie
from sitl.firmware.px4 import Px4

OFFBOARD, LOITER, POSCTL = 6 << 16, 4 << 16 | 3 << 24, 3 << 16
LEVEL = (1.0, 0.0, 0.0, 0.0)
TICK = 4000


class Bench:
    """A vehicle on a table, its clock in our hand."""

    def __init__(self) -> None:
        self.vehicle = Px4(1, TICK, (False, True, True), 25.0)
        self.now = 0
        self.R, self.Omega = np.eye(3), np.zeros(3)
        self.heard: list[Any] = []

    def tick(self, ticks: int = 1, target: AttitudeTarget | None = None) -> None:
        for _ in range(ticks):
            self.now += TICK
            if target is not None:
                self.send(target)
            self.vehicle.tick(self.now)
            s = Snapshot(
                self.now, self.R, self.Omega, np.zeros(3), np.zeros(3), np.zeros(3), 0.0, False, 1,
                (self.R, self.Omega, 0.0), Home(),
            )  # fmt: skip
            self.act = self.vehicle.actuation(s)
            out = self.vehicle.outgoing(self.vehicle.snapshot(s), (True, False, False))
            self.heard += [reread(o.message) for o in out if o.link in (0, None)]

    def send(self, value: object) -> None:
        self.vehicle.handle(0, 255, 190, value, self.now)

    def command(self, number: int, *params: float, system: int = 1, component: int = 1) -> list[int]:
        """Results acknowledged for a command."""
        self.heard.clear()
        p = (*params, *([0.0] * (7 - len(params))))
        self.send(Command(system, component, number, p[:7]))  # type: ignore[arg-type]
        self.tick()
        return [a.result for a in self.heard if isinstance(a, CommandAck) and a.command == number]

    def texts(self) -> list[str]:
        said: list[str] = []
        for h in self.heard:
            if isinstance(h, StatusText):
                said += [h.text] if h.chunk == 0 else [said.pop() + h.text]
        return said

    def beat(self) -> Heartbeat:
        """The next heartbeat, with setpoints held as they are."""
        self.heard.clear()
        self.tick(251)
        return next(h for h in self.heard if isinstance(h, Heartbeat))


def target(**changes: Any) -> AttitudeTarget:
    return AttitudeTarget(0, 1, 1, 7, LEVEL, (0.0, 0.0, 0.0), 0.6)._replace(**changes)


def flying() -> Bench:
    """In OFFBOARD, armed, in the air."""
    bench = Bench()
    bench.tick(10, target())
    bench.command(176, 1, 6)
    bench.command(400, 1)
    bench.vehicle.set_landed(IN_AIR)
    bench.tick(1, target())
    bench.heard.clear()
    return bench


def test_disarmed_loiter_is_what_a_fresh_vehicle_shows() -> None:
    assert Bench().beat() == Heartbeat(2, 12, 29, LOITER, 3)


def test_mode_changes_are_acked_twice_and_show_in_the_heartbeat() -> None:
    bench = Bench()
    bench.tick(5, target())
    assert bench.command(176, 1, 6) == [0, 0]
    assert bench.beat().custom_mode == OFFBOARD


def test_offboard_heartbeats_show_stream_and_arming() -> None:
    bench = flying()
    bench.heard.clear()
    bench.tick(251, target())
    beat = next(h for h in bench.heard if isinstance(h, Heartbeat))
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (145, OFFBOARD, 4)


@pytest.mark.parametrize(
    ("params", "acks"),
    [((1, 99), [0, 0]), ((1, 4, 99), [0, 1]), ((1, 4, 3), [0, 0]), ((1, 3), [0, 0]), ((1, math.nan), [0, 0])],
)
def test_do_set_mode_answers_as_the_firmware_does(params: tuple[float, ...], acks: list[int]) -> None:
    bench = Bench()
    assert bench.command(176, *params) == acks


def test_set_mode_message_is_acked_once() -> None:
    bench = Bench()
    bench.tick(5, target())
    bench.heard.clear()
    bench.send(SetMode(1, 1, OFFBOARD))
    bench.tick()
    assert [a for a in bench.heard if isinstance(a, CommandAck)] == [CommandAck(176, 0, 255, 190)]


def test_offboard_in_flight_needs_setpoints() -> None:
    bench = flying()
    bench.command(176, 1, 4, 3)
    bench.tick(300)
    assert bench.command(176, 1, 6) == [0, 1]
    assert "Switching to Offboard is currently not available" in bench.texts()


def test_arming_in_offboard_without_a_stream_is_denied_with_its_reason() -> None:
    bench = Bench()
    assert bench.command(176, 1, 6) == [0, 0]  # disarmed, any mode may be entered
    assert bench.command(400, 1) == [1]
    assert "Arming denied: Resolve system health failures first" in bench.texts()
    assert bench.command(400, 1, 21196) == [1]  # forcing from outside skips nothing


@pytest.mark.parametrize(("wish", "acks"), [(1.0, [0]), (2.0, []), (math.nan, []), (0.0, [0])])
def test_arm_command_values(wish: float, acks: list[int]) -> None:
    assert Bench().command(400, wish) == acks


def test_disarming_in_the_air_needs_the_magic_number() -> None:
    bench = flying()
    assert bench.command(400, 0) == [1]
    assert bench.vehicle.armed
    assert bench.command(400, 0, 21196) == [0]
    bench.tick()
    assert not bench.vehicle.armed
    assert bench.act.throttle == 0.0


def test_an_idle_vehicle_disarms_after_ten_seconds() -> None:
    bench = Bench()
    bench.command(400, 1)
    bench.tick(2400)
    assert bench.vehicle.armed
    bench.tick(150)
    assert not bench.vehicle.armed


def test_setpoint_loss_fails_over_after_one_second_and_comes_back_by_itself() -> None:
    bench = flying()
    bench.tick(240)
    assert bench.vehicle.mode.custom == OFFBOARD
    bench.tick(20)
    beat = bench.beat()
    assert (beat.custom_mode, beat.system_status) == (POSCTL, 5)
    bench.tick(1, target())
    assert bench.vehicle.mode.custom == OFFBOARD


@pytest.mark.parametrize("offset", [0, 1, 2, 3])
def test_one_and_a_quarter_hertz_holds_offboard_and_less_than_one_does_not(offset: int) -> None:
    bench = flying()
    for _ in range(4):
        bench.tick(200 + offset)
        assert bench.vehicle.mode.custom == OFFBOARD
        bench.tick(1, target())
    bench.tick(260)
    assert bench.vehicle.mode.custom == POSCTL


@pytest.mark.parametrize(
    ("system", "component", "obeyed"), [(1, 1, True), (1, 0, True), (0, 1, False), (2, 1, False), (1, 200, False)]
)
def test_setpoints_are_obeyed_only_by_the_vehicle_they_name(system: int, component: int, obeyed: bool) -> None:
    bench = Bench()
    bench.tick(1, target(system=system, component=component))
    assert bench.vehicle.fresh_setpoint(bench.now) is obeyed


def test_commands_to_system_zero_or_to_others_are_not_answered() -> None:
    for system, component in [(0, 1), (2, 1), (1, 200)]:
        assert Bench().command(400, 1, system=system, component=component) == []


ROLLED = lie.exp(np.array([0.2, 0.0, 0.0]))
ROLLED_QUAT = tuple(lie.quat_from_rotation(ROLLED).tolist())


@pytest.mark.parametrize("scale", [1.0, 2.0, -1.0, 0.1])
def test_quaternions_of_any_norm_and_sign_are_the_same_setpoint(scale: float) -> None:
    bench = flying()
    bench.tick(1, target(quat_wxyz=tuple(scale * c for c in ROLLED_QUAT)))
    np.testing.assert_allclose(bench.act.R_c, ROLLED, rtol=0, atol=1e-12)


@pytest.mark.parametrize("quat", [(0.0,) * 4, (math.nan,) * 4, (1.0, math.inf, 0.0, 0.0)])
def test_an_invalid_quaternion_leaves_the_attitude_to_drift_and_says_so(quat: tuple) -> None:
    bench = flying()
    bench.Omega = np.array([0.1, -0.2, 0.3])
    bench.tick(2, target(quat_wxyz=quat))
    assert bench.act.rate_only
    np.testing.assert_array_equal(bench.act.Omega_c, bench.Omega)
    assert bench.act.throttle == 0.6
    assert "Offboard: invalid quaternion, attitude uncontrolled" in bench.texts()


@pytest.mark.parametrize(
    ("change", "throttle", "text"),
    [
        ({"thrust": math.nan}, 0.0, "not finite, motors off"),
        ({"type_mask": 7 | 64}, 0.0, "throttle ignored by type mask, motors off"),
        ({"thrust": 1.7}, 1.0, ""),
        ({"thrust": -0.4}, 0.0, ""),
    ],
)
def test_thrust_is_a_motor_command_and_its_dangers_are_told(change: dict, throttle: float, text: str) -> None:
    bench = flying()
    bench.tick(2, target(**change))
    assert bench.act.throttle == throttle
    assert any(text in t for t in bench.texts()) or not text


def test_type_mask_decides_between_attitude_rates_and_feed_forward() -> None:
    bench = flying()
    rates = (0.1, 0.2, 0.3)
    bench.tick(1, target(type_mask=7, rates=rates))
    assert not bench.act.rate_only
    np.testing.assert_array_equal(bench.act.Omega_c, 0.0)
    bench.tick(1, target(type_mask=3, rates=rates, quat_wxyz=ROLLED_QUAT))
    np.testing.assert_allclose(bench.act.Omega_c, ROLLED.T @ [0.0, 0.0, 0.3], rtol=0, atol=1e-12)
    bench.tick(1, target(type_mask=128, rates=rates))
    assert bench.act.rate_only
    np.testing.assert_allclose(bench.act.Omega_c, rates, rtol=0, atol=1e-12)
    bench.Omega = np.array([0.5, 0.5, 0.5])
    bench.tick(1, target(type_mask=128, rates=(math.nan, 0.2, math.nan)))
    np.testing.assert_allclose(bench.act.Omega_c, [0.5, 0.2, 0.5], rtol=0, atol=1e-12)


def test_outside_offboard_a_setpoint_only_refreshes_the_signal() -> None:
    bench = Bench()
    bench.command(400, 1)
    bench.tick(5, target(quat_wxyz=ROLLED_QUAT, thrust=0.9))
    assert abs(bench.act.R_c[1, 2]) < 0.05
    assert bench.vehicle.fresh_setpoint(bench.now)


@given(st.floats(0, 1), st.floats(0, 1))
def test_thrust_model_factor_is_inverted_by_the_bridges_thrust_law(force: float, factor: float) -> None:
    """fac x^2 + (1 - fac) x = field, F = F_max x^2: newtons asked are newtons made."""
    from bridge.thrust import ThrustLaw

    vehicle = Px4(1, TICK, (False,), 25.0)
    vehicle.parameters.write(ParamSet(1, 1, "THR_MDL_FAC", factor, 9))
    law = ThrustLaw(25.0, factor)
    made = 25.0 * vehicle._motor_command(law.field(25.0 * force)) ** 2
    assert made == pytest.approx(25.0 * force, rel=0, abs=1e-5)


class TestParameters:
    """The parameter protocol, with PX4's bytewise integers."""

    def ask(self, bench: Bench, request: object, ticks: int = 1) -> list[ParamValue]:
        bench.heard.clear()
        bench.send(request)
        bench.tick(ticks)
        return [h for h in bench.heard if isinstance(h, ParamValue)]

    def test_the_list_is_complete_and_numbered(self) -> None:
        values = self.ask(Bench(), ParamRequestList(1, 1), 20)
        assert sorted(v.number for v in values) == list(range(values[0].total))
        assert len({v.name for v in values}) == values[0].total

    def test_integers_read_as_their_bits(self) -> None:
        (value,) = self.ask(Bench(), ParamRequestRead(1, 1, "MAV_SYS_ID"))
        assert param_int(value.value) == 1
        assert value.value == pytest.approx(1.4e-45, rel=1e-1)

    def test_writing_is_answered_with_what_stands(self) -> None:
        bench = Bench()
        (value,) = self.ask(bench, ParamSet(1, 1, "COM_OF_LOSS_T", 2.5, 9))
        assert value.value == 2.5
        assert bench.vehicle.parameters["COM_OF_LOSS_T"] == 2.5
        (value,) = self.ask(bench, ParamSet(1, 1, "COM_OBL_RC_ACT", param_bits(4), 6))
        assert param_int(value.value) == 4

    @pytest.mark.parametrize(("value", "type"), [(math.nan, 9), (-5.0, 9), (1e9, 9), (1.0, 6)])
    def test_values_that_do_not_fit_change_nothing(self, value: float, type: int) -> None:
        (answer,) = self.ask(Bench(), ParamSet(1, 1, "COM_OF_LOSS_T", value, type))
        assert answer.value == 1.0

    def test_unknown_names_get_silence(self) -> None:
        assert self.ask(Bench(), ParamRequestRead(1, 1, "NO_SUCH")) == []
        assert self.ask(Bench(), ParamSet(1, 1, "NO_SUCH", 1.0, 9)) == []
        assert self.ask(Bench(), ParamRequestRead(1, 1, "", 9999)) == []


def test_streams_run_at_their_rates_and_follow_set_message_interval() -> None:
    bench = Bench()
    bench.tick(2)

    def count(msgid: int) -> int:
        total = 0
        for _ in range(250):
            bench.now += TICK
            s = Snapshot(
                bench.now, bench.R, bench.Omega, np.zeros(3), np.zeros(3), np.zeros(3), 0.0, False, 1,
                (bench.R, bench.Omega, 0.0), Home(),
            )  # fmt: skip
            out = bench.vehicle.outgoing(s, (True, True, False))
            total += sum(o.message.msgid == msgid and o.link in (0, None) for o in out)
        return total

    assert count(30) == pytest.approx(100, abs=3)
    assert count(31) == pytest.approx(50, abs=2)
    assert bench.command(511, 31, 4000) == [0]
    assert count(31) == 250
    assert bench.command(511, 31, -1) == [0]
    assert count(31) == 0
    assert bench.command(511, 31, 0) == [0]
    assert count(31) == pytest.approx(50, abs=2)
    assert bench.command(511, 0, -1) == [4]  # HEARTBEAT is nobody's to stop
    assert bench.command(511, 9999, 1000) == [4]
    assert bench.command(511, math.nan, 1000) == [4]
    assert count(0) == 1


def test_the_attitude_quaternion_closes_every_tick() -> None:
    bench = Bench()
    for _ in range(200):
        bench.heard.clear()
        bench.tick()
        kinds = [type(h).__name__ for h in bench.heard]
        assert "VehicleAttitude" not in kinds[:-1]


def test_services_answer() -> None:
    bench = Bench()
    bench.tick(3)
    bench.heard.clear()
    for request in (Timesync(0, 77), Ping(5, 6, 0, 0), MissionRequestList(1, 1)):
        bench.send(request)
    assert bench.command(512, 148) == [0]
    assert bench.command(520) == [0]
    assert bench.command(31000) == [3]
    bench.send(Timesync(0, 78))
    bench.tick()
    assert any(isinstance(h, Timesync) and h.ts1 == 78 and h.tc1 > 0 for h in bench.heard)
    bench.command(512, 148)
    assert any(isinstance(h, ServerVersion) and h.capabilities == 0xE8FF for h in bench.heard)
    assert bench.command(512, 242) == [0]
    assert bench.command(512, 9999) == [2]
    assert mavlink.MAV_CMD_REQUEST_MESSAGE == 512
