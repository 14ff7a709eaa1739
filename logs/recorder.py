"""MCAP out, in a thread or a process of its own: the control loop only hands values over.

The file is NAME.mcap.part until `finish`; chunks are closed every `FLUSH_S`, so a killed run loses no more.
A write that fails (a full disk) cuts the file back to its last whole chunk, keeps the error and ends the recording.
"""

import contextlib
import os
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap_protobuf.schema import build_file_descriptor_set

from cablequad.pilot import Sample
from cablequad.state import Difference
from cablequad.types import Array
from logs import encode
from logs.encode import Model, Motion
from logs.schema import cablequad_pb2 as pb
from logs.serialize import LogWriter, mavlink_frame

FLUSH_S = 0.5
SYNC_S = 2.0
CHUNK_BYTES = 512 * 1024
TF_NS = 20_000_000  # frames for viewers at 50 Hz
EPOCH_NS = 1_700_000_000_000_000_000  # log_time of the vehicles' clock at zero, unless the scenario says otherwise
TRACKER = 200


class Frame(NamedTuple):
    """A MAVLink frame with its header."""

    other: int  # the system it came from or went to
    frame: bytes
    msgid: int
    system: int
    component: int
    seq: int
    name: str


class RecorderError(Exception):
    """A recording that cannot begin; the message says why and what to do."""


class Attachment(NamedTuple):
    """A file inside the log."""

    name: str
    media_type: str
    data: bytes


_TYPES: dict[str, Any] = {
    "/plant/state": pb.PlantState,
    "/control/state": pb.ControlState,
    "/control/reference": pb.ControlReference,
    "/control/estimate": pb.EstimateError,
    "/tf": FrameTransforms,
    "/scene": SceneUpdate,
    "/log": Log,
    "/event": pb.Event,
    "/plant/event": pb.Event,
    "/plant/log": Log,
    "/perf": pb.Perf,
}


