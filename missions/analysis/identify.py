"""How vehicles answer: attitude response and hover thrust, from the log of a flight that tilts them at hover.

A second-order response of bandwidth w, damping z and delay d is fitted to what a vehicle was told (SET_ATTITUDE_TARGET)
and how it turned (ATTITUDE_QUATERNION), roll and pitch together, by least squares. Its hover thrust is what was asked
of it while it hovered, against its weight and that of its cable.
"""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from bridge.wire.messages import decode
from bridge.wire.values import AttitudeTarget, VehicleAttitude
from cablequad.model import lie
from cablequad.types import Array
from logs.reading.reader import LogError, read
from logs.reading.records import entries
from logs.schema import cablequad_pb2 as pb
from missions.analysis.replay_control import Frame, told_by
from missions.scenario.flights import Flight
from sitl.firmware.telemetry import euler

STEP_S = 0.002
AFTER_S = 10.0  # that the last command is known to stand
GUESSES = ((10.0, 0.9, 0.02), (25.0, 0.8, 0.02), (5.0, 0.9, 0.05))
LOWEST, HIGHEST = (2.0, 0.3, 0.0), (80.0, 2.0, 0.2)
HUNG = 0.75  # of the weight of a cable that is slack under its vehicle, that hangs on it
TELLING_RAD = 0.03  # steps that did not tilt a vehicle by this say nothing


class Response(NamedTuple):
    """How one vehicle answers."""

    bandwidth_rad_s: float
    damping: float
    delay_s: float  # from a decision's time stamp until it acts
    misfit_deg: float  # rms of what the fit leaves
    hover_share: float  # of its greatest thrust, asked at hover
    thrust_scale: float  # N made per N asked


Told = tuple[Array, Array]  # (m,) s, (m, 2) rad: commanded roll and pitch


def answers(p: Array, told: Told, at: Array, start: Array) -> Array:
    """(k, 2) rad at times `at` (k,) s: how a response of p = bandwidth (rad/s), damping, delay (s) follows `told`."""
    bandwidth, damping, delay = p
    steps = np.arange(at[0], at[-1] + 2 * STEP_S, STEP_S)
    second_order = [bandwidth**2], [1.0, 2.0 * damping * bandwidth, bandwidth**2]
    numerator, denominator, _ = cont2discrete(second_order, STEP_S, "zoh")
    goals = _mean_commands(told, steps - delay) - start
    out = start + lfilter(numerator.ravel(), denominator, goals, axis=0)
    return np.column_stack([np.interp(at, steps, out[:, k]) for k in range(2)])


def _mean_commands(told: Told, begins: Array) -> Array:
    """(k, 2) rad: the mean of what was commanded in each step that begins there: smooth in the delay.

    A command stands until the next, the first and the last for ever.
    """
    times, angles = told
    turned = np.zeros((len(times) + 1, 2))  # its integral, until far after the last
    turned[1:] = np.cumsum(angles * np.diff(times, append=times[-1] + AFTER_S)[:, None], axis=0)
    edges = np.append(begins, begins[-1] + STEP_S)
    ends = np.append(times, times[-1] + AFTER_S)
    whole = np.column_stack([np.interp(edges, ends, turned[:, k]) for k in range(2)])
    early = np.minimum(edges - times[0], 0.0)[:, None] * angles[0]
    return np.asarray(np.diff(whole + early, axis=0) / STEP_S)


def fitted(told: Told, at: Array, seen: Array) -> tuple[tuple[float, float, float], float]:
    """(bandwidth rad/s, damping, delay s) that fit best, and the rms of what they leave, rad."""

    def misfit(p: Array) -> Array:
        return (answers(p, told, at, seen[0]) - seen).ravel()

    found = [least_squares(misfit, guess, bounds=(LOWEST, HIGHEST), x_scale=(10.0, 1.0, 0.02)) for guess in GUESSES]
    best = min(found, key=lambda f: f.cost)
    w, z, d = (float(p) for p in best.x)
    return (w, z, d), math.sqrt(2.0 * best.cost / seen.size)


class Heard(NamedTuple):
    """One vehicle's part of a log, in the tracker's time."""

    told: Told
    at: Array  # (k,) s
    seen: Array  # (k, 2) rad


