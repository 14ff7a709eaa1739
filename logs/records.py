"""An MCAP file, whole or truncated, as messages by channel: every record that somebody reads, and no more."""

import io
import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool
from google.protobuf.descriptor import Descriptor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream

from cablequad.types import Counts
from logs.messages import Messages

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_WHOLE = struct.Struct("<BQHIQQ")  # both in one
_READ: dict[int, Any] = {
    Opcode.CHUNK: Chunk, Opcode.MESSAGE: Message, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata, Opcode.ATTACHMENT: Attachment,
}  # fmt: skip
_INDEX = np.dtype([("time", "<u8"), ("offset", "<u8")])  # of a message in its chunk
_LENGTH = np.arange(1, 9)  # bytes of a record's length, from its start
AHEAD = 4  # chunks that are unpacked while an earlier one is taken in


class LogError(Exception):
    """A file that cannot be read as a log; the message says which and why."""


class Entry(NamedTuple):
    """One message as it stands in the file."""

    topic: str
    log_time: int  # ns
    data: bytes
    schema: str = ""
    publish_time: int = 0  # ns, wall clock


def guarded(path: Path, read: Callable[[Any], Iterator[Any]]) -> Iterator[Any]:
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
        except (McapError, EOFError, ValueError, OSError, RuntimeError, KeyError, struct.error):
            return
        except Exception as error:  # decompression errors of a cut chunk have no common type
            if type(error).__module__.split(".")[0] not in ("zstandard", "lz4", "struct", "zlib"):
                raise


def _unpacked(chunk: Chunk) -> bytes:
    """What is in a chunk, its checksum checked."""
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(size)


def raw_records(file: Any) -> Iterator[tuple[int, bytes]]:
    """The records of an open file up to its summary, unread; one that nobody reads stands for the end of a chunk.

    Ends where the file is cut.
    """
    file.seek(8)
    while True:
        head = file.read(9)
        opcode, length = _RECORD.unpack(head) if len(head) == 9 else (Opcode.DATA_END, 0)
        wanted = opcode in _READ or opcode == Opcode.MESSAGE_INDEX
        data = file.read(length) if wanted else b""
        if opcode == Opcode.DATA_END or (wanted and len(data) < length):
            yield Opcode.DATA_END, b""
            return
        if not wanted:
            file.seek(length, io.SEEK_CUR)
        yield opcode, data


def whole_records(file: Any, at: int = 8) -> Iterator[Any]:
    """The records of an open file from byte `at` on that somebody reads here, up to its summary.

    Raises EOFError where it is cut.
    """
    file.seek(at)
    while True:
        head = file.read(9)
        if len(head) < 9:
            raise EOFError
        opcode, length = _RECORD.unpack(head)
        if opcode == Opcode.DATA_END:
            return
        if opcode not in _READ:
            file.seek(length, io.SEEK_CUR)  # indexes, mostly
            continue
        data = file.read(length)
        if len(data) < length:
            raise EOFError
        yield _parsed(opcode, data)


def _parsed(opcode: int, data: bytes) -> Any:
    stream = ReadDataStream(io.BytesIO(data))
    return Message.read(stream, len(data)) if opcode == Opcode.MESSAGE else _READ[opcode].read(stream)


