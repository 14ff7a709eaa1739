"""The recording as a process of its own: decisions and frames from the bridge, truth from the simulator.

The control loop only writes what it did into a pipe. Truth comes by a pipe that joins the
simulator and the scribe and that the bridge's process never reads. What the simulator says of a tick is written when
that tick has been answered, and before the answer: a run's log does not depend on how the processes happened to run.
"""

import contextlib
import fcntl
import math
import multiprocessing
import os
import pickle
import signal
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bridge.link import Received, Sent
from bridge.phases import CARRIED
from bridge.wire.dialect import mavlink
from cablequad.pilot import Sample
from cablequad.state import Difference, State, differences
from logs import encode
from logs.encode import Model, Motion
from logs.recorder import FLUSH_S, Attachment, Decisions, Message, Recorder, RecorderError
from missions.channel import Shapes, Told, put_sample, sample_shapes, take, take_motions, take_samples
from missions.tracking import Followed, Following, Grounded, OnGround, Standing
from sitl.settings import Event

PIPE_BYTES = 1 << 20  # what may wait for the scribe before the control loop does
TOGETHER = 16  # decisions in one write, as a wake-up of the scribe costs more than what it is told
WAIT_S = 0.06  # wall clock, that a decision waits for others at most
AT_ONCE = 512  # entries that are written together, which costs less for each
BATCH = 128  # entries that wait at most, where no tick is answered
TRUTH_WAIT_S = 1.0  # the simulator says what it did right after it spoke; longer means that it has ended
START_S = 60.0
TAUT_N = 0.05  # a cable that was slack is taut again when every link pulls with this


class Opening(NamedTuple):
    """Everything a recording begins with."""

    path: Path
    model: Model
    metadata: Mapping[str, Mapping[str, str]]
    attachments: Sequence[Attachment]
    epoch_ns: int
    with_truth: bool
    target_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    standing: Standing | None = None  # of a mission


class Judged(NamedTuple):
    """What was true of a flight, by the simulator; nothing where there is none."""

    smallest_tension_N: float
    followed: Followed | None
    grounded: Grounded | None = None


class Closing(NamedTuple):
    """How a recording ended."""

    path: str
    error: str | None


class Scribe:
    """The bridge's end of the recording. Its process is on its way before it is known what to record."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        down, self._down = context.Pipe(duplex=False)
        self._up, up = context.Pipe(duplex=False)
        truth, self.truth_end = context.Pipe(duplex=False)
        if sys.platform == "linux":  # elsewhere pipes keep the size they have
            for pipe in (self._down, self.truth_end):
                with contextlib.suppress(OSError):
                    fcntl.fcntl(pipe.fileno(), fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self.error: str | None = None
        self._batch: list[tuple] = []
        self._shapes_told = False
        self._decisions, self._flushed = 0, time.monotonic()  # since then
        self._path = Path()
        self._process = context.Process(target=_child, args=(down, up, truth), name="cablequad-scribe", daemon=True)
        self._process.start()
        for end in (down, up, truth):
            end.close()

    def open(self, opening: Opening) -> None:
        """Say what is recorded, and where."""
        self._path = opening.path
        with contextlib.suppress(OSError):  # it ended by itself: `wait_ready` says so
            self._down.send_bytes(pickle.dumps(opening, 5))

    def wait_ready(self) -> None:
        """Until the log is open. Raises RecorderError if it cannot be."""
        self.truth_end.close()
        answer = self._answer(START_S)
        if answer != "ready":
            raise RecorderError(str(answer))

    def received(self, boot_us: int, frames: Sequence[Received]) -> None:
        """Frames that came in."""
        self._put("rx", boot_us, [(f.system, f.frame) for f in frames])

    def sent(self, boot_us: int, frames: Sequence[tuple[int, Sent]]) -> None:
        """Frames that went out, each with the system it went to."""
        self._put("tx", boot_us, [(to, frame.frame) for to, frame in frames])

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
            self.error = str(self._answer(0.0))

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
        answer = self._answer(START_S) if self.error is None else nothing
        if isinstance(answer, Judged):
            return answer
        self.error = str(answer)
        return nothing

    def finish(self, result: Mapping[str, str]) -> Path:
        """Write everything out; the log's path. Where that failed, `error` says so."""
        self._put("finish", 0, dict(result))
        self.flush()
        closing = self._answer(START_S)
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

    def _answer(self, timeout_s: float) -> Any:
        try:
            if self._up.poll(timeout_s):
                return self._up.recv()
        except (EOFError, OSError):
            pass
        return "the recording ended by itself"


