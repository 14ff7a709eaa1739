"""Protobuf and MCAP bytes for what is written every tick: half of what the recording cost was objects made for them.

The layout comes from the generated module, and the tests hold every byte against the protobuf and mcap libraries' own.
"""

import struct
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import IO, Any, NamedTuple

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from mcap._chunk_builder import ChunkBuilder
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import MessageIndex, Statistics
from mcap.writer import CompressionType, Writer

from cablequad.types import Counts
from logs.writing import layout

_KEPT = np.int64(-1 << 16)  # of a double's bits in arrays: to 1.5e-11 of it, which takes a fifth less room
_DOUBLE = struct.Struct("<d").pack
_KINDS: dict[int, type[np.floating]] = {FieldDescriptor.TYPE_DOUBLE: np.float64, FieldDescriptor.TYPE_FLOAT: np.float32}


def varint(value: int) -> bytes:
    """A protobuf varint; negative numbers take ten bytes."""
    value &= (1 << 64) - 1
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


@cache
def _head(tag: int, size: int) -> bytes:
    return varint(tag) + varint(size)


def _text(tag: int) -> Callable[[Any], bytes]:
    def write(value: Any) -> bytes:
        data = value if isinstance(value, bytes) else value.encode()
        return _head(tag, len(data)) + data if data else b""

    return write


def _number(tag: int) -> Callable[[Any], bytes]:
    head = varint(tag)
    return lambda value: head + varint(int(value)) if value else b""


def _real(tag: int) -> Callable[[Any], bytes]:
    head, zero = varint(tag), _DOUBLE(0.0)

    def write(value: Any) -> bytes:
        data = _DOUBLE(value)
        return head + data if data != zero else b""

    return write


class _Field(NamedTuple):
    """How a field is written."""

    tag: int
    array: type[np.floating] | None  # the kind of number of a repeated field
    write: Callable[[Any], bytes]  # of one that is not


@cache
def _fields(kind: Any) -> dict[str, _Field]:
    out = {}
    for f in kind.DESCRIPTOR.fields:
        text = f.type in (f.TYPE_STRING, f.TYPE_BYTES)
        wire = 2 if f.is_repeated or text else 1 if f.type == f.TYPE_DOUBLE else 0
        tag = f.number << 3 | wire
        write = _text(tag) if text else _real(tag) if wire == 1 else _number(tag)
        out[f.name] = _Field(tag, _KINDS[f.type] if f.is_repeated else None, write)
    return out


def serialized(kind: Any, rows: int, values: Sequence[tuple[str, Any]]) -> list[bytes]:
    """`rows` messages of the generated class `kind` as bytes; `values` are its fields by name, in their numbers' order.

    A repeated field takes an array with a row for every message, of any shape; another a sequence with a value for
    each. Raises KeyError for a field that there is not.
    """
    fields = _fields(kind)
    columns: list[Sequence[bytes]] = []  # of what follows each other in a message, one piece for each row
    run: list[tuple[_Field, Any]] = []
    for name, value in values:
        field = fields[name]
        if field.array is not None:
            run.append((field, value))
            continue
        columns += _arrays(rows, run)
        columns.append([field.write(v) for v in value])
        run = []
    columns += _arrays(rows, run)
    return [b"".join(pieces) for pieces in zip(*columns, strict=True)]


def _arrays(rows: int, run: Sequence[tuple[_Field, Any]]) -> list[list[bytes]]:
    """Repeated fields that follow each other, as one piece for each row: a table of bytes, filled field by field."""
    parts, at = [], 0
    for field, value in run:
        a = np.ascontiguousarray(value, field.array).reshape(rows, -1)
        if a.size == 0:
            continue
        data = a.view(np.uint8) if field.array is np.float32 else (a.view(np.int64) & _KEPT).view(np.uint8)
        head = _head(field.tag, data.shape[1])
        parts.append((at, head, data))
        at += len(head) + data.shape[1]
    if not parts:
        return []
    table = np.empty((rows, at), np.uint8)
    for start, head, data in parts:
        middle = start + len(head)
        table[:, start:middle] = np.frombuffer(head, np.uint8)
        table[:, middle : middle + data.shape[1]] = data
    flat = table.tobytes()
    return [[flat[k * at : (k + 1) * at] for k in range(rows)]]


class PendingMessages:
    """Messages that are to be written, in their order."""

    def __init__(self) -> None:
        self.bodies: list[bytes] = []
        self.topics: list[str] = []
        self.log_times: list[int] = []
        self.enveloped: list[bool] = []

    def put(self, topic: str, log_time: int, body: bytes) -> None:
        """One more."""
        self.bodies.append(body)
        self.topics.append(topic)
        self.log_times.append(log_time)
        self.enveloped.append(False)

    def put_frames(self, topics: Sequence[str], log_time: int, frames: Sequence[bytes]) -> None:
        """Bare MAVLink frames, to be written each in a cablequad.MavlinkFrame around it."""
        self.bodies += frames
        self.topics += topics
        self.log_times += [log_time] * len(frames)
        self.enveloped += [True] * len(frames)


