"""What a recording begins with: the run, the system and its gains, the scenario."""

import json
import math
import platform
import subprocess
import time
from collections.abc import Mapping, Sequence
from importlib import metadata as packages
from pathlib import Path

from cablequad.control.design import Design
from cablequad.control.yaw_frame import about_down
from cablequad.model import lie
from logs.writing.encode import SCHEMA_VERSION, Model
from logs.writing.recorder import Attachment, RecorderError
from missions.flight.recording.log_process import LogHeader
from missions.scenario.flights import Flight
from missions.scenario.mission_setup import guards, standing


def header_of(flight: Flight, design: Design, out: Path, lockstep: bool, connected: bool, vehicles: str) -> LogHeader:
    """What a recording of the flight begins with, in a new file in `out`. Raises RecorderError."""
    s = flight.scenario
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecorderError(f"folder {out}: {error.strerror}; choose another with --out") from None
    stamp = time.strftime("%Y%m%d-%H%M%S")
    path = out / f"{s.name}-{stamp}.mcap"
    serial = 1
    while path.exists() or path.with_name(path.name + ".part").exists():
        serial += 1
        path = out / f"{s.name}-{stamp}-{serial}.mcap"
    model = _model(flight, design)
    ground_z = None if s.ground is None else s.ground.z_m
    limits = {} if s.mission is None else {g.name: g.limit for g in guards(flight)}
    about = {
        "scenario": s.name,
        "seed": str(s.seed),
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "cablequad": packages.version("cablequad"),
        "schema_version": str(SCHEMA_VERSION),
        "python": platform.python_version(),
        "git_commit": _commit(),
        "time": "vehicles' clock" + (" in lockstep" if lockstep else ""),
        "frame": "NED world, FRD bodies",
        "quaternion_order": "wxyz",
        "units": "SI",
        "vehicles": vehicles,
    }
    gains = {"K_x": design.K_x.tolist(), "K_xdot": design.K_xdot.tolist(), "u_star": design.u_star.tolist()}
    return LogHeader(
        path,
        model,
        {
            "run": about,
            "model": drawn_model(model, s.target.position_m, ground_z, limits),
            "gains": {"law": s.control.law, **{key: json.dumps(value) for key, value in gains.items()}},
        },
        [
            Attachment("scenario.toml", "application/toml", flight.source.encode()),
            Attachment("scenario.json", "application/json", s.model_dump_json(indent=1).encode()),
            *([Attachment("mission.py", "text/x-python", flight.script.encode())] if flight.script else []),
        ],
        s.epoch_s * 10**9,
        with_truth=not connected,
        standing=standing(flight),
        in_gaps=lockstep,
        target_m=(float(s.target.position_m[0]), float(s.target.position_m[1]), float(s.target.position_m[2])),
    )


def _model(flight: Flight, design: Design) -> Model:
    x, y, z = flight.scenario.payload.box_m
    turned = about_down(math.radians(flight.scenario.target.yaw_deg))
    w, a, b, c = lie.quat_from_rotation(turned @ design.hanging.R0).tolist()
    return Model(flight.system, (x, y, z), tuple(flight.airframe.max_thrust.tolist()), (w, a, b, c))


def drawn_model(
    model: Model, target_m: Sequence[float], ground_z: float | None = None, limits: Mapping[str, float] | None = None
) -> dict[str, str]:
    """The `model` metadata record: what a replay needs to draw the system, each value as JSON.

    `limits` are those of the guards of a mission, by their names.
    """
    system = model.system
    values = {
        "n": len(system.m),
        "n_links": system.n_links.tolist(),
        "lengths_m": system.length.tolist(),
        "attachments_m": system.rho.tolist(),
        "box_m": list(model.box),
        "max_thrust_N": list(model.max_thrust),
        "target_m": list(target_m),
        "target_quat_wxyz": list(model.target_quat_wxyz),
        "ground_z_m": ground_z,
        "guards": dict(limits or {}),
    }
    return {key: json.dumps(value) for key, value in values.items()}


def _commit() -> str:
    """The git commit of the sources that fly, if they are a checkout."""
    try:
        here = Path(__file__).parent
        out = subprocess.run(
            ["git", "-C", str(here), "rev-parse", "HEAD"], capture_output=True, text=True, timeout=2, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
    return out.stdout.strip() if out.returncode == 0 else "unknown"
