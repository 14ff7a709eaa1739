"""Many messages framed at once, by compiled code: what is said at every tick.

A batch is laid out once, a row for each message, and filled in tick after tick. Frames are byte for byte those of
`frames.frame`.
"""

import math
from collections.abc import Sequence

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.frames import Packed
from cablequad._jit import inlined, jit
from cablequad.model import lie
from cablequad.model.instant import places
from cablequad.types import Array, Bytes, Counts, Floats

HEADER, CHECKSUM = 10, 2
PAYLOAD = 255  # bytes at most


class Batch:
    """k messages: what is in them stands in the rows of `payload`, trailing zeros and all."""

    def __init__(self, messages: Sequence[Packed]) -> None:
        """`messages`: what stays of each as it is, and something where it will be filled in."""
        sizes = [mavlink.mavlink_map[m.msgid].unpacker.size for m in messages]
        self.msgids = [m.msgid for m in messages]
        self._sizes: Counts = np.array(sizes, np.int64)
        self._kinds = np.array([(*m.msgid.to_bytes(3, "little"), m.crc_extra) for m in messages], np.uint8)
        self.payload: Bytes = np.zeros((len(messages), max(sizes)), np.uint8)
        for row, message in zip(self.payload, messages, strict=True):
            row[: len(message.payload)] = np.frombuffer(message.payload, np.uint8)
        self.floats: Floats = np.zeros(PAYLOAD // 4, np.float32)  # of one message on their way into its payload
        self.as_bytes: Bytes = self.floats.view(np.uint8)  # the same memory
        self._frames: Bytes = np.zeros(len(messages) * (HEADER + CHECKSUM) + sum(sizes), np.uint8)
        self._ends: Counts = np.zeros(len(messages), np.int64)

    def __len__(self) -> int:
        return len(self.msgids)

    def framed(self, seqs: bytes, systems: bytes, component: int, flags: int) -> list[bytes]:
        """The frames of the first messages, as many as there are sequence numbers, each with its sender.

        `flags` as for MAVLink 2's incompatibility flags.
        """
        size = _framed(
            self.payload, self._sizes, self._kinds, seqs, systems, component, flags, self._frames, self._ends
        )
        whole, at, out = self._frames[:size].tobytes(), 0, []
        for end in self._ends[: len(seqs)].tolist():
            out.append(whole[at:end])
            at = end
        return out


def _crc_table() -> Counts:
    """CRC-16/MCRF4XX of every byte."""
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
        table.append(crc)
    return np.array(table, np.int64)


_CRC = _crc_table()


@jit
def _framed(
    payload: Bytes, sizes: Counts, kinds: Bytes, seqs: bytes, systems: bytes, component: int, flags: int, out: Bytes,
    ends: Counts,
) -> int:  # fmt: skip
    at = 0
    for k in range(len(seqs)):
        size = sizes[k]
        while size > 1 and payload[k, size - 1] == 0:
            size -= 1
        out[at], out[at + 1], out[at + 2], out[at + 3] = 0xFD, size, flags, 0
        out[at + 4], out[at + 5], out[at + 6] = seqs[k], systems[k], component
        for b in range(3):
            out[at + 7 + b] = kinds[k, b]
        stop = at + HEADER + size
        for b in range(size):
            out[at + HEADER + b] = payload[k, b]
        crc = 0xFFFF
        for b in range(at + 1, stop):
            crc = crc >> 8 ^ _CRC[(crc ^ out[b]) & 255]
        crc = crc >> 8 ^ _CRC[(crc ^ kinds[k, 3]) & 255]
        out[stop], out[stop + 1] = crc & 255, crc >> 8
        at = stop + CHECKSUM
        ends[k] = at
    return at


CABLE_LINKS, ODOMETRY_POSE = 15, 8  # where numbers begin in a payload


@jit
def put_load(
    row: Array, boot_us: int, n: int, L: int, parts: Counts, payload: Bytes, floats: Floats, as_bytes: Bytes
) -> None:
    """Fill in CABLE_STATE of some links a message, then the pose and twist of ODOMETRY, from an `instant.row`.

    `parts` (k, 3) says of each of the k first messages its cable (from 0), first link and number of links; which cable
    and links they are stands in `payload` already. `floats` and `as_bytes` are one memory.
    """
    start = places(n, L)
    for k in range(len(parts)):
        cable, first, count = parts[k]
        floats[0] = row[start.tension + cable * L + _last(parts, k)]
        for j in range(count):
            at = 3 * (cable * L + first + j)
            for a in range(3):
                floats[1 + 6 * j + a], floats[4 + 6 * j + a] = row[start.q + at + a], row[start.omega + at + a]
        _put_whole(payload, k, boot_us, 8)
        _put_floats(payload, k, 8, as_bytes, 0, 1)
        _put_floats(payload, k, CABLE_LINKS, as_bytes, 1, 6 * count)
    R = row[6:15].reshape(3, 3)
    quat = lie.wxyz_from_rotation(R)
    for a in range(3):
        floats[a] = row[a]
        floats[7 + a] = row[3] * R[0, a] + row[4] * R[1, a] + row[5] * R[2, a]
        floats[10 + a] = row[15 + a]
    floats[3], floats[4], floats[5], floats[6] = quat
    _put_whole(payload, len(parts), boot_us, 8)
    _put_floats(payload, len(parts), ODOMETRY_POSE, as_bytes, 0, 13)


@jit
def put_targets(R_c: Array, thrust: Array, boot_ms: int, payload: Bytes, floats: Floats, as_bytes: Bytes) -> int:
    """Fill in time, quaternion and thrust of SET_ATTITUDE_TARGET, for attitudes (n, 3, 3) and thrust fields (n,).

    The first row, from 0, that would not be finite; -1 where all are. `floats` and `as_bytes` are one memory.
    """
    for k in range(len(thrust)):
        w, x, y, z = lie.wxyz_from_rotation(R_c[k])
        if not math.isfinite(w + x + y + z + thrust[k]):
            return k
        floats[0], floats[1], floats[2], floats[3], floats[7] = w, x, y, z, thrust[k]
        _put_whole(payload, k, boot_ms, 4)
        _put_floats(payload, k, 4, as_bytes, 0, 8)
    return -1


@jit
def put_attitudes(R: Array, Omega: Array, boot_ms: int, payload: Bytes, floats: Floats, as_bytes: Bytes) -> None:
    """Fill in time, quaternion and rates of ATTITUDE_QUATERNION, for attitudes (k, 3, 3) and rates (k, 3) rad/s.

    `floats` and `as_bytes` are one memory.
    """
    for k in range(len(R)):
        floats[0], floats[1], floats[2], floats[3] = lie.wxyz_from_rotation(R[k])
        for a in range(3):
            floats[4 + a] = Omega[k, a]
        _put_whole(payload, k, boot_ms, 4)
        _put_floats(payload, k, 4, as_bytes, 0, 7)


@inlined
def _last(parts: Counts, k: int) -> int:
    """The last link of the cable that message k is of: the one at the load."""
    while k + 1 < len(parts) and parts[k + 1, 0] == parts[k, 0]:
        k += 1
    return parts[k, 1] + parts[k, 2] - 1


@inlined
def _put_floats(out: Bytes, row: int, at: int, values: Bytes, first: int, count: int) -> None:
    """`count` numbers, from `first` on, of float32 seen as bytes, to where they stand in a payload."""
    for b in range(4 * count):
        out[row, at + b] = values[4 * first + b]


@inlined
def _put_whole(out: Bytes, row: int, value: int, size: int) -> None:
    """A time in `size` bytes, the lowest first, at the beginning of a payload."""
    for b in range(size):
        out[row, b] = value >> 8 * b & 255