class _Ledger:
    """The scribe's side: puts what it is told into the recorder, truth in its place."""

    def __init__(
        self,
        recorder: Recorder,
        model: Model,
        truth: Connection,
        target_m: tuple[float, float, float],
        standing: Standing | None,
    ) -> None:
        self._recorder = recorder
        self._used = np.arange(model.system.length.shape[1])[None, :] < model.system.n_links[:, None]
        self._shape = model.system.length.shape
        self._n_links = model.system.n_links
        self._truth: Connection | None = truth
        self._told: deque[Told | Event] = deque()
        self._answered_us = 0
        self._ended = False
        self._slack: set[int] = set()
        self._shapes: Shapes = ()
        self._smallest_N = math.inf
        self._following = Following(target_m)
        self._recent: list[tuple[list[int], State]] = []  # the truth that was taken in last
        self._true: deque[tuple[int, list[Message]]] = deque()  # what is to be written of it
        self._ground = None if standing is None else OnGround(standing)

    def take(self, batch: Sequence[tuple]) -> None:
        """Write entries of the bridge, in their order: what was decided is made many at a time."""
        begun = 0
        for k, (kind, _, *rest) in enumerate(batch):
            if kind == "shapes":
                self._shapes = rest[0]
            elif kind == "event" and rest[0] == "end" and not self._ended:
                self._write(batch[begun:k])
                begun, self._ended = k, True
        self._write(batch[begun:])
        self._recorder.settle()

    @property
    def judged(self) -> Judged:
        """What was true of the flight so far."""
        return Judged(
            self._smallest_N, self._following.followed(), None if self._ground is None else self._ground.judged()
        )

    def _write(self, batch: Sequence[tuple]) -> None:
        decided = iter(self._decisions([entry[1:] for entry in batch if entry[0] == "decided"]))
        for kind, boot_us, *rest in batch:
            match kind:
                case "rx" | "tx":
                    self._recorder.frames(boot_us, kind, rest[0])
                case "decided":
                    self._write_truth(boot_us)
                    self._recorder.write(boot_us, next(decided))
                case "event":
                    self._recorder.write(boot_us, self._recorder.line(boot_us, *rest))
                case "perf":
                    turnaround_s, ticks = rest
                    self._recorder.perf(boot_us, turnaround_s, ticks, len(self._told))

    def _decisions(self, entries: Sequence[tuple]) -> list[list[Message]]:
        """What is to be written of decisions; the truth until the last of them is written."""
        if not entries:
            return []
        boot_us, samples, tension, phase, age_s = (list(column) for column in zip(*entries, strict=True))
        self._read_truth(boot_us[-1])
        self._take_in(boot_us[-1])
        d = Decisions(boot_us, take_samples(samples, self._shapes), tension, phase, age_s)
        row = {us: k for k, us in enumerate(us for times, _ in self._recent for us in times)}
        known = [k for k, us in enumerate(boot_us) if us in row]
        if not known:
            return self._recorder.decided(d)
        was = [row[boot_us[k]] for k in known]
        true = State(*(np.concatenate(field)[was] for field in zip(*(s for _, s in self._recent), strict=True)))
        off = differences(State(*(field[known] for field in d.sample.state)), true, self._n_links)
        self._follow(d, known, true, off)
        return self._recorder.decided(d, off, known)

    def _follow(self, d: Decisions, known: list[int], true: State, off: Difference) -> None:
        """How well the load follows, by those decisions whose true state is known."""
        flown = [j for j, k in enumerate(known) if d.phase[k] in CARRIED and not self._ended]
        if not flown:
            return
        t, wanted = d.sample.t.tolist(), d.sample.reference.x0.tolist()  # type: ignore[attr-defined]
        x, v = true.x0.tolist(), true.v0.tolist()
        for j in flown:
            self._following.take(t[known[j]], x[j], v[j], wanted[known[j]])
        self._following.judge(off.link_direction[flown][:, self._used], off.attitude[flown])

    def sources(self, down: Connection) -> list[Connection]:
        """What may have something to say."""
        return [down] if self._truth is None else [down, self._truth]

    def listen(self, ready: Sequence[object]) -> None:
        """Take what the simulator has said, also while nothing is decided: it must never wait for us."""
        if self._truth in ready:
            self._take_truth()

    def end_truth(self, whole: bool) -> None:
        """Read to the end of what the simulator said."""
        self._read_truth(2**62)
        self._take_in(self._answered_us if whole else 2**62)
        self._write_truth(2**62)
        self._recorder.settle()

    def _read_truth(self, until_us: int) -> None:
        """Take what the simulator says until it has spoken of `until_us`, or has no more to say."""
        while self._truth is not None and (not self._told or self._told[-1].boot_us < until_us):
            if not self._truth.poll(TRUTH_WAIT_S if until_us < 2**62 else 0.1):
                return
            self._take_truth()

    def _take_truth(self) -> None:
        assert self._truth is not None
        try:
            self._told += take(self._truth.recv_bytes())
        except (EOFError, OSError):
            self._truth = None

    def _take_in(self, answered_us: int) -> None:
        """Make what is to be written of the truth until then."""
        self._answered_us = answered_us
        self._recent = []
        states: list[Told] = []
        while self._told and self._told[0].boot_us <= answered_us:
            message = self._told.popleft()
            if isinstance(message, Told):
                states.append(message)
                continue
            self._states(states)
            states = []
            self._line(message.boot_us, f"sitl-{message.kind}", message.subject, message.text)
        self._states(states)

    def _write_truth(self, until_us: int) -> None:
        while self._true and self._true[0][0] <= until_us:
            self._recorder.write(*self._true.popleft())

    def _line(self, boot_us: int, kind: str, subject: str, text: str) -> None:
        self._true.append((boot_us, self._recorder.line(boot_us, kind, subject, text, "/plant")))

    def _states(self, told: Sequence[Told]) -> None:
        if not told:
            return
        times, held = [t.boot_us for t in told], [t.held for t in told]
        motion = take_motions(told, *self._shape)
        self._recent.append((times, motion.state))
        if self._ground is not None:
            self._ground.take(motion, self._used)
        pull = np.where(self._used, motion.tension, np.inf)
        flown = [k for k, still in enumerate(held) if not still and not self._ended]
        self._smallest_N = min(self._smallest_N, float(pull[flown].min(initial=math.inf)))
        loose = set(flown) if self._slack or bool((pull[flown] < 0).any()) else set()
        for k, messages in enumerate(self._recorder.truths(times, held, motion)):
            self._true.append((times[k], messages))
            if k in loose:
                self._tell_slack(times[k], pull[k])

    def _tell_slack(self, boot_us: int, tension: np.ndarray) -> None:
        """An event when a link of a cable begins to push, that is, the cable is slack, and when it pulls again."""
        for i, link in enumerate(tension.argmin(axis=1).tolist()):
            pushes = bool(tension[i, link] < 0)
            if pushes and i not in self._slack:
                self._slack.add(i)
                text = f"link {link + 1} pushes with {-tension[i, link]:.2f} N: the cable is slack"
                self._line(boot_us, "slack", f"cable {i + 1}", text)
            elif tension[i, link] > TAUT_N and i in self._slack:
                self._slack.discard(i)
                self._line(boot_us, "taut", f"cable {i + 1}", "every link pulls again")


