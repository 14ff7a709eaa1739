"""The wire's figures beside pymavlink's, in one run: `python -m benchmarks.wire [--out FILE]`.

Codec per message against pymavlink's own objects, a vehicle's handling of a message, and the real-time factor of
`cablequad fly` in lockstep with everything recorded, split by phase on both sides. Phases are wall time, other
processes' turns on the processor included.
"""

import argparse
import importlib
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bridge.fleet.fleet import Fleet
from bridge.loop.state_assembly import StateAssembler
from bridge.wire.dialect import mavlink
from bridge.wire.frames import frame
from bridge.wire.link import Link
from bridge.wire.messages import decode, encode
from bridge.wire.values import AttitudeTarget, CableShape, PayloadState, VehicleAttitude, VehiclePosition
from cablequad.control.law import StateFeedback
from cablequad.model import lie
from cablequad.model.instant import row
from cablequad.model.state import State
from missions.flight.processes import simulate
from missions.flight.recording.log_process import LogProcess
from missions.flight.run import Options, Progress, run
from missions.scenario import loading as scenarios
from sitl.firmware.autopilot import Autopilot, Body, LinkKind
from sitl.firmware.px4 import Px4
from sitl.plant import Plant
from sitl.tracker import Tracker
from sitl.tracker_batch import LoadReport

R = lie.exp(np.array([0.1, -0.2, 0.3]))
V = np.array([0.3, -0.1, 0.2])
HOT: list[Any] = [
    VehicleAttitude.of(1000, R, V),
    VehiclePosition(1000, V, V),
    AttitudeTarget(1000, 1, 1, 7, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.6),
    PayloadState(1_000_000, V, V, R, V),
    CableShape(1_000_000, 1, 5, 0, 1.2, np.tile(V, (5, 2))),
]


FOUR_CABLES, SENDERS = LoadReport(np.full(4, 5)), bytes(5)  # whose batch holds the load's ODOMETRY as well
STILL, LINKS = np.zeros((4, 3)), np.tile(V, (4, 5, 1))
MOVING = row(State(V, V, R, V, LINKS, LINKS, np.tile(R, (4, 1, 1)), STILL), STILL, STILL, np.ones((4, 5)), np.ones(4))


def best_us(call: Callable[[], object], number: int = 2000) -> float:
    """us a call, the best of five."""
    times = []
    for _ in range(5):
        begun = time.perf_counter()
        for _ in range(number):
            call()
        times.append((time.perf_counter() - begun) / number)
    return min(times) * 1e6


def framed(value: Any) -> list[bytes]:
    """The frames of a value; those of a load and its cables as the tracker makes them, all five at once."""
    if not isinstance(value, CableShape | PayloadState):
        return [frame(encode(value), 0, 1, 1)]
    FOUR_CABLES.tell(value.boot_us, MOVING)
    return FOUR_CABLES.framed(SENDERS, SENDERS, 1, 0)


def _packed_anew(kind: Any, fields: list[Any], peer: Any) -> None:
    kind(*fields).pack(peer)


def codec() -> list[dict[str, Any]]:
    """us a message: value to bytes and back, ours and pymavlink's."""
    peer = mavlink.MAVLink(None, 1, 1)
    peer.robust_parsing = True
    rows = []
    for value in HOT:
        packed = encode(value)
        whole = frame(packed, 0, 1, 1)
        message = peer.decode(bytearray(whole))
        fields = [getattr(message, name) for name in message.fieldnames]
        kind = type(message)
        rows.append(
            {
                "message": packed.name,
                "bytes": len(whole),
                "out_us": best_us(partial(framed, value)) / len(framed(value)),
                "in_us": best_us(partial(decode, packed.msgid, whole)),
                "pymavlink_out_us": best_us(partial(_packed_anew, kind, fields, peer)),
                "pymavlink_in_us": best_us(partial(peer.parse_buffer, whole)),
            }
        )
    return rows


IN_A_TICK = {"SET_ATTITUDE_TARGET": 4, "ATTITUDE_QUATERNION": 4, "CABLE_STATE": 4, "ODOMETRY": 1}


def peer_us(rows: list[dict[str, Any]]) -> float:
    """us that pymavlink alone takes to pack and read a tick's messages: how fast the machine runs Python by now."""
    return sum(IN_A_TICK.get(r["message"], 0) * (r["pymavlink_out_us"] + r["pymavlink_in_us"]) for r in rows)


def handling_us() -> float:
    """us that a vehicle takes for one setpoint."""
    vehicle = Px4(1, 4000, (LinkKind.ONBOARD,), Body(0.755, 25.0, 9.81))
    return best_us(lambda: vehicle.handle(0, 250, 191, HOT[2], 1000))


@contextmanager
def timed(places: list[tuple[type | Any, str, str]]) -> Iterator[dict[str, float]]:
    """Wall seconds by phase while inside, for calls of (where, name, phase), without what they call of other phases."""
    spent: dict[str, float] = {}
    depth: list[float] = []
    originals = [(where, name, getattr(where, name)) for where, name, _ in places]

    def wrap(call: Callable[..., Any], phase: str) -> Callable[..., Any]:
        def timing(*a: Any, **k: Any) -> Any:
            begun = time.perf_counter()
            depth.append(0.0)
            try:
                return call(*a, **k)
            finally:
                took = time.perf_counter() - begun
                spent[phase] = spent.get(phase, 0.0) + took - depth.pop()
                if depth:
                    depth[-1] += took

        return timing

    for where, name, phase in places:
        setattr(where, name, wrap(getattr(where, name), phase))
    try:
        yield spent
    finally:
        for where, name, call in originals:
            setattr(where, name, call)


