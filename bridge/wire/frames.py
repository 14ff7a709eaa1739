"""Messages <-> frames: header, checksum, signature. Bytes as pymavlink makes them, at a fifth of its cost.

A message is packed once (`Packed`) and framed as often as it is sent. Signing follows the MAVLink 2 specification: a
signature is checked before anything that came with it is believed, its time stamp included.
"""

import hashlib
import math
import re
import struct
from collections.abc import Callable
from enum import Enum
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import fastcrc

from bridge.wire.dialect import Kind, mavlink

checksum: Callable[[bytes], int] = fastcrc.crc16.mcrf4xx
SIGNATURE_BYTES = 13
SIGNED = 1  # the one incompatibility flag there is
LARGEST_SINGLE = 3.4028234663852886e38  # what a float field holds
FIRST_STAMP_AGE = 6_000_000  # 10 us: the first signed frame of a stream may be a minute old
SIGNING_EPOCH_S = 1_420_070_400  # 2015-01-01, where signing time stamps begin


class Packed(NamedTuple):
    """A message ready to be framed."""

    msgid: int
    name: str
    crc_extra: int
    payload: bytes  # trailing zeros cut, as MAVLink 2 sends it


def pack(kind: Kind, *fields: Any) -> Packed:
    """`fields` in wire order, arrays flat, as a message of the class `kind`; what a field cannot hold saturates."""
    try:
        payload = kind.unpacker.pack(*fields)
    except (struct.error, OverflowError):
        payload = kind.unpacker.pack(*map(_saturated, codes(kind), fields))
    return Packed(kind.id, kind.msgname, kind.crc_extra, payload.rstrip(b"\0") or b"\0")


@cache
def codes(kind: Kind) -> tuple[str, ...]:
    """The struct code of every value that `kind` packs, in wire order."""
    out: list[str] = []
    for count, code in re.findall(r"(\d*)([a-zA-Z])", kind.unpacker.format):
        out += ["s"] if code == "s" else [code] * int(count or 1)
    return tuple(out)


def bounds(code: str) -> tuple[int, int]:
    """The smallest and the largest number that an integer field of this struct code holds."""
    bits = 8 * struct.calcsize(f"<{code}")
    return (0, 2**bits - 1) if code.isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def _saturated(code: str, value: Any) -> Any:
    if code in "sc":
        return value
    if code == "f":
        return math.copysign(math.inf, value) if abs(value) > LARGEST_SINGLE else value
    if code == "d":
        return value
    low, high = bounds(code)
    return min(max(int(value), low), high)


def packed(kind: Kind, *fields: Any) -> Packed:
    """`fields` in the order of the message's definition, arrays as sequences; extensions left out are zeros."""
    places, blank = _layout(kind)
    given = (*fields, *blank[len(fields) :])
    flat: list[Any] = []
    for at, many in places:
        if many:
            flat += given[at]
        else:
            flat.append(given[at])
    return pack(kind, *flat)


@cache
def _layout(kind: Kind) -> tuple[list[tuple[int, bool]], list[Any]]:
    """For each field in wire order its place in the definition and whether it is an array; what stands for nothing."""
    many = [length > 1 for length in kind.lengths]
    places = sorted((wire, at) for at, wire in enumerate(kind.orders))
    blank: list[Any] = [
        b"" if type == "char" else [0] * kind.lengths[wire] if many[wire] else 0
        for type, wire in zip(kind.fieldtypes, kind.orders, strict=True)
    ]
    return [(at, many[wire]) for wire, at in places], blank


def fields(kind: Kind, payload: bytes) -> SimpleNamespace:
    """The fields of a payload by name, arrays as tuples, text as bytes up to its last character."""
    flat, at, named = unpack(kind, payload), 0, {}
    for name, length in zip(kind.ordered_fieldnames, kind.lengths, strict=True):
        value = flat[at] if length == 1 else flat[at : at + length]
        named[name] = value.rstrip(b"\0") if isinstance(value, bytes) else value
        at += length
    return SimpleNamespace(**named)


def unpack(kind: Kind, payload: bytes) -> tuple[Any, ...]:
    """The fields of a payload in wire order, arrays flat."""
    layout = kind.unpacker
    return tuple(layout.unpack(whole_payload(payload, layout.size)))


