"""The PX4 persona: one table a behaviour, against messages and a clock that the test turns."""

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from workbench import (
    BODY,
    CMD_ARM,
    CMD_CAPABILITIES,
    CMD_INTERVAL,
    CMD_LAND,
    CMD_REPOSITION,
    CMD_REQUEST,
    CMD_RETURN,
    CMD_SET_MODE,
    CMD_TAKEOFF,
    LINKS,
    ROLLED,
    ROLLED_QUAT,
    TICK,
    Bench,
    Point,
    target,
)

from bridge.fleet.thrust import MotorCommand
from bridge.wire.dialect import mavlink
from bridge.wire.messages import param_bits, param_int
from bridge.wire.values import (
    IN_AIR,
    ON_GROUND,
    CommandAck,
    DataStream,
    FileRefusal,
    FileRequest,
    Heartbeat,
    MissionAck,
    MissionClear,
    MissionCount,
    MissionRequestList,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    Ping,
    PositionTarget,
    ServerVersion,
    SetMode,
    Timesync,
)
from cablequad.model import lie
from cablequad.model.earth import Home, geodetic
from sitl.firmware.px4 import Px4

OFFBOARD, LOITER, POSCTL = 6 << 16, 4 << 16 | 3 << 24, 3 << 16
TAKEOFF, RTL, LAND = 4 << 16 | 2 << 24, 4 << 16 | 5 << 24, 4 << 16 | 6 << 24


def bench(ready_us: int = 0) -> Bench:
    return Bench(Px4(1, TICK, LINKS, BODY, ready_us))


def flying() -> Bench:
    """In OFFBOARD, armed, in the air."""
    b = bench()
    b.tick(10, target())
    b.command(CMD_SET_MODE, 1, 6)
    b.command(CMD_ARM, 1)
    b.vehicle.set_landed(IN_AIR)
    b.vehicle._armed_at_us = -(10**7)  # long since: the motors are up to speed
    b.tick(1, target())
    b.heard.clear()
    return b


def test_disarmed_loiter_is_what_a_fresh_vehicle_shows() -> None:
    assert bench().beat() == Heartbeat(2, 12, 29, LOITER, 3)


def test_mode_changes_are_acked_twice_and_show_in_the_heartbeat() -> None:
    b = bench()
    b.tick(5, target())
    assert b.command(CMD_SET_MODE, 1, 6) == [0, 0]
    assert b.beat().custom_mode == OFFBOARD


def test_offboard_heartbeats_show_stream_and_arming() -> None:
    b = flying()
    beat = b.beat(target())
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (145, OFFBOARD, 4)


@pytest.mark.parametrize(
    ("params", "acks"),
    [((1, 99), [0, 0]), ((1, 4, 99), [0, 1]), ((1, 4, 3), [0, 0]), ((1, 3), [0, 0]), ((1, math.nan), [0, 0])],
)
def test_do_set_mode_answers_as_the_firmware_does(params: tuple[float, ...], acks: list[int]) -> None:
    b = bench()
    assert b.command(CMD_SET_MODE, *params) == acks


def test_set_mode_message_is_acked_once() -> None:
    b = bench()
    b.tick(5, target())
    b.heard.clear()
    b.send(SetMode(1, 1, OFFBOARD))
    b.tick()
    assert [a for a in b.heard if isinstance(a, CommandAck)] == [CommandAck(176, 0, 255, 190)]


def test_offboard_in_flight_needs_setpoints() -> None:
    b = flying()
    b.command(CMD_SET_MODE, 1, 4, 3)
    b.tick(300)
    assert b.command(CMD_SET_MODE, 1, 6) == [0, 1]
    assert "Switching to Offboard is currently not available" in b.texts()


def test_arming_in_offboard_without_a_stream_is_denied_with_its_reason() -> None:
    b = bench()
    assert b.command(CMD_SET_MODE, 1, 6) == [0, 0]  # disarmed, any mode may be entered
    assert b.command(CMD_ARM, 1) == [1]
    assert "Arming denied: Resolve system health failures first" in b.texts()
    assert b.command(CMD_ARM, 1, 21196) == [1]  # forcing from outside skips nothing