BRIDGE = [
    (Link, "poll", "socket and wait"),
    (Link, "flush", "socket"),
    (Link, "_split", "codec"),
    (StateAssembler, "feed", "observe"),
    (StateAssembler, "estimate", "observe"),
    (StateFeedback, "step", "control"),
    (Fleet, "setpoints", "codec"),
    (Fleet, "due", "protocol"),
    (Fleet, "feed", "protocol"),
    (Link, "put", "codec"),
    (Link, "put_all", "codec"),
    (LogProcess, "received", "record"),
    (LogProcess, "sent", "record"),
    (LogProcess, "decided", "record"),
]
VEHICLES = [
    (Link, "poll", "socket and wait"), (Link, "flush", "socket"), (Link, "_split", "codec"), (Link, "put", "codec"),
    (Plant, "advance", "physics"), (Plant, "truth", "physics"), (Plant, "kinematics", "physics"),
    (Plant, "specific_force", "physics"), (Plant, "command", "physics"), (Autopilot, "outgoing", "codec"),
    (Autopilot, "handle", "protocol"), (Tracker, "tell", "codec"),
    (Link, "put_all", "codec"),
    (simulate, "put", "record"),
]  # fmt: skip
_real_child = simulate._child


def _timed_child(values: Any, status: Any, truth: Any) -> None:
    """The simulator's process with its phases printed at its end."""
    with timed(VEHICLES) as spent:
        _real_child(values, status, truth)
    print(json.dumps({"vehicles": spent}), file=sys.stderr, flush=True)


def flight(seconds: float, phases: bool) -> dict[str, Any]:
    """One flight in lockstep, everything recorded."""
    loaded = scenarios.load("paper-case-1", duration_s=seconds)
    with tempfile.TemporaryDirectory() as folder:
        options = Options(out=Path(folder), port_offset=3300)
        if not phases:
            summary, _ = run(loaded, options, Progress())
            return {"real_time_factor": summary.real_time_factor, "messages": summary.messages_sent}
        # by the name that the other process finds it under, also where this file runs as `__main__`
        simulate._child = importlib.import_module("benchmarks.wire")._timed_child
        try:
            with timed(BRIDGE) as spent:
                begun = time.perf_counter()
                summary, _ = run(loaded, options, Progress())
                wall = time.perf_counter() - begun
        finally:
            simulate._child = _real_child
        return {"real_time_factor": summary.real_time_factor, "wall_s": wall, "bridge": spent}


def main() -> None:
    """Print the tables; write them where asked."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--out", type=Path)
    arguments.add_argument("--seconds", type=float, default=20.0)
    asked = arguments.parse_args()
    console = Console(width=120, highlight=False)
    rows = codec()
    table = Table(title="us a message, value to bytes and back", title_justify="left")
    for column in ("message", "bytes", "out", "in", "pymavlink out", "pymavlink in"):
        table.add_column(column, justify="left" if column == "message" else "right")
    for entry in rows:
        us = (f"{entry[k]:.2f}" for k in ("out_us", "in_us", "pymavlink_out_us", "pymavlink_in_us"))
        table.add_row(entry["message"], str(entry["bytes"]), *us)
    console.print(table)
    handle = handling_us()
    whole = sum(row["out_us"] + row["in_us"] for row in rows) / len(rows) + handle
    console.print(
        f"a vehicle handles a setpoint in {handle:.2f} us; decode, handle, encode: {1e6 / whole:,.0f} messages/s"
    )
    flight(2.0, phases=False)  # compiled, cached, warm
    factors = [flight(asked.seconds, phases=False)["real_time_factor"] for _ in range(3)]
    console.print(
        f"fly in lockstep, {asked.seconds:g} s at 250 Hz, four vehicles, everything recorded: "
        f"{max(factors):.2f} x real time (best of {', '.join(f'{f:.2f}' for f in factors)})"
    )
    before, after = peer_us(rows), peer_us(codec())
    console.print(
        f"a tick of 4 ms takes {4000 / max(factors):.0f} us; pymavlink alone packs and reads its "
        f"{sum(IN_A_TICK.values())} messages in {before:.0f} us (after the flights: {after:.0f})"
    )
    split = flight(asked.seconds, phases=True)
    ticks = asked.seconds * 250
    table = Table(
        title="the controller's process, us a tick (timers included)", title_justify="left", show_header=False
    )
    for phase, seconds in sorted(split["bridge"].items(), key=lambda item: -item[1]):
        table.add_row(phase, f"{seconds / ticks * 1e6:.0f}")
    console.print(table)
    if asked.out:
        figures = {"codec": rows, "handle_us": handle, "real_time_factors": factors, "phases_s": split}
        figures["pymavlink_tick_us"] = [before, after]
        figures["messages_per_s"] = math.floor(1e6 / whole)
        asked.out.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
