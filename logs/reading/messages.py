"""The messages of one channel, left where they stand in the chunks that they came in until somebody asks for them."""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cablequad.types import Bytes, Counts


class _Block(NamedTuple):
    """Messages in one piece of memory."""

    data: bytes
    starts: Counts  # (k,) of each
    ends: Counts  # (k,)
    time_ns: Counts  # (k,)


class Messages:
    """Messages and their log times, in their order."""

    def __init__(self, bodies: Sequence[bytes] = ()) -> None:
        self._blocks: list[_Block] = []
        self._loose: list[tuple[int, bytes]] = [(0, body) for body in bodies]  # not in a block yet

    def put(self, time_ns: int, body: bytes) -> None:
        """One more."""
        self._loose.append((time_ns, body))
        self.__dict__.pop("_whole", None)

    def put_block(self, data: bytes, starts: Counts, ends: Counts, time_ns: Counts) -> None:
        """More, that stand in `data` from `starts` (k,) to `ends` (k,)."""
        self._gather_loose()
        self._blocks.append(_Block(data, starts, ends, time_ns))
        self.__dict__.pop("_whole", None)

    def __len__(self) -> int:
        return len(self._loose) + sum(len(block.starts) for block in self._blocks)

    @property
    def time_ns(self) -> Counts:
        """(T,) log times; less the epoch they are the vehicles' clock."""
        return self._whole[0]

    @property
    def lengths(self) -> Counts:
        """(T,) bytes of each."""
        return self._whole[1]

    @property
    def data(self) -> list[bytes]:
        """Each as bytes of its own."""
        self._gather_loose()
        spans = ((b.data, b.starts.tolist(), b.ends.tolist()) for b in self._blocks)
        return [data[a:e] for data, starts, ends in spans for a, e in zip(starts, ends, strict=True)]

    def table(self, rows: Counts, length: int) -> Bytes:
        """(k, length) the bytes of `rows` (k,), in rising order; none is longer, shorter ones end in what there is."""
        out = np.empty((len(rows), length), np.uint8)
        first = self._whole[2]
        bounds = np.searchsorted(rows, first)
        for k, block in enumerate(self._blocks):
            mine = rows[bounds[k] : bounds[k + 1]] - first[k]
            if len(mine) == 0:
                continue
            raw = np.frombuffer(block.data, np.uint8)
            starts = block.starts[mine]
            if int(starts.max()) + length > len(raw):  # the last ones end with the block
                raw = np.concatenate([raw, np.zeros(length, np.uint8)])
            out[bounds[k] : bounds[k + 1]] = sliding_window_view(raw, length)[starts]
        return out

    def _gather_loose(self) -> None:
        if self._loose:
            ends = np.cumsum([len(body) for _, body in self._loose])
            starts = np.concatenate([[0], ends[:-1]])
            times = np.array([time_ns for time_ns, _ in self._loose])
            self._blocks.append(_Block(b"".join(body for _, body in self._loose), starts, ends, times))
            self._loose = []

    @cached_property
    def _whole(self) -> tuple[Counts, Counts, Counts]:
        """Times and lengths of all, and the first of each block, with the count of all behind them."""
        self._gather_loose()
        none = np.zeros(0, np.int64)
        times = np.concatenate([none, *(b.time_ns for b in self._blocks)])
        lengths = np.concatenate([none, *(b.ends - b.starts for b in self._blocks)])
        return times, lengths, np.cumsum([0, *(len(b.starts) for b in self._blocks)])