@pytest.mark.parametrize(("wish", "acks"), [(1.0, [0]), (2.0, []), (math.nan, []), (0.0, [0])])
def test_arm_command_values(wish: float, acks: list[int]) -> None:
    assert bench().command(CMD_ARM, wish) == acks


def test_disarming_in_the_air_needs_the_magic_number() -> None:
    b = flying()
    assert b.command(CMD_ARM, 0) == [1]
    assert b.vehicle.armed
    assert b.command(CMD_ARM, 0, 21196) == [0]
    b.tick()
    assert not b.vehicle.armed
    assert b.act.throttle == 0.0


def test_an_idle_vehicle_disarms_after_ten_seconds() -> None:
    b = bench()
    b.command(CMD_ARM, 1)
    b.tick(2400)
    assert b.vehicle.armed
    b.tick(150)
    assert not b.vehicle.armed


def test_setpoint_loss_fails_over_after_one_second_and_comes_back_by_itself() -> None:
    b = flying()
    b.tick(240)
    assert b.vehicle.mode.custom == OFFBOARD
    b.tick(20)
    beat = b.beat()
    assert (beat.custom_mode, beat.system_status) == (POSCTL, 5)
    b.tick(1, target())
    assert b.vehicle.mode.custom == OFFBOARD


@pytest.mark.parametrize("offset", [0, 1, 2, 3])
def test_one_and_a_quarter_hertz_holds_offboard_and_less_than_one_does_not(offset: int) -> None:
    b = flying()
    for _ in range(4):
        b.tick(200 + offset)
        assert b.vehicle.mode.custom == OFFBOARD
        b.tick(1, target())
    b.tick(260)
    assert b.vehicle.mode.custom == POSCTL


@pytest.mark.parametrize(
    ("system", "component", "obeyed"), [(1, 1, True), (1, 0, True), (0, 1, False), (2, 1, False), (1, 200, False)]
)
def test_setpoints_are_obeyed_only_by_the_vehicle_they_name(system: int, component: int, obeyed: bool) -> None:
    b = bench()
    b.tick(1, target(system=system, component=component))
    assert b.vehicle.fresh_setpoint(b.now) is obeyed


def test_commands_to_system_zero_or_to_others_are_not_answered() -> None:
    for system, component in [(0, 1), (2, 1), (1, 200)]:
        assert bench().command(CMD_ARM, 1, system=system, component=component) == []


@pytest.mark.parametrize("scale", [1.0, 2.0, -1.0, 0.1])
def test_quaternions_of_any_norm_and_sign_are_the_same_setpoint(scale: float) -> None:
    b = flying()
    b.tick(1, target(quat_wxyz=tuple(scale * c for c in ROLLED_QUAT)))
    np.testing.assert_allclose(b.act.R_c, ROLLED, rtol=0, atol=1e-12)


@pytest.mark.parametrize("quat", [(0.0,) * 4, (math.nan,) * 4, (1.0, math.inf, 0.0, 0.0)])
def test_an_invalid_quaternion_leaves_the_attitude_to_drift_and_says_so(quat: tuple) -> None:
    b = flying()
    b.Omega = np.array([0.1, -0.2, 0.3])
    b.tick(2, target(quat_wxyz=quat))
    assert b.act.rate_only
    np.testing.assert_array_equal(b.act.Omega_c, b.Omega)
    assert b.act.throttle == 0.6
    assert "Offboard: invalid quaternion, attitude uncontrolled" in b.texts()


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
    b = flying()
    b.tick(2, target(**change))
    assert b.act.throttle == throttle
    assert any(text in t for t in b.texts()) or not text


def test_type_mask_decides_between_attitude_rates_and_feed_forward() -> None:
    b = flying()
    rates = (0.1, 0.2, 0.3)
    b.tick(1, target(type_mask=7, rates=rates))
    assert not b.act.rate_only
    np.testing.assert_array_equal(b.act.Omega_c, 0.0)
    b.tick(1, target(type_mask=3, rates=rates, quat_wxyz=ROLLED_QUAT))
    np.testing.assert_allclose(b.act.Omega_c, ROLLED.T @ [0.0, 0.0, 0.3], rtol=0, atol=1e-12)
    b.tick(1, target(type_mask=128, rates=rates))
    assert b.act.rate_only
    np.testing.assert_allclose(b.act.Omega_c, rates, rtol=0, atol=1e-12)
    b.Omega = np.array([0.5, 0.5, 0.5])
    b.tick(1, target(type_mask=128, rates=(math.nan, 0.2, math.nan)))
    np.testing.assert_allclose(b.act.Omega_c, [0.5, 0.2, 0.5], rtol=0, atol=1e-12)


