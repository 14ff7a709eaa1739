"""Work in the gaps of the processors: done beside others while there are any, carried on where there are none."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from conftest import flown

from logs.reading.reader import read
from missions.flight.recording import idle_scheduler as gaps

pytestmark = pytest.mark.alone

STEPS, LATE_FROM = 60, 30


class Counted:
    """Steps, and the threads that did them."""

    def __init__(self, late_from: int) -> None:
        self.leave = False
        self.by: list[str] = []
        self._late_from = late_from

    @property
    def late(self) -> bool:
        return len(self.by) >= self._late_from

    @property
    def done(self) -> bool:
        return len(self.by) >= STEPS

    def run(self) -> None:
        while not self.done and not self.leave:
            self.by.append(threading.current_thread().name)
            time.sleep(0.02)


HERE = threading.current_thread().name


def test_work_that_keeps_up_is_done_beside_its_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gaps, "LEAST", 0.0)
    work = Counted(STEPS + 1)
    gaps.in_gaps(work)
    first = work.by.index("in gaps")  # it begins here, to see whether there are gaps
    assert 0 < first < STEPS
    assert work.by == [HERE] * first + ["in gaps"] * (STEPS - first)


def test_work_that_is_late_is_carried_on_by_its_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gaps, "LEAST", 0.0)
    work = Counted(LATE_FROM)
    gaps.in_gaps(work)
    beside = work.by.count("in gaps")
    first = work.by.index("in gaps")
    assert LATE_FROM <= first + beside < STEPS
    assert work.by == [HERE] * first + ["in gaps"] * beside + [HERE] * (STEPS - first - beside)


def test_work_stays_with_its_caller_where_there_are_no_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gaps, "LEAST", 1.1)
    work = Counted(STEPS)
    gaps.in_gaps(work)
    assert work.by == [HERE] * STEPS


def test_a_flight_in_lockstep_comes_to_its_end_where_every_processor_is_busy(tmp_path: Path, offset: int) -> None:
    """Its recording has no idle time to go into: it takes what it needs, nobody waits in vain, nothing is left out."""
    spin = "while True: pass"
    busy = [subprocess.Popen([sys.executable, "-c", spin]) for _ in os.sched_getaffinity(0)]
    try:
        run = flown(
            "--out", str(tmp_path), "--no-replay", "--duration", "1.5", "--port-offset", str(offset), sockets=True
        )
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert all(process.returncode == -signal.SIGKILL for process in busy)  # busy from its start to its end
    log = read(Path(run["log"]))
    assert log.complete
    assert not [e for e in log.events if e.kind == "sitl-answer-missing"]
