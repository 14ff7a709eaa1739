"""`fly --live`: the follower of the log that is being written, as a process of its own."""

import multiprocessing
import os
from pathlib import Path

from missions.flight.processes.child_process import begin, leave_to_parent


def _child(part: Path, parent: int) -> None:
    leave_to_parent()
    os.nice(15)  # a picture may be late
    from logs.views.live import follow

    follow(part, lambda: os.getppid() == parent)


class Show:
    """The process that shows a run; it ends with the log."""

    def __init__(self, log: Path) -> None:
        """`log` is the path that the log will have when it is whole."""
        part = log.with_name(log.name + ".part")
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(target=_child, args=(part, os.getpid()), name="cablequad-live", daemon=True)
        begin(self._process)

    def close(self) -> None:
        """Wait until what was flown is shown, for a while."""
        self._process.join(10.0)
        if self._process.is_alive():
            self._process.terminate()