def test_outside_offboard_a_setpoint_only_refreshes_the_signal() -> None:
    b = bench()
    b.command(CMD_ARM, 1)
    b.tick(5, target(quat_wxyz=ROLLED_QUAT, thrust=0.9))
    assert abs(b.act.R_c[1, 2]) < 0.05
    assert b.vehicle.fresh_setpoint(b.now)


@given(st.floats(0, 1), st.floats(0, 1))
def test_thrust_model_factor_is_inverted_by_the_bridges_thrust_law(force: float, factor: float) -> None:
    """fac x^2 + (1 - fac) x = field, F = F_max x^2: newtons asked are newtons made."""
    vehicle = Px4(1, TICK, LINKS, BODY)
    vehicle.parameters.write(ParamSet(1, 1, "THR_MDL_FAC", factor, 9))
    law = MotorCommand(25.0, factor)
    made = 25.0 * vehicle.motor_command(law.field(25.0 * force, 1.0)) ** 2
    assert made == pytest.approx(25.0 * force, rel=0, abs=1e-5)


class TestParameters:
    """The parameter protocol, with PX4's bytewise integers."""

    def ask(self, b: Bench, request: object, ticks: int = 1) -> list[ParamValue]:
        b.heard.clear()
        b.send(request)
        b.tick(ticks)
        return [h for h in b.heard if isinstance(h, ParamValue)]

    def test_the_list_is_complete_and_numbered(self) -> None:
        values = self.ask(bench(), ParamRequestList(1, 1), 20)
        assert sorted(v.number for v in values) == list(range(values[0].total))
        assert len({v.name for v in values}) == values[0].total

    def test_integers_read_as_their_bits(self) -> None:
        (value,) = self.ask(bench(), ParamRequestRead(1, 1, "MAV_SYS_ID"))
        assert param_int(value.value) == 1
        assert value.value == pytest.approx(1.4e-45, rel=1e-1)

    def test_writing_is_answered_with_what_stands(self) -> None:
        b = bench()
        (value,) = self.ask(b, ParamSet(1, 1, "COM_OF_LOSS_T", 2.5, 9))
        assert value.value == 2.5
        assert b.vehicle.parameters["COM_OF_LOSS_T"] == 2.5
        (value,) = self.ask(b, ParamSet(1, 1, "COM_OBL_RC_ACT", param_bits(4), 6))
        assert param_int(value.value) == 4

    @pytest.mark.parametrize(("value", "type"), [(math.nan, 9), (-5.0, 9), (1e9, 9), (1.0, 6)])
    def test_values_that_do_not_fit_change_nothing(self, value: float, type: int) -> None:
        (answer,) = self.ask(bench(), ParamSet(1, 1, "COM_OF_LOSS_T", value, type))
        assert answer.value == 1.0

    def test_unknown_names_get_silence(self) -> None:
        assert self.ask(bench(), ParamRequestRead(1, 1, "NO_SUCH")) == []
        assert self.ask(bench(), ParamSet(1, 1, "NO_SUCH", 1.0, 9)) == []
        assert self.ask(bench(), ParamRequestRead(1, 1, "", 9999)) == []


def test_streams_run_at_their_rates_and_follow_set_message_interval() -> None:
    b = bench()
    b.tick(2)

    count = b.count
    assert count(30) == pytest.approx(100, abs=3)
    assert count(31) == pytest.approx(50, abs=2)
    assert b.command(CMD_INTERVAL, 31, 4000) == [0]
    assert count(31) == 250
    assert b.command(CMD_INTERVAL, 31, -1) == [0]
    assert count(31) == 0
    assert b.command(CMD_INTERVAL, 31, 0) == [0]
    assert count(31) == pytest.approx(50, abs=2)
    assert b.command(CMD_INTERVAL, 0, -1) == [4]  # HEARTBEAT is nobody's to stop
    assert b.command(CMD_INTERVAL, 9999, 1000) == [4]
    assert b.command(CMD_INTERVAL, math.nan, 1000) == [4]
    assert count(0) == 1


