"""What the virtual vehicles do, row by row, with the test that shows it: `python -m docs.vehicles` writes vehicles.md.

The rows are those of the firmware facts (ArduCopter 4.7-dev and PX4 main, run in software and read in source): the
fields of SET_ATTITUDE_TARGET, bad input and time-outs, modes, arming and acks. A test of tests/test_vehicles_doc.py
sees to it that every row names, for each persona, a test that exists, or says why it is left out.
"""

from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent


class Row(NamedTuple):
    """One behaviour of both personas: what it does, and the test that says so, or why it is left out."""

    what: str
    px4: str
    px4_test: str
    arducopter: str
    arducopter_test: str


LEFT_OUT = "left out: "
P, A, W, L, C = "test_px4.py::", "test_arducopter.py::", "test_wire.py::", "test_links.py::", "test_clients.py::"

SECTIONS: dict[str, list[Row]] = {
    "SET_ATTITUDE_TARGET, field by field": [
        Row("time_boot_ms", "ignored; stamped on reception", P + "test_one_and_a_quarter_hertz_holds_offboard_and_less_than_one_does_not",
            "ignored", A + "test_three_seconds_of_silence_level_the_vehicle_and_hold_its_height_in_guided"),
        Row("target_system", "its own; others are ignored, and 0 as well, so that n vehicles do not all obey", P + "test_setpoints_are_obeyed_only_by_the_vehicle_they_name",
            "the same", A + "test_setpoints_for_a_wrong_component_of_the_right_system_are_obeyed"),
        Row("target_component", "0 or 1", P + "test_setpoints_are_obeyed_only_by_the_vehicle_they_name",
            "any: with no route to a wrong one the frame is taken", A + "test_setpoints_for_a_wrong_component_of_the_right_system_are_obeyed"),
        Row("type_mask 7", "attitude and thrust", P + "test_type_mask_decides_between_attitude_rates_and_feed_forward",
            "attitude and thrust", A + "test_unit_quaternions_of_either_sign_are_the_same_setpoint"),
        Row("type_mask 0", "attitude, yaw rate fed forward about world z", P + "test_type_mask_decides_between_attitude_rates_and_feed_forward",
            "rates are read in the earth frame and carry the target on", A + "test_attitude_with_rates_reads_them_in_the_earth_frame_and_carries_the_target_on"),
        Row("type_mask 0: rate setpoint for one cycle", "published beside the attitude",
            LEFT_OUT + "one cycle of a rate loop, 0.9 degrees on the firmware, is below what the second-order attitude response resolves",
            "-", LEFT_OUT + "PX4 alone does this"),
        Row("type_mask 3", "yaw rate fed forward", P + "test_type_mask_decides_between_attitude_rates_and_feed_forward",
            "stops", A + "test_what_it_does_not_take_stops_the_vehicle_where_it_is"),
        Row("type_mask 128", "body rates and thrust", P + "test_type_mask_decides_between_attitude_rates_and_feed_forward",
            "body rates and thrust", A + "test_rates_alone_are_body_rates"),
        Row("any mask with 64", "motors off, and told", P + "test_thrust_is_a_motor_command_and_its_dangers_are_told",
            "stops in GUIDED; keeps the last thrust in GUIDED_NOGPS", A + "test_in_guided_nogps_throttle_ignored_keeps_the_last_thrust"),
        Row("partial rates (1, 2, 4, 5, 6)", "accepted", P + "test_type_mask_decides_between_attitude_rates_and_feed_forward",
            "stops", A + "test_what_it_does_not_take_stops_the_vehicle_where_it_is"),
        Row("q", "normalised; antipodes are the same", P + "test_quaternions_of_any_norm_and_sign_are_the_same_setpoint",
            "within 1e-3 of unit length, else it stops", A + "test_what_it_does_not_take_stops_the_vehicle_where_it_is"),
        Row("rate limits", "220, 220, 200 deg/s", LEFT_OUT + "the rate loop inside is a response model; commands beyond it are a test of the firmware, not of a load",
            "off by default", LEFT_OUT + "there is none by default"),
        Row("meaning of thrust", "motor command, whose force is its square; THR_MDL_FAC inverted", P + "test_thrust_model_factor_is_inverted_by_the_bridges_thrust_law",
            "climb rate; with GUID_OPTIONS 8 a share of the greatest thrust", A + "TestThrust::test_without_8_it_is_a_climb_rate"),
        Row("thrust out of range", "saturates", P + "test_thrust_is_a_motor_command_and_its_dangers_are_told",
            "clipped, negative is zero", A + "TestThrust::test_with_8_it_is_a_share_of_the_greatest_thrust"),
        Row("tilt compensation", "none", P + "test_thrust_is_a_motor_command_and_its_dangers_are_told",
            "1 / cos(tilt), ten times at most, unless ATC_ANGLE_BOOST is 0", A + "TestThrust::test_tilt_boosts_it_ten_times_at_most"),
        Row("tilt limit", "none", P + "test_quaternions_of_any_norm_and_sign_are_the_same_setpoint",
            "ANGLE_MAX does not limit the quaternion", A + "TestThrust::test_forty_five_degrees_are_flown_whatever_angle_max_says"),
        Row("battery compensation of thrust", "-", LEFT_OUT + "there is none", "on",
            LEFT_OUT + "the vehicles' batteries do not sag yet"),
        Row("attitude response", "10/50/90 % of a step in 0.1, 0.2, 0.4 s: attitude_bandwidth_rad_s = 10", L + "test_two_of_each_with_the_response_of_stock_firmware_fly_together",
            "the same", L + "test_two_of_each_with_the_response_of_stock_firmware_fly_together"),
    ],
    "SET_POSITION_TARGET_LOCAL_NED and DO_REPOSITION (vehicles that are free, or on a slack cable)": [
        Row("places", "every axis by itself, in LOCAL_NED", P + "test_offboard_by_position_flies_there_and_turns_the_nose",
            "all three axes or none; no time-out", A + "TestPositionTargets::test_one_place_is_enough_and_has_no_time_out"),
        Row("velocities", "every axis by itself; LOCAL_NED and BODY_NED", P + "test_offboard_by_velocity_holds_the_axes_that_have_a_place",
            "all three or none; they end after GUID_TIMEOUT", A + "TestPositionTargets::test_a_velocity_ends_after_guid_timeout"),
        Row("frames", "LOCAL_NED; BODY_NED for velocities; others are told and left out", P + "test_body_velocities_turn_with_the_nose_and_unknown_frames_are_told",
            "LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED", A + "TestPositionTargets::test_an_offset_counts_from_where_it_was_and_a_body_offset_from_its_nose"),
        Row("what makes no sense", "axes that are not finite count as ignored", "test_dialect.py::test_after_any_message_the_vehicle_ticks_on_with_finite_commands",
            "stops", A + "TestPositionTargets::test_what_makes_no_sense_stops_it"),
        Row("accelerations alone", "it stays where it is: the position loop here takes places and velocities", P + "test_accelerations_alone_leave_it_where_it_is",
            "the same", A + "TestPositionTargets::test_accelerations_alone_leave_it_where_it_is"),
        Row("yaw", "turned to at 60 deg/s", P + "test_offboard_by_position_flies_there_and_turns_the_nose",
            "the same; without one the nose stays where it points", LEFT_OUT + "WP_YAW_BEHAVIOR, which turns the nose along the way by default, is not modelled"),
        Row("the stream ends", "a lost offboard signal", P + "test_a_stream_of_positions_that_ends_is_a_lost_offboard_signal",
            "a place stays in force", A + "TestPositionTargets::test_one_place_is_enough_and_has_no_time_out"),
        Row("DO_REPOSITION", "into Hold and there; UNSUPPORTED without its flag for the change of mode; DENIED for no place on earth", P + "test_do_reposition_goes_into_hold_and_there",
            "in GUIDED; from another mode only with that flag, else DENIED", A + "TestPositionTargets::test_do_reposition_changes_into_guided_only_where_it_says_so"),
    ],
    "Bad input and time-outs": [
        Row("not in the mode that obeys", "refreshes the signal alone", P + "test_outside_offboard_a_setpoint_only_refreshes_the_signal",
            "ignored silently", A + "test_outside_guided_a_setpoint_is_ignored_silently"),
        Row("stop", "-", LEFT_OUT + "ArduCopter alone does this", "brakes and holds until the next valid message", A + "test_what_it_does_not_take_stops_the_vehicle_where_it_is"),
        Row("q NaN", "attitude drifts, thrust stays; told", P + "test_an_invalid_quaternion_leaves_the_attitude_to_drift_and_says_so",
            "stops (as with SIM_FLOAT_EXCEPT 0)", A + "test_what_it_does_not_take_stops_the_vehicle_where_it_is"),
        Row("q zero", "as NaN", P + "test_an_invalid_quaternion_leaves_the_attitude_to_drift_and_says_so",
            "stops", A + "test_what_it_does_not_take_stops_the_vehicle_where_it_is"),
        Row("thrust NaN", "motors off; told", P + "test_thrust_is_a_motor_command_and_its_dangers_are_told",
            "falls; Internal Errors 0x400", A + "TestThrust::test_nan_drops_the_vehicle_and_is_told"),
        Row("rates NaN", "that rate is held", P + "test_type_mask_decides_between_attitude_rates_and_feed_forward",
            "undefined", LEFT_OUT + "the firmware's answer is undefined; here such a rate counts as zero"),
        Row("no setpoint", "after COM_OF_LOSS_T COM_OBL_RC_ACT, CRITICAL; sinks slowly in POSCTL", P + "test_com_obl_rc_act_chooses_what_follows_setpoint_loss",
            "after GUID_TIMEOUT level, height held, stays in GUIDED", A + "test_three_seconds_of_silence_level_the_vehicle_and_hold_its_height_in_guided"),
        Row("terminate, disarm on loss", "COM_OBL_RC_ACT 6 and 7", P + "test_termination_and_disarming_on_setpoint_loss_stop_the_motors",
            "-", LEFT_OUT + "PX4 alone has this"),
        Row("the stream resumes", "back to OFFBOARD by itself", P + "test_setpoint_loss_fails_over_after_one_second_and_comes_back_by_itself",
            "continues at once", A + "test_three_seconds_of_silence_level_the_vehicle_and_hold_its_height_in_guided"),
        Row("slowest usable rate", "above 1 / COM_OF_LOSS_T", P + "test_one_and_a_quarter_hertz_holds_offboard_and_less_than_one_does_not",
            "above 1 / 3 Hz", A + "test_three_seconds_of_silence_level_the_vehicle_and_hold_its_height_in_guided"),
        Row("ground station falls silent", "NAV_DLL_ACT after COM_DL_LOSS_T, off by default", P + "test_nav_dll_act_acts_on_a_ground_station_that_falls_silent",
            "FS_GCS_ENABLE after FS_GCS_TIMEOUT, for MAV_GCS_SYSID alone", A + "test_fs_gcs_enable_acts_on_heartbeats_of_the_named_station_alone"),
    ],
    "Modes, arming, acks, streams": [
        Row("DO_SET_MODE", "main and sub mode; two acks", P + "test_mode_changes_are_acked_twice_and_show_in_the_heartbeat",
            "mode number; one ack", A + "test_do_set_mode_answers_once"),
        Row("bad mode", "acks 0, 0 or 0, 1; no change", P + "test_do_set_mode_answers_as_the_firmware_does",
            "FAILED and told; DENIED without the custom bit", A + "test_do_set_mode_answers_once"),
        Row("modes when disarmed", "any; OFFBOARD without a stream as well", P + "test_arming_in_offboard_without_a_stream_is_denied_with_its_reason",
            "any", A + "test_guided_needs_a_position_to_arm_and_says_so"),
        Row("control mode in the air", "OFFBOARD needs setpoints", P + "test_offboard_in_flight_needs_setpoints",
            "GUIDED needs a position", A + "test_armed_without_a_position_guided_is_not_entered"),
        Row("modes that need sticks", "rejected in the air: nobody has a radio", P + "test_in_the_air_modes_that_need_sticks_are_rejected",
            "level, no thrust in STABILIZE and ACRO", A + "test_armed_without_a_position_guided_is_not_entered"),
        Row("SET_MODE", "works, one ack", P + "test_set_mode_message_is_acked_once",
            "works, no ack", A + "test_set_mode_message_works_without_an_ack"),
        Row("arm", "TEMPORARILY_REJECTED with its reason", P + "test_arming_in_offboard_without_a_stream_is_denied_with_its_reason",
            "FAILED with its reason, until the estimator has a position", A + "test_guided_needs_a_position_to_arm_and_says_so"),
        Row("estimator", "ready 2 s after boot", P + "test_before_its_estimator_is_ready_it_shows_uninit_and_refuses_to_arm",
            "30 s after boot; positions are sent from then on", A + "TestStreams::test_a_position_is_sent_only_once_there_is_one"),
        Row("modes that cannot be armed in", "those that need sticks or a mission", P + "test_in_the_air_modes_that_need_sticks_are_rejected",
            "RTL, LAND, BRAKE, AUTO", A + "test_modes_that_only_end_flights_are_not_armable"),
        Row("forced arm", "skips nothing", P + "test_arming_in_offboard_without_a_stream_is_denied_with_its_reason",
            "mandatory checks remain", A + "test_guided_needs_a_position_to_arm_and_says_so"),
        Row("disarm in the air", "rejected; 21196 stops the motors", P + "test_disarming_in_the_air_needs_the_magic_number",
            "FAILED; 21196 stops the motors", A + "test_disarming_in_the_air_fails_unless_forced"),
        Row("arm with another param1", "rounded; 2 is not answered", P + "test_arm_command_values",
            "UNSUPPORTED", A + "test_other_arm_values_are_unsupported"),
        Row("armed and idle on the ground", "disarms after COM_DISARM_PRFLT", P + "test_an_idle_vehicle_disarms_after_ten_seconds",
            "disarms after DISARM_DELAY", A + "test_an_idle_vehicle_disarms_after_disarm_delay"),
        Row("motors up to speed", "COM_SPOOLUP_TIME after arming", P + "test_on_the_ground_the_motors_stand_still_until_they_are_up_to_speed",
            "a second after the first thrust", A + "test_motors_spin_only_after_thrust_and_a_second_of_spooling"),
        Row("unknown command", "UNSUPPORTED", P + "test_services_answer",
            "UNSUPPORTED", A + "TestStreams::test_it_claims_no_more_than_exists"),
        Row("command addressing", "system exact, component 0 or 1", P + "test_commands_to_system_zero_or_to_others_are_not_answered",
            "system 0 too", A + "test_commands_to_system_zero_are_obeyed_and_to_others_not_answered"),
        Row("ack fields", "target is the sender", P + "test_set_mode_message_is_acked_once",
            "the same", L + "test_an_arducopter_fleet_flies_case_1_as_px4_does"),
        Row("sender", "any", C + "test_mavutil_sees_flies_and_lands_them", "any", C + "test_mavutil_sees_flies_and_lands_them"),
        Row("SET_MESSAGE_INTERVAL", "unknown id or HEARTBEAT: FAILED", P + "test_streams_run_at_their_rates_and_follow_set_message_interval",
            "unknown id, under 3 ms or param3: DENIED", A + "TestStreams::test_set_message_interval"),
        Row("REQUEST_DATA_STREAM", "ignored", P + "test_request_data_stream_is_ignored",
            "starts and stops groups", A + "TestStreams::test_request_data_stream_starts_and_stops_groups"),
        Row("REQUEST_MESSAGE 148, capabilities", "of the firmware's 0xE8FF those that exist here (no missions, fence, rally points, FTP)", P + "test_services_answer",
            "of 0xFBEF the same", A + "TestStreams::test_it_claims_no_more_than_exists"),
        Row("integer parameters", "as their bits", P + "TestParameters::test_integers_read_as_their_bits",
            "as numbers", A + "TestStreams::test_parameters_are_numbers_whatever_their_type"),
        Row("HEARTBEAT", "main << 16, sub << 24; base_mode and status by state", P + "test_offboard_heartbeats_show_stream_and_arming",
            "mode number; 81, 89, 217", A + "test_a_fresh_vehicle_shows_stabilize_and_then_a_position"),
        Row("TIMESYNC", "answers; asks at 10 Hz on the onboard link", P + "test_it_asks_for_the_time_ten_times_a_second_on_the_onboard_link",
            "answers; asks every 10 s", A + "test_nothing_streams_until_it_is_asked_for"),
        Row("TIMESYNC latency", "0.15 ms", LEFT_OUT + "answers leave with the next tick of the vehicles' clock",
            "5.6 ms", LEFT_OUT + "answers leave with the next tick of the vehicles' clock"),
        Row("default streams", "the onboard set of rates", P + "test_streams_run_at_their_rates_and_follow_set_message_interval",
            "HEARTBEAT and TIMESYNC alone", A + "test_nothing_streams_until_it_is_asked_for"),
        Row("ATTITUDE_TARGET", "the setpoint, thrust as a norm", P + "test_attitude_target_shows_the_setpoint_and_the_size_of_its_thrust",
            "the target, thrust before the boost", A + "TestThrust::test_tilt_boosts_it_ten_times_at_most"),
        Row("missions", "empty; uploads are not taken", P + "test_a_mission_nobody_uploaded_is_not_flown",
            "the same", P + "test_a_mission_nobody_uploaded_is_not_flown"),
        Row("files", "refused, so that clients go on at once", P + "test_file_transfer_is_refused_so_that_clients_go_on",
            "the same", C + "test_mavproxy_sees_flies_and_lands_them"),
        Row("take off, hold, return, land", "AUTO modes", P + "test_take_off_climbs_to_its_altitude_holds_there_returns_and_lands",
            "GUIDED take-off, RTL, LAND, BRAKE", A + "test_it_returns_lands_and_disarms"),
        Row("under a load it does not know", "the hold's integral carries it", P + "test_a_hold_finds_its_height_under_a_load_it_does_not_know",
            "the same loop", P + "test_a_hold_finds_its_height_under_a_load_it_does_not_know"),
    ],
}  # fmt: skip


def page() -> str:
    """vehicles.md."""
    out = [
        "# What the virtual vehicles do",
        "",
        "Written by `python -m docs.vehicles`. Every row has a test for each persona, named beside it, or says why it is",
        "left out. The facts were established by running ArduCopter 4.7-dev and PX4 main in software.",
        "",
    ]
    for title, rows in SECTIONS.items():
        out += [f"## {title}", "", "| | PX4 | ArduCopter |", "|---|---|---|"]
        for row in rows:
            cells = []
            for does, test in ((row.px4, row.px4_test), (row.arducopter, row.arducopter_test)):
                cells.append(
                    f"{does} *({test})*" if test.startswith(LEFT_OUT) else f"{does} (`{test.split('::')[-1]}`)"
                )
            out.append(f"| {row.what} | {cells[0]} | {cells[1]} |")
        out.append("")
    return "\n".join(out)


if __name__ == "__main__":
    (HERE / "vehicles.md").write_text(page())