class Contents:
    """What has been read of a file so far: its schemas and channels, and how to walk its chunks."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}

    def entries(self, records: Iterable[Any]) -> Iterator[Entry]:
        """The messages of `records` in file order; everything else is kept here."""
        for record in records:
            match record:
                case Chunk():
                    stream, size = get_chunk_data_stream(record, validate_crc=True)
                    yield from self._walk(stream.read(size))
                case Message():
                    yield self._entry(record.channel_id, record.log_time, record.publish_time, record.data)
                case Schema():
                    self.schemas[record.id] = record
                case Channel():
                    self.channels[record.id] = record
                case Metadata():
                    self.metadata[record.name] = dict(record.metadata)
                case Attachment():
                    self.attachments[record.name] = record.data

    def collect(self, records: Iterable[Any], into: dict[int, Messages]) -> None:
        """The messages of `records` by channel, without an object for each; everything else is kept here."""
        for record in records:
            if not isinstance(record, Chunk):
                for entry in self.entries([record]):
                    channel = next(c.id for c in self.channels.values() if c.topic == entry.topic)
                    self._kept(into, channel).put(entry.log_time, entry.data)
                continue
            stream, size = get_chunk_data_stream(record, validate_crc=True)
            data, at = stream.read(size), 0
            while at < size:
                if data[at] == Opcode.MESSAGE:
                    _, length, channel, _, log_time, _ = _WHOLE.unpack_from(data, at)
                    self._kept(into, channel).put(log_time, data[at + 31 : at + 9 + length])
                else:
                    opcode, length = _RECORD.unpack_from(data, at)
                    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                        self.collect([_parsed(opcode, data[at + 9 : at + 9 + length])], into)
                at += 9 + length

    def gather(self, records: Iterable[tuple[int, bytes]], into: dict[int, Messages]) -> None:
        """As `collect`, of unread records with the indexes of chunks among them, which say where messages stand."""
        coming: deque[tuple[Chunk, Future[bytes], list[bytes]]] = deque()  # chunks, oldest first, with their indexes
        with ThreadPoolExecutor(1) as beside:  # decompression leaves the interpreter to us
            for opcode, data in records:
                if opcode == Opcode.MESSAGE_INDEX and coming:
                    coming[-1][2].append(data)
                elif opcode == Opcode.CHUNK:
                    chunk = _parsed(opcode, data)
                    coming.append((chunk, beside.submit(_unpacked, chunk), []))
                    if len(coming) > AHEAD:
                        self._take(*coming.popleft(), into)
                elif opcode in _READ:
                    self.collect([_parsed(opcode, data)], into)
            while coming:
                self._take(*coming.popleft(), into)

    def _take(self, chunk: Chunk, unpacked: Future[bytes], indexes: list[bytes], into: dict[int, Messages]) -> None:
        """A chunk by its indexes where they name all that is in it, else record by record."""
        data = unpacked.result()
        size = len(data)
        raw, named = np.frombuffer(data, np.uint8), 0
        found: list[tuple[int, Counts, Counts, Counts]] = []
        for index in indexes:
            entries = np.frombuffer(index, _INDEX, offset=6)
            starts = entries["offset"].astype(np.int64)
            if not len(starts) or int(starts.max()) + 31 > size:
                continue
            lengths = raw[starts[:, None] + _LENGTH].copy().view("<u8").ravel().astype(np.int64)
            named += int(lengths.sum()) + 9 * len(starts)
            channel = int.from_bytes(index[:2], "little")
            found.append((channel, starts + 31, starts + 9 + lengths, entries["time"].astype(np.int64)))
        if named != size or any(channel not in self.channels for channel, *_ in found):
            self.collect([chunk], into)
            return
        for channel, begins, ends, times in found:
            self._kept(into, channel).put_block(data, begins, ends, times)

    def _kept(self, into: dict[int, Messages], channel: int) -> Messages:
        if channel not in self.channels:
            raise KeyError(channel)
        return into.setdefault(channel, Messages())

    def _walk(self, data: bytes) -> Iterator[Entry]:
        at, end = 0, len(data)
        while at < end:
            opcode, length = _RECORD.unpack_from(data, at)
            at += 9
            if opcode == Opcode.MESSAGE:
                channel, _, log_time, publish_time = _MESSAGE.unpack_from(data, at)
                yield self._entry(channel, log_time, publish_time, data[at + 22 : at + length])
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                for _ in self.entries([_parsed(opcode, data[at : at + length])]):
                    pass
            at += length

    def _entry(self, channel: int, log_time: int, publish_time: int, data: bytes) -> Entry:
        known = self.channels[channel]
        schema = self.schemas.get(known.schema_id)
        return Entry(known.topic, log_time, data, "" if schema is None else schema.name, publish_time)

    def kind_of(self, topic: str) -> Descriptor:
        """The message type of a topic, as the file describes it."""
        schema = self.schemas[next(c.schema_id for c in self.channels.values() if c.topic == topic)]
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(file)
        return pool.FindMessageTypeByName(schema.name)


def entries(path: Path) -> Iterator[Entry]:
    """Every message in file order, as far as the file goes. Raises LogError if it is no MCAP file at all."""
    yield from guarded(path, lambda file: Contents().entries(whole_records(file)))


class Copied(NamedTuple):
    """A message with all that describes it."""

    entry: Entry
    channel: Channel
    schema: Schema | None


def contents_of(path: Path) -> Iterator[Copied | tuple[str, dict[str, str]] | Attachment]:
    """Everything in a file, in its order: messages, metadata records (name, values) and attachments.

    Raises LogError if it is no MCAP file at all.
    """
    contents = Contents()

    def read(file: Any) -> Iterator[Copied | tuple[str, dict[str, str]] | Attachment]:
        for record in whole_records(file):
            for entry in contents.entries([record]):
                channel = next(c for c in contents.channels.values() if c.topic == entry.topic)
                yield Copied(entry, channel, contents.schemas.get(channel.schema_id))
            if isinstance(record, Metadata):
                yield record.name, dict(record.metadata)
            elif isinstance(record, Attachment):
                yield record

    yield from guarded(path, read)


def is_complete(path: Path) -> bool:
    """Whether the file ends with its footer and summary, as the MCAP library's own reader wants it."""
    try:
        with open(path, "rb") as file:
            return make_reader(file).get_summary() is not None
    except (McapError, EOFError, ValueError, OSError):
        return False
