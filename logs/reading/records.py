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
from logs.reading.messages import Messages

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


class Damage(NamedTuple):
    """A part of a file that nothing can be made of."""

    at: int  # byte of the file
    messages: int | None  # that are lost with it, where the file's indexes say
    begin_ns: int  # log times between which they lie; 0 where nobody knows
    end_ns: int
    what: str

    def text(self, zero_ns: int = 0) -> str:
        """In words; `zero_ns` is the log time that counts as 0 s."""
        many = "an unknown number of messages" if self.messages is None else f"{self.messages} messages"
        when = ""
        if self.begin_ns or self.end_ns:
            when = f" between {(self.begin_ns - zero_ns) * 1e-9:.3f} s and {(self.end_ns - zero_ns) * 1e-9:.3f} s"
        return f"{self.what} at byte {self.at}: {many} lost{when}"


MAGIC = b"\x89MCAP0\r\n"
_CHUNK_HEAD = struct.Struct("<BQQQQI")  # opcode, length, first and last time, size, checksum; then the compression
_COMPRESSIONS = tuple(struct.pack("<I", len(name)) + name for name in (b"zstd", b"lz4"))
_LOOKED_THROUGH = 1 << 20  # bytes at a time, for the next chunk
_SUMMARY_OPCODES = frozenset({Opcode.FOOTER, Opcode.SUMMARY_OFFSET, Opcode.STATISTICS, Opcode.CHUNK_INDEX,
                              Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX})  # fmt: skip


def guarded(path: Path, read: Callable[[Any], Iterator[Any]]) -> Iterator[Any]:
    """What `read` yields from the open file, up to where a truncated file ends."""
    try:
        file = open(path, "rb")  # noqa: SIM115
    except OSError as error:
        raise LogError(f"log {path}: {error.strerror}; give the path of an .mcap file") from None
    with file:
        if file.read(8) != MAGIC:
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


def raw_records(file: Any, damages: list[Damage]) -> Iterator[tuple[int, bytes, int]]:
    """The records of an open file up to its summary, unread, and where each begins; one that nobody reads stands for

    the end of a chunk. Ends where the file is cut; what cannot be a record is passed over and noted in `damages`.
    """
    end = file.seek(0, io.SEEK_END)
    file.seek(8)
    told_ns = 0  # of the last message before
    while True:
        at = file.tell()
        head = file.read(9)
        opcode, length = _RECORD.unpack(head) if len(head) == 9 else (Opcode.DATA_END, 0)
        if len(head) == 9 and (not 0 < opcode < 0x10 or at + 9 + length > end):
            following = _next_chunk(file, at + 1)
            if following is None:
                if not 0 < opcode < 0x10:
                    damages.append(Damage(at, None, 0, 0, f"{end - at} bytes that are no records"))
                yield Opcode.DATA_END, b"", at
                return
            file.seek(following + 9)
            next_ns = int.from_bytes(file.read(8), "little")
            damages.append(Damage(at, None, told_ns, next_ns, f"{following - at} bytes that are no records"))
            file.seek(following)
            continue
        wanted = opcode in _READ or opcode == Opcode.MESSAGE_INDEX
        data = file.read(length) if wanted else b""
        if opcode == Opcode.DATA_END or opcode in _SUMMARY_OPCODES:
            if len(head) == 9:
                _look_behind(file, at, damages)
            yield Opcode.DATA_END, b"", at
            return
        if not wanted:
            file.seek(length, io.SEEK_CUR)
        if opcode == Opcode.CHUNK:
            told_ns = max(told_ns, int.from_bytes(data[8:16], "little"))
        yield opcode, data, at


def missing(path: Path, read: int) -> int:
    """How many messages a file's own summary counts beyond the `read` ones; 0 where it has none."""
    try:
        with open(path, "rb") as file:
            summary = make_reader(file).get_summary()
    except (McapError, EOFError, ValueError, OSError, struct.error):
        return 0
    if summary is None or summary.statistics is None:
        return 0
    return max(0, summary.statistics.message_count - read)


def _next_chunk(file: Any, at: int) -> int | None:
    """Where the next chunk's record begins, from byte `at` on, up to where another file begins."""
    file.seek(at)
    kept, base = b"", at
    while block := file.read(_LOOKED_THROUGH):
        data = kept + block
        stop = data.find(MAGIC)
        found = [k for name in _COMPRESSIONS for k in _places(data, name)]
        for k in sorted(found):
            begins = k - _CHUNK_HEAD.size
            if begins >= 0 and data[begins] == Opcode.CHUNK and not 0 <= stop < begins:
                return base + begins
        if stop >= 0:
            return None
        keep = min(len(data), 64)
        base += len(data) - keep
        kept = data[-keep:]
    return None


def _places(data: bytes, what: bytes) -> Iterator[int]:
    at = data.find(what)
    while at >= 0:
        yield at
        at = data.find(what, at + 1)


def _look_behind(file: Any, at: int, damages: list[Damage]) -> None:
    """Note another file that follows this one's end: two that were joined."""
    end = file.seek(0, io.SEEK_END)
    file.seek(at)
    while True:
        head = file.read(9)
        if len(head) < 9:
            return
        opcode, length = _RECORD.unpack(head)
        if file.tell() + length > end:
            return
        file.seek(length, io.SEEK_CUR)
        if opcode == Opcode.FOOTER:
            break
    begins = file.tell() + 8
    if begins < end:
        damages.append(Damage(begins, None, 0, 0, f"{end - begins} bytes of another file, joined to this one,"))


class Unpacked(NamedTuple):
    """What was in a chunk, its checksum checked."""

    data: bytes


