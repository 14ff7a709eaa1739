"""Well-formed frames of every kind that anybody may send, with random and extreme fields."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as everything

from bridge.wire.dialect import CABLE_STATE, mavlink
from bridge.wire.frames import Packed, bounds, codes

FLOATS = (0.0, -0.0, 1.0, -1.0, 0.5, math.nan, math.inf, -math.inf, 1e38, -1e38, 1e-45, 2989.0, 21196.0)
OURS: dict[int, Any] = dict(mavlink.mavlink_map)  # the dialect that is spoken here
FOREIGN: dict[int, Any] = {k: v for k, v in everything.mavlink_map.items() if k not in OURS}  # what others send
assert CABLE_STATE.id in OURS


def absurd_fields(kind: Any, rng: np.random.Generator, given: Mapping[str, int]) -> tuple[Any, ...]:
    """A value for every field in wire order, arrays flat; those of `given` as they are."""
    out: list[Any] = []
    names: list[str] = []
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    for name, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True):
        names += [name] * (1 if types[name] == "char" else max(1, length))
    for name, code in zip(names, codes(kind), strict=True):
        if code == "s":
            out.append(bytes(rng.integers(0, 256, 16).tolist()))
        elif code == "c":
            out.append(bytes((int(rng.integers(256)),)))
        elif name in given:
            out.append(given[name])
        elif code in "fd":
            absurd = rng.random() < 0.7
            out.append(float(rng.choice(FLOATS)) if absurd else float(rng.normal() * 10))
        else:
            low, high = bounds(code)
            few = (low, high, 0, 1)
            out.append(few[int(rng.integers(4))] if rng.random() < 0.5 else int(rng.integers(0, min(high, 255) + 1)))
    return tuple(out)


def absurd(kind: Any, rng: np.random.Generator, given: Mapping[str, int]) -> Packed:
    """A message of `kind` with such fields."""
    payload = kind.unpacker.pack(*absurd_fields(kind, rng, given)).rstrip(b"\0") or b"\0"
    return Packed(kind.id, kind.msgname, kind.crc_extra, payload)