def _encode_once(model: Model) -> None:
    """Compile what encoding calls before anybody waits for it."""
    n, L = model.system.length.shape
    still = np.zeros((n, 3))
    row = encode.single(Motion(State.hanging(model.system), still, still, np.zeros((n, L)), np.zeros(n)))
    encode.plants([0], [True], row)
    encode.transforms(model, row, [0], True)
    differences(row.state, row.state, model.system.n_links)


def _child(down: Connection, up: Connection, truth: Connection) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the bridge's end of the pipe decides
    with contextlib.suppress(OSError):
        os.nice(10)  # the flight goes first
    names = {number: kind.msgname for number, kind in mavlink.mavlink_map.items()}
    try:
        opening: Opening = pickle.loads(down.recv_bytes())
    except (EOFError, OSError):
        return
    try:
        recorder = Recorder(
            opening.path, opening.model, opening.metadata, opening.attachments, opening.epoch_ns, opening.with_truth,
            names,
        )  # fmt: skip
    except RecorderError as error:
        up.send(str(error))
        return
    _encode_once(opening.model)
    up.send("ready")
    ledger = _Ledger(recorder, opening.model, truth, opening.target_m, opening.standing)
    told_error = False
    batch: list[tuple] = []
    flushed = time.monotonic()
    while True:
        try:
            ready = wait(ledger.sources(down), max(0.0, flushed + FLUSH_S - time.monotonic()))
            ledger.listen(ready)
            if down in ready:
                batch += pickle.loads(down.recv_bytes())
        except (EOFError, OSError):
            ledger.take(batch)
            ledger.end_truth(False)
            recorder.finish()
            return
        now = time.monotonic()
        last = batch[-1] if batch and batch[-1][0] in ("truth ends", "finish") else None  # nothing follows these
        due = now >= flushed + FLUSH_S
        if last is None and not due and len(batch) < AT_ONCE:
            continue  # what waits would be lost with an open chunk as well
        ledger.take(batch if last is None else batch[:-1])
        batch = []
        if due:
            recorder.flush()
            flushed = now
        if last is not None and last[0] == "truth ends":
            ledger.end_truth(last[2])
            up.send(ledger.judged)
        elif last is not None:
            recorder.metadata("result", last[2])
            path = recorder.finish()
            up.send(Closing(str(path), recorder.error))
            return
        if recorder.error is not None and not told_error:
            told_error = True
            up.send(recorder.error)
