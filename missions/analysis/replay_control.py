"""Today's controller on yesterday's measurements: every decision of a log made again, and the first that differs.

The frames that came in are decoded and observed as in flight; only the times of decisions, the phase and the release
are taken from the log. A decision is compared as it would be written.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bridge.fleet.fleet import COMPONENT, SYSTEM, TRACKER
from bridge.loop.state_assembly import Instant, StateAssembler
from bridge.loop.time_sync import ClockOffset, TimeSync
from bridge.mission.phases import FLY
from bridge.wire.messages import decode
from bridge.wire.values import Command
from cablequad.control.control_step import Measurement
from cablequad.control.design import Design
from cablequad.control.trajectory import at
from logs.reading.columns import columns
from logs.reading.messages import Messages
from logs.reading.reader import LogError, read
from logs.reading.records import entries
from logs.schema import cablequad_pb2 as pb
from logs.writing import encode
from missions.flight.setup import loop_of, set_up
from missions.scenario import laws
from missions.scenario import loading as scenarios
from missions.scenario.flights import Flight, ScenarioError
from missions.scenario.script import OUTSIDE

SYSTEMS = 199  # ids that vehicles may have
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
    if script == OUTSIDE.encode():
        raise LogError(f"log {path}: flown by a program that the log does not hold; its decisions cannot be made again")
    return scenarios.restored(attached.decode(), source, None if script is None else script.decode())


def redecide(path: Path) -> Redecided:
    """Make every decision of a log again. Raises LogError where the log holds none, or nothing to make them from."""
    try:
        flight = flight_of(path)
        design = laws.design(flight)
    except ScenarioError as error:
        raise LogError(f"log {path}: its scenario does not load: {error}") from None
    follow = _follow if flight.scenario.mission is None else _follow_mission
    after = follow(path, flight, design)
    if not after:
        raise LogError(f"log {path}: no decision in it")
    return _compared(read(path).columns.get("/control/state", {}), after)


def _follow(path: Path, flight: Flight, design: Design) -> list[bytes]:
    """The decisions of a plan; when it flies and when it was released is taken from the log."""
    observer = StateAssembler(loop_of(flight))
    law = laws.law_of(flight)
    memory, after = law.first(design), []
    for told in told_by(path, len(flight.system.m)):
        match told:
            case Frame():
                if told.own:
                    observer.feed(told.system, told.mapped)
            case pb.Event():
                if told.kind == "release":
                    observer.released()
            case pb.ControlState():
                boot_ms, instant = _instant(path, observer, told)
                measured = Measurement(told.t, instant.state, restrained=told.phase != FLY)
                memory, sample = law.step(design, memory, measured, at(flight.trajectory, told.t))
                observer.commanded(boot_ms, sample.R_c, sample.f)
                tension, age_s = instant.tension.tolist(), instant.age_ms * 1e-3
                after += encode.controls([boot_ms * 1000], encode.single(sample), [tension], [told.phase], [age_s])
    return after


def _follow_mission(path: Path, flight: Flight, design: Design) -> list[bytes]:
    """The decisions of a mission, which also decides by what its fleet has said, and when."""
    fleet, decider, _, mission = set_up(flight, design, configure=True)
    assert mission is not None
    after: list[bytes] = []
    heard: float | None = None  # s, of frames that came before the first decision
    for told in told_by(path, len(flight.system.m)):
        match told:
            case Frame():
                if heard is not None and told.now != heard and not after:
                    fleet.due(heard)
                heard = told.now
                fleet.feed(told.system, told.component, told.value, told.now)
                if isinstance(told.value, Command) and (told.value.system, told.value.component) == (SYSTEM, COMPONENT):
                    decider.command(told.value.command, told.value.params)
                if told.own:
                    decider.feed(told.system, told.mapped)
            case pb.ControlState():
                boot_ms, instant = _instant(path, decider.observer, told)
                decided = decider.answer(told.t, boot_ms * 1e-3, instant)
                fleet.observed(boot_ms * 1e-3, decided.gaps_m)
                fleet.due(boot_ms * 1e-3)
                sample, age_s = decided.sample, instant.age_ms * 1e-3
                after += encode.controls(
                    [boot_ms * 1000], encode.single(sample), [decided.tension], [decider.phase], [age_s]
                )
    mission.close()
    return after


class Frame(NamedTuple):
    """A frame that came in and made sense."""

    now: float  # s, vehicles' clock
    system: int
    component: int
    value: Any
    mapped: Any
    own: bool  # of the flight controller itself, or of the tracker


def told_by(path: Path, vehicles: int = SYSTEMS) -> Iterator[Frame | pb.Event | pb.ControlState]:
    """What a log says that decisions go by, in its order; what vehicles say is in the tracker's time and frame.

    What systems other than the `vehicles` and the tracker measure is nobody's own.
    """
    run = read(path)
    epoch_ns = run.epoch_ns
    relation = TimeSync(SYSTEMS, TRACKER, any(event.kind == "clock" for event in run.events))
    for entry in entries(path):
        if entry.topic.startswith("/mavlink/") and entry.topic.endswith("/rx"):
            f = pb.MavlinkFrame.FromString(entry.data)
            value = decode(f.msgid, f.frame)
            if value is not None:
                relation.learn(f.sysid, value)
                tracker = (f.sysid, f.compid) == (TRACKER, COMPONENT)
                own = tracker or (f.compid == 1 and 1 <= f.sysid <= vehicles)
                mapped = relation.mapped(f.sysid, value)
                yield Frame((entry.log_time - epoch_ns) * 1e-9, f.sysid, f.compid, value, mapped, own)
        elif entry.topic == "/event":
            event = pb.Event.FromString(entry.data)
            if event.kind == "clock":
                relation.set(ClockOffset.read(event.subject, event.text))
            yield event
        elif entry.topic == "/control/state":
            yield pb.ControlState.FromString(entry.data)


def _instant(path: Path, observer: StateAssembler, was: pb.ControlState) -> tuple[int, Instant]:
    """The time stamp (ms) that a decision was made for, and what was known of it."""
    boot_ms = was.sim_time_ns // 1_000_000
    instant = observer.estimate(boot_ms)
    if instant is None:
        raise LogError(f"log {path}: no state can be made of the frames before t = {was.t:.3f} s")
    return boot_ms, instant


def _compared(was: Mapping[str, np.ndarray], after: list[bytes]) -> Redecided:
    now = columns(pb.ControlState.DESCRIPTOR, Messages(after))
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
