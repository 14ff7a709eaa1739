"""The real firmware under the load: run where its binaries are, skipped loudly elsewhere.

    CABLEQUAD_ARDUCOPTER=/path/to/arducopter CABLEQUAD_PX4=/path/to/px4_sitl_default pytest tests/firmware

`CABLEQUAD_ARDUCOPTER` is the arducopter binary, `CABLEQUAD_PX4` PX4's build folder (with bin/px4 and etc/). PX4's ports
cannot be moved: nothing else may use them meanwhile.
"""

import json
import os
import signal
import subprocess
import time
import warnings
from pathlib import Path

import numpy as np
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


def flown(command: str, scenario: str, backend: tuple[str, str], folder: Path, *more: str) -> dict:
    """One flight with the real firmware, started and stopped with it."""
    name, path = backend
    usual = () if command == "identify" else ("--firmware", "auto", "--no-replay")
    code, out, err = Command(
        command, scenario, "--backend", name, "--launch", path, "--json", "--out", str(folder), *usual, *more
    ).wait(FLIGHT_S)
    assert out, err
    return {**json.loads(out), "exit_code": code, "error": err}


def events(s: dict, kind: str) -> list[str]:
    return [e.text for e in read(Path(s["log"])).events if e.kind == kind]


def test_four_real_autopilots_carry_case_1_from_their_stands(backend: tuple[str, str], tmp_path: Path) -> None:
    """It arms, with every parameter taken; acceptance holds, e_q as far as the estimator lets it."""
    s = flown("fly", "paper-case-1-50hz", backend, tmp_path)
    assert s["exit_code"] == 0, s["reason"]
    assert s["final_position_error_m"] < 0.02
    assert s["real_time_factor"] > 0.9
    assert read(Path(s["log"])).complete
    assert events(s, "parameter") == []
    assert not [text for text in events(s, "statustext") if "No ap_message" in text]


def test_they_make_the_thrust_that_they_are_asked_for_and_every_one_is_known(
    backend: tuple[str, str], tmp_path: Path
) -> None:
    s = flown("fly", "paper-case-1-50hz", backend, tmp_path)
    assert len(s["thrust_scale"]) == 4
    for scale in s["thrust_scale"]:
        assert scale is not None
        assert scale["scale"] == pytest.approx(1.0, abs=0.01)


def test_attitudes_are_not_older_than_they_need_to_be(backend: tuple[str, str], tmp_path: Path) -> None:
    """At 50 Hz from 50 Hz of attitudes it was 19 ms with ArduCopter and 12 ms with PX4."""
    s = flown("fly", "paper-case-1-50hz", backend, tmp_path)
    assert s["state_age_ms"] < 8.0


def test_clocks_are_related_once_and_not_set_anew_in_flight(backend: tuple[str, str], tmp_path: Path) -> None:
    s = flown("fly", "ground-to-ground", backend, tmp_path)
    run = read(Path(s["log"]))
    assert not [e for e in run.events if e.kind == "clock" and e.time_ns > run.release_ns]


