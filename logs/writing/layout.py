"""Bytes of many records at once, compiled: what a log's hot messages look like in a chunk."""

import numpy as np

from cablequad._jit import inlined, jit
from cablequad.types import Array, Bytes, Counts

HEAD = 31  # bytes of a message's record before its data
ENVELOPE = 48  # bytes that an envelope adds to a frame at most, its name not counted
MESSAGE = 0x05  # the opcode


@jit
def records(
    data: Bytes, ends: Counts, channel: Counts, log_time: Counts, enveloped: Counts, publish_time: int, names: Bytes,
    named: Counts, out: Bytes,
) -> Counts:  # fmt: skip
    """Messages as the records of a chunk, written to `out`; (k + 1,) where each begins, and the end.

    `data` holds what is in them, one behind the other, and `ends` (k,) where each stops. One that is `enveloped` is a
    MAVLink frame there and a cablequad.MavlinkFrame in its record; `named` (m, 3) says of messages by id, in rising
    order, where in `names` theirs begin and end.
    """
    begins = np.empty(len(ends) + 1, np.int64)
    at, start = 0, 0
    for k in range(len(ends)):
        begins[k] = at
        body = at + HEAD
        end = ends[k]
        if enveloped[k]:
            stop = _envelope(data, start, end, names, named, out, body)
        else:
            stop = _copied(data, start, end, out, body)
        out[at] = MESSAGE
        _little(out, at + 1, stop - body + 22, 8)
        _little(out, at + 9, channel[k], 2)
        _little(out, at + 11, 0, 4)
        _little(out, at + 15, log_time[k], 8)
        _little(out, at + 23, publish_time, 8)
        at, start = stop, end
    begins[len(ends)] = at
    return begins


@jit
def transforms(stamp: Bytes, pairs: Bytes, ends: Counts, moved: Array, turned: Array, out: Bytes) -> int:
    """foxglove.FrameTransforms of one instant, written to `out`; how many bytes.

    `stamp` is its time; `pairs` holds parent and child of each transform up to `ends` (k,), as they stand in it; the
    last of them have moved (m, 3) and turned (m, 4), x, y, z, w.
    """
    at, skip = 0, len(ends) - len(moved)
    move, turn = moved.view(np.int64), turned.view(np.int64)
    for k in range(skip, len(ends)):
        begin = ends[k - 1] if k > 0 else 0
        m, t = _reals(move[k - skip]), _reals(turn[k - skip])
        out[at] = 0x0A
        at = _varint(out, at + 1, 2 + len(stamp) + ends[k] - begin + 2 + m + 2 + t)
        out[at], out[at + 1] = 0x0A, len(stamp)
        at = _copied(stamp, 0, len(stamp), out, at + 2)
        at = _copied(pairs, begin, ends[k], out, at)
        out[at], out[at + 1] = 0x22, m
        at = _put_reals(out, at + 2, move[k - skip])
        out[at], out[at + 1] = 0x2A, t
        at = _put_reals(out, at + 2, turn[k - skip])
    return at


@inlined
def _copied(data: Bytes, start: int, end: int, out: Bytes, at: int) -> int:
    stop = at + end - start
    out[at:stop] = data[start:end]
    return stop


@inlined
def _envelope(data: Bytes, start: int, end: int, names: Bytes, named: Counts, out: Bytes, at: int) -> int:
    if data[start] == 0xFD:
        header, long = start + 4, True
    else:
        header, long = start + 2, False
    seq, system, component = np.int64(data[header]), np.int64(data[header + 1]), np.int64(data[header + 2])
    msgid = np.int64(data[header + 3])
    if long:
        msgid |= np.int64(data[header + 4]) << 8 | np.int64(data[header + 5]) << 16
    out[at] = 0x0A
    at = _varint(out, at + 1, end - start)
    at = _copied(data, start, end, out, at)
    at = _number(out, at, 0x10, msgid)
    at = _number(out, at, 0x18, system)
    at = _number(out, at, 0x20, component)
    at = _number(out, at, 0x28, seq)
    row = np.searchsorted(named[:, 0], msgid)
    if row < len(named) and named[row, 0] == msgid:
        out[at] = 0x32
        at = _varint(out, at + 1, named[row, 2] - named[row, 1])
        at = _copied(names, named[row, 1], named[row, 2], out, at)
    return at


@inlined
def _number(out: Bytes, at: int, tag: int, value: int | np.int64) -> int:
    if value == 0:
        return at
    out[at] = tag
    return _varint(out, at + 1, value)


@inlined
def _varint(out: Bytes, at: int, value: int | np.int64) -> int:
    while value > 127:
        out[at] = value & 127 | 128
        value >>= 7
        at += 1
    out[at] = value
    return at + 1


@inlined
def _little(out: Bytes, at: int, value: int, size: int) -> None:
    for i in range(size):
        out[at + i] = value >> 8 * i & 255


@inlined
def _reals(bits: Counts) -> int:
    """Bytes that doubles take as fields of their own, of which those that are 0 are left out."""
    size = 0
    for value in bits:
        if value != 0:
            size += 9
    return size


@inlined
def _put_reals(out: Bytes, at: int, bits: Counts) -> int:
    for field in range(len(bits)):
        if bits[field] != 0:
            out[at] = field + 1 << 3 | 1
            _little(out, at + 1, bits[field], 8)
            at += 9
    return at
