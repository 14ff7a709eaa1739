"""What the joint step needs of an autopilot, whichever protocol it speaks."""

from typing import NamedTuple, Protocol

from cablequad.types import Array


class Own(NamedTuple):
    """The true motion of one vehicle at an instant."""

    time_us: int  # of the physics' clock
    R: Array  # (3, 3) B -> W
    Omega: Array  # (3,) rad/s, B
    x: Array  # (3,) m, W
    v: Array  # (3,) m/s, W
    specific_force: Array  # (3,) m/s^2, B: mean over the last step, the cable's pull included


class PacketCounts:
    """Packets of one autopilot."""

    def __init__(self) -> None:
        self.taken = 0
        self.answered = 0
        self.repeated = 0  # the same frame again, answered again and not stepped again
        self.stale = 0  # frames from before
        self.refused = 0  # that made no sense
        self.unanswered = 0  # states that were followed by the next without an answer


class SeatError(Exception):
    """An autopilot that cannot go on; the message says why."""


class Seat(Protocol):
    """One autopilot's place."""

    who: str  # vehicle 2 (ArduPilot, udp 127.0.0.1:9012)
    tally: PacketCounts
    share: tuple[float, float, float, float]  # of its greatest thrust, that every rotor is asked for

    @property
    def present(self) -> bool:
        """Whether the autopilot has come."""

    @property
    def engaged(self) -> bool:
        """Whether it keeps step with us, so that time may go as fast as both can."""

    @property
    def settled(self) -> bool:
        """Whether it has said what it does with the newest state it was told."""

    def sockets(self) -> list[int]:
        """File descriptors that it may be heard on."""

    def hear(self) -> None:
        """Take what has come. Raises SeatError where it went away or began anew."""

    def nudge(self) -> None:
        """It has left its newest state unanswered for a while: see whether it runs, and get it going again.

        Raises SeatError where it no longer runs.
        """

    def due(self, now_us: int) -> bool:
        """Whether it is to be told the state of this instant."""

    def tell(self, own: Own) -> None:
        """Tell it how it moves."""

    def close(self) -> None:
        """Release the sockets."""
