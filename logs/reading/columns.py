"""Many protobuf messages of one kind -> one numpy array a field, without an object a message.

Messages of one recording mostly have the same layout: those of one length are looked at side by side as a matrix of
bytes. Where some of them are laid out otherwise they go through the protobuf library one by one.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from google.protobuf import message_factory
from google.protobuf.descriptor import FieldDescriptor

from logs.reading.messages import Messages

_F = FieldDescriptor
_REAL: dict[int, np.dtype[Any]] = {_F.TYPE_DOUBLE: np.dtype("<f8"), _F.TYPE_FLOAT: np.dtype("<f4")}
_WHOLE = frozenset({_F.TYPE_INT64, _F.TYPE_INT32, _F.TYPE_UINT64, _F.TYPE_UINT32, _F.TYPE_BOOL, _F.TYPE_ENUM})
_TEXT = frozenset({_F.TYPE_STRING, _F.TYPE_BYTES})


class _Piece(NamedTuple):
    """A field's value in the bytes of a message."""

    field: Any
    start: int
    end: int


class _Unlike(Exception):
    """Messages that cannot be read side by side."""


GROUNDED = ("prepare", "preflight", "arm", "disarm")  # phases in which nothing flies
CARRYING = ("fly", "lift", "carry", "set down")  # phases in which the load hangs and is flown along its reference


def flown(control: Mapping[str, np.ndarray]) -> np.ndarray:
    """(k,) bool: which decisions of /control/state were made in flight."""
    phase = control["phase"]
    return (phase == "fly") | ((control["t"] > 0.0) & ~np.isin(phase, GROUNDED))


def columns(kind: Any, messages: Messages) -> dict[str, np.ndarray]:
    """One row a message for each field of `kind` that can be a column; fields that a message leaves out are zero.

    Repeated numbers give (T, k); numbers (T,); texts (T,) of str. Raises ValueError for bytes that are no such message.
    """
    known = {f.number: f for f in kind.fields if f.type in _REAL or f.type in _WHOLE or f.type in _TEXT}
    lengths = messages.lengths
    found: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
    for length in np.unique(lengths).tolist():
        rows = np.flatnonzero(lengths == length)
        found += _alike(kind, known, rows, messages.table(rows, length))
    out: dict[str, np.ndarray] = {}
    for f in known.values():
        parts = [(rows, values[f.name]) for rows, values in found if f.name in values]
        repeated = f.is_repeated
        column: np.ndarray
        if f.type in _TEXT:
            width = max((p.dtype.itemsize for _, p in parts), default=4)
            column = np.zeros(len(messages), dtype=f"U{max(1, width // 4)}")
        elif repeated:
            width = max((p.shape[-1] for _, p in parts), default=0)
            column = np.zeros((len(messages), width), dtype=float)
        else:
            column = np.zeros(len(messages), dtype=float if f.type in _REAL else np.int64)
        for rows, part in parts:
            if repeated and part.shape[-1] != column.shape[-1]:
                column[rows[:, None], np.arange(part.shape[-1])] = part
            else:
                column[rows] = part
        out[f.name] = column.astype(bool) if f.type == f.TYPE_BOOL else column
    return out


def _alike(
    kind: Any, known: dict[int, Any], rows: np.ndarray, matrix: np.ndarray
) -> list[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """The values of messages of one length, a row of `matrix` each, in as many groups as there are layouts."""
    out: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
    while len(matrix):
        try:
            pieces, fixed, varying = _layout(known, matrix[0].tobytes())
        except _Unlike:
            return [*out, (rows, _one_by_one(kind, known, [row.tobytes() for row in matrix]))]
        same = np.all(matrix[:, fixed] == matrix[0, fixed], axis=1)
        same &= np.all((matrix[:, varying] & 128) == (matrix[0, varying] & 128), axis=1)
        alike = matrix if same.all() else matrix[same]
        out.append((rows[same], {p.field.name: _value(p, alike) for p in pieces}))
        rows, matrix = rows[~same], matrix[~same]
        if len(out) > 16 and len(matrix):
            return [*out, (rows, _one_by_one(kind, known, [row.tobytes() for row in matrix]))]
    return out


def _layout(known: dict[int, Any], data: bytes) -> tuple[list[_Piece], np.ndarray, np.ndarray]:
    """Where fields stand in `data`; the bytes that every message of this layout shares; those of its varint values."""
    pieces: list[_Piece] = []
    fixed: list[int] = []
    varying: list[int] = []
    at = 0
    while at < len(data):
        begun = at
        tag, at = _varint(data, at)
        field, wire = known.get(tag >> 3), tag & 7
        if wire == 0:
            fixed += range(begun, at)
            start = at
            _, at = _varint(data, at)
            varying += range(start, at)
        elif wire == 1 or wire == 5:
            fixed += range(begun, at)
            start, at = at, at + (8 if wire == 1 else 4)
        elif wire == 2:
            size, at = _varint(data, at)
            fixed += range(begun, at)
            start, at = at, at + size
        else:
            raise _Unlike
        if at > len(data):
            raise _Unlike
        if field is not None:
            fits = (0,) if field.type in _WHOLE else (2,) if field.type in _TEXT or field.is_repeated else (1, 5)
            if wire not in fits or any(p.field is field for p in pieces):
                raise _Unlike
            pieces.append(_Piece(field, start, at))
    return pieces, np.array(fixed, dtype=int), np.array(varying, dtype=int)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        if at >= len(data) or shift > 63:
            raise _Unlike
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
        shift += 7


def _value(piece: _Piece, matrix: np.ndarray) -> np.ndarray:
    field = piece.field
    part = np.ascontiguousarray(matrix[:, piece.start : piece.end])
    if field.type in _REAL:
        values = part.view(_REAL[field.type])
        return values.astype(float) if field.is_repeated else values[:, 0].astype(float)
    if field.type in _TEXT:
        size = piece.end - piece.start
        if not size:
            return np.zeros(len(matrix), dtype="U1")
        texts, where = np.unique(part.view(f"S{size}")[:, 0], return_inverse=True)
        return np.array([t.decode("utf-8", "replace") for t in texts.tolist()])[where]
    shifts = np.arange(part.shape[1], dtype=np.uint64) * np.uint64(7)
    return np.bitwise_or.reduce((part & 127).astype(np.uint64) << shifts, axis=1).view(np.int64)


def _one_by_one(kind: Any, known: dict[int, Any], messages: list[bytes]) -> dict[str, np.ndarray]:
    cls = message_factory.GetMessageClass(kind)
    try:
        read = [cls.FromString(m) for m in messages]
    except Exception as error:  # the library's own exception differs between its implementations
        raise ValueError(f"not a {kind.full_name}: {error}") from None
    out: dict[str, np.ndarray] = {}
    for f in known.values():
        values = [getattr(m, f.name) for m in read]
        if f.is_repeated:
            width = max(len(v) for v in values)
            out[f.name] = np.array([[*v] + [0.0] * (width - len(v)) for v in values], dtype=float)
        elif f.type in _TEXT:
            out[f.name] = np.array([v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in values])
        else:
            out[f.name] = np.array(values, dtype=float if f.type in _REAL else np.int64)
    return out
