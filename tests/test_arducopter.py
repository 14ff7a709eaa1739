"""The ArduCopter persona: one table a behaviour, against messages and a clock that the test turns."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from workbench import (
    BODY,
    CMD_ARM,
    CMD_INTERVAL,
    CMD_REPOSITION,
    CMD_REQUEST,
    CMD_RETURN,
    CMD_SET_MODE,
    CMD_TAKEOFF,
    LEVEL,
    LINKS,
    ROLLED,
    ROLLED_QUAT,
    TICK,
    Bench,
    target,
)

from bridge.fleet.thrust import LinearShare
from bridge.wire.values import (
    IN_AIR,
    CommandAck,
    DataStream,
    Heartbeat,
    ParamRequestRead,
    ParamSet,
    ParamValue,
    PositionTarget,
    ServerVersion,
    SetMode,
    Timesync,
)
from cablequad.model import lie
from cablequad.model.earth import Home, geodetic
from sitl.firmware.arducopter import ArduCopter

STABILIZE, GUIDED, LOITER, RTL, LAND, BRAKE, NOGPS = 0, 4, 5, 6, 9, 17, 20


def bench(ready_us: int = 0) -> Bench:
    return Bench(ArduCopter(1, TICK, LINKS, BODY, ready_us))


def flying(thrust_mode: bool = True, mode: int = GUIDED) -> Bench:
    """Armed, in the air, in GUIDED; the thrust field is thrust unless it is said otherwise."""
    b = bench()
    if thrust_mode:
        b.vehicle.parameters.preset("GUID_OPTIONS", 8)
    b.command(CMD_SET_MODE, 1, mode)
    b.command(CMD_ARM, 1)
    b.tick(1, target())
    b.vehicle.set_landed(IN_AIR)
    b.tick(1, target())
    b.heard.clear()
    return b


def test_a_fresh_vehicle_shows_stabilize_and_then_a_position() -> None:
    b = bench(ready_us=30_000_000)
    assert b.beat() == Heartbeat(2, 3, 81, STABILIZE, 1)  # booting
    assert b.beat() == Heartbeat(2, 3, 81, STABILIZE, 3)
    b.command(CMD_SET_MODE, 1, GUIDED)
    assert b.beat().base_mode == 81
    b.tick(7500)
    assert b.beat() == Heartbeat(2, 3, 89, GUIDED, 3)
    b.command(CMD_ARM, 1)
    b.send(target(thrust=0.9))
    assert b.beat(target()).base_mode == 217


def test_nothing_streams_until_it_is_asked_for() -> None:
    b = bench()
    b.tick(2600)
    kinds = {type(h).__name__ for h in b.heard}
    assert kinds == {"Heartbeat", "Timesync"}
    asked = [h for h in b.heard if isinstance(h, Timesync)]
    assert [h.tc1 for h in asked] == [0, 0]  # every ten seconds
    assert asked[1].ts1 % 1000 == 1  # boot time in ns, and the system id


@pytest.mark.parametrize(
    ("params", "acks", "mode"),
    [
        ((1, GUIDED), [0], GUIDED),
        ((1, 99), [4], STABILIZE),
        ((0, GUIDED), [2], STABILIZE),
        ((1, math.nan), [4], STABILIZE),
        ((math.nan, 4), [2], STABILIZE),
    ],
)
def test_do_set_mode_answers_once(params: tuple[float, ...], acks: list[int], mode: int) -> None:
    b = bench()
    assert b.command(CMD_SET_MODE, *params) == acks
    assert any("No such mode" in t for t in b.texts()) == (acks == [4])
    assert b.beat().custom_mode == mode


def test_set_mode_message_works_without_an_ack() -> None:
    b = bench()
    b.send(SetMode(1, 1, GUIDED))
    b.tick()
    assert not any(isinstance(h, CommandAck) for h in b.heard)
    assert b.beat().custom_mode == GUIDED


def test_guided_needs_a_position_to_arm_and_says_so() -> None:
    b = bench(ready_us=30_000_000)
    b.command(CMD_SET_MODE, 1, GUIDED)  # disarmed, any mode may be entered
    for forced in (0, 2989, 21196):  # forcing skips optional checks, and this one is not
        assert b.command(CMD_ARM, 1, forced) == [4]
        assert "Arm: Need Position Estimate" in b.texts()
    b.tick(7500)
    assert b.command(CMD_ARM, 1) == [0]
    assert b.command(CMD_ARM, 1) == [0]  # already armed


def test_armed_without_a_position_guided_is_not_entered() -> None:
    b = bench(ready_us=30_000_000)
    assert b.command(CMD_ARM, 1) == [0]  # STABILIZE needs none
    assert b.command(CMD_SET_MODE, 1, GUIDED) == [4]
    assert any("requires position" in t for t in b.texts())


@pytest.mark.parametrize("wish", [0.5, 2.0, math.nan, -1.0])
def test_other_arm_values_are_unsupported(wish: float) -> None:
    assert bench().command(CMD_ARM, wish) == [3]


@pytest.mark.parametrize("mode", [RTL, LAND, BRAKE])
def test_modes_that_only_end_flights_are_not_armable(mode: int) -> None:
    b = bench()
    b.command(CMD_SET_MODE, 1, mode)
    assert b.command(CMD_ARM, 1) == [4]
    assert "Arm: Mode not armable" in b.texts()


def test_disarming_in_the_air_fails_unless_forced() -> None:
    b = flying()
    assert b.command(CMD_ARM, 0) == [4]
    assert b.vehicle.armed
    assert b.command(CMD_ARM, 0, 21196) == [0]
    b.tick()
    assert b.act.throttle == 0.0


def test_an_idle_vehicle_disarms_after_disarm_delay() -> None:
    b = bench()
    b.command(CMD_ARM, 1)
    b.tick(2480)
    assert b.vehicle.armed
    b.tick(40)
    assert not b.vehicle.armed


def test_motors_spin_only_after_thrust_and_a_second_of_spooling() -> None:
    b = bench()
    b.vehicle.parameters.preset("GUID_OPTIONS", 8)
    b.command(CMD_SET_MODE, 1, GUIDED)
    b.command(CMD_ARM, 1)
    b.tick(100, target(thrust=0.0))
    assert b.act.throttle == 0.0
    b.tick(240, target())
    assert b.act.throttle == 0.0
    assert not b.vehicle.carries(b.now)
    b.tick(20, target())
    assert b.act.throttle > 0.5
    assert b.vehicle.carries(b.now)


@pytest.mark.parametrize(
    ("system", "component", "answered"), [(1, 1, True), (0, 1, True), (1, 0, True), (2, 1, False), (1, 200, False)]
)
def test_commands_to_system_zero_are_obeyed_and_to_others_not_answered(
    system: int, component: int, answered: bool
) -> None:
    assert bool(bench().command(CMD_ARM, 1, system=system, component=component)) is answered


@pytest.mark.parametrize(
    ("system", "component", "obeyed"), [(1, 1, True), (1, 0, True), (1, 200, True), (2, 1, False), (0, 1, False)]
)
def test_setpoints_for_a_wrong_component_of_the_right_system_are_obeyed(
    system: int, component: int, obeyed: bool
) -> None:
    """To system 0 as well on the real firmware; here never, as every vehicle would obey."""
    b = flying()
    b.tick(1, target(system=system, component=component, quat_wxyz=ROLLED_QUAT))
    assert bool(abs(b.act.R_c[2, 1]) > 0.1) is obeyed


def test_outside_guided_a_setpoint_is_ignored_silently() -> None:
    b = flying()
    b.command(CMD_SET_MODE, 1, LOITER)
    b.heard.clear()
    b.tick(5, target(quat_wxyz=ROLLED_QUAT))
    assert not b.texts()
    assert not b.vehicle.fresh_setpoint(b.now)
    assert abs(b.act.R_c[2, 1]) < 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_unit_quaternions_of_either_sign_are_the_same_setpoint(sign: float) -> None:
    b = flying()
    b.tick(1, target(quat_wxyz=tuple(sign * c for c in ROLLED_QUAT)))
    np.testing.assert_allclose(b.act.R_c, ROLLED, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"quat_wxyz": tuple(1.01 * c for c in ROLLED_QUAT)}, "quaternion"),
        ({"quat_wxyz": (0.0,) * 4}, "quaternion"),
        ({"quat_wxyz": (math.nan,) * 4}, "quaternion"),
        ({"type_mask": 3}, "rates"),
        ({"type_mask": 1}, "rates"),
        ({"type_mask": 7 | 64}, "throttle"),
        ({"type_mask": 7 | 128}, "neither"),
    ],
)
def test_what_it_does_not_take_stops_the_vehicle_where_it_is(change: dict, why: str) -> None:
    b = flying()
    b.tick(1, target(quat_wxyz=ROLLED_QUAT))
    b.tick(2, target(**change))
    assert any(f"Guided: {why}" in t or why in t for t in b.texts())
    assert b.vehicle.navigator.active
    assert not b.vehicle.fresh_setpoint(b.now)
    b.tick(1, target(quat_wxyz=ROLLED_QUAT))  # the next valid one resumes
    np.testing.assert_allclose(b.act.R_c, ROLLED, rtol=0, atol=1e-12)


def test_in_guided_nogps_throttle_ignored_keeps_the_last_thrust() -> None:
    b = flying(mode=NOGPS)
    b.tick(1, target(thrust=0.4))
    before = b.act.throttle
    b.tick(1, target(type_mask=7 | 64, thrust=0.9, quat_wxyz=ROLLED_QUAT))
    assert b.vehicle.fresh_setpoint(b.now)
    assert b.act.throttle == pytest.approx(before * math.sqrt(1 / math.cos(0.2)), rel=1e-9)


def test_rates_alone_are_body_rates() -> None:
    b = flying()
    b.tick(1, target(type_mask=128, rates=(0.1, 0.2, 0.3)))
    assert b.act.rate_only
    np.testing.assert_array_equal(b.act.Omega_c, [0.1, 0.2, 0.3])


def test_attitude_with_rates_reads_them_in_the_earth_frame_and_carries_the_target_on() -> None:
    """At yaw 90 degrees a roll rate of 0.3 becomes a pitch rate: the quirk of input_quaternion."""
    b = flying()
    east = tuple(lie.quat_from_rotation(lie.exp(np.array([0.0, 0.0, math.pi / 2]))).tolist())
    b.tick(1, target(type_mask=0, quat_wxyz=east, rates=(0.3, 0.0, 0.0)))
    np.testing.assert_allclose(b.act.Omega_c, [0.0, 0.3, 0.0], rtol=0, atol=1e-12)
    first = b.act.R_c
    b.tick(10)
    turned = lie.log(first.T @ b.act.R_c)
    assert np.linalg.norm(turned) == pytest.approx(0.3 * 10 * TICK * 1e-6, rel=1e-4)


class TestThrust:
    """The meaning of the thrust field, which GUID_OPTIONS decides."""

    def test_with_8_it_is_a_share_of_the_greatest_thrust(self) -> None:
        b = flying()
        for asked, made in [(0.39, 0.39), (1.0, 1.0), (1.7, 1.0), (-0.4, 0.0), (0.0, 0.0)]:
            b.tick(1, target(thrust=asked))
            assert b.act.throttle**2 == pytest.approx(made, abs=1e-12)

    @pytest.mark.parametrize("degrees", [0, 20, 45, 80, 89])
    def test_tilt_boosts_it_ten_times_at_most(self, degrees: float) -> None:
        b = flying()
        quat = tuple(lie.quat_from_rotation(lie.exp(np.array([math.radians(degrees), 0.0, 0.0]))).tolist())
        b.tick(1, target(thrust=0.05, quat_wxyz=quat))
        boost = min(10.0, 1 / math.cos(math.radians(degrees)))
        assert b.act.throttle**2 == pytest.approx(0.05 * boost, rel=1e-9)
        assert b.snapshot().offboard_target[2] == 0.05  # ATTITUDE_TARGET shows it before the boost
        b.vehicle.parameters.preset("ATC_ANGLE_BOOST", 0)
        b.tick(1, target(thrust=0.05, quat_wxyz=quat))
        assert b.act.throttle**2 == pytest.approx(0.05, rel=1e-9)

    def test_forty_five_degrees_are_flown_whatever_angle_max_says(self) -> None:
        b = flying()
        quat = tuple(lie.quat_from_rotation(lie.exp(np.array([0.0, math.radians(45), 0.0]))).tolist())
        b.tick(1, target(quat_wxyz=quat))
        assert b.act.R_c[2, 2] == pytest.approx(math.cos(math.radians(45)), rel=1e-9)

    def test_nan_drops_the_vehicle_and_is_told(self) -> None:
        b = flying()
        b.tick(2, target(thrust=math.nan))
        assert b.act.throttle == 0.0
        assert "Internal Errors 0x400" in b.texts()

    @pytest.mark.parametrize(("field", "climb"), [(0.5, 0.0), (0.8, 1.5), (1.0, 2.5), (0.0, -1.5), (0.25, -0.75)])
    def test_without_8_it_is_a_climb_rate(self, field: float, climb: float) -> None:
        b = flying(thrust_mode=False)
        b.point = b.point._replace(x=np.array([0.0, 0.0, -50.0]))
        b.vehicle.navigator.end()
        for _ in range(40):
            b.send(target(thrust=field))
            b.drive(0.1)
        assert -b.point.v[2] == pytest.approx(climb, abs=0.08)

    @given(st.floats(0, 1), st.floats(0, 1.4), st.booleans())
    def test_newtons_asked_are_newtons_made(self, force: float, tilt: float, boost: bool) -> None:
        """The bridge's law undoes the vehicle's, boost and all."""
        law = LinearShare(25.0, boost)
        b = flying()
        b.vehicle.parameters.preset("ATC_ANGLE_BOOST", float(boost))
        quat = tuple(lie.quat_from_rotation(lie.exp(np.array([tilt, 0.0, 0.0]))).tolist())
        b.tick(1, target(thrust=law.field(25.0 * force, math.cos(tilt)), quat_wxyz=quat))
        assert 25.0 * b.act.throttle**2 == pytest.approx(25.0 * force, rel=1e-9, abs=1e-9)


def test_three_seconds_of_silence_level_the_vehicle_and_hold_its_height_in_guided() -> None:
    b = flying()
    b.point = b.point._replace(x=np.array([0.0, 0.0, -20.0]))
    b.tick(1, target(quat_wxyz=ROLLED_QUAT, thrust=0.3))
    b.drive(2.96)
    np.testing.assert_allclose(b.act.R_c, ROLLED, rtol=0, atol=1e-12)  # the tilt is kept until then
    b.tick(20)
    assert abs(b.act.R_c[2, 1]) < 1e-9
    b.drive(3.5)
    assert abs(b.point.v[2]) < 0.1
    assert b.beat().custom_mode == GUIDED
    b.tick(1, target(quat_wxyz=ROLLED_QUAT))  # continues at once
    np.testing.assert_allclose(b.act.R_c, ROLLED, rtol=0, atol=1e-12)


def test_fs_gcs_enable_acts_on_heartbeats_of_the_named_station_alone() -> None:
    b = flying()
    b.vehicle.parameters.preset("FS_GCS_ENABLE", 1)
    b.send(Heartbeat(6, 8, 0, 0, 4), system=255)
    b.tick(1000, target())
    b.send(Heartbeat(6, 8, 0, 0, 4), system=42)
    b.tick(300, target())
    beat = b.beat()
    assert (beat.custom_mode, beat.system_status) == (RTL, 5)


class TestStreams:
    """What is sent, and who may ask for it."""

    def test_set_message_interval(self) -> None:
        b = bench()
        assert b.command(CMD_INTERVAL, 31, 4000) == [0]
        assert b.count(31) == 250
        assert b.command(CMD_INTERVAL, 31, -1) == [0]
        assert b.count(31) == 0
        assert b.command(CMD_INTERVAL, 9999, 1000) == [2]
        assert b.command(CMD_INTERVAL, 31, 4000, 1) == [2]
        assert b.command(CMD_INTERVAL, 31, math.nan) == [2]
        assert b.command(CMD_INTERVAL, 31, 2000) == [2]  # the loop runs at 400 Hz
        assert any("refused" in t for t in b.texts())

    def test_request_data_stream_starts_and_stops_groups(self) -> None:
        b = bench()
        b.send(DataStream(1, 1, 0, 10, True))
        assert b.count(30) == pytest.approx(10, abs=1)
        assert b.count(33) == pytest.approx(10, abs=1)
        b.send(DataStream(1, 1, 10, 10, False))
        assert b.count(30) == 0
        assert b.count(33) == pytest.approx(10, abs=1)

    def test_a_position_is_sent_only_once_there_is_one(self) -> None:
        b = bench(ready_us=2_000_000)
        b.command(CMD_INTERVAL, 32, 100_000)
        assert b.count(32) == 0
        b.tick(300)
        assert b.count(32) == pytest.approx(10, abs=1)

    def test_it_claims_no_more_than_exists(self) -> None:
        b = bench()
        assert b.command(CMD_REQUEST, 148) == [0]
        assert ServerVersion(0x20CA, (4, 7, 0), 1) in b.heard
        assert b.command(CMD_REQUEST, 9999) == [4]
        assert b.command(31000) == [3]

    def test_parameters_are_numbers_whatever_their_type(self) -> None:
        b = bench()
        b.send(ParamRequestRead(1, 1, "GUID_OPTIONS"))
        b.send(ParamSet(1, 1, "GUID_OPTIONS", 8.0, 9))
        b.tick()
        values = [h.value for h in b.heard if isinstance(h, ParamValue)]
        assert values == [0.0, 8.0]


def test_take_off_in_guided_climbs_and_then_takes_setpoints() -> None:
    b = bench()
    assert b.command(CMD_TAKEOFF, 0, 0, 0, 0, 0, 0, 3) == [4]  # not armed, not in GUIDED
    b.command(CMD_SET_MODE, 1, GUIDED)
    b.command(CMD_ARM, 1)
    assert b.command(CMD_TAKEOFF, 0, 0, 0, 0, 0, 0, 3) == [0]
    b.drive(7.0)
    assert b.point.x[2] == pytest.approx(-3.0, abs=0.1)
    b.vehicle.parameters.preset("GUID_OPTIONS", 8)
    b.tick(1, target(quat_wxyz=ROLLED_QUAT))
    np.testing.assert_allclose(b.act.R_c, ROLLED, rtol=0, atol=1e-12)


def test_it_returns_lands_and_disarms() -> None:
    b = bench()
    b.vehicle.parameters.preset("RTL_ALT", 500)
    b.command(CMD_SET_MODE, 1, GUIDED)
    b.command(CMD_ARM, 1)
    b.command(CMD_TAKEOFF, 0, 0, 0, 0, 0, 0, 3)
    b.drive(7.0)
    b.point = b.point._replace(x=b.point.x + np.array((4.0, 0.0, 0.0)))
    assert b.command(CMD_RETURN) == [0]
    b.drive(4.0)
    assert b.point.x[2] < -4.0
    b.drive(30.0)
    assert not b.vehicle.armed
    np.testing.assert_allclose(b.point.x, 0.0, rtol=0, atol=0.5)


def test_a_level_setpoint_holds_no_height_in_thrust_mode() -> None:
    b = flying()
    b.tick(1, target(quat_wxyz=LEVEL, thrust=0.2))
    assert b.act.throttle**2 == pytest.approx(0.2, rel=1e-9)


class TestPositionTargets:
    """SET_POSITION_TARGET_LOCAL_NED and DO_REPOSITION, as GUIDED takes them."""

    def up(self) -> Bench:
        b = bench()
        b.command(CMD_SET_MODE, 1, GUIDED)
        b.command(CMD_ARM, 1)
        b.command(CMD_TAKEOFF, 0, 0, 0, 0, 0, 0, 3.0)
        b.drive(8.0)
        return b

    def target(self, **changes: Any) -> PositionTarget:
        none = (0.0, 0.0, 0.0)
        return PositionTarget(0, 1, 1, 1, 0xDF8, none, none, none, 0.0, 0.0)._replace(**changes)

    def test_one_place_is_enough_and_has_no_time_out(self) -> None:
        b = self.up()
        start = b.point.x.copy()
        b.send(self.target(x=tuple((start + np.array([2.0, -1.0, -1.0])).tolist())))
        b.drive(10.0)
        assert np.linalg.norm(b.point.x - start - (2.0, -1.0, -1.0)) < 0.1

    def test_an_offset_counts_from_where_it_was_and_a_body_offset_from_its_nose(self) -> None:
        b = self.up()
        start = b.point.x.copy()
        b.send(self.target(frame=7, x=(1.0, 0.0, 0.0)))
        b.drive(6.0)
        assert np.linalg.norm(b.point.x - start - (1.0, 0.0, 0.0)) < 0.1
        b.R = lie.exp(np.array([0.0, 0.0, math.pi / 2]))
        b.tick()
        b.send(self.target(frame=9, x=(1.0, 0.0, 0.0)))
        b.drive(6.0)
        assert np.linalg.norm(b.point.x - start - (1.0, 1.0, 0.0)) < 0.15

    def test_a_velocity_ends_after_guid_timeout(self) -> None:
        b = self.up()
        b.send(self.target(type_mask=0xDC7, v=(1.0, 0.0, 0.0)))
        b.drive(2.5)
        assert b.point.v[0] == pytest.approx(1.0, abs=0.1)
        b.drive(4.0)
        assert abs(b.point.v[0]) < 0.1
        assert any("no velocity target" in text for text in b.texts())

    @pytest.mark.parametrize(
        "change", [{"frame": 0}, {"type_mask": 0xFFF}, {"x": (math.nan, 0.0, 0.0)}, {"x": (1e30, 0.0, 0.0)}]
    )
    def test_what_makes_no_sense_stops_it(self, change: dict[str, Any]) -> None:
        b = self.up()
        start = b.point.x.copy()
        b.send(self.target(**change))
        b.drive(3.0)
        assert np.linalg.norm(b.point.x - start) < 0.1
        assert b.vehicle.mode_name == "GUIDED"

    def test_accelerations_alone_leave_it_where_it_is(self) -> None:
        b = self.up()
        start = b.point.x.copy()
        b.send(self.target(type_mask=0xC3F, a=(2.0, 0.0, 0.0)))
        b.drive(2.0)
        assert np.linalg.norm(b.point.x - start) < 0.05

    def test_do_reposition_changes_into_guided_only_where_it_says_so(self) -> None:
        b = self.up()
        b.command(CMD_SET_MODE, 1, LOITER)
        start = b.point.x.copy()
        lat, lon, altitude = geodetic(Home(), start + np.array([2.0, 0.0, -1.0]))
        assert b.command(CMD_REPOSITION, -1, 0, 0, 0, lat, lon, altitude) == [2]
        assert b.command(CMD_REPOSITION, -1, 1, 0, 0, lat, lon, altitude) == [0]
        b.drive(8.0)
        assert b.vehicle.mode_name == "GUIDED"
        assert np.linalg.norm(b.point.x - start - (2.0, 0.0, -1.0)) < 0.1
