"""Protobuf and MCAP bytes for what is written every tick: half of what the recording cost was objects made for them.

The layout comes from the generated module, and the tests hold every byte against the protobuf and mcap libraries' own.
"""

import struct
from collections.abc import Callable, Sequence
from functools import cache
from typing import IO, Any, NamedTuple

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from mcap._chunk_builder import ChunkBuilder
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Message, MessageIndex, Statistics
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


_varint = cache(varint)


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


def serialized(kind: Any, values: Sequence[tuple[str, Any]]) -> bytes:
    """A message of the generated class `kind` as bytes; `values` are its fields by name, in the order of their numbers.

    Arrays of any shape go into repeated fields, row by row. Raises KeyError for a field that there is not.
    """
    fields = _fields(kind)
    arrays = [np.asarray(value, float).ravel() for name, value in values if fields[name].array is not None]
    flat = np.concatenate(arrays) if arrays else np.empty(0)
    doubles = (flat.view(np.int64) & _KEPT).tobytes()  # all at once: a call for each field would cost more than it does
    floats = flat.astype(np.float32).tobytes()
    parts = []
    at, sizes = 0, iter(arrays)
    for name, value in values:
        field = fields[name]
        if field.array is None:
            parts.append(field.write(value))
            continue
        end = at + len(next(sizes))
        if end > at:
            data = floats[4 * at : 4 * end] if field.array is np.float32 else doubles[8 * at : 8 * end]
            parts.append(_head(field.tag, len(data)))
            parts.append(data)
        at = end
    return b"".join(parts)


@cache
def frame_middle(msgid: int, system: int, component: int) -> bytes:
    """Fields 2 to 4 of a MavlinkFrame, the same for a whole flight."""
    numbers = ((2, msgid), (3, system), (4, component))
    return b"".join(_number(k << 3)(value) for k, value in numbers)


@cache
def _frame_name(name: str) -> bytes:
    return _text(6 << 3 | 2)(name)


def mavlink_frame(frame: bytes, msgid: int, system: int, component: int, seq: int, name: str) -> bytes:
    """A MavlinkFrame as bytes."""
    last = b"\x28" + _varint(seq) if seq else b""
    return _head(10, len(frame)) + frame + frame_middle(msgid, system, component) + last + _frame_name(name)


class _Index(MessageIndex):
    """A chunk's index of one channel, written in one piece."""

    def write(self, stream: RecordBuilder) -> None:
        """As the library writes it."""
        data = np.array(self.records, "<u8").tobytes()
        stream.write(struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(data), self.channel_id, len(data)) + data)


class Chunks(ChunkBuilder):
    """The library's chunk builder with its one hot call written out: the same bytes, a quarter of the time."""

    def add_message(self, message: Message) -> None:
        """Put a message behind those that are there."""
        self.add(message.channel_id, message.log_time, message.data, message.publish_time, message.sequence)

    def add(self, channel: int, log_time: int, data: bytes, publish_time: int, sequence: int) -> None:
        """The same without an object for the message."""
        stream = self.record_writer._buffer
        if self.num_messages == 0 or log_time < self.message_start_time:
            self.message_start_time = log_time
        if log_time > self.message_end_time:
            self.message_end_time = log_time
        index = self.message_indices.get(channel)
        if index is None:
            index = self.message_indices[channel] = _Index(channel_id=channel, records=[])
        index.records.append((log_time, stream.tell()))
        self.num_messages += 1
        stream.write(_RECORD(Opcode.MESSAGE, 22 + len(data), channel, sequence, log_time, publish_time))
        stream.write(data)


class LogWriter(Writer):
    """The library's writer with `Chunks` inside, where the library keeps its own."""

    _Writer__chunk_builder: Chunks
    _Writer__statistics: Statistics

    def __init__(self, output: IO[bytes], chunk_size: int) -> None:
        super().__init__(output, chunk_size=chunk_size, compression=CompressionType.ZSTD)
        self._Writer__chunk_builder = Chunks()
        self._most = chunk_size

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        """As the library's, which makes an object of every message; what closes a chunk stays the library's."""
        s, chunks = self._Writer__statistics, self._Writer__chunk_builder
        if chunks.record_writer._buffer.tell() + len(data) + 31 >= self._most:
            super().add_message(channel_id, log_time, data, publish_time, sequence)
            return
        if s.message_count == 0 or log_time < s.message_start_time:
            s.message_start_time = log_time
        if log_time > s.message_end_time:
            s.message_end_time = log_time
        s.channel_message_counts[channel_id] += 1
        s.message_count += 1
        chunks.add(channel_id, log_time, data, publish_time, sequence)
