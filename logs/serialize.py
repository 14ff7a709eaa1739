"""Protobuf and MCAP bytes for what is written every tick: half of what the recording cost was objects made for them.

The layout comes from the generated module, and the tests hold every byte against the protobuf and mcap libraries' own.
"""

import struct
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

_KEPT = np.int64(-1 << 16)  # of a double's bits in arrays: to 1.5e-11 of it, which takes a fifth less room
_DOUBLE = struct.Struct("<d").pack
_RECORD = struct.Struct("<BQHIQQ").pack
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


@cache
def _frame_tail(msgid: int, system: int, component: int, name: str) -> tuple[bytes, bytes]:
    """What stands around the sequence number behind a MavlinkFrame's bytes; the same for a whole flight."""
    numbers = ((2, msgid), (3, system), (4, component))
    return b"".join(_number(k << 3)(value) for k, value in numbers), _text(6 << 3 | 2)(name)


_SEQ = [b"", *(b"\x28" + varint(seq) for seq in range(1, 256))]


def mavlink_frame(frame: bytes, names: Mapping[int, str]) -> bytes:
    """A MavlinkFrame as bytes, of a frame of either protocol version; `names` are those of messages by their id."""
    if frame[0] == 0xFD:
        msgid, seq, system, component = frame[7] | frame[8] << 8 | frame[9] << 16, frame[4], frame[5], frame[6]
    else:
        msgid, seq, system, component = frame[5], frame[2], frame[3], frame[4]
    before, after = _frame_tail(msgid, system, component, names.get(msgid, ""))
    return b"".join((_head(10, len(frame)), frame, before, _SEQ[seq], after))


class _Index(MessageIndex):
    """A chunk's index of one channel, written in one piece."""

    def write(self, stream: RecordBuilder) -> None:
        """As the library writes it."""
        data = np.array(self.records, "<u8").tobytes()
        stream.write(struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(data), self.channel_id, len(data)) + data)


class Chunks(ChunkBuilder):
    """The library's chunk builder that also takes many messages at once: the same bytes, in a sixth of the time."""

    def add_all(self, messages: Sequence[tuple[int, int, bytes]], publish_time: int) -> None:
        """Put messages (channel, log time, data) behind those that are there."""
        indices, stream = self.message_indices, self.record_writer._buffer
        at, parts = stream.tell(), []
        for channel, log_time, data in messages:
            index = indices.get(channel)
            if index is None:
                index = indices[channel] = _Index(channel_id=channel, records=[])
            index.records.append((log_time, at))
            parts.append(_RECORD(Opcode.MESSAGE, 22 + len(data), channel, 0, log_time, publish_time))
            parts.append(data)
            at += 31 + len(data)
        stream.write(b"".join(parts))
        times = [log_time for _, log_time, _ in messages]
        self.message_start_time = min(times) if self.num_messages == 0 else min(self.message_start_time, *times)
        self.message_end_time = max(self.message_end_time, *times)
        self.num_messages += len(messages)


class LogWriter(Writer):
    """The library's writer with `Chunks` inside, where the library keeps its own."""

    _Writer__chunk_builder: Chunks
    _Writer__statistics: Statistics

    def __init__(self, output: IO[bytes], chunk_size: int) -> None:
        super().__init__(output, chunk_size=chunk_size, compression=CompressionType.ZSTD)
        self._Writer__chunk_builder = Chunks()
        self._most = chunk_size

    def add_messages(self, messages: Sequence[tuple[int, int, bytes]], publish_time: int) -> None:
        """As the library's `add_message` of every (channel, log time, data), which makes an object of each.

        What closes a chunk stays the library's.
        """
        s, chunks = self._Writer__statistics, self._Writer__chunk_builder
        room = self._most - chunks.record_writer._buffer.tell()
        waiting: list[tuple[int, int, bytes]] = []
        for message in messages:
            channel, log_time, data = message
            room -= 31 + len(data)
            if room <= 0:
                if waiting:
                    chunks.add_all(waiting, publish_time)
                    waiting = []
                self.add_message(channel, log_time, data, publish_time)
                room = self._most - chunks.record_writer._buffer.tell()
                continue
            if s.message_count == 0 or log_time < s.message_start_time:
                s.message_start_time = log_time
            if log_time > s.message_end_time:
                s.message_end_time = log_time
            s.channel_message_counts[channel] += 1
            s.message_count += 1
            waiting.append(message)
        if waiting:
            chunks.add_all(waiting, publish_time)
