"""The recording as a process of its own: decisions and frames from the bridge, truth from the simulator.

The control loop only writes what it did into a pipe. Truth comes by a pipe that joins the simulator and the log and
that the bridge's process never reads. What is written, and in which order, is the merge's.
"""

import contextlib
import fcntl
import math
import multiprocessing
import os
import pickle
import signal
import time
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.link import Received
from cablequad.control.control_step import Sample
from cablequad.model.instant import Motion
from cablequad.model.state import State, differences
from logs.writing import encode
from logs.writing.encode import Model
from logs.writing.recorder import FLUSH_S, Attachment, Recorder, RecorderError
from missions.flight.processes.child_process import begin, leave_to_parent
from missions.flight.recording.idle_scheduler import in_gaps
from missions.flight.recording.ipc import put_sample, sample_shapes
from missions.flight.recording.merge import Judged, Merge
from missions.scenario.metrics import Standing

PIPE_BYTES = 1 << 20  # what may wait for the log before the control loop does
TOGETHER = 16  # decisions in one write, as a wake-up of the log costs more than what it is told
WAIT_S = 0.06  # wall clock, that a decision waits for others at most
AT_ONCE = 256  # entries that are written together, which costs less for each
BATCH = 128  # entries that wait at most, where no tick is answered
LATE_S = 0.5  # that a step may take in the gaps of the processors
LOOK_S = 0.5  # wall clock, between looks at whether the process that an answer is waited for lives
STALL_S = 600.0  # that it may stand still


class LogHeader(NamedTuple):
    """Everything a recording begins with."""

    path: Path
    model: Model
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Sequence[Attachment]
    epoch_ns: int
    with_truth: bool
    target_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    standing: Standing | None = None  # of a mission
    in_gaps: bool = False  # written in the gaps that a flight in lockstep leaves on the processors


class Recording(Protocol):
    """Where a flight's log goes, whoever writes it."""

    error: str | None

    def open(self, header: LogHeader) -> None:
        """Say what is recorded, and where."""

    def wait_ready(self) -> None:
        """Until the log is open. Raises RecorderError if it cannot be."""

    def received(self, boot_us: int, frames: Sequence[Received]) -> None:
        """Frames that came in."""

    def sent(self, boot_us: int, to: Sequence[int], frames: list[bytes]) -> None:
        """Frames that went out, each with the system it went to."""

    def decided(self, boot_us: int, sample: Sample, tension: list[float], phase: str, age_s: float) -> None:
        """A control decision, which ends a tick."""

    def event(self, boot_us: int, kind: str, subject: str, text: str) -> None:
        """Something worth a line."""

    def perf(self, boot_us: int, turnaround_s: float, ticks: int) -> None:
        """Wall-clock figures."""

    def judged(self, whole: bool) -> Judged:
        """What was true of the flight. Ends what truth is written."""

    def finish(self, result: Mapping[str, str]) -> Path:
        """Write everything out; the log's path. Where that failed, `error` says so."""

    def close(self) -> None:
        """End it; without `finish` before, the log ends without a result."""


class Closing(NamedTuple):
    """How a recording ended."""

    path: str
    error: str | None


class LogProcess:
    """The bridge's end of the recording. Its process is on its way before it is known what to record."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        down, self._down = context.Pipe(duplex=False)
        self._up, up = context.Pipe(duplex=False)
        truth, self.truth_end = context.Pipe(duplex=False)
        if hasattr(fcntl, "F_SETPIPE_SZ"):  # elsewhere pipes keep the size they have
            for pipe in (self._down, self.truth_end):
                with contextlib.suppress(OSError):
                    fcntl.fcntl(pipe.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self.error: str | None = None
        self._batch: list[tuple] = []
        self._shapes_told = False
        self._decisions, self._flushed = 0, time.monotonic()  # since then
        self._path = Path()
        self._process = context.Process(target=_child, args=(down, up, truth), name="cablequad-log", daemon=True)
        begin(self._process)
        for end in (down, up, truth):
            end.close()

    def open(self, header: LogHeader) -> None:
        """Say what is recorded, and where."""
        self._path = header.path
        with contextlib.suppress(OSError):  # it ended by itself: `wait_ready` says so
            self._down.send_bytes(pickle.dumps(header, 5))

    def wait_ready(self) -> None:
        """Until the log is open. Raises RecorderError if it cannot be."""
        self.truth_end.close()
        answer = self._answer()
        if answer != "ready":
            raise RecorderError(str(answer))

    def received(self, boot_us: int, frames: Sequence[Received]) -> None:
        """Frames that came in."""
        self._put("rx", boot_us, bytes([f.system for f in frames]), [f.frame for f in frames])

    def sent(self, boot_us: int, to: Sequence[int], frames: list[bytes]) -> None:
        """Frames that went out, each with the system it went to."""
        self._put("tx", boot_us, bytes(to), frames)

    def decided(self, boot_us: int, sample: Sample, tension: list[float], phase: str, age_s: float) -> None:
        """A control decision, which ends a tick."""
        if not self._shapes_told:
            self._shapes_told = True
            self._put("shapes", boot_us, sample_shapes(sample))
        self._put("decided", boot_us, put_sample(sample), tension, phase, age_s)
        self._decisions += 1
        if self._decisions >= TOGETHER or time.monotonic() > self._flushed + WAIT_S:
            self.flush()

    def event(self, boot_us: int, kind: str, subject: str, text: str) -> None:
        """Something worth a line."""
        self._put("event", boot_us, kind, subject, text)

    def perf(self, boot_us: int, turnaround_s: float, ticks: int) -> None:
        """Wall-clock figures; here the loop also learns how the writing goes."""
        self._put("perf", boot_us, turnaround_s, ticks)
        self.flush()
        if self.error is None and self._up.poll():
            self.error = str(self._answer())

    def flush(self) -> None:
        """Hand over what waits."""
        batch, self._batch = self._batch, []
        self._decisions, self._flushed = 0, time.monotonic()
        if batch and self.error is None:
            self._send(batch)

    def judged(self, whole: bool) -> Judged:
        """What was true of the flight. Ends what truth is written.

        Where the run is not `whole`, what the simulator said of ticks that nobody answered is written as well.
        """
        self._put("truth ends", 0, whole)
        self.flush()
        nothing = Judged(math.inf, None)
        answer = self._answer() if self.error is None else nothing
        if isinstance(answer, Judged):
            return answer
        self.error = str(answer)
        return nothing

    def finish(self, result: Mapping[str, str]) -> Path:
        """Write everything out; the log's path. Where that failed, `error` says so."""
        self._put("finish", 0, dict(result))
        self.flush()
        closing = self._answer()
        self._process.join(5.0)
        if isinstance(closing, Closing):
            self.error = self.error or closing.error
            return Path(closing.path)
        self.error = self.error or str(closing)
        return self._path.with_name(self._path.name + ".part")

    def close(self) -> None:
        """End the process; without `finish` before, the log ends without a result."""
        with contextlib.suppress(OSError):
            self._down.close()
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.kill()

    def _put(self, *entry: Any) -> None:
        self._batch.append(entry)
        if len(self._batch) >= BATCH:
            self.flush()

    def _send(self, batch: list[tuple]) -> None:
        try:
            self._down.send_bytes(pickle.dumps(batch, 5))
        except OSError:
            self.error = self.error or "the recording ended by itself"

    def _answer(self) -> Any:
        """What the process says next, however long it takes; why it says nothing, where it has died or stands still."""
        try:
            for _ in range(round(STALL_S / LOOK_S)):
                if self._up.poll(LOOK_S):
                    return self._up.recv()
                if not self._process.is_alive() and not self._up.poll(0.0):
                    return "the recording ended by itself"
        except (EOFError, OSError):
            return "the recording ended by itself"
        return f"the recording has stood still for {STALL_S:g} s"