def whole_payload(payload: bytes, size: int) -> bytes:
    """A payload as long as its kind is: what was cut counts as zeros, what is unknown is left out."""
    return payload[:size].ljust(size, b"\0")


def payload_of(frame: bytes) -> bytes:
    """The payload of a frame of either protocol version."""
    start = 10 if frame[0] == 0xFD else 6
    return frame[start : start + frame[1]]


def frame(
    message: Packed, seq: int, system: int, component: int, signer: "Signer | None" = None, link_id: int = 0
) -> bytes:
    """One MAVLink 2 frame; `link_id` goes into its signature."""
    msgid, payload = message.msgid, message.payload
    flags = 0 if signer is None else SIGNED
    body = bytes(
        (len(payload), flags, 0, seq, system, component, msgid & 255, msgid >> 8 & 255, msgid >> 16)
    ) + payload  # fmt: skip
    crc = checksum(body + bytes((message.crc_extra,)))
    out = b"\xfd" + body + bytes((crc & 255, crc >> 8))
    return out if signer is None else out + signer.signature(out, link_id)


class Verdict(Enum):
    """What a signature is worth."""

    GOOD = "signed"
    UNSIGNED = "unsigned"
    WRONG = "wrongly signed"
    STALE = "signed with a clock that is more than a minute behind"
    REPLAYED = "replayed"


class Signer:
    """One side's key, the time stamps it has given out and those it has seen."""

    def __init__(self, key: bytes, accept_unsigned_telemetry: bool = False, epoch_s: int | None = None) -> None:
        """`epoch_s`: when simulated time began (Unix), which dates everything; None: the wall clock does."""
        if len(key) != 32:
            raise ValueError(f"a signing key has 32 bytes, not {len(key)}")
        self._key = key
        self.accept_unsigned_telemetry = accept_unsigned_telemetry
        self.stamp = 0  # 10 us since 2015; the owner of a clock moves it on
        self._epoch_s = epoch_s
        self._seen: dict[tuple[int, int, int], int] = {}
        self.advance(0)

    def at(self, unix_s: float) -> None:
        """Let the time stamps follow the wall clock, but where time is simulated; they never go back."""
        if self._epoch_s is None:
            self._follow(unix_s)

    def advance(self, simulated_us: int) -> None:
        """Let them follow simulated time, where that dates them."""
        if self._epoch_s is not None:
            self._follow(self._epoch_s + 1e-6 * simulated_us)

    def _follow(self, unix_s: float) -> None:
        self.stamp = max(self.stamp, int((unix_s - SIGNING_EPOCH_S) * 1e5))

    def signature(self, unsigned: bytes, link_id: int) -> bytes:
        """The 13 bytes that end a frame whose flags already say that it is signed.

        Each link has an id of its own, as what goes out on two of them may arrive in another order.
        """
        self.stamp += 1
        tail = bytes((link_id,)) + self.stamp.to_bytes(6, "little")
        return tail + hashlib.sha256(self._key + unsigned + tail).digest()[:6]

    def judge(self, frame: bytes) -> Verdict:
        """Whether a frame with a right checksum may be believed. Only a good one moves the stream's time stamp."""
        if frame[0] != 0xFD or not frame[2] & SIGNED:
            return Verdict.UNSIGNED
        if hashlib.sha256(self._key + frame[:-6]).digest()[:6] != frame[-6:]:
            return Verdict.WRONG
        stream = (frame[5], frame[6], frame[-13])
        stamp = int.from_bytes(frame[-12:-6], "little")
        newest = self._seen.get(stream)
        if newest is None and stamp <= self.stamp - FIRST_STAMP_AGE:
            return Verdict.STALE
        if newest is not None and stamp <= newest:
            return Verdict.REPLAYED
        self._seen[stream] = stamp
        return Verdict.GOOD


def targeted(msgid: int) -> bool:
    """Whether messages of this kind are for somebody, and so may ask for something."""
    kind = mavlink.mavlink_map.get(msgid)
    return kind is not None and "target_system" in kind.fieldnames and msgid not in _ANSWERS


_ANSWERS = frozenset({mavlink.MAVLINK_MSG_ID_COMMAND_ACK, mavlink.MAVLINK_MSG_ID_MISSION_COUNT})
