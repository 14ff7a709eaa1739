"""What vehicles measure and what is left of their batteries."""

from pathlib import Path

import numpy as np
import pytest
from conftest import flown, next_offset
from pymavlink.dialects.v20 import common as mav

from bridge.wire.dialect import mavlink
from cablequad.model import lie
from cablequad.model.earth import RADIUS_M, Home, altitude_m
from cablequad.model.noise import Noise
from logs.reading.reader import read
from logs.reading.records import entries
from logs.schema import cablequad_pb2 as pb
from missions.flight.processes.simulate import Serving, settings
from missions.scenario import loading as scenarios
from sitl.batteries import Batteries, Battery
from sitl.firmware.telemetry import Snapshot
from sitl.instruments import Grades, Instruments
from sitl.sensors import Sensors
from sitl.settings import plant_of

STILL = np.zeros(3)


def test_at_rest_instruments_read_gravity_the_field_and_the_air_with_noise_and_bias_from_the_seed() -> None:
    def one(seed: int) -> Instruments:
        return Instruments(Grades(), np.random.default_rng(seed))

    i, turned = one(3), lie.exp(np.array([0.2, -0.3, 1.0]))
    many = np.array([i.acceleration(np.array([0.0, 0.0, -9.81])) for _ in range(400)])
    assert many.std(axis=0) == pytest.approx(0.02, rel=0.2)
    assert np.abs(many.mean(axis=0) - [0, 0, -9.81]).max() < 0.08
    assert np.linalg.norm(i.field_gauss(turned)) == pytest.approx(0.4844, abs=0.004)
    assert altitude_m(i.pressure_hPa(488.0)) == pytest.approx(488.0, abs=1.0)
    assert (one(3).rate(STILL) == one(3).rate(STILL)).all()
    assert (one(3).rate(STILL) != one(4).rate(STILL)).any()


def test_a_wrong_heading_turns_an_attitude_about_the_vertical_and_thrust_with_it() -> None:
    R = lie.exp(np.array([0.0, -0.3, 0.0]))  # leaning forwards
    sensors = Sensors(Noise(), np.random.default_rng(1), (np.zeros((1, 3)), np.zeros((1, 3)), 0.1))
    resting = (R, STILL, 0.0)
    own = Snapshot(0, R, STILL, STILL, STILL, np.array([0.0, 0.0, -9.81]), 0.0, False, 1, resting, Home())
    told = sensors.vehicle(0, own, tells_imu=False).R
    assert told @ R.T == pytest.approx(lie.exp(np.array([0.0, 0.0, 0.1])), abs=1e-12)
    assert abs(told[1, 2] / R[0, 2]) == pytest.approx(np.sin(0.1), abs=1e-12)  # what pushes forwards pushes to the side


def test_a_fix_is_as_old_as_the_receiver_is_late_and_new_only_at_its_rate() -> None:
    exact = Grades(position=0.0, velocity=0.0, fix_us=200_000, fix_delay_us=120_000)
    i = Instruments(exact, np.random.default_rng(0))
    told = {t: i.fix(t, np.array([t * 1e-6, 0.0, 0.0]), np.ones(3)).x[0] for t in range(4000, 1_000_001, 4000)}
    assert told[600_000] == pytest.approx(0.48, abs=0.0041)
    assert told[796_000] == told[600_000] < told[800_000]


def test_what_a_vehicle_tells_of_its_instruments_is_noisy_late_and_biased_as_the_scenario_says(tmp_path: Path) -> None:
    base = scenarios.load("paper-case-1-50hz").scenario
    table = base.model_dump(mode="json")
    table["sensors"] |= {
        "position_bias_m": 0.05, "imu": {"acceleration_m_s2": 0.3, "acceleration_bias_m_s2": 0.0}, "barometer": {},
        "gps": {"position_m": 0.0, "position_bias_m": 1.0, "rate_hz": 5.0, "delay_ms": 200.0},
    }  # fmt: skip
    file = tmp_path / "felt.json"
    file.write_text(type(base).model_validate(table).model_dump_json())
    s = flown(str(file), "--no-replay", "--duration", "6", "--out", str(tmp_path), "--port-offset", str(next_offset()))
    assert s["final_position_error_m"] is not None, s["reason"]
    feels, fixes, places, air = [], [], [], []
    for entry in entries(Path(s["log"])):
        if entry.topic == "/mavlink/quad1/rx":
            f = pb.MavlinkFrame.FromString(entry.data)
            if f.msgid == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU:
                m = mav.MAVLink(None).decode(bytearray(f.frame))
                feels.append((m.xacc, m.yacc, m.zacc))
                air.append(m.abs_pressure)
            elif f.msgid == mavlink.MAVLINK_MSG_ID_GPS_RAW_INT:
                m = mav.MAVLink(None).decode(bytearray(f.frame))
                fixes.append((m.time_usec * 1e-6, m.lat))
            elif f.msgid == mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
                m = mav.MAVLink(None).decode(bytearray(f.frame))
                places.append((m.time_boot_ms * 1e-3, m.x))
    early = np.array(feels[:60])  # held: gravity alone
    assert early.std(axis=0) == pytest.approx(0.3, rel=0.35)
    assert np.std(air[:60]) > 0.003
    true = read(Path(s["log"])).columns["/plant/state"]
    t, x = true["sim_time_ns"] * 1e-9, true["quad_position"][:, 0]
    wrong = [place - np.interp(when, t, x) for when, place in places]
    assert np.ptp(wrong) < 2e-3
    assert 0.001 < abs(np.mean(wrong)) < 0.2
    north = np.array([(when, np.radians(lat * 1e-7 - Home().latitude_deg) * RADIUS_M) for when, lat in fixes])
    moving = north[:, 0] > north[0, 0] + 3.0
    late = [
        np.std(n - np.interp(when - d, t, x))
        for d in (0.0, 0.2, 0.4)
        for when, n in [(north[moving, 0], north[moving, 1])]
    ]
    assert late[1] < 0.5 * late[0]
    assert late[1] < 0.5 * late[2]


def test_a_battery_empties_with_thrust_and_takes_thrust_with_it() -> None:
    flight = scenarios.load("paper-case-1")
    plant = plant_of(settings(flight, Serving(True)))
    weight = flight.system.m * flight.system.g
    batteries = Batteries((Battery(100.0, 0.2), None, None, None), weight)
    plant.thrust = 4.0 ** (2 / 3) * weight  # four times the power
    for _ in range(100):
        batteries.use(plant, 0.1)
    assert batteries.left == pytest.approx([0.6, 1.0, 1.0, 1.0])
    assert plant._thrust_scale == pytest.approx([0.92, 1.0, 1.0, 1.0])