def recorder_of(header: LogHeader) -> Recorder:
    """What writes the log that begins so. Raises RecorderError."""
    names = {number: kind.msgname for number, kind in mavlink.mavlink_map.items()}
    return Recorder(
        header.path, header.model, header.metadata, header.attachments, header.epoch_ns, header.with_truth, names
    )


def encode_once(model: Model) -> None:
    """Compile what encoding calls before anybody waits for it."""
    n, L = model.system.length.shape
    still = np.zeros((n, 3))
    row = encode.single(Motion(State.hanging(model.system), still, still, np.zeros((n, L)), np.zeros(n)))
    encode.plants([0], [True], row)
    encode.transforms(model, row, [0], True)
    differences(row.state, row.state, model.system.n_links)


def _child(down: Connection, up: Connection, truth: Connection) -> None:
    leave_to_parent()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the bridge's end of the pipe decides
    with contextlib.suppress(OSError):
        os.nice(10)  # the flight goes first
    try:
        header: LogHeader = pickle.loads(down.recv_bytes())
    except (EOFError, OSError):
        return
    try:
        recorder = recorder_of(header)
    except RecorderError as error:
        up.send(str(error))
        return
    encode_once(header.model)
    up.send("ready")
    merge = Merge(recorder, header.model, truth, header.target_m, header.standing)
    writing = _Writing(recorder, merge, down, up)
    if header.in_gaps:
        in_gaps(writing)
    else:
        writing.run()


class _Writing:
    """Takes what comes and writes it, until it has ended."""

    def __init__(self, recorder: Recorder, merge: Merge, down: Connection, up: Connection) -> None:
        self.leave = self.done = False
        self._recorder, self._merge, self._down, self._up = recorder, merge, down, up
        self._batch: list[tuple] = []
        self._flushed = time.monotonic()
        self._begun: float | None = None  # the step that is being made
        self._told_error = False

    @property
    def late(self) -> bool:
        """Whether a step takes as long as what a flush keeps."""
        begun = self._begun
        return begun is not None and time.monotonic() > begun + LATE_S

    def run(self) -> None:
        """Until the recording has ended, or `leave`."""
        while not self.done and not self.leave:
            self._step()
            self._begun = None

    def _step(self) -> None:
        try:
            ready = wait(self._merge.sources(self._down), max(0.0, self._flushed + FLUSH_S - time.monotonic()))
            self._begun = time.monotonic()
            self._merge.listen(ready)
            if self._down in ready:
                self._batch += pickle.loads(self._down.recv_bytes())
        except (EOFError, OSError):
            self._merge.take(self._batch)
            self._merge.end_truth(False)
            self._recorder.finish()
            self.done = True
            return
        now, batch = time.monotonic(), self._batch
        last = batch[-1] if batch and batch[-1][0] in ("truth ends", "finish") else None  # nothing follows these
        due = now >= self._flushed + FLUSH_S
        if last is None and not due and len(batch) < AT_ONCE:
            return  # what waits would be lost with an open chunk as well
        self._batch = []
        self._merge.take(batch if last is None else batch[:-1])
        if due:
            self._recorder.flush()
            self._flushed = now
        if last is not None and last[0] == "truth ends":
            self._merge.end_truth(last[2])
            self._up.send(self._merge.judged)
        elif last is not None:
            self._recorder.metadata("result", last[2])
            path = self._recorder.finish()
            self._up.send(Closing(str(path), self._recorder.error))
            self.done = True
        elif self._recorder.error is not None and not self._told_error:
            self._told_error = True
            self._up.send(self._recorder.error)
