"""Flights with real ArduCopters and PX4s, as they were recorded: what they showed, and whether the stand-ins do the same.

The recordings are not part of the project; where they are not beside it these tests are skipped.
"""

import importlib.util
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from conftest import cablequad
from workbench import CMD_INTERVAL

from bridge.wire.messages import decode
from bridge.wire.values import CommandAck, Heartbeat, Imu, StatusText, VehicleAttitude
from logs.reading.records import entries
from logs.schema import cablequad_pb2 as pb
from missions.analysis.identify import identified
from missions.analysis.replay_control import flight_of
from sitl.firmware.personas import PERSONAS

FLOWN = Path(__file__).resolve().parents[2] / "shared" / "flown"
FIRMWARE = {"arducopter": False, "px4": True}

pytestmark = pytest.mark.skipif(not FLOWN.is_dir(), reason="no recordings of real autopilots beside the project")


def stand_in() -> ModuleType:
    """The stand-in's own module, which imports nothing of ours."""
    spec = importlib.util.spec_from_file_location("autopilot", Path(__file__).parent / "peers" / "autopilot.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def said(name: str, vehicle: int = 1) -> Iterator[object]:
    """What a vehicle said, in its order."""
    for entry in entries(FLOWN / name):
        if entry.topic == f"/mavlink/quad{vehicle}/rx":
            frame = pb.MavlinkFrame.FromString(entry.data)
            yield decode(frame.msgid, frame.frame)


@pytest.mark.parametrize("firmware", FIRMWARE)
def test_attitudes_stream_at_a_phase_of_their_own_as_the_stand_ins_do(firmware: str) -> None:
    phases: Counter[int] = Counter()
    for value in said(f"{firmware}-case-1/run.mcap"):
        if isinstance(value, VehicleAttitude):
            phases[value.boot_ms % 20] += 1
    ((phase, count),) = phases.most_common(1)
    assert count > 0.7 * phases.total()
    assert stand_in().PHASE_US[FIRMWARE[firmware]] == 1000 * phase


@pytest.mark.parametrize("firmware", FIRMWARE)
def test_modes_are_the_ones_that_profiles_and_stand_ins_know(firmware: str) -> None:
    modes = {v.custom_mode for v in said(f"{firmware}-case-1/run.mcap") if isinstance(v, Heartbeat)}
    assert (6 << 16 if FIRMWARE[firmware] else 4) in modes
    assert modes <= ({6 << 16, 4 << 16 | 3 << 24} if FIRMWARE[firmware] else {0, 4, 17})


def test_arducopter_refuses_what_it_does_not_have_in_words_that_the_stand_in_says_too() -> None:
    values = list(said("arducopter-case-1/run.mcap"))
    texts = [v.text for v in values if isinstance(v, StatusText)]
    for msgid in (141, 331):
        assert f"No ap_message for mavlink id ({msgid})" in texts
        assert msgid not in stand_in().COPTER_HAS
    refused = [v for v in values if isinstance(v, CommandAck) and v.command == CMD_INTERVAL and v.result == 2]
    assert len(refused) == 2
    asked = {1, 24, 30, 31, 32, 33, 36, 49, 83, 85, 105, 147, 245}  # and taken
    assert asked <= stand_in().COPTER_HAS


def test_arducopter_boots_in_the_order_of_the_stand_in() -> None:
    texts = [v.text for v in said("arducopter-case-1/run.mcap") if isinstance(v, StatusText)]
    order = [texts.index(words) for words in stand_in().BOOT]
    assert order == sorted(order)
    assert order[-1] < texts.index("Arm: Need Position Estimate")


@pytest.mark.parametrize("firmware", FIRMWARE)
def test_how_they_answer_is_what_is_known_of_them_and_what_the_stand_ins_are_set_to(firmware: str) -> None:
    """12.4 to 13.4 rad/s, damping 0.83 to 0.86, 43 to 55 ms, and 10.1 to 10.4, 1.06 to 1.08, 33 to 37 ms."""
    path = FLOWN / f"{firmware}-identify.mcap"
    found, known = identified(path, flight_of(path)), PERSONAS[firmware].known
    assert len(found) == 4
    for r in found:
        assert r.bandwidth_rad_s == pytest.approx(known.bandwidth_rad_s, abs=0.7)
        assert r.damping == pytest.approx(known.damping, abs=0.05)
        assert r.delay_s == pytest.approx(known.delay_s, abs=0.008)
    assert stand_in().RESPONSE[FIRMWARE[firmware]][:2] == (known.bandwidth_rad_s, known.damping)


@pytest.mark.parametrize("firmware", FIRMWARE)
def test_accelerometers_are_not_on_ticks(firmware: str) -> None:
    """So that what they say is compared with what was known of the ticks around it."""
    stamps = Counter(v.boot_us // 1000 % 20 for v in said(f"{firmware}-case-1/run.mcap", 4) if isinstance(v, Imu))
    assert stamps[0] < 0.02 * stamps.total()


@pytest.mark.parametrize("name", ["arducopter-case-1", "px4-case-1", "arducopter-ground-to-ground"])
def test_todays_controller_takes_every_recorded_measurement(name: str) -> None:
    """What it would decide; where it first differs is told with the reason."""
    _, out, err = cablequad("log", "replay-control", str(FLOWN / name / "run.mcap"), "--json")
    told = json.loads(out)
    assert told["decisions"] > 700, err
    first = told["first"]
    assert first is None or (first["field"] and first["t_s"] >= 0.0)
