"""How the loop keeps time, on the wall clock."""

from array import array
from collections.abc import Sequence
from typing import NamedTuple

from bridge.fleet.thrust import ThrustScale
from bridge.wire.ports import Address


class TickStatistics(NamedTuple):
    """How the loop kept time, on the wall clock."""

    ticks: int
    missed_ticks: int  # states of the vehicles that were never answered
    intervals_s: Sequence[float]  # between the states that were answered, in flight
    flight_s: float  # wall clock from the first state answered in flight to the last
    thrust_scales: list[ThrustScale]  # of each vehicle: newtons made per newton asked
    predicted_ticks: int  # answered with a state that was not all measured
    mean_age_ms: float | None = None  # of the oldest measurement that decisions in flight rested on
    unread: int = 0  # frames that had come in when the flight ended and nobody looked at
    foreign: int = 0  # frames of others than the vehicles and the tracker, or under their ids from elsewhere
    places: frozenset[tuple[int, Address]] = frozenset()  # ports and addresses that vehicles and tracker spoke from


class TickTiming:
    """Ticks that were answered, and when."""

    def __init__(self, period_ms: int) -> None:
        self.ticks = 0
        self._period_ms = period_ms
        self._missed = self._predicted = self._ages_ms = self._aged = 0
        self._intervals = array("f")  # a long flight has millions
        self._started: float | None = None
        self._last: tuple[int, float] | None = None

    def answered(self, boot_ms: int, age_ms: int, arrived: float, flying: bool) -> bool:
        """A state was answered, which came at `arrived` of the wall clock; whether it is time to tell how it goes."""
        if flying:
            self._predicted += age_ms > 0
            self._ages_ms += age_ms
            self._aged += 1
        self.ticks += 1
        if flying and self._started is None:
            self._started = arrived
        elif flying and self._last is not None:
            self._missed += max(0, (boot_ms - self._last[0]) // self._period_ms - 1)
            self._intervals.append(arrived - self._last[1])
        self._last = (boot_ms, arrived)
        return self.ticks % max(1, 1000 // self._period_ms) == 0

    def statistics(self, thrust: list[ThrustScale]) -> TickStatistics:
        """So far."""
        flight = 0.0 if self._started is None or self._last is None else self._last[1] - self._started
        age = self._ages_ms / self._aged if self._aged else None
        return TickStatistics(self.ticks, self._missed, self._intervals, flight, thrust, self._predicted, age)