class Names:
    """Names of MAVLink messages by their id, as `layout.records` looks them up."""

    def __init__(self, names: Mapping[int, str]) -> None:
        texts = {msgid: name.encode() for msgid, name in sorted(names.items())}
        ends = np.cumsum([len(text) for text in texts.values()], dtype=np.int64)
        starts = ends - [len(text) for text in texts.values()]
        self.text = np.frombuffer(b"".join(texts.values()), np.uint8)
        self.table = np.stack([np.array(list(texts), np.int64), starts.astype(np.int64), ends], axis=1)
        self.longest = max((len(text) for text in texts.values()), default=0)


class _Index(MessageIndex):
    """A chunk's index of one channel, written in one piece."""

    def write(self, stream: RecordBuilder) -> None:
        """As the library writes it."""
        data = np.asarray(self.records, "<u8").tobytes()
        stream.write(struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(data), self.channel_id, len(data)) + data)


class Chunks(ChunkBuilder):
    """The library's chunk builder, which takes many messages at once and sorts out their indexes in the end."""

    def __init__(self) -> None:
        self._added: list[np.ndarray] = []  # (k, 3): channel, log time and offset of what was put in together
        super().__init__()

    @property
    def message_indices(self) -> dict[int, MessageIndex]:
        """A chunk's indexes, in the order in which channels come."""
        if not self._added:
            return {}
        rows: Any = np.concatenate(self._added)
        channels = dict.fromkeys(rows[:, 0].tolist())
        return {c: _Index(channel_id=c, records=rows[rows[:, 0] == c, 1:]) for c in channels}

    @message_indices.setter
    def message_indices(self, _: dict[int, MessageIndex]) -> None:
        self._added = []

    def reset(self) -> None:
        """Begin another chunk."""
        self._added = []
        super().reset()  # type: ignore[no-untyped-call]

    def add_all(self, waiting: PendingMessages, channels: Counts, publish_time: int, names: Names) -> None:
        """Put messages of `channels` (k,) behind those that are there."""
        data = np.frombuffer(b"".join(waiting.bodies), np.uint8)
        ends = np.cumsum(np.fromiter(map(len, waiting.bodies), np.int64, len(waiting.bodies)))
        times = np.array(waiting.log_times, np.int64)
        enveloped = np.array(waiting.enveloped, np.int64)
        out = np.empty(len(data) + len(ends) * (layout.HEAD + layout.ENVELOPE + names.longest), np.uint8)
        begins = layout.records(
            data, ends, channels, times, enveloped, publish_time, names.text, names.table, out
        )  # fmt: skip
        stream = self.record_writer._buffer
        self._added.append(np.stack([channels, times, begins[:-1] + stream.tell()], axis=1))
        stream.write(out[: begins[-1]].tobytes())
        first, last = int(times.min()), int(times.max())
        self.message_start_time = first if self.num_messages == 0 else min(self.message_start_time, first)
        self.message_end_time = max(self.message_end_time, last)
        self.num_messages += len(ends)


class LogWriter(Writer):
    """The library's writer with `Chunks` inside, where the library keeps its own."""

    _Writer__chunk_builder: Chunks
    _Writer__statistics: Statistics

    def __init__(self, output: IO[bytes], chunk_size: int, names: Mapping[int, str] | None = None) -> None:
        super().__init__(output, chunk_size=chunk_size, compression=CompressionType.ZSTD)
        self._Writer__chunk_builder = Chunks()
        self._most = chunk_size
        self._names = Names(names or {})

    def add_messages(self, waiting: PendingMessages, channels: Mapping[str, int], publish_time: int) -> None:
        """As the library's `add_message` of each, which makes an object of every one; a chunk ends where this does.

        `channels` are the registered ones by topic.
        """
        if not waiting.bodies:
            return
        s, chunks = self._Writer__statistics, self._Writer__chunk_builder
        first, last = min(waiting.log_times), max(waiting.log_times)
        s.message_start_time = first if s.message_count == 0 else min(s.message_start_time, first)
        s.message_end_time = max(s.message_end_time, last)
        s.message_count += len(waiting.bodies)
        numbers = [channels[topic] for topic in waiting.topics]
        for channel, count in Counter(numbers).items():
            s.channel_message_counts[channel] += count
        chunks.add_all(waiting, np.array(numbers, np.int64), publish_time, self._names)
        if chunks.record_writer._buffer.tell() >= self._most:
            self.flush()