class Recorder:
    """One run's log. Everything it is given must not be changed afterwards."""

    def __init__(
        self,
        path: Path,
        model: Model,
        metadata: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment] = (),
        epoch_ns: int = EPOCH_NS,
        with_truth: bool = False,
        threaded: bool = True,
    ) -> None:
        """`with_truth`: a simulator will tell its state, so frames for viewers come from it and not from decisions.

        Not `threaded`: the caller has a process for it, writes inline and calls `idle` when it has nothing to say.
        """
        self.path = path
        self.part = path.with_name(path.name + ".part")
        self.error: str | None = None
        self._model = model
        self._epoch_ns = epoch_ns
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._channels: dict[str, int] = {}
        self._last_tf_ns = -TF_NS
        self._with_truth = with_truth
        self._begun = time.monotonic()
        self._good_offset = 0
        self._now_ns = time.time_ns()
        if path.exists():
            raise RecorderError(f"log {path}: exists already; choose another with --out")
        try:
            self._file = open(self.part, "xb", buffering=1 << 20)  # noqa: SIM115 - closed by the writer thread
        except FileExistsError:
            raise RecorderError(f"log {self.part}: another recorder writes it; choose another with --out") from None
        except OSError as error:
            raise RecorderError(f"log {self.part}: {error.strerror}; choose another folder with --out") from None
        self._writer = LogWriter(self._file, CHUNK_BYTES)
        self._writer.start(profile="", library="cablequad")
        for item in attachments:
            self._writer.add_attachment(epoch_ns, epoch_ns, item.name, item.media_type, item.data)
        for name, values in metadata.items():
            self._writer.add_metadata(name, dict(values))
        self._file.flush()
        self._flushed = self._synced = time.monotonic()
        self._thread: threading.Thread | None = None
        if threaded:
            self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
            self._thread.start()
        self._put(lambda: self._write("/scene", 0, encode.scene(model, epoch_ns)))

    # -- what the loop calls -------------------------------------------------------------------------------------------

    def truth(self, boot_us: int, held: bool, motion: Motion) -> None:
        """The simulator's state."""
        self._put(lambda: self._truth(boot_us, held, motion))

    def frames(self, boot_us: int, direction: str, frames: Sequence[Frame]) -> None:
        """Frames that came in ("rx") or went out ("tx")."""
        self._put(lambda: self._frames_of(boot_us, direction, frames))

    def decided(
        self,
        boot_us: int,
        sample: Sample,
        tension: list[float],
        phase: str,
        age_s: float = 0.0,
        off: Difference | None = None,
    ) -> None:
        """A control decision; `age_s` is that of the oldest measurement that its state rests on.

        `off` says how far that state was from the true one, where a simulator told it.
        """
        self._put(lambda: self._decided(boot_us, sample, tension, phase, age_s))
        if off is not None:
            self._put(lambda: self._write("/control/estimate", boot_us, encode.estimate(boot_us, off)))

    def event(self, boot_us: int, kind: str, subject: str, text: str) -> None:
        """Something worth a line."""
        self._put(lambda: self._event(boot_us, kind, subject, text))

    def plant_event(self, boot_us: int, kind: str, subject: str, text: str) -> None:
        """A line about the simulator's side: topics of its own, as its order against ours depends on the threads."""
        self._put(lambda: self._event(boot_us, kind, subject, text, "/plant"))

    def perf(self, boot_us: int, turnaround_s: float, ticks: int) -> None:
        """Wall-clock figures."""
        waiting = self._queue.qsize()
        factor = boot_us * 1e-6 / max(1e-9, time.monotonic() - self._begun)
        message = pb.Perf(
            sim_time_ns=boot_us * 1000,
            turnaround_s=turnaround_s,
            ticks=ticks,
            queue_length=waiting,
            real_time_factor=factor,
        )
        self._put(lambda: self._write("/perf", boot_us, message))

    def idle(self) -> None:
        """Let time pass: a chunk that is old enough is closed."""
        self._put(self._nothing)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """A metadata record, in its place in the file."""
        self._put(lambda: self._writer.add_metadata(name, dict(values)))

    def finish(self) -> Path:
        """Write everything out and give the log its name; where that fails, `error` says so and the part stays."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
        self._end()
        if self.error is None:
            os.replace(self.part, self.path)
            return self.path
        return self.part

    # -- the writer thread ---------------------------------------------------------------------------------------------

    def _put(self, write: Callable[[], None]) -> None:
        if self._thread is None:
            self._do(write)
        else:
            self._queue.put(write)

    def _run(self) -> None:
        while True:
            try:
                job = self._queue.get(timeout=FLUSH_S)
            except queue.Empty:
                job = self._nothing
            if job is None:
                return
            self._do(job)

    def _do(self, job: Callable[[], None]) -> None:
        """Write, and close a chunk when it is time; what comes after a failed write has nowhere to go."""
        if self.error is not None:
            return
        self._now_ns = time.time_ns()
        try:
            job()
            now = time.monotonic()
            if now - self._flushed >= FLUSH_S:
                self._flushed = now
                self._flush()
                if now - self._synced >= SYNC_S:
                    self._synced = now
                    os.fdatasync(self._file.fileno())
        except OSError as error:
            self._give_up(error)

    def _end(self) -> None:
        if self.error is None:
            try:
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
                os.fsync(self._file.fileno())
                self._file.close()
            except OSError as error:
                self._give_up(error)

    def _nothing(self) -> None:
        return

    def _flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._good_offset = self._file.tell()

    def _give_up(self, error: OSError) -> None:
        self.error = f"log {self.part}: {error.strerror or error}; kept up to the last flush"
        descriptor = os.dup(self._file.fileno())
        with contextlib.suppress(OSError):
            self._file.close()
        os.ftruncate(descriptor, self._good_offset)
        os.close(descriptor)

    def _write(self, topic: str, boot_us: int, message: Any) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            kind = _TYPES.get(topic, pb.MavlinkFrame)
            schema = self._writer.register_schema(
                kind.DESCRIPTOR.full_name, "protobuf", build_file_descriptor_set(kind).SerializeToString()
            )
            channel = self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        data = message if isinstance(message, bytes) else message.SerializeToString()
        self._writer.add_message(channel, self._epoch_ns + boot_us * 1000, data, self._now_ns)

    def _truth(self, boot_us: int, held: bool, motion: Motion) -> None:
        self._write("/plant/state", boot_us, encode.plant(boot_us, held, motion))
        self._frames(boot_us, motion)

    def _frames(self, boot_us: int, motion: Motion) -> None:
        ns = boot_us * 1000
        if ns - self._last_tf_ns >= TF_NS:
            first = self._last_tf_ns < 0
            self._last_tf_ns = ns
            self._write("/tf", boot_us, encode.transforms(self._model, motion, self._epoch_ns + ns, first))

    def _frames_of(self, boot_us: int, direction: str, frames: Sequence[Frame]) -> None:
        for f in frames:
            who = "payload" if f.other == TRACKER else f"quad{f.other}"
            envelope = mavlink_frame(f.frame, f.msgid, f.system, f.component, f.seq, f.name)
            self._write(f"/mavlink/{who}/{direction}", boot_us, envelope)

    def _decided(self, boot_us: int, sample: Sample, tension: list[float], phase: str, age_s: float) -> None:
        self._write("/control/state", boot_us, encode.control(boot_us, sample, tension, phase, age_s))
        self._write("/control/reference", boot_us, encode.reference(boot_us, sample))
        if not self._with_truth:
            thrust: Array = sample.f
            self._frames(boot_us, encode.measured_motion(self._model, sample, tension, thrust))

    def _event(self, boot_us: int, kind: str, subject: str, text: str, room: str = "") -> None:
        message = pb.Event(sim_time_ns=boot_us * 1000, kind=kind, subject=subject, text=text)
        self._write(f"{room}/event", boot_us, message)
        self._write(f"{room}/log", boot_us, encode.log_line(self._epoch_ns + boot_us * 1000, kind, subject, text))