def identified(path: Path, flight: Flight) -> list[Response]:
    """How every vehicle answers. Raises LogError where the log does not show it."""
    run = read(path)
    marks = {e.text: e.time_ns * 1e-9 for e in run.events if e.kind == "script"}
    if not {"hover", "steps", "done"} <= set(marks):
        raise LogError(f"log {path}: no tilting of vehicles in it; it is not of a flight that was identified")
    n, system = len(flight.system.m), flight.system
    heard = _heard(path, n, marks["steps"], marks["done"])
    control = run.columns["/control/state"]
    now = control["sim_time_ns"] * 1e-9
    hovering = (now > marks["hover"]) & (now < marks["steps"])
    asked = control["thrust"][hovering].mean(axis=0)
    out = []
    for i, h in enumerate(heard):
        if len(h.at) < 10 or np.ptp(h.seen, axis=0).max() < TELLING_RAD:
            raise LogError(f"log {path}: vehicle {i + 1} did not tilt when it was told to")
        (w, z, d), left = fitted(h.told, h.at, h.seen)
        cable = float(system.M_iT[i] - system.m[i])
        made = (float(system.m[i]) + HUNG * cable) * system.g
        share = float(asked[i] / flight.airframe.max_thrust[i])
        out.append(Response(w, z, d, math.degrees(left), share, made / float(asked[i])))
    return out


def _heard(path: Path, n: int, begin: float, end: float) -> list[Heard]:
    commands: list[list[tuple[float, float, float]]] = [[] for _ in range(n)]
    attitudes: list[list[tuple[float, float, float]]] = [[] for _ in range(n)]
    for entry in entries(path):
        if entry.topic.startswith("/mavlink/") and entry.topic.endswith("/tx"):
            frame = pb.MavlinkFrame.FromString(entry.data)
            value = decode(frame.msgid, frame.frame)
            if isinstance(value, AttitudeTarget) and 1 <= value.system <= n:
                roll, pitch, _ = euler(lie.rotation_from_quat(np.array(value.quat_wxyz)))
                commands[value.system - 1].append((value.boot_ms * 1e-3, roll, pitch))
    for told in told_by(path):
        if not isinstance(told, Frame) or not told.own or not 1 <= told.system <= n:
            continue
        value = told.mapped
        if isinstance(value, VehicleAttitude) and begin <= value.boot_ms * 1e-3 <= end:
            roll, pitch, _ = euler(value.R)
            attitudes[told.system - 1].append((value.boot_ms * 1e-3, roll, pitch))
    asked = [np.array(c).reshape(-1, 3) for c in commands]
    seen = [np.array(sorted(a)).reshape(-1, 3) for a in attitudes]
    return [Heard((c[:, 0], c[:, 1:]), a[:, 0], a[:, 1:]) for c, a in zip(asked, seen, strict=True)]


def with_responses(flight: Flight, found: list[Response]) -> dict[str, Any]:
    """The scenario with what was found in its tables: responses, delay, and rotors that give what they are asked.

    Rotors that are weaker than they are taken for have a lower greatest thrust; what really flies stays as it was.
    """
    s = flight.scenario
    table: dict[str, Any] = s.model_dump(mode="json")
    was, density = s.real.thrust_scale, s.vehicle.air_density_ratio
    scales = list(was) if isinstance(was, list) else [was] * len(found)
    for i, r in enumerate(found):
        own = table["vehicles"][i]
        own["attitude_bandwidth_rad_s"] = round(r.bandwidth_rad_s, 2)
        own["attitude_damping"] = round(r.damping, 3)
        own["max_thrust_N"] = round(float(flight.airframe.max_thrust[i]) / density * r.thrust_scale, 3)
        scales[i] = round(scales[i] / r.thrust_scale, 4)
    table["vehicle"]["identified"] = True
    period_s = flight.control_us * 1e-6
    table["control"]["delay_ticks"] = max(1, round(max(r.delay_s for r in found) / period_s))
    table["real"]["thrust_scale"] = scales
    table["name"] = f"{s.name}-identified"
    return table
