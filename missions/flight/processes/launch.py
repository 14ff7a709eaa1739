"""Autopilots of their own: their command lines and parameters for a scenario's vehicles, and their processes."""

import math
import os
import shlex
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from bridge.wire.ports import vehicle_ports
from cablequad.model.earth import Home
from missions.flight.processes.simulate import Backend, joint_steps, kinds
from missions.scenario.flights import Flight, ScenarioError, parameters_of
from sitl.external.ardupilot import MOTORS

ARM_M = 0.17  # of rotors that nothing is said of
RATE_LOOP = 18.0  # rad/s: the bandwidth that rate gains are scaled to
STOP_S = 5.0
BESIDE_PX4 = '"$(dirname "$(readlink -f "$(command -v px4)")")/../etc"'  # where px4 on the PATH has its start scripts
ACCELEROMETERS = ("", "2")  # that SITL has, by what their parameters' names have in them
COMPASS_OFFSETS = {"X": 5.0, "Y": 13.0, "Z": -18.0}  # that SITL's compasses have; without them none is calibrated


class Launch(NamedTuple):
    """How one autopilot is started."""

    name: str  # of its folder
    argv: tuple[str, ...]
    environment: Mapping[str, str]
    files: Mapping[str, str]  # to be written into its folder: name -> text

    def line(self) -> str:
        """As one would type it."""
        before = " ".join(f"{k}={shlex.quote(v)}" for k, v in self.environment.items())
        words = " ".join(word if word == BESIDE_PX4 else shlex.quote(word) for word in self.argv)
        return f"{before} {words}".strip()


def launches(flight: Flight, backend: Backend, path: Path | None, offset: int, host: str, speed: float) -> list[Launch]:
    """How every vehicle's autopilot is started; `path` as `--launch` gives it.

    Raises ScenarioError where a binary is not there, or ports cannot be moved by `offset`.
    """
    out = []
    for i, kind in enumerate(kinds(flight, backend)):
        if kind == "arducopter":
            rate = round(1e6 / joint_steps(flight, backend).frame_us)
            out.append(_ardupilot(flight, i, _binary(path, "arducopter"), offset, host, speed=speed, rate=rate))
        else:
            out.append(_px4(flight, i, _binary(path, "px4"), offset, speed))
    return out


def _binary(path: Path | None, name: str) -> Path:
    """The binary `name` at or below `path`; just its name where no path is given."""
    if path is None:
        return Path(name)
    places = [path, path / name, path / "bin" / name, path / "px4_sitl_default" / "bin" / name]
    for place in places:
        if place.is_file() and os.access(place, os.X_OK) and place.name.startswith(name[:3]):
            return place.resolve()
    raise ScenarioError(f"--launch {path}: no {name} that can be run there; give its binary or the folder it is in")


def started_with(flight: Flight, backend: Backend, i: int) -> dict[str, float]:
    """The parameters that vehicle i's autopilot is started with, by name."""
    return (arducopter_values if kinds(flight, backend)[i] == "arducopter" else px4_values)(flight, i)


