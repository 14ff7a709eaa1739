"""A run as it is flown, in a viewer that is open: the log is followed as it is written, by a process of its own.

The control loop has nothing to do with it. The picture is half a second late, as that is how often the log is flushed.
"""

import socket
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr

from logs.reading.reader import Happening, LogError, Tail
from logs.views import replay
from logs.views.motion import motion_of
from logs.views.replay_layout import layout

VIEWER = ("127.0.0.1", 9876)
LOOK_S = 0.25
START_S = 240.0


def reachable() -> bool:
    """Whether a viewer listens."""
    try:
        socket.create_connection(VIEWER, timeout=1.0).close()
    except OSError:
        return False
    return True


def follow(part: Path, parent_lives: Callable[[], bool]) -> None:
    """Stream the log that is being written as `part` until it ends; it may not be there yet."""
    until = time.monotonic() + START_S
    while not part.exists():
        if time.monotonic() > until or not parent_lives():
            return
        time.sleep(LOOK_S)
    tail = Tail(part)
    out = rr.RecordingStream("cablequad", recording_id=part.name.removesuffix(".mcap.part"))
    out.connect_grpc("rerun+http://{}:{}/proxy".format(*VIEWER))
    events: list[Happening] = []
    trail: list[np.ndarray] = []
    while True:
        ended = not parent_lives()
        tail.look()
        if tail.waiting:
            _send(out, tail, events, trail)
        if tail.ended or ended:
            break
        time.sleep(LOOK_S)
    out.flush()
    out.disconnect()


def _send(out: rr.RecordingStream, tail: Tail, events: list[Happening], trail: list[np.ndarray]) -> None:
    told = len(events) if trail else 0
    run = tail.take(events)
    if not any(e.kind == "release" for e in events):
        return  # the clock of a replay begins with the release
    try:
        motion = motion_of(run)
    except LogError:
        return
    if not trail:
        out.send_blueprint(layout(motion, ended=False))
    trail.append(motion.x0)
    replay.log(out, run, motion, told=told)
    replay.log_trail(out, np.concatenate(trail))
