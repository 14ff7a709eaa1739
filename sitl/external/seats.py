"""The autopilots of a flight: wait until all have come, hear them all, leave out who went away."""

import select
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from sitl.external.seat import Own, Seat, SeatError
from sitl.settings import Event

GRACE_S = 30.0  # of the physics' clock, for those that are left
BOOT_S = 120.0  # wall clock, for autopilots that somebody else starts
PROBE_S = 0.5  # wall clock, between looks whether one that is silent still runs
STALL_SAID_S = 3.0  # wall clock, after which a silence is told
BURST_S = 0.002  # wall clock: that answers of one step are apart, at most, for all to be heard together


class AutopilotError(Exception):
    """An autopilot never came, ended or began anew; the message says which, and since when.

    `untested`: it runs and does not answer, which says nothing of the flight.
    """

    def __init__(self, text: str, untested: bool = False) -> None:
        super().__init__(text)
        self.untested = untested


class External(NamedTuple):
    """Who flies instead of the built-in vehicles."""

    kinds: tuple[str, ...]  # of each vehicle: arducopter or px4
    connect_s: float = BOOT_S  # wall clock, for the last to come
    stall_s: float = 600.0  # wall clock, that one which runs may leave a question unanswered


class Seats:
    """Every autopilot's place, by vehicle."""

    def __init__(self, seats: list[Seat], external: External, sink: Callable[[Event], None]) -> None:
        self._seats, self._external, self._sink = seats, external, sink
        self._gone: dict[int, str] = {}
        self._ends_us: int | None = None

    def __iter__(self) -> Iterator[Seat]:
        return iter(self._seats)

    @property
    def engaged(self) -> bool:
        """Whether all keep step with us."""
        return all(seat.engaged for seat in self._seats)

    @property
    def shares(self) -> list[tuple[float, float, float, float]]:
        """Of its greatest thrust, that every rotor is asked for; nothing of those that are left out."""
        return [seat.share if i not in self._gone else (0.0,) * 4 for i, seat in enumerate(self._seats)]

    def assemble(self, stop: Callable[[], bool]) -> bool:
        """Wait for everyone; whether all have come. Raises AutopilotError where they do not."""
        deadline = time.monotonic() + self._external.connect_s
        told: set[int] = set()
        while not stop():
            for i, seat in enumerate(self._seats):
                try:
                    seat.hear()
                except SeatError as error:
                    raise AutopilotError(f"{seat.who} {error}, before all had come") from None
                if seat.present and i not in told:
                    told.add(i)
                    self._sink(Event(0, "autopilot", f"vehicle {i + 1}", f"{seat.who} has come"))
            if len(told) == len(self._seats):
                return True
            if time.monotonic() > deadline:
                missing = "; ".join(seat.who for seat in self._seats if not seat.present)
                raise AutopilotError(
                    f"{missing}: no autopilot came within {self._external.connect_s:g} s; is it running, and told to "
                    "use this address for its physics?"
                )
            _listen(0.05, self._seats)
        return False

    def gather(self, stop: Callable[[], bool], now_us: int) -> None:
        """Until everybody has said what it does now. Who runs is waited for: a busy machine stalls.

        Raises AutopilotError where that takes too long.
        """
        begun = time.monotonic()
        nudged, said = begun, False
        self._each([seat for seat in self._left(self._seats) if not seat.engaged], now_us, _hear)
        missing = [seat for seat in self._left(self._seats) if not seat.settled]
        while missing and not stop():
            # who was told last answers last, mostly: being woken for every answer would cost more than the step
            _listen(BURST_S, missing[-1:])
            self._each(missing, now_us, _hear)
            missing = [seat for seat in self._left(missing) if not seat.settled]
            now = time.monotonic()
            if missing and now - nudged > PROBE_S:
                nudged = now
                self._each(missing, now_us, _nudge)
            if missing and not said and now - begun > STALL_SAID_S:
                said = True
                for seat in missing:
                    vehicle = f"vehicle {self._seats.index(seat) + 1}"
                    self._sink(Event(now_us, "stall", vehicle, f"{seat.who} does not answer; it is waited for"))
            if missing and now - begun > self._external.stall_s:
                who = ", ".join(seat.who for seat in missing)
                raise AutopilotError(
                    f"not tested: {who} has not answered since t = {now_us * 1e-6:.3f} s, for "
                    f"{self._external.stall_s:g} s; it still runs",
                    untested=True,
                )

    def tell(self, now_us: int, own: Callable[[int], Own]) -> None:
        """`own` of vehicle i to each that waits for it at this instant."""
        for i, seat in enumerate(self._seats):
            if i in self._gone or not seat.due(now_us):
                continue
            try:
                seat.tell(own(i))
            except SeatError as error:
                self._lose(seat, str(error), now_us)

    def end_after_grace(self, now_us: int) -> None:
        """Raises AutopilotError once those that are left have had their time to land."""
        if self._ends_us is not None and now_us >= self._ends_us:
            raise AutopilotError("; ".join(self._gone.values()))

    def close(self) -> None:
        """Release the sockets."""
        for seat in self._seats:
            seat.close()

    def _left(self, seats: list[Seat]) -> list[Seat]:
        return [seat for seat in seats if self._seats.index(seat) not in self._gone] if self._gone else seats

    def _each(self, seats: list[Seat], now_us: int, act: Callable[[Seat], None]) -> None:
        """Do something with each; who cannot go on is left out."""
        for seat in seats:
            try:
                act(seat)
            except SeatError as error:
                self._lose(seat, str(error), now_us)

    def _lose(self, seat: Seat, why: str, now_us: int) -> None:
        i = self._seats.index(seat)
        self._gone[i] = f"{seat.who} {why}"
        self._sink(Event(now_us, "autopilot-lost", f"vehicle {i + 1}", f"{seat.who} {why}; its motors stop"))
        if self._ends_us is None:
            self._ends_us = now_us + round(GRACE_S * 1e6)
        if len(self._gone) == len(self._seats):
            self._ends_us = now_us


def _listen(seconds: float, seats: list[Seat]) -> None:
    select.select([number for seat in seats for number in seat.sockets()], (), (), seconds)


def _hear(seat: Seat) -> None:
    seat.hear()


def _nudge(seat: Seat) -> None:
    seat.nudge()
