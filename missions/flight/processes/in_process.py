"""A flight in one process and one thread: vehicles and log beside the controller, the same bytes between them.

Whoever waits lets the other side go on. Nothing waits for the wall clock, so nothing depends on the computer.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from bridge.wire.link import Received
from bridge.wire.memory import MemoryNetwork
from cablequad.control.control_step import Sample
from logs.writing.recorder import Recorder
from missions.flight.recording.ipc import put, put_sample, sample_shapes
from missions.flight.recording.log_process import LogHeader, encode_once, recorder_of
from missions.flight.recording.merge import Judged, Merge
from sitl.plant import PhysicsError
from sitl.server import Server
from sitl.settings import Report, ServerOutput, Settings

TOGETHER = 64  # decisions that are encoded at once, which costs less for each
FLUSH_DECISIONS = 4096  # between two times that what is written is handed to the disk


class _Truth:
    """What the simulator says, until the log takes it."""

    def __init__(self) -> None:
        self._records: deque[bytes] = deque()

    def send_bytes(self, buf: bytes) -> None:
        self._records.append(buf)

    def poll(self, timeout: float = 0.0, /) -> bool:
        del timeout
        return bool(self._records)

    def recv_bytes(self) -> bytes:
        if not self._records:
            raise EOFError
        return self._records.popleft()


class InProcessLog:
    """The log, written where the flight is flown; see LogProcess."""

    def __init__(self) -> None:
        self.truth_end = _Truth()
        self.error: str | None = None
        self._recorder: Recorder | None = None
        self._merge: Merge | None = None
        self._header: LogHeader | None = None
        self._batch: list[tuple] = []
        self._decisions = self._unflushed = 0
        self._shapes_told = self._closed = False

    def open(self, header: LogHeader) -> None:
        """Say what is recorded, and where."""
        self._header = header

    def wait_ready(self) -> None:
        """Open the log. Raises RecorderError if it cannot be."""
        header = self._header
        assert header is not None
        self._recorder = recorder_of(header)
        encode_once(header.model)
        self._merge = Merge(self._recorder, header.model, self.truth_end, header.target_m, header.standing)

    def received(self, boot_us: int, frames: Sequence[Received]) -> None:
        """Frames that came in."""
        self._batch.append(("rx", boot_us, bytes([f.system for f in frames]), [f.frame for f in frames]))

    def sent(self, boot_us: int, to: Sequence[int], frames: list[bytes]) -> None:
        """Frames that went out, each with the system it went to."""
        self._batch.append(("tx", boot_us, bytes(to), frames))

    def decided(self, boot_us: int, sample: Sample, tension: list[float], phase: str, age_s: float) -> None:
        """A control decision, which ends a tick."""
        if not self._shapes_told:
            self._shapes_told = True
            self._batch.append(("shapes", boot_us, sample_shapes(sample)))
        self._batch.append(("decided", boot_us, put_sample(sample), tension, phase, age_s))
        self._decisions += 1
        if self._decisions >= TOGETHER:
            self.flush()

    def event(self, boot_us: int, kind: str, subject: str, text: str) -> None:
        """Something worth a line."""
        self._batch.append(("event", boot_us, kind, subject, text))

    def perf(self, boot_us: int, turnaround_s: float, ticks: int) -> None:
        """Wall-clock figures."""
        self._batch.append(("perf", boot_us, turnaround_s, ticks))

    def flush(self) -> None:
        """Write what waits."""
        batch, self._batch = self._batch, []
        if self._merge is None or self._recorder is None:
            return
        self._merge.take(batch)
        self._unflushed += self._decisions
        self._decisions = 0
        if self._unflushed >= FLUSH_DECISIONS:
            self._unflushed = 0
            self._recorder.flush()
        self.error = self.error or self._recorder.error

    def judged(self, whole: bool) -> Judged:
        """What was true of the flight. Ends what truth is written."""
        self.flush()
        assert self._merge is not None
        self._merge.end_truth(whole)
        return self._merge.judged

    def finish(self, result: Mapping[str, str]) -> Path:
        """Write everything out; the log's path. Where that failed, `error` says so."""
        assert self._recorder is not None
        self.flush()
        self._recorder.metadata("result", result)
        self._closed = True
        path = self._recorder.finish()
        self.error = self.error or self._recorder.error
        return path

    def close(self) -> None:
        """End it; without `finish` before, the log ends without a result."""
        if self._recorder is not None and not self._closed:
            self._closed = True
            self.flush()
            self._recorder.finish()


class InProcessSimulator:
    """The vehicles, which take their turn when the controller waits; see Simulator."""

    def __init__(self, values: Settings, truth: _Truth, network: MemoryNetwork) -> None:
        """Raises LinkError where an address is taken; what else cannot be served is the `failure`."""
        self.failure: str | None = None
        self.untested = False
        self.report: Report | None = None
        self._stopped = False
        self._truth = truth
        self._turns: Iterator[None] = iter(())
        self._server: Server | None = None
        try:
            self._server = Server(values, self._sink, network)
        except ValueError as error:
            self.failure = str(error)

    def wait_ready(self, waiting: Callable[[], bool]) -> bool:
        """They are, where they can be served."""
        del waiting
        return self.failure is None

    def go(self) -> None:
        """Let the vehicles' clock run, a turn at a time."""
        assert self._server is not None
        self._turns = self._server.turns(lambda: self._stopped)

    def go_on(self) -> bool:
        """One turn; False once they have ended."""
        try:
            next(self._turns)
        except StopIteration:
            return False
        except PhysicsError as error:
            assert self._server is not None
            t = self._server.now_us * 1e-6
            self.failure = f"physics: {error} (t = {t:.2f} s of the vehicles' clock)"
            return False
        return True

    def stop(self) -> None:
        """End the vehicles and take what they still had to say."""
        if self._stopped or self._server is None:
            return
        self._stopped = True
        while self.go_on():
            pass
        self.report = self._server.report()
        self._server.close()

    def _sink(self, message: ServerOutput) -> None:
        put(self._truth, [message])
