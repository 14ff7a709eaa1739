"""The real firmware under the load: run where its binaries are, skipped loudly elsewhere.

    CABLEQUAD_ARDUCOPTER=/path/to/arducopter CABLEQUAD_PX4=/path/to/px4_sitl_default pytest tests/firmware

`CABLEQUAD_ARDUCOPTER` is the arducopter binary, `CABLEQUAD_PX4` PX4's build folder (with bin/px4 and etc/). PX4's ports
cannot be moved: nothing else may use them meanwhile.
"""

import json
import os
import warnings
from pathlib import Path

import pytest
from conftest import Command

from logs.reading.reader import read
from missions.scenario import loading as scenarios

BINARIES = {"ardupilot": os.environ.get("CABLEQUAD_ARDUCOPTER"), "px4": os.environ.get("CABLEQUAD_PX4")}
WHERE = {"ardupilot": "CABLEQUAD_ARDUCOPTER", "px4": "CABLEQUAD_PX4"}
FLIGHT_S = 600.0

pytestmark = pytest.mark.timeout(900)


@pytest.fixture(params=list(BINARIES))
def backend(request: pytest.FixtureRequest) -> tuple[str, str]:
    """A backend, and where its firmware is."""
    path = BINARIES[request.param]
    if path is None:
        text = f"REAL FIRMWARE NOT TESTED: {request.param}; set {WHERE[request.param]} to its binary"
        warnings.warn(text, stacklevel=2)
        pytest.skip(text)
    return request.param, path


def flown(command: str, scenario: str, backend: tuple[str, str], folder: Path) -> dict:
    """One flight with the real firmware, started and stopped with it."""
    name, path = backend
    more = () if command == "identify" else ("--firmware", "auto", "--no-replay")
    code, out, err = Command(
        command, scenario, "--backend", name, "--launch", path, "--json", "--out", str(folder), *more
    ).wait(FLIGHT_S)
    assert out, err
    return {**json.loads(out), "exit_code": code, "error": err}


def test_four_real_autopilots_carry_case_1_from_their_stands(backend: tuple[str, str], tmp_path: Path) -> None:
    s = flown("fly", "paper-case-1-50hz", backend, tmp_path)
    assert "plan flown to its end" in s["reason"] or "asked" in s["reason"], s["reason"]
    assert s["final_position_error_m"] < 0.2
    assert s["real_time_factor"] > 0.9
    assert read(Path(s["log"])).complete


def test_four_real_autopilots_fly_from_the_ground_to_the_ground(backend: tuple[str, str], tmp_path: Path) -> None:
    s = flown("fly", "ground-to-ground", backend, tmp_path)
    assert "mission flown to its end" in s["reason"] or "asked" in s["reason"], s["reason"]
    assert s["set_down_error_m"] < 0.3
    assert s["touch_down_m_s"] < 0.5


def test_one_real_autopilot_flies_too(backend: tuple[str, str], tmp_path: Path) -> None:
    base = scenarios.load("one-vehicle").scenario
    vehicle = base.vehicle.model_copy(update={"attitude_bandwidth_rad_s": 10.0})  # what both firmwares show
    control = base.control.model_copy(update={"rate_hz": 50, "law": "sampled", "delay_ticks": 1})
    file = tmp_path / "one.json"
    file.write_text(base.model_copy(update={"vehicle": vehicle, "control": control}).model_dump_json())
    s = flown("fly", str(file), backend, tmp_path)
    assert s["final_position_error_m"] < 0.3, s["reason"]


def test_how_real_autopilots_answer_is_found(backend: tuple[str, str], tmp_path: Path) -> None:
    s = flown("identify", "ground-to-ground", backend, tmp_path)
    for vehicle in s["vehicles"]:
        assert 3.0 < vehicle["bandwidth_rad_s"] < 40.0
        assert 0.7 < vehicle["thrust_scale"] < 1.4
