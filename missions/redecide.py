"""Today's controller on yesterday's measurements: every decision of a log made again, and the first that differs.

The frames that came in are decoded and observed as in flight; only the times of decisions, the phase and the release
are taken from the log. A decision is compared as it would be written.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bridge.decide import Decider
from bridge.fleet import COMPONENT, SYSTEM, TRACKER
from bridge.mission import Mission
from bridge.observe import Observer
from bridge.phases import FLY, PREPARE
from bridge.wire.dialect import mavlink
from bridge.wire.messages import decode
from bridge.wire.values import Command
from cablequad.design import Design
from cablequad.pilot import Measurement, first_memory, tick
from cablequad.trajectory import at
from logs import encode
from logs.columns import columns
from logs.reader import LogError, entries, read
from logs.schema import cablequad_pb2 as pb
from missions import scenario as scenarios
from missions.run import loop_of, prepared
from missions.scenario import Flight, ScenarioError

DECISION = ("ideal_force", "thrust", "attitude", "e_x0", "e_v0", "Psi", "e_q", "e_w", "position", "link_direction")


class Divergence(NamedTuple):
    """A decision that came out otherwise."""

    t_s: float
    field: str
    largest: float  # difference
    decided_before: int  # equal decisions before it


class Redecided(NamedTuple):
    """What replaying the decisions of a log showed."""

    decisions: int
    first: Divergence | None
    largest: dict[str, float]  # difference of every field over the whole log


def flight_of(path: Path) -> Flight:
    """The flight that a log says it is of, from what is attached to it. Raises LogError, ScenarioError."""
    run = read(path)
    attached = run.attachments.get("scenario.json")
    if attached is None:
        raise LogError(f"log {path}: no scenario is attached; it was not written by cablequad or is cut at its start")
    source = run.attachments.get("scenario.toml", b"").decode()
    script = run.attachments.get("mission.py")
    return scenarios.restored(attached.decode(), source, None if script is None else script.decode())


def redecide(path: Path) -> Redecided:
    """Make every decision of a log again. Raises LogError where the log holds none, or nothing to make them from."""
    try:
        flight = flight_of(path)
        design = scenarios.design(flight)
    except ScenarioError as error:
        raise LogError(f"log {path}: its scenario does not load: {error}") from None
    follow = _follow if flight.scenario.mission is None else _follow_mission
    return follow(path, flight, design)


def _follow(path: Path, flight: Flight, design: Design) -> Redecided:
    observer = Observer(loop_of(flight))
    memory = first_memory(design)
    recorded, after = read(path).columns.get("/control/state", {}), []
    for entry in entries(path):
        if entry.topic.startswith("/mavlink/") and entry.topic.endswith("/rx"):
            f = pb.MavlinkFrame.FromString(entry.data)
            if f.compid == (COMPONENT if f.sysid == TRACKER else 1):
                observer.feed(f.sysid, _value(f))
        elif entry.topic == "/event":
            if pb.Event.FromString(entry.data).kind == "release":
                observer.released()
        elif entry.topic == "/control/state":
            was = pb.ControlState.FromString(entry.data)
            boot_ms = was.sim_time_ns // 1_000_000
            instant = observer.estimate(boot_ms)
            if instant is None:
                raise LogError(f"log {path}: no state can be made of the frames before t = {was.t:.3f} s")
            measured = Measurement(was.t, instant.state, held=was.phase != FLY)
            memory, sample = tick(memory, measured, at(flight.trajectory, was.t), design)
            observer.commanded(boot_ms, sample.R_c, sample.f)
            tension, age_s = instant.tension.tolist(), instant.age_ms * 1e-3
            after.append(encode.control(boot_ms * 1000, sample, tension, was.phase, age_s))
    if not after:
        raise LogError(f"log {path}: no decision in it")
    return _compared(recorded, after)


def _follow_mission(path: Path, flight: Flight, design: Design) -> Redecided:
    """As `_follow`; a mission also decides by what its fleet has said, and when."""
    fleet, plan, loop = prepared(flight, design, configure=True)
    assert isinstance(plan, Mission)
    decider = Decider(plan, loop, design)
    run = read(path)
    recorded = run.columns.get("/control/state", {})
    after: list[bytes] = []
    heard: float | None = None  # s, of frames that were not answered yet
    for entry in entries(path):
        if entry.topic.startswith("/mavlink/") and entry.topic.endswith("/rx"):
            f = pb.MavlinkFrame.FromString(entry.data)
            now = (entry.log_time - run.epoch_ns) * 1e-9
            if heard is not None and now != heard and not after:
                fleet.due(heard)
            heard, value = now, _value(f)
            if value is None:
                continue
            fleet.feed(f.sysid, f.compid, value, now)
            if isinstance(value, Command) and (value.system, value.component) == (SYSTEM, COMPONENT):
                plan.command(value.command, value.params)
            if f.compid == (COMPONENT if f.sysid == TRACKER else 1):
                decider.feed(f.sysid, value)
        elif entry.topic == "/control/state":
            was = pb.ControlState.FromString(entry.data)
            boot_ms = was.sim_time_ns // 1_000_000
            instant = decider.observer.estimate(boot_ms)
            if instant is None:
                raise LogError(f"log {path}: no state can be made of the frames before t = {was.t:.3f} s")
            own = decider.answer(was.t, boot_ms * 1e-3, instant)
            decider.observer.commanded(boot_ms, own.R_c, own.f)
            fleet.observed(boot_ms * 1e-3, [0.0] * fleet.n)
            fleet.due(boot_ms * 1e-3)
            tension, age_s = decider.tension(instant), instant.age_ms * 1e-3
            phase = str(plan.phase or PREPARE)
            after.append(encode.control(boot_ms * 1000, decider.whole(own), tension, phase, age_s))
    plan.close()
    if not after:
        raise LogError(f"log {path}: no decision in it")
    return _compared(recorded, after)


def _value(f: Any) -> Any:
    try:
        return decode(f.msgid, f.frame)
    except (mavlink.MAVError, ValueError, ArithmeticError):
        return None


def _compared(was: Mapping[str, np.ndarray], after: list[bytes]) -> Redecided:
    now = columns(pb.ControlState.DESCRIPTOR, after)
    first: Divergence | None = None
    largest = {}
    for name in DECISION:
        if was[name].shape != now[name].shape:
            gap = np.full(len(after), np.inf)
        else:
            gap = np.abs(np.nan_to_num(was[name]) - np.nan_to_num(now[name])).reshape(len(after), -1).max(axis=1)
        largest[name] = float(gap.max())
        where = np.flatnonzero(gap > 0)
        if len(where) and (first is None or where[0] < first.decided_before):
            k = int(where[0])
            first = Divergence(float(was["t"][k]), name, float(gap[k]), k)
    return Redecided(len(after), first, largest)
