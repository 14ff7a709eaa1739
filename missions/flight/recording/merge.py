"""What the log process is told, put into the recorder: decisions and frames in their order, truth in its place.

What the simulator says of a tick is written when that tick has been answered, and before the answer: a run's log does
not depend on how the processes happened to run, nor on how much is taken at once.
"""

import math
from collections import deque
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import NamedTuple, Protocol

import numpy as np

from bridge.mission.phases import CARRIED
from cablequad.model.instant import Shapes
from cablequad.model.state import Difference, State, differences
from logs.writing.encode import Model
from logs.writing.recorder import Decisions, Message, Recorder
from missions.flight.recording.ipc import PlantState, take, take_motions, take_samples
from missions.flight.recording.slack import SlackCables
from missions.scenario.metrics import Followed, Following, Grounded, OnGround, Standing
from sitl.plant import AirMotion
from sitl.settings import Event

TRUTH_WAIT_S = 1.0  # the simulator says what it did right after it spoke; longer means that it has ended


class TruthSource(Protocol):
    """Where the simulator's word comes from, a record at a time."""

    def poll(self, timeout: float = 0.0, /) -> bool:
        """Whether there is a record, waiting up to `timeout` s."""

    def recv_bytes(self) -> bytes:
        """The next record. Raises EOFError where nothing more comes."""


class Judged(NamedTuple):
    """What was true of a flight, by the simulator; nothing where there is none."""

    smallest_tension_N: float
    followed: Followed | None
    grounded: Grounded | None = None


class Merge:
    """Takes what the bridge and the simulator say, and judges the flight by it."""

    def __init__(
        self,
        recorder: Recorder,
        model: Model,
        truth: TruthSource,
        target_m: tuple[float, float, float],
        standing: Standing | None,
    ) -> None:
        self._recorder = recorder
        self._used = np.arange(model.system.length.shape[1])[None, :] < model.system.n_links[:, None]
        self._shape = model.system.length.shape
        self._n_links = model.system.n_links
        self._truth: TruthSource | None = truth
        self._told: deque[PlantState | Event | AirMotion] = deque()
        self._answered_us = 0
        self._ended = False
        self._slack = SlackCables(model.system)
        self._shapes: Shapes = ()
        self._smallest_N = math.inf
        self._following = Following(target_m, standing is None)
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
                    self._recorder.frames(boot_us, kind, *rest)
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
        return [down, self._truth] if isinstance(self._truth, Connection) else [down]

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
        states: list[PlantState] = []
        while self._told and self._told[0].boot_us <= answered_us:
            message = self._told.popleft()
            if isinstance(message, PlantState):
                states.append(message)
                continue
            self._states(states)
            states = []
            if isinstance(message, AirMotion):
                self._true.append((message.boot_us, self._recorder.air(*message)))
                continue
            self._line(message.boot_us, f"sitl-{message.kind}", message.subject, message.text)
        self._states(states)

    def _write_truth(self, until_us: int) -> None:
        while self._true and self._true[0][0] <= until_us:
            self._recorder.write(*self._true.popleft())

    def _line(self, boot_us: int, kind: str, subject: str, text: str) -> None:
        self._true.append((boot_us, self._recorder.line(boot_us, kind, subject, text, "/plant")))

    def _states(self, states: Sequence[PlantState]) -> None:
        if not states:
            return
        times, restrained = [t.boot_us for t in states], [t.restrained for t in states]
        motion = take_motions(states, *self._shape)
        self._recent.append((times, motion.state))
        if self._ground is not None:
            self._ground.take(motion, self._used)
        pull = np.where(self._used, motion.tension, np.inf)
        flown = [k for k, still in enumerate(restrained) if not still and not self._ended]
        self._smallest_N = min(self._smallest_N, float(pull[flown].min(initial=math.inf)))
        q = motion.state.q
        suspects = self._slack.suspects(pull[flown], q[flown]) if flown else np.zeros(0, dtype=bool)
        begun = flown[int(suspects.argmax())] if suspects.any() else len(times)  # from then on every instant counts
        loose = {k for k in flown if k >= begun}
        for k, messages in enumerate(self._recorder.truths(times, restrained, motion)):
            self._true.append((times[k], messages))
            if k in loose:
                for change in self._slack.look(times[k], pull[k], q[k]):
                    self._line(times[k], change.kind, f"cable {change.cable}", change.text)