def test_four_real_autopilots_fly_from_the_ground_to_the_ground(backend: tuple[str, str], tmp_path: Path) -> None:
    s = flown("fly", "ground-to-ground", backend, tmp_path)
    assert "mission flown to its end" in s["reason"] or "asked" in s["reason"], s["reason"]
    assert s["set_down_error_m"] < 0.05
    assert s["touch_down_m_s"] < 0.2
    run = read(Path(s["log"]))
    plant = run.columns["/plant/state"]
    before = plant["sim_time_ns"] < run.release_ns
    x = plant["payload_position"][before]
    assert float(np.linalg.norm(x[-1, :2] - x[len(x) // 4, :2])) < 0.002  # it stands: nothing creeps


@pytest.mark.parametrize("scenario", ["one-vehicle", "two-vehicles"])
def test_one_and_two_fly_as_their_scenarios_are_shipped(
    scenario: str, backend: tuple[str, str], tmp_path: Path
) -> None:
    """Which suppose 40 rad/s and 250 Hz."""
    s = flown("fly", scenario, backend, tmp_path)
    assert s["final_position_error_m"] < 0.05, s["reason"]


def test_a_parameter_of_the_firmware_itself_is_set(backend: tuple[str, str], tmp_path: Path) -> None:
    name = {"px4": "COM_DISARM_LAND", "ardupilot": "LAND_REPOSITION"}[backend[0]]
    file = tmp_path / "own.toml"
    file.write_text(scenarios.text("paper-case-1-50hz") + f"\n[vehicle.parameters]\n{name} = 1.0\nNO_SUCH_ONE = 1.0\n")
    s = flown("fly", str(file), backend, tmp_path)
    named = events(s, "parameter")
    assert len(named) == 4
    assert all("NO_SUCH_ONE" in text and "no such parameter" in text for text in named)


def test_the_lines_that_are_printed_start_them_and_fly_connects(backend: tuple[str, str], tmp_path: Path) -> None:
    """Physics and controller first, the autopilots half a minute later: both wait, and say for what."""
    name, path = backend
    folder = Path(path).parent if Path(path).is_file() else Path(path) / "bin"
    served = Command("sitl", "paper-case-1-50hz", "--backend", name)
    lines: list[str] = []
    while len(lines) < 4:
        assert served.process.stdout is not None
        line = served.process.stdout.readline()
        if line.strip().startswith("(cd"):
            lines.append(line.strip())
    urls = [f"udpin:127.0.0.1:{port}" for port in (14540, 14541, 14542, 14543, 14600)]
    flying = Command(
        "fly", "paper-case-1-50hz", *(word for url in urls for word in ("--connect", url)), "--configure",
        "--no-replay", "--json", "--out", str(tmp_path),
    )  # fmt: skip
    time.sleep(30.0)
    env = {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}
    started = [
        subprocess.Popen(["sh", "-c", line], env=env, start_new_session=True, stdout=subprocess.DEVNULL)
        for line in lines
    ]
    try:
        _, out, err = flying.wait(FLIGHT_S)
    finally:
        for process in started:
            os.killpg(process.pid, signal.SIGKILL)
        served.interrupt()
    assert json.loads(out)["final_position_error_m"] < 0.2, err
    assert "waiting for vehicle 1: its first word" in err


def _pids(log: Path, vehicle: int) -> list[int]:
    """Processes that work in a vehicle's folder."""
    own = next(log.with_suffix("").glob(f"vehicle-{vehicle}-*")).resolve()
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and (entry / "cwd").resolve() == own:
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def _in_carry(name: str, path: str, folder: Path, *more: str) -> tuple[Command, Path]:
    """A flight that has begun to carry, and its log that is still being written."""
    flying = Command(
        "fly", "ground-to-ground", "--backend", name, "--launch", path, "--json", "--no-replay", "--out", str(folder),
        *more,
    )  # fmt: skip
    assert flying.process.stderr is not None
    for line in flying.process.stderr:
        if "phase: carry" in line:
            break
    time.sleep(2.0)
    return flying, next(folder.glob("*.mcap*"))


def test_one_that_stands_still_for_a_while_ends_nothing(backend: tuple[str, str], tmp_path: Path) -> None:
    flying, log = _in_carry(*backend, tmp_path)
    pids = _pids(log.with_suffix("") if log.suffix == ".part" else log, 2)
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(4.0)
    for pid in pids:
        os.kill(pid, signal.SIGCONT)
    code, out, err = flying.wait(FLIGHT_S)
    assert code == 0, err
    assert json.loads(out)["set_down_error_m"] < 0.05


def test_one_that_is_killed_in_mid_carry_is_the_only_one_given_up(backend: tuple[str, str], tmp_path: Path) -> None:
    flying, log = _in_carry(*backend, tmp_path)
    for pid in _pids(log.with_suffix("") if log.suffix == ".part" else log, 2):
        os.kill(pid, signal.SIGKILL)
    code, out, _ = flying.wait(FLIGHT_S)
    assert code == 1
    s = json.loads(out)
    assert len(events(s, "lost")) == 1
    assert len(events(s, "fate")) == 4
    assert events(s, "phase")[-1] == "disarm"


def test_how_real_autopilots_answer_is_found(backend: tuple[str, str], tmp_path: Path) -> None:
    s = flown("identify", "ground-to-ground", backend, tmp_path)
    for vehicle in s["vehicles"]:
        assert 3.0 < vehicle["bandwidth_rad_s"] < 40.0
        assert 0.7 < vehicle["thrust_scale"] < 1.4
