"""Work that goes into the gaps that others leave on the processors, as long as there are any."""

import contextlib
import os
import threading
import time
from pathlib import Path
from typing import Protocol

WINDOW_S = 0.25  # for which gaps are looked for at a time
LEAST = 0.03  # of all processors' time
LOOK_S = 0.1
_STAT = Path("/proc/stat")


class Work(Protocol):
    """What is done, in steps."""

    leave: bool  # asked to return after this step

    @property
    def done(self) -> bool:
        """Whether nothing is left."""

    @property
    def late(self) -> bool:
        """Whether it does not keep up."""

    def run(self) -> None:
        """Go on until all is `done`, or `leave`."""


def in_gaps(work: Work) -> None:
    """Do `work` in idle time (SCHED_IDLE) where there is some: who wakes beside it never waits for its turn to end.

    A thread that went idle may not come back without privileges: once it is late, as others keep every processor busy,
    the caller's thread goes on in its place, with the share of a processor that it has.
    """
    while not work.done and _unused_beside(work) < LEAST:
        pass  # there may be none for now, as others compile what they need
    if not work.done:
        thread = threading.Thread(target=_idle, args=(work,), name="in gaps", daemon=True)
        thread.start()
        while thread.is_alive():
            thread.join(LOOK_S)
            work.leave = work.leave or work.late
        work.leave = False
    work.run()  # what is left of it


def _unused_beside(work: Work) -> float:
    """Go on with `work` for a while; the share of all processors' time that nobody used meanwhile."""
    before, begun = _unused_s(), time.monotonic()
    clock = threading.Timer(WINDOW_S, setattr, (work, "leave", True))
    clock.daemon = True
    clock.start()
    work.run()
    clock.cancel()
    work.leave = False
    return (_unused_s() - before) / (time.monotonic() - begun) / (os.cpu_count() or 1)


def _unused_s() -> float:
    """Seconds that processors had nothing to do so far, all together; 0 where the system does not say."""
    try:
        _, _, _, _, idle, waiting, *_ = _STAT.read_text().split("\n", 1)[0].split()
        return (int(idle) + int(waiting)) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError):
        return 0.0


def _idle(work: Work) -> None:
    with contextlib.suppress(AttributeError, OSError):  # not on every system
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    work.run()
