"""MCAP out, for a process of its own: what is to be written comes many instants at a time.

The file is NAME.mcap.part until `finish`; chunks are closed every `FLUSH_S` by `flush`, so a killed run loses no more.
A write that fails (a full disk) cuts the file back to its last whole chunk, keeps the error and ends the recording.
"""

import contextlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap_protobuf.schema import build_file_descriptor_set

from cablequad.control.control_step import Sample
from cablequad.model.instant import Motion
from cablequad.model.state import Difference
from logs.schema import cablequad_pb2 as pb
from logs.schema.topics import TOPICS
from logs.writing import encode
from logs.writing.encode import Model
from logs.writing.serialize import LogWriter, PendingMessages

FLUSH_S = 0.4  # with what waits elsewhere for less than 0.1 s, no more than 0.5 s is lost
SYNC_S = 2.0
CHUNK_BYTES = 512 * 1024
TF_NS = 20_000_000  # frames for viewers at 50 Hz
EPOCH_NS = 1_700_000_000_000_000_000  # log_time of the vehicles' clock at zero, unless the scenario says otherwise
TRACKER = 200


class RecorderError(Exception):
    """A recording that cannot begin; the message says why and what to do."""


class LogFile:
    """The file: NAME.mcap.part until its end, cut back to its last whole chunk where a write fails."""

    def __init__(self, path: Path, names: Mapping[int, str] | None) -> None:
        """`names` of messages by their id. Raises RecorderError where it cannot be written."""
        self.path = path
        self.part = path.with_name(path.name + ".part")
        self.error: str | None = None
        self._channels: dict[str, int] = {}
        self._good_offset = 0
        if path.exists():
            raise RecorderError(f"log {path}: exists already; choose another with --out")
        try:
            self._file = open(self.part, "xb", buffering=1 << 20)  # noqa: SIM115 - closed at the end
        except FileExistsError:
            raise RecorderError(f"log {self.part}: another recorder writes it; choose another with --out") from None
        except OSError as error:
            raise RecorderError(f"log {self.part}: {error.strerror}; choose another folder with --out") from None
        self.writer = LogWriter(self._file, CHUNK_BYTES, names)
        self.writer.start(profile="", library="cablequad")
        self._synced = time.monotonic()

    def begun(self) -> None:
        """What stands at the beginning is in the file."""
        self._file.flush()
        self._synced = time.monotonic()

    def attempt(self, job: Callable[[], None]) -> None:
        """What comes after a failed write has nowhere to go."""
        if self.error is None:
            try:
                job()
            except OSError as error:
                self._give_up(error)

    def put(self, waiting: PendingMessages) -> None:
        """Messages into the open chunk."""
        for topic in dict.fromkeys(waiting.topics):
            if topic not in self._channels:
                self._channels[topic] = self._registered(topic)
        self.writer.add_messages(waiting, self._channels, time.time_ns())

    def flush(self) -> None:
        """Close the chunk."""
        self.writer.flush()
        self._good_offset = self._file.tell()
        now = time.monotonic()
        if now - self._synced >= SYNC_S:
            self._synced = now
            os.fdatasync(self._file.fileno())

    def end(self) -> None:
        """Write everything out."""
        self.writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def _give_up(self, error: OSError) -> None:
        self.error = f"log {self.part}: {error.strerror or error}; kept up to the last flush"
        descriptor = os.dup(self._file.fileno())
        with contextlib.suppress(OSError):
            self._file.close()
        os.ftruncate(descriptor, self._good_offset)
        os.close(descriptor)

    def _registered(self, topic: str) -> int:
        kind = _TYPES.get(topic, pb.MavlinkFrame)
        schema = self.writer.register_schema(
            kind.DESCRIPTOR.full_name, "protobuf", build_file_descriptor_set(kind).SerializeToString()
        )
        return self.writer.register_channel(topic, "protobuf", schema)


class _Rooms(dict[int, str]):
    """Topics of frames one way, by the other system."""

    def __init__(self, way: str) -> None:
        self._way = way

    def __missing__(self, system: int) -> str:
        who = "payload" if system == TRACKER else f"quad{system}"
        topic = self[system] = f"/mavlink/{who}/{self._way}"
        return topic


class Attachment(NamedTuple):
    """A file inside the log."""

    name: str
    media_type: str
    data: bytes


_TYPES: dict[str, Any] = {
    **TOPICS, "/tf": FrameTransforms, "/scene": SceneUpdate, "/log": Log, "/plant/log": Log,
}  # fmt: skip


Message = tuple[str, bytes]  # its topic, and it


class Decisions(NamedTuple):
    """Control decisions in their order, with a row for each."""

    boot_us: list[int]
    sample: Sample
    tension: list[list[float]]  # N, as it was told at the load
    phase: list[str]
    age_s: list[float]  # of the oldest measurement that the state rests on


