"""Links that fail: delay, jitter, loss alone and in bursts, duplicates, reordering, a narrow line, a cut.

A `Channel` stands between a socket and whoever reads it, on that one's simulated clock and with a generator of its own,
so that a run fails the same way every time. Frames are counted by the lockstep barrier before they come here: a lost
one never stops the clock.
"""

import heapq
from typing import Generic, NamedTuple, TypeVar

import numpy as np

Item = TypeVar("Item")

FOREVER_S = 1e9  # a frame on a line of next to no bytes a second
REORDERED_US = 20_000  # how long a frame that is overtaken waits
QUEUE_US = 500_000  # what a narrow line keeps; more is lost


class Faults(NamedTuple):
    """What one direction of one link does to its frames; shares are probabilities, 0 to 1."""

    delay_us: int = 0
    jitter_us: int = 0  # added to the delay, uniform from 0 on, for each frame by itself
    loss: float = 0.0  # of each frame by itself
    burst_loss: float = 0.0  # share of frames lost in bursts
    burst_frames: float = 10.0  # mean length of a burst
    duplicate: float = 0.0
    reorder: float = 0.0  # share that is overtaken by what comes after
    rate_bytes_s: float = 0.0  # of the line; 0: as much as comes
    cuts_us: tuple[tuple[int, int], ...] = ()  # nothing passes from, to; on the clock since the release

    @property
    def none(self) -> bool:
        """Whether every frame passes at once."""
        return self._replace(burst_frames=10.0) == Faults()


class FaultCounts:
    """What became of the frames: offered + duplicated = passed + lost + waiting."""

    def __init__(self) -> None:
        self.offered = 0
        self.duplicated = 0
        self.passed = 0
        self.lost = 0
        self.waiting = 0


class Channel(Generic[Item]):
    """One direction of one link."""

    def __init__(self, faults: Faults, rng: np.random.Generator) -> None:
        self.faults = faults
        self.tally = FaultCounts()
        self.released_us: int | None = None  # when the clock of `cuts_us` began
        self._rng = rng
        self._heap: list[tuple[int, int, Item]] = []
        self._serial = 0
        self._in_burst = False
        self._line_free_us = 0

    def put(self, item: Item, size: int, now_us: int) -> None:
        """Offer a frame of `size` bytes at `now_us`; `take` gives it when it is due, if it is not lost."""
        f, draw = self.faults, self._rng.random(5)
        self.tally.offered += 1
        if self._lost(draw[0], draw[1], now_us):
            self.tally.lost += 1
            return
        due = now_us + f.delay_us + round(f.jitter_us * draw[2])
        if draw[3] < f.reorder:
            due += REORDERED_US
        if f.rate_bytes_s > 0:
            begins = max(now_us, self._line_free_us)
            if begins - now_us > QUEUE_US:
                self.tally.lost += 1
                return
            self._line_free_us = begins + round(min(size / f.rate_bytes_s, FOREVER_S) * 1e6)
            due += self._line_free_us - now_us
        self._push(due, item)
        if draw[4] < f.duplicate:
            self.tally.duplicated += 1
            self._push(due, item)

    def take(self, now_us: int) -> list[Item]:
        """What is due at `now_us`, in the order of its arrival."""
        out = []
        while self._heap and self._heap[0][0] <= now_us:
            out.append(heapq.heappop(self._heap)[2])
        self.tally.passed += len(out)
        self.tally.waiting = len(self._heap)
        return out

    def _push(self, due_us: int, item: Item) -> None:
        self._serial += 1
        heapq.heappush(self._heap, (due_us, self._serial, item))
        self.tally.waiting = len(self._heap)

    def _lost(self, alone: float, burst: float, now_us: int) -> bool:
        """Each frame by itself, a two-state chain for bursts, and cuts."""
        f = self.faults
        if self.released_us is not None:
            t = now_us - self.released_us
            if any(begin <= t < end for begin, end in f.cuts_us):
                return True
        if f.burst_loss > 0.0:
            ends = 1.0 / max(f.burst_frames, 1.0)
            begins = min(1.0, ends * f.burst_loss / (1.0 - min(f.burst_loss, 0.999)))
            self._in_burst = burst >= ends if self._in_burst else burst < begins
            if self._in_burst:
                return True
        return alone < f.loss


def generator(seed: int, system: int, up: bool) -> np.random.Generator:
    """The generator of one direction of one system's link: the same for a seed, whatever the others draw."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(system, int(up))))