def _ardupilot(flight: Flight, i: int, binary: Path, offset: int, host: str, speed: float, rate: int) -> Launch:
    if offset % 10 and binary.is_absolute():
        raise ScenarioError(f"--port-offset {offset}: ArduPilot's ports move in steps of 10")
    home = Home()
    argv = (
        str(binary), "--model", f"JSON:{host}", "-I", str(i + offset // 10), "--sysid", str(i + 1), "--home",
        f"{home.latitude_deg},{home.longitude_deg},{home.altitude_m:g},0", "--rate", str(rate), "--speedup",
        f"{speed if math.isfinite(speed) else 10:g}", "--wipe", "--defaults", "vehicle.parm", "--serial0",
        f"udpclient:{host}:{vehicle_ports(i)[0] + offset}",
    )  # fmt: skip
    return Launch(
        f"vehicle-{i + 1}-arducopter", argv, {}, {"vehicle.parm": parameter_file(arducopter_values(flight, i))}
    )


def _px4(flight: Flight, i: int, binary: Path, offset: int, speed: float) -> Launch:
    if offset and binary.is_absolute():
        raise ScenarioError(f"--port-offset {offset}: PX4's ports go by its instance alone; leave it out")
    root = binary.parent.parent
    environment = {"PX4_SIM_MODEL": "none_iris", "PX4_SIM_SPEED_FACTOR": f"{speed if math.isfinite(speed) else 10:g}"}
    environment |= {f"PX4_PARAM_{name}": f"{value:g}" for name, value in px4_values(flight, i).items()}
    argv = (str(binary), "-i", str(i), "-d", str(root / "etc") if binary.is_absolute() else BESIDE_PX4)
    return Launch(f"vehicle-{i + 1}-px4", argv, environment, {})


def authority(flight: Flight, i: int) -> tuple[float, float]:
    """rad/s^2 that a full command turns vehicle i by: about its roll and pitch axes, and about yaw.

    A full command is half of every rotor's greatest thrust more on one side and less on the other.
    """
    system, most = flight.world.system, float(flight.airframe.max_thrust[i]) / MOTORS
    rotors = flight.world.around.rotors
    arm, drag = (ARM_M, 0.02) if rotors is None else (float(rotors.arm[i]), float(rotors.drag[i]))
    tilt = MOTORS * 0.5 * most * arm / math.sqrt(2.0)
    J = system.J[i]
    return tilt / float(max(J[0, 0], J[1, 1])), MOTORS * 0.5 * most * drag / float(J[2, 2])


def parameter_file(values: Mapping[str, float]) -> str:
    """A file as ArduPilot's `--defaults` takes it."""
    return "".join(f"{name} {value:.6g}\n" for name, value in values.items())


def arducopter_values(flight: Flight, i: int) -> dict[str, float]:
    """What ArduCopter is to be told: frame, thrust as share of the greatest, rate gains for the vehicle's inertia.

    Only accelerometers that SITL has are calibrated: it arms with none that is calibrated and not there.
    """
    tilting, turning = authority(flight, i)
    p, yaw = min(max(RATE_LOOP / tilting, 0.01), 0.5), min(max(0.5 * RATE_LOOP / turning, 0.05), 2.5)
    density = flight.scenario.vehicle.air_density_ratio  # which it makes up for
    share = density * float(flight.system.m[i]) * flight.system.g / float(flight.airframe.max_thrust[i])
    calibrated = {f"COMPASS_OFS{k}_{a}": v for k in ("", "2", "3") for a, v in COMPASS_OFFSETS.items()}
    calibrated |= {f"INS_ACC{k}OFFS_{a}": 0.001 for k in ACCELEROMETERS for a in "XYZ"}
    calibrated |= {f"INS_ACC{k}SCAL_{a}": 1.001 for k in ACCELEROMETERS for a in "XYZ"}
    return calibrated | {
        "FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0, "GUID_OPTIONS": 8.0, "GUID_TIMEOUT": 3.0,
        "MOT_THST_EXPO": 0.65, "MOT_SPIN_MIN": 0.15, "MOT_SPIN_MAX": 0.95, "MOT_SPIN_ARM": 0.1, "MOT_BAT_VOLT_MAX": 0.0,
        "MOT_THST_HOVER": min(max(share, 0.125), 0.6875), "MOT_HOVER_LEARN": 0.0, "MOT_YAW_HEADROOM": 100.0,
        "ATC_RAT_RLL_P": p, "ATC_RAT_RLL_I": p, "ATC_RAT_RLL_D": 0.02 * p,
        "ATC_RAT_PIT_P": p, "ATC_RAT_PIT_I": p, "ATC_RAT_PIT_D": 0.02 * p,
        "ATC_RAT_YAW_P": yaw, "ATC_RAT_YAW_I": 0.1 * yaw,
        "FS_THR_ENABLE": 0.0, "FS_GCS_ENABLE": 0.0, "FENCE_ENABLE": 0.0, "BATT_MONITOR": 4.0, "LOG_DISARMED": 0.0,
    } | parameters_of(flight.scenario, i)  # fmt: skip


def px4_values(flight: Flight, i: int) -> dict[str, float]:
    """What PX4 is to be told: rate gains for the vehicle's inertia, no radio, linear speed of the motors."""
    tilting, turning = authority(flight, i)
    p, yaw = min(max(RATE_LOOP / tilting, 0.01), 0.5), min(max(0.5 * RATE_LOOP / turning, 0.02), 0.6)
    share = float(flight.system.m[i]) * flight.system.g / float(flight.airframe.max_thrust[i])
    return {
        "COM_RC_IN_MODE": 4.0, "NAV_RCL_ACT": 0.0, "NAV_DLL_ACT": 0.0, "COM_OF_LOSS_T": 1.0, "THR_MDL_FAC": 0.0,
        "MPC_THR_HOVER": min(max(math.sqrt(share), 0.1), 0.8), "MC_ROLLRATE_P": p, "MC_ROLLRATE_I": p,
        "MC_ROLLRATE_D": 0.02 * p, "MC_PITCHRATE_P": p, "MC_PITCHRATE_I": p, "MC_PITCHRATE_D": 0.02 * p,
        "MC_YAWRATE_P": yaw, "IMU_INTEG_RATE": 250.0, "SDLOG_MODE": -1.0,
    } | parameters_of(flight.scenario, i)  # fmt: skip


def start_lines(starts: list[Launch], folder: Path) -> list[str]:
    """Every autopilot's folder below `folder` with its files in it; the lines that start them. Raises ScenarioError."""
    lines = []
    for start in starts:
        own = folder / start.name
        try:
            own.mkdir(parents=True, exist_ok=True)
            for name, text in start.files.items():
                (own / name).write_text(text)
        except OSError as error:
            raise ScenarioError(f"folder {own}: {error.strerror}; work where you may write") from None
        lines.append(f"(cd {shlex.quote(str(own))} && {start.line()})")
    return lines


class Autopilots:
    """Their processes, each in a folder of its own below `folder`; what they print goes to autopilot.log there."""

    def __init__(self, starts: list[Launch], folder: Path) -> None:
        """Starts all. Raises ScenarioError where one cannot be."""
        self._processes: list[tuple[Launch, subprocess.Popen[bytes]]] = []
        start_lines(starts, folder)
        try:
            for start in starts:
                own = folder / start.name
                with (own / "autopilot.log").open("wb") as log:
                    process = subprocess.Popen(
                        start.argv, cwd=own, env={**os.environ, **start.environment}, stdin=subprocess.DEVNULL,
                        stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
                    )  # fmt: skip
                self._processes.append((start, process))
        except OSError as error:
            self.stop()
            raise ScenarioError(f"{starts[len(self._processes)].argv[0]}: {error.strerror}") from None

    def ended(self) -> str | None:
        """Which has ended by itself, and how; None while all run."""
        for start, process in self._processes:
            code = process.poll()
            if code is not None:
                return f"{start.name} ended by itself (exit code {code}); see its autopilot.log"
        return None

    def stop(self) -> None:
        """End them, and those that do not want to."""
        for _, process in self._processes:
            if process.poll() is None:
                process.terminate()
        deadline = time.monotonic() + STOP_S
        for _, process in self._processes:
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