class Recorder:
    """One run's log. Where a write fails `error` says so, and what comes after has nowhere to go."""

    def __init__(
        self,
        path: Path,
        model: Model,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment] = (),
        epoch_ns: int = EPOCH_NS,
        with_truth: bool = False,
        names: Mapping[int, str] | None = None,
    ) -> None:
        """`with_truth`: a simulator will tell its state, so frames for viewers come from it and not from decisions.

        `names` of messages by their id. Raises RecorderError where the file cannot be written.
        """
        self._file = LogFile(path, names)
        self._model = model
        self._epoch_ns = epoch_ns
        self._rooms = {way: _Rooms(way) for way in ("rx", "tx")}
        self._waiting = PendingMessages()
        self._last_tf_ns = -TF_NS
        self._first = True  # of these
        self._with_truth = with_truth
        self._begun = time.monotonic()
        for item in attachments:
            self._file.writer.add_attachment(epoch_ns, epoch_ns, item.name, item.media_type, item.data)
        for name, values in metadata.items():
            self._file.writer.add_metadata(name, dict(values))
        self._file.begun()
        self.write(0, [("/scene", encode.scene(model, epoch_ns).SerializeToString())])

    @property
    def error(self) -> str | None:
        """Why nothing is written any more."""
        return self._file.error

    @property
    def part(self) -> Path:
        """The file until its end."""
        return self._file.part

    # -- what is to be written, in its order; `settle` writes it -------------------------------------------------------

    def truths(self, boot_us: Sequence[int], restrained: Sequence[bool], motion: Motion) -> list[list[Message]]:
        """What is to be written of each of the simulator's states, for `write`; `motion` has a row for each."""
        messages: list[list[Message]] = [
            [("/plant/state", data)] for data in encode.plants(boot_us, restrained, motion)
        ]
        due = self._drawn(boot_us)
        if due:
            for k, data in self._transforms(boot_us, due, encode.rows(motion, due)):
                messages[k].append(("/tf", data))
        return messages

    def frames(self, boot_us: int, direction: str, systems: Sequence[int], frames: Sequence[bytes]) -> None:
        """Frames that came in ("rx") or went out ("tx"), and for each the system it came from or went to."""
        rooms = self._rooms[direction]
        self._waiting.put_frames([rooms[system] for system in systems], self._epoch_ns + 1000 * boot_us, frames)

    def decided(self, d: Decisions, off: Difference | None = None, known: Sequence[int] = ()) -> list[list[Message]]:
        """What is to be written of each decision, for `write`.

        `off` says how far the states of the rows `known` were from the true ones, where a simulator told it.
        """
        pairs = zip(encode.controls(*d), encode.references(d.boot_us, d.sample), strict=True)
        messages: list[list[Message]] = [[("/control/state", c), ("/control/reference", r)] for c, r in pairs]
        if off is not None:
            for k, data in zip(known, encode.estimates([d.boot_us[k] for k in known], off), strict=True):
                messages[k].append(("/control/estimate", data))
        if not self._with_truth:
            due = self._drawn(d.boot_us)
            if due:
                told_N = np.array([d.tension[k] for k in due])
                motion = encode.measured_motion(self._model, encode.rows(d.sample, due), told_N)
                for k, data in self._transforms(d.boot_us, due, motion):
                    messages[k].append(("/tf", data))
        return messages

    def write(self, boot_us: int, messages: Sequence[Message]) -> None:
        """Messages as `truths`, `decided` and `line` make them: their place among all others is the caller's."""
        for topic, data in messages:
            self._waiting.put(topic, self._epoch_ns + 1000 * boot_us, data)

    def line(self, boot_us: int, kind: str, subject: str, text: str, room: str = "") -> list[Message]:
        """Something worth a line; of the simulator's side in a `room` of its own: its order against ours is chance."""
        message = pb.Event(sim_time_ns=boot_us * 1000, kind=kind, subject=subject, text=text)
        line = encode.log_line(self._epoch_ns + boot_us * 1000, kind, subject, text)
        return [(f"{room}/event", message.SerializeToString()), (f"{room}/log", line.SerializeToString())]

    def air(self, boot_us: int, wind: tuple[float, float, float]) -> list[Message]:
        """How the air moves, (3,) m/s, W, as a simulator tells it."""
        return [("/plant/wind", pb.Wind(sim_time_ns=boot_us * 1000, velocity=wind).SerializeToString())]

    def perf(self, boot_us: int, turnaround_s: float, ticks: int, waiting: int) -> None:
        """Wall-clock figures; `waiting` records of the simulator have not been written yet."""
        factor = boot_us * 1e-6 / max(1e-9, time.monotonic() - self._begun)
        message = pb.Perf(
            sim_time_ns=boot_us * 1000,
            turnaround_s=turnaround_s,
            ticks=ticks,
            queue_length=waiting,
            real_time_factor=factor,
        )
        self.write(boot_us, [("/perf", message.SerializeToString())])

    def settle(self) -> None:
        """Put what waits into the open chunk."""
        waiting, self._waiting = self._waiting, PendingMessages()
        self._file.attempt(lambda: self._file.put(waiting))

    def flush(self) -> None:
        """Close the chunk: what was given until now is kept, whatever happens. To be called every `FLUSH_S`."""
        self.settle()
        self._file.attempt(self._file.flush)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """A metadata record, behind all that was written."""
        self.settle()
        self._file.attempt(lambda: self._file.writer.add_metadata(name, dict(values)))

    def finish(self) -> Path:
        """Write everything out and give the log its name; where that fails, `error` says so and the part stays."""
        self.settle()
        self._file.attempt(self._file.end)
        if self.error is None:
            os.replace(self._file.part, self._file.path)
            return self._file.path
        return self._file.part

    # -- inside --------------------------------------------------------------------------------------------------------

    def _drawn(self, boot_us: Sequence[int]) -> list[int]:
        """Which of these instants have frames for viewers."""
        due = []
        for k, us in enumerate(boot_us):
            if us * 1000 - self._last_tf_ns >= TF_NS:
                self._last_tf_ns = us * 1000
                due.append(k)
        return due

    def _transforms(self, boot_us: Sequence[int], due: Sequence[int], motion: Motion) -> list[tuple[int, bytes]]:
        first, self._first = self._first, False
        drawn = encode.transforms(self._model, motion, [self._epoch_ns + 1000 * boot_us[k] for k in due], first)
        return list(zip(due, drawn, strict=True))