def sound_records(file: Any, damages: list[Damage]) -> Iterator[Any]:
    """The records of an open file that somebody reads here, chunks unpacked; what is damaged is noted and left out."""
    damaged = False
    for opcode, data, at in raw_records(file, damages):
        if opcode == Opcode.MESSAGE_INDEX and damaged:
            damages[-1] = _with_more(damages[-1], data)
        if opcode not in _READ:
            continue
        damaged = False
        try:
            record = _parsed(opcode, data)
            yield Unpacked(_unpacked(record)) if isinstance(record, Chunk) else record
        except GeneratorExit:
            raise
        except Exception:  # of a damaged record; decompression errors have no common type
            damaged = opcode == Opcode.CHUNK
            head = _CHUNK_HEAD.unpack_from(struct.pack("<BQ", opcode, len(data)) + data.ljust(32, b"\0"))
            begin_ns, end_ns = (head[2], head[3]) if damaged else (0, 0)
            what = "a damaged chunk" if damaged else "a damaged record"
            damages.append(Damage(at, None, begin_ns, end_ns, what))


def _with_more(damage: Damage, index: bytes) -> Damage:
    """The damage of a chunk with what one of its indexes says that was in it."""
    return damage._replace(messages=(damage.messages or 0) + max(0, len(index) - 6) // _INDEX.itemsize)


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

    def __init__(self, path: Path | None = None) -> None:
        """`path`: whose summary tells what channels there are, where what told it first is damaged."""
        self.damages: list[Damage] = []
        self._path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}

    def entries(self, records: Iterable[Any]) -> Iterator[Entry]:
        """The messages of `records` in file order; everything else is kept here."""
        for record in records:
            match record:
                case Unpacked():
                    yield from self._walk(record.data)
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

    def gather(self, file: Any, into: dict[int, Messages]) -> None:
        """As `collect`, of a whole open file, with the indexes of its chunks, which say where messages stand."""
        coming: deque[_Coming] = deque()  # chunks, oldest first, with their indexes
        with ThreadPoolExecutor(1) as beside:  # decompression leaves the interpreter to us
            for opcode, data, at in raw_records(file, self.damages):
                if opcode == Opcode.MESSAGE_INDEX and coming:
                    coming[-1].indexes.append(data)
                elif opcode in _READ:
                    try:
                        record = _parsed(opcode, data)
                    except Exception:  # of a damaged record
                        self.damages.append(Damage(at, None, 0, 0, "a damaged record"))
                        continue
                    if opcode != Opcode.CHUNK:
                        self.collect([record], into)
                        continue
                    coming.append(_Coming(record, beside.submit(_unpacked, record), [], at))
                    if len(coming) > AHEAD:
                        self._take(coming.popleft(), into)
            while coming:
                self._take(coming.popleft(), into)

    def _take(self, coming: "_Coming", into: dict[int, Messages]) -> None:
        """A chunk by its indexes where they name all that is in it, else record by record."""
        chunk, unpacked, indexes, at = coming
        try:
            data = unpacked.result()
        except Exception:  # decompression errors of a damaged chunk have no common type
            damage = Damage(at, None, chunk.message_start_time, chunk.message_end_time, "a damaged chunk")
            for index in indexes:
                damage = _with_more(damage, index)
            self.damages.append(damage)
            return
        size = len(data)
        raw, named = np.frombuffer(data, np.uint8), 0
        found: list[tuple[int, Counts, Counts, Counts]] = []
        for index in indexes:
            many = max(0, len(index) - 6) // _INDEX.itemsize
            entries = np.frombuffer(index, _INDEX, many, 6) if many else np.empty(0, _INDEX)
            starts = entries["offset"].astype(np.int64)
            if not len(starts) or int(starts.min()) < 0 or int(starts.max()) > size - 31:
                continue  # an index that is damaged names nothing
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
        self._known(channel)
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
        known = self._known(channel)
        schema = self.schemas.get(known.schema_id)
        return Entry(known.topic, log_time, data, "" if schema is None else schema.name, publish_time)

    def _known(self, channel: int) -> Channel:
        """A channel by its number. Raises KeyError for one that the file tells nothing of."""
        if channel not in self.channels and self._path is not None:
            path, self._path = self._path, None
            with open(path, "rb") as file:
                summary = make_reader(file).get_summary()
            if summary is not None:
                self.schemas = {**summary.schemas, **self.schemas}
                self.channels = {**summary.channels, **self.channels}
        return self.channels[channel]

    def kind_of(self, topic: str) -> Descriptor:
        """The message type of a topic, as the file describes it."""
        schema = self.schemas[next(c.schema_id for c in self.channels.values() if c.topic == topic)]
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(file)
        return pool.FindMessageTypeByName(schema.name)


class _Coming(NamedTuple):
    """A chunk that is being unpacked."""

    chunk: Chunk
    data: Future[bytes]
    indexes: list[bytes]
    at: int


def entries(path: Path, damages: list[Damage] | None = None) -> Iterator[Entry]:
    """Every message in file order, as far as the file goes; what is damaged is left out, and noted in `damages`.

    Raises LogError if it is no MCAP file at all.
    """
    noted = [] if damages is None else damages
    yield from guarded(path, lambda file: Contents(path).entries(sound_records(file, noted)))


class Copied(NamedTuple):
    """A message with all that describes it."""

    entry: Entry
    channel: Channel
    schema: Schema | None


def contents_of(path: Path, damages: list[Damage]) -> Iterator[Copied | tuple[str, dict[str, str]] | Attachment]:
    """Everything sound in a file, in its order: messages, metadata records (name, values) and attachments.

    What is not sound is noted in `damages`. Raises LogError if it is no MCAP file at all.
    """
    contents = Contents(path)

    def read(file: Any) -> Iterator[Copied | tuple[str, dict[str, str]] | Attachment]:
        for record in sound_records(file, damages):
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
