"""The stands that hold vehicles in place and let them turn, until every one of them carries itself."""

from collections.abc import Callable

import numpy as np

from cablequad.types import Array
from sitl.plant import Plant
from sitl.settings import Event

CARRIED_S, STEADY = 0.5, 0.04  # what a vehicle gives must be more than its weight, and change by no more, for so long


class Stands:
    """When vehicles are let go, and when a flight's time begins."""

    def __init__(self, weight_N: Array, sink: Callable[[Event], None]) -> None:
        """`weight_N` (n,)."""
        self.released_us: int | None = None
        self._weight, self._sink = weight_N, sink
        self._carries: list[tuple[int, float]] = [(0, 0.0)] * len(weight_N)  # since when a vehicle gives as much, N

    def settle(self, now_us: int, plant: Plant, share: np.ndarray) -> None:
        """Let go of everybody together; on the ground time begins when all motors turn (`share` (n, 4) of each)."""
        if plant.restrained:
            self._release(now_us, plant)
        elif self.released_us is None and (share.sum(axis=1) > 0.0).all():
            self._begin(now_us, "all motors turn, on the ground")

    def _release(self, now_us: int, plant: Plant) -> None:
        up = plant.thrust * plant.attitudes[0][:, 2, 2]
        for i, (_, level) in enumerate(self._carries):
            if up[i] < self._weight[i] or abs(up[i] - level) > STEADY * level:
                self._carries[i] = (now_us, float(up[i]))
        if all(now_us - since >= CARRIED_S * 1e6 for since, _ in self._carries):
            plant.restrained = False
            self._begin(now_us, "every vehicle bears itself: let go")

    def _begin(self, now_us: int, text: str) -> None:
        self.released_us = now_us
        self._sink(Event(now_us, "release", "all", text))
