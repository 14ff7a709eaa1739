"""MCAP in, whole or truncated; columns as named arrays."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Attachment, Metadata
from mcap.stream_reader import StreamReader

from logs.schema import cablequad_pb2 as pb

_TYPES: dict[str, Any] = {
    "/plant/state": pb.PlantState,
    "/control/state": pb.ControlState,
    "/control/reference": pb.ControlReference,
    "/control/estimate": pb.EstimateError,
    "/event": pb.Event,
    "/plant/event": pb.Event,
    "/perf": pb.Perf,
}


EVENTS = ("/event", "/plant/event")


class LogError(Exception):
    """A file that cannot be read as a log; the message says which and why."""


class Entry(NamedTuple):
    """One message as it stands in the file."""

    topic: str
    log_time: int  # ns
    data: bytes


class Happening(NamedTuple):
    """One /event."""

    time_ns: int  # vehicles' clock
    kind: str
    subject: str
    text: str


class Run(NamedTuple):
    """A log in memory."""

    path: Path
    complete: bool  # the file ended as it should
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]
    columns: dict[str, dict[str, np.ndarray]]  # topic -> field -> one row a message
    events: list[Happening]

    @property
    def release_ns(self) -> int:
        """The vehicles' clock at t = 0; where nothing was released, its first time stamp."""
        for event in self.events:
            if event.kind == "release":
                return event.time_ns
        for columns in self.columns.values():
            if "sim_time_ns" in columns and len(columns["sim_time_ns"]):
                return int(columns["sim_time_ns"][0])
        return 0


def _guarded(path: Path, read: Callable[[Any], Iterator[Any]]) -> Iterator[Any]:
    """What `read` yields from the open file, up to where a truncated or damaged file ends."""
    try:
        file = open(path, "rb")  # noqa: SIM115
    except OSError as error:
        raise LogError(f"log {path}: {error.strerror}; give the path of an .mcap file") from None
    with file:
        if file.read(8) != b"\x89MCAP0\r\n":
            raise LogError(f"log {path}: not an MCAP file")
        file.seek(0)
        try:
            yield from read(file)
        except (McapError, EOFError, ValueError, OSError, RuntimeError):
            return
        except Exception as error:  # decompression errors of a cut chunk have no common type
            if type(error).__module__.split(".")[0] not in ("zstandard", "lz4", "struct"):
                raise


def entries(path: Path) -> Iterator[Entry]:
    """Every message in file order, as far as the file goes. Raises LogError if it is no MCAP file at all."""

    def read(file: Any) -> Iterator[Entry]:
        for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            yield Entry(channel.topic, message.log_time, message.data)

    yield from _guarded(path, read)


def is_complete(path: Path) -> bool:
    """Whether the file ends with its footer and summary, as the MCAP library's own reader wants it."""
    try:
        with open(path, "rb") as file:
            return make_reader(file).get_summary() is not None
    except (McapError, EOFError, ValueError, OSError):
        return False


def read(path: Path) -> Run:
    """The whole log, or what a truncated one holds. Raises LogError if there is nothing to read."""
    rows: dict[str, list[Any]] = {}
    events: list[Happening] = []
    for entry in entries(path):
        kind = _TYPES.get(entry.topic)
        if kind is None:
            continue
        message = kind.FromString(entry.data)
        if entry.topic in EVENTS:
            events.append(Happening(message.sim_time_ns, message.kind, message.subject, message.text))
        else:
            rows.setdefault(entry.topic, []).append(message)
    events.sort(key=lambda event: event.time_ns)
    columns = {topic: _columns(messages) for topic, messages in rows.items()}
    metadata: dict[str, dict[str, str]] = {}
    attachments: dict[str, bytes] = {}
    for record in _guarded(path, lambda file: StreamReader(file).records):
        if isinstance(record, Metadata):
            metadata[record.name] = dict(record.metadata)
        elif isinstance(record, Attachment):
            attachments[record.name] = record.data
    return Run(path, is_complete(path), metadata, attachments, columns, events)


def _columns(messages: list[Any]) -> dict[str, np.ndarray]:
    out: dict[str, np.ndarray] = {}
    for field in messages[0].DESCRIPTOR.fields:
        values = [getattr(message, field.name) for message in messages]
        if field.type == field.TYPE_DOUBLE:
            out[field.name] = np.array([tuple(v) for v in values] if field.is_repeated else values, dtype=float)
        elif field.type == field.TYPE_INT64:
            out[field.name] = np.array(values, dtype=np.int64)
        else:
            out[field.name] = np.array(values)
    return out
