"""A log in other forms: a whole file from a cut one, MAVLink tlogs, columns as CSV or Parquet."""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer

from logs.reading.reader import LogError, Run
from logs.reading.records import Copied, Damage, contents_of, entries, missing
from logs.schema import cablequad_pb2 as pb

TRACKER_TOPIC = "payload"


class Salvaged(NamedTuple):
    """What was kept of a log, and what was not."""

    messages: int
    damages: list[Damage]
    lost: int  # messages, as far as the file's summary counted them
    begin_ns: int  # log time of its first message


def salvage(source: Path, target: Path) -> Salvaged:
    """Copy every sound record of `source` into `target` with an index at its end.

    Raises LogError where there is nothing to copy or `target` is there already; then no new file is left.
    """
    made = False
    try:
        with _new(target) as file:
            made = True
            return _copied(source, file)
    except BaseException:
        if made:
            target.unlink()
        raise


def _copied(source: Path, file: IO[bytes]) -> Salvaged:
    damages: list[Damage] = []
    writer = Writer(file, compression=CompressionType.ZSTD, chunk_size=512 * 1024)
    writer.start(library="cablequad salvage")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    count = begin_ns = 0
    for record in contents_of(source, damages):
        match record:
            case Copied(entry, channel, schema):
                if channel.id not in channels:
                    if schema is not None and schema.id not in schemas:
                        schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                    known = schemas[schema.id] if schema is not None else 0
                    channels[channel.id] = writer.register_channel(
                        channel.topic, channel.message_encoding, known, channel.metadata
                    )
                writer.add_message(channels[channel.id], entry.log_time, entry.data, entry.publish_time)
                begin_ns = min(begin_ns or entry.log_time, entry.log_time)
                count += 1
            case (str() as name, dict() as values):
                writer.add_metadata(name, values)
            case attachment:
                writer.add_attachment(
                    attachment.create_time, attachment.log_time, attachment.name, attachment.media_type,
                    attachment.data,
                )  # fmt: skip
    writer.finish()
    if count == 0:
        raise LogError(f"log {source}: no whole message in it; nothing to salvage")
    return Salvaged(count, damages, missing(source, count) if damages else 0, begin_ns)


def tlogs(source: Path, folder: Path) -> list[Path]:
    """One .tlog for each vehicle and the tracker: what went both ways, as ground stations read it.

    Each frame behind its time as a big-endian count of microseconds since 1970. Raises LogError.
    """
    files: dict[str, IO[bytes]] = {}
    try:
        for entry in entries(source):
            if not entry.topic.startswith("/mavlink/"):
                continue
            who = entry.topic.split("/")[2]
            if who not in files:
                files[who] = _new(folder / f"{source.stem}-{who}.tlog")
            frame = pb.MavlinkFrame.FromString(entry.data).frame
            files[who].write((entry.log_time // 1000).to_bytes(8, "big") + frame)
    finally:
        for file in files.values():
            file.close()
    if not files:
        raise LogError(f"log {source}: no MAVLink frame in it")
    return [Path(file.name) for file in files.values()]


def tables(run: Run, folder: Path, form: str) -> list[Path]:
    """One file of columns for each topic, `form` csv or parquet; arrays become name_0, name_1, ... Raises LogError."""
    out = []
    for topic, columns in run.columns.items():
        names, values = zip(*_flat(columns, run.release_ns), strict=True)
        path = folder / f"{run.path.stem}{topic.replace('/', '-')}.{form}"
        if form == "csv":
            with _new(path) as raw, open(raw.fileno(), "w", newline="", closefd=False) as file:
                writer = csv.writer(file)
                writer.writerow(names)
                writer.writerows(zip(*(v.tolist() for v in values), strict=True))
        else:
            import pyarrow as pa
            from pyarrow import parquet

            with _new(path) as file:
                parquet.write_table(pa.table(dict(zip(names, values, strict=True))), file)
        out.append(path)
    if not out:
        raise LogError(f"log {run.path}: no columns in it")
    return out


def _flat(columns: dict[str, np.ndarray], release_ns: int) -> Iterator[tuple[str, np.ndarray]]:
    yield "t_s", (columns["sim_time_ns"] - release_ns) * 1e-9
    for name, values in columns.items():
        if values.ndim == 1:
            yield name, values
        else:
            for k in range(values.shape[1]):
                yield f"{name}_{k}", values[:, k]


def _new(path: Path) -> IO[bytes]:
    try:
        return open(path, "xb")
    except FileExistsError:
        raise LogError(f"{path}: exists already; give another name or folder") from None
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}; give another name or folder") from None
