"""MCAP in, whole or truncated; columns as named arrays, read by the schema that the file brings."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from logs.reading.columns import columns
from logs.reading.messages import Messages
from logs.reading.records import Contents, Damage, LogError, guarded, is_complete, whole_records

__all__ = ["Happening", "LogError", "Run", "Tail", "frame_headers", "missing_before", "read"]

OWN = "cablequad."  # schemas whose topics become columns

EVENTS = ("/event", "/plant/event")


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
    frames: dict[str, Messages]  # by topic: the raw MAVLink envelopes
    epoch_ns: int = 0  # log time where the vehicles' clock is zero
    damages: tuple[Damage, ...] = ()  # parts of the file that are lost

    @property
    def release_ns(self) -> int:
        """The vehicles' clock at t = 0; where nothing was released, its first time stamp."""
        for event in self.events:
            if event.kind == "release":
                return event.time_ns
        for fields in self.columns.values():
            if "sim_time_ns" in fields and len(fields["sim_time_ns"]):
                return int(fields["sim_time_ns"][0])
        return 0


@contextmanager
def _no_collections() -> Iterator[None]:
    """Hundreds of thousands of rows that stay are no reason to look for cycles."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def read(path: Path) -> Run:
    """The whole log, or what a truncated one holds. Raises LogError if there is nothing to read."""
    contents = Contents(path)
    by_channel: dict[int, Messages] = {}

    def collect(file: Any) -> Iterator[None]:
        contents.gather(file, by_channel)
        yield

    with _no_collections():
        for _ in guarded(path, collect):
            pass
        return _run(path, contents, by_channel, is_complete(path))


class Tail:
    """A log that is being written: what has come since the last look."""

    def __init__(self, path: Path) -> None:
        """Raises LogError if it cannot be opened."""
        try:
            self._file = open(path, "rb")  # noqa: SIM115
        except OSError as error:
            raise LogError(f"log {path}: {error.strerror}") from None
        self._path = path
        self._contents = Contents()
        self._kept: dict[int, Messages] = {}
        self._at = 8
        self.ended = False

    def look(self) -> None:
        """Take in the chunks that are whole by now."""
        try:
            for record in whole_records(self._file, self._at):
                self._contents.collect([record], self._kept)
                self._at = self._file.tell()
            self.ended = True
        except EOFError:
            return

    def take(self, events: list[Happening]) -> Run:
        """The rows since the last `take`, under the events of `events`, to which new ones are added."""
        run = _run(self._path, self._contents, self._kept, False)
        self._kept = {}
        events += run.events
        return run._replace(events=list(events))

    @property
    def waiting(self) -> bool:
        """Whether there is something to take."""
        return bool(self._kept)


def _run(path: Path, contents: Contents, by_channel: dict[int, Messages], complete: bool) -> Run:
    rows: dict[str, Messages] = {}
    frames: dict[str, Messages] = {}
    first: dict[str, int] = {}
    for number, kept in by_channel.items():
        channel = contents.channels[number]
        schema = contents.schemas.get(channel.schema_id)
        if channel.topic.startswith("/mavlink/"):
            frames[channel.topic] = kept
        elif schema is not None and schema.name.startswith(OWN):
            rows[channel.topic], first[channel.topic] = kept, int(kept.time_ns[0])
    events: list[Happening] = []
    found: dict[str, dict[str, np.ndarray]] = {}
    for topic, messages in rows.items():
        try:
            read_here = columns(contents.kind_of(topic), messages)
        except (ValueError, KeyError, TypeError) as error:
            raise LogError(f"log {path}: {topic} cannot be read: {error}") from None
        if topic in EVENTS:
            named = (read_here[name].tolist() for name in ("sim_time_ns", "kind", "subject", "text"))
            events += [Happening(*happening) for happening in zip(*named, strict=True)]
        else:
            found[topic] = read_here
    events.sort(key=lambda event: event.time_ns)
    epoch_ns = next((first[topic] - int(c["sim_time_ns"][0]) for topic, c in found.items()), 0)
    damages = tuple(contents.damages)
    return Run(path, complete, contents.metadata, contents.attachments, found, events, frames, epoch_ns, damages)


def frame_headers(frames: Messages) -> dict[str, np.ndarray]:
    """sysid, compid and seq (T,) of the frames of one topic, of either version of MAVLink."""
    heads = frames.table(np.arange(len(frames)), 11)
    rows = np.arange(len(heads))
    at = np.where(heads[:, 1] > 127, 3, 2)  # behind the field's tag and length
    first = at + np.where(heads[rows, at] == 0xFD, 4, 2)
    names = ("seq", "sysid", "compid")
    return {name: heads[rows, np.minimum(first + k, 10)].astype(int) for k, name in enumerate(names)}


def missing_before(seq: np.ndarray) -> np.ndarray:
    """(T,) how many frames of one sender are missing before each; -1 where one comes late and fills a gap."""
    steps = ((np.diff(seq, prepend=seq[:1]) + 128) & 255) - 128
    count = np.cumsum(steps)
    newest = np.maximum.accumulate(count)
    before = np.concatenate([count[:1] - 1, newest[:-1]])
    first = np.zeros(len(seq), dtype=bool)
    first[np.unique(count, return_index=True)[1]] = True
    return np.where(count > before, count - before - 1, np.where(first, -1, 0))