def test_the_attitude_quaternion_closes_every_tick() -> None:
    b = bench()
    for _ in range(200):
        b.heard.clear()
        b.tick()
        kinds = [type(h).__name__ for h in b.heard]
        assert "VehicleAttitude" not in kinds[:-1]


def test_services_answer() -> None:
    b = bench()
    b.tick(3)
    b.heard.clear()
    for request in (Timesync(0, 77), Ping(5, 6, 0, 0), MissionRequestList(1, 1)):
        b.send(request)
    assert b.command(CMD_REQUEST, 148) == [0]
    assert b.command(CMD_CAPABILITIES) == [0]
    assert b.command(31000) == [3]
    b.send(Timesync(0, 78))
    b.tick()
    assert any(isinstance(h, Timesync) and h.ts1 == 78 and h.tc1 > 0 for h in b.heard)
    b.command(CMD_REQUEST, 148)
    assert any(isinstance(h, ServerVersion) and h.capabilities == 0x20DA for h in b.heard)
    assert b.command(CMD_REQUEST, 242) == [0]
    assert b.command(CMD_REQUEST, 9999) == [2]
    assert mavlink.MAV_CMD_REQUEST_MESSAGE == 512


def test_before_its_estimator_is_ready_it_shows_uninit_and_refuses_to_arm() -> None:
    b = bench(ready_us=2_000_000)
    assert b.beat().system_status == 0
    assert b.command(CMD_ARM, 1) == [1]
    assert "Arming denied: Resolve system health failures first" in b.texts()
    b.tick(300)
    assert b.beat().system_status == 3
    assert b.command(CMD_ARM, 1) == [0]


def test_on_the_ground_the_motors_stand_still_until_they_are_up_to_speed() -> None:
    b = bench()
    b.tick(5, target())
    b.command(CMD_SET_MODE, 1, 6)
    b.command(CMD_ARM, 1)
    b.tick(240, target())
    assert b.act.throttle == 0.0
    assert not b.vehicle.carries(b.now)
    b.tick(20, target())
    assert b.act.throttle == 0.6
    assert b.vehicle.carries(b.now)


@pytest.mark.parametrize(
    ("action", "mode"), [(0, POSCTL), (1, 2 << 16), (2, 7 << 16), (3, RTL), (4, LAND), (5, LOITER)]
)
def test_com_obl_rc_act_chooses_what_follows_setpoint_loss(action: int, mode: int) -> None:
    b = flying()
    b.send(ParamSet(1, 1, "COM_OBL_RC_ACT", param_bits(action), 6))
    b.tick(260)
    beat = b.beat()
    assert (beat.custom_mode, beat.system_status) == (mode, 5)


def test_termination_and_disarming_on_setpoint_loss_stop_the_motors() -> None:
    b = flying()
    b.send(ParamSet(1, 1, "COM_OBL_RC_ACT", param_bits(6), 6))
    b.tick(260)
    assert b.beat().system_status == 8
    assert b.act.throttle == 0.0
    b = flying()
    b.send(ParamSet(1, 1, "COM_OBL_RC_ACT", param_bits(7), 6))
    b.tick(260)
    assert not b.vehicle.armed


def test_nav_dll_act_acts_on_a_ground_station_that_falls_silent() -> None:
    b = flying()
    b.send(ParamSet(1, 1, "NAV_DLL_ACT", param_bits(2), 6))
    b.send(Heartbeat(6, 8, 0, 0, 4))
    b.tick(2400, target())
    assert b.vehicle.mode.custom == OFFBOARD
    b.tick(150, target())
    assert b.vehicle.mode.custom == RTL


@pytest.mark.parametrize(("main", "acks"), [(1, [0, 1]), (2, [0, 1]), (5, [0, 1]), (7, [0, 1]), (3, [0, 0])])
def test_in_the_air_modes_that_need_sticks_are_rejected(main: int, acks: list[int]) -> None:
    assert flying().command(CMD_SET_MODE, 1, main) == acks
    assert bench().command(CMD_SET_MODE, 1, main) == [0, 0]  # disarmed, any mode may be entered


def test_a_mission_nobody_uploaded_is_not_flown() -> None:
    assert flying().command(CMD_SET_MODE, 1, 4, 4) == [0, 1]
    b = bench()
    b.send(MissionRequestList(1, 1))
    b.send(MissionCount(1, 1, 3))
    b.send(MissionClear(1, 1))
    b.tick()
    assert MissionCount(255, 190, 0) in b.heard
    assert [h.result for h in b.heard if isinstance(h, MissionAck)] == [3, 0]


def test_file_transfer_is_refused_so_that_clients_go_on() -> None:
    b = bench()
    b.send(FileRequest(1, 1, 7, 2, 4))
    b.tick()
    assert not any(isinstance(h, FileRefusal) for h in b.heard)  # it is read back as a request: opcode 129 is NAK
    assert FileRequest(255, 190, 8, 2, 129) in b.heard


def test_request_data_stream_is_ignored() -> None:
    b = bench()
    b.send(DataStream(1, 1, 0, 2, True))
    assert b.count(30) == pytest.approx(100, abs=3)


def test_it_asks_for_the_time_ten_times_a_second_on_the_onboard_link() -> None:
    b = bench()
    b.tick(251)
    asked = [h for h in b.heard if isinstance(h, Timesync)]
    assert len(asked) == pytest.approx(10, abs=1)
    assert all(h.tc1 == 0 for h in asked)


def test_take_off_climbs_to_its_altitude_holds_there_returns_and_lands() -> None:
    """The modes on board, flown by a point mass: what clients use without an attitude setpoint."""
    b = bench()
    b.command(CMD_ARM, 1)
    assert b.command(CMD_TAKEOFF, *[math.nan] * 7) == [0]
    b.drive(6.0)
    assert b.vehicle.mode.custom == LOITER
    assert b.point.x[2] == pytest.approx(-2.5, abs=0.1)
    b.point = b.point._replace(x=b.point.x + np.array((3.0, -2.0, 0.0)))  # carried away
    b.vehicle.navigator.end()
    b.drive(3.0)
    assert b.point.x[0] == pytest.approx(3.0, abs=0.1)
    b.send(ParamSet(1, 1, "RTL_RETURN_ALT", 6.0, 9))
    assert b.command(CMD_RETURN) == [0]
    b.drive(6.0)
    assert b.point.x[2] < -5.0
    b.drive(25.0)
    assert not b.vehicle.armed
    np.testing.assert_allclose(b.point.x, 0.0, rtol=0, atol=0.5)


def test_it_lands_where_it_is_told_to_and_disarms() -> None:
    b = bench()
    b.command(CMD_ARM, 1)
    b.command(CMD_TAKEOFF)
    b.drive(6.0)
    assert b.command(CMD_LAND) == [0]
    b.drive(3.0)
    assert 0.5 < b.point.v[2] < 0.9  # MPC_LAND_SPEED
    b.drive(6.0)
    assert not b.vehicle.armed
    assert b.vehicle.landed == ON_GROUND
    assert any("Disarmed by landing" in t for t in b.texts())


def pulled(newton: float, _: Point) -> np.ndarray:
    return np.array([0.0, 0.0, newton])


def test_a_hold_finds_its_height_under_a_load_it_does_not_know() -> None:
    """The position loop's integral carries what hangs on the cable, and lets go of it again."""
    b = bench()
    b.command(CMD_ARM, 1)
    b.command(CMD_TAKEOFF)
    b.drive(6.0)
    for newton in (2.0, 0.0):
        b.drive(8.0, partial(pulled, newton))
        assert b.point.x[2] == pytest.approx(-2.5, abs=0.05)


def test_attitude_target_shows_the_setpoint_and_the_size_of_its_thrust() -> None:
    b = flying()
    b.tick(1, target(quat_wxyz=ROLLED_QUAT))
    R_c, rates, thrust = b.snapshot().offboard_target
    np.testing.assert_allclose(R_c, ROLLED, rtol=0, atol=1e-12)
    assert not rates.any()
    assert thrust == 0.6
    b.tick(1, target(thrust=-0.4))
    assert b.snapshot().offboard_target[2] == 0.4


PLACE, VELOCITY = 0xDF8, 0xDC7  # type masks that leave a place, or a velocity


def position_target(**changes: Any) -> PositionTarget:
    none = (0.0, 0.0, 0.0)
    return PositionTarget(0, 1, 1, 1, PLACE, none, none, none, 0.0, 0.0)._replace(**changes)


def streamed(b: Bench, value: PositionTarget, seconds: float) -> None:
    """Fly by a stream of ten targets a second."""
    for _ in range(round(10 * seconds)):
        b.send(value)
        b.drive(0.1)


def in_offboard_at_altitude() -> Bench:
    b = bench()
    b.command(CMD_ARM, 1)
    b.command(CMD_TAKEOFF)
    b.drive(8.0)
    b.send(position_target(x=tuple(b.point.x.tolist())))
    assert b.command(CMD_SET_MODE, 1, 6) == [0, 0]
    return b


def test_offboard_by_position_flies_there_and_turns_the_nose() -> None:
    b = in_offboard_at_altitude()
    start = b.point.x.copy()
    streamed(b, position_target(x=(start[0] + 3.0, start[1] - 2.0, start[2] - 1.0), yaw=1.0, type_mask=0x9F8), 8.0)
    assert np.linalg.norm(b.point.x - start - (3.0, -2.0, -1.0)) < 0.1  # measured 0.002
    assert math.atan2(b.R[1, 0], b.R[0, 0]) == pytest.approx(1.0, abs=0.02)


def test_offboard_by_velocity_holds_the_axes_that_have_a_place() -> None:
    b = in_offboard_at_altitude()
    height = float(b.point.x[2])
    mask = 0xDC7 & ~4 | 32  # x and y by velocity, z by place
    streamed(b, position_target(type_mask=mask, x=(0.0, 0.0, height), v=(1.0, 0.0, 9.0)), 6.0)
    assert b.point.v[0] == pytest.approx(1.0, abs=0.05)
    assert float(b.point.x[2]) == pytest.approx(height, abs=0.1)


def test_body_velocities_turn_with_the_nose_and_unknown_frames_are_told() -> None:
    b = in_offboard_at_altitude()
    b.R = lie.exp(np.array([0.0, 0.0, math.pi / 2]))
    streamed(b, position_target(frame=8, type_mask=VELOCITY, v=(1.0, 0.0, 0.0)), 4.0)
    assert b.point.v[1] == pytest.approx(1.0, abs=0.05)  # forward is east
    b.heard.clear()
    b.send(position_target(frame=0))
    b.tick()
    assert any("coordinate frame 0 unsupported" in text for text in b.texts())


def test_accelerations_alone_leave_it_where_it_is() -> None:
    b = in_offboard_at_altitude()
    start = b.point.x.copy()
    streamed(b, position_target(type_mask=0xC3F, a=(2.0, 0.0, 0.0)), 3.0)
    assert np.linalg.norm(b.point.x - start) < 0.05


def test_a_stream_of_positions_that_ends_is_a_lost_offboard_signal() -> None:
    b = in_offboard_at_altitude()
    b.drive(1.5)
    assert b.vehicle.mode.custom == POSCTL


def test_do_reposition_goes_into_hold_and_there() -> None:
    b = bench()
    b.command(CMD_ARM, 1)
    b.command(CMD_TAKEOFF)
    b.drive(8.0)
    start = b.point.x.copy()
    home = Home()
    lat, lon, altitude = geodetic(home, start + np.array([2.0, 1.0, -1.0]))
    assert b.command(CMD_REPOSITION, -1, 0, 0, math.nan, lat, lon, altitude) == [3]  # without leave to change the mode
    assert b.command(CMD_REPOSITION, -1, 1, 0, math.nan, 91.0, lon, altitude) == [2]
    assert b.command(CMD_REPOSITION, -1, 1, 0, math.nan, lat, lon, altitude) == [0]
    b.drive(8.0)
    assert b.vehicle.mode.custom == LOITER
    assert np.linalg.norm(b.point.x - start - (2.0, 1.0, -1.0)) < 0.1
