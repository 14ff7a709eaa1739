"""From where each vehicle and the tracker speak: what comes under their ids from elsewhere is not theirs.

A router or a second ground station may forward or send anything to the controller's ports. A vehicle is taken to be
where its autopilot's HEARTBEAT first came from, the tracker where its first report did, unless that is known before.
"""

from collections.abc import Mapping

from bridge.fleet.fleet import COMPONENT, TRACKER
from bridge.wire.dialect import mavlink
from bridge.wire.link import Address, Received
from bridge.wire.values import CableShape, Heartbeat, PayloadState

RIVAL_BEATS = 3  # HEARTBEATs of their own from a second place: two vehicles have one id
BEATS_KEPT = 16

Place = tuple[int, Address]


class Sources:
    """The one place that each system of the flight speaks from."""

    def __init__(self, vehicles: int, places: Mapping[int, Place]) -> None:
        """`places` (port, address) by system id, where they are known before anybody speaks."""
        self.routes: dict[int, Place] = dict(places)
        self.foreign = 0  # frames of others, and those under these ids from elsewhere
        self.rival: str | None = None  # two vehicles with one id, in words
        self._vehicles = vehicles
        self._given = frozenset(places)
        self._own: dict[int, list[bytes]] = {}  # HEARTBEATs of the place that is known
        self._theirs: dict[int, list[bytes]] = {}  # and of others, that are no copies of those
        self._told: set[int] = set()
        self._said = ""

    def take(self, frame: Received) -> bool:
        """Whether a frame that is not from a known place is to be taken in; it may make its place known."""
        system = frame.system
        if not (1 <= system <= self._vehicles or system == TRACKER):
            self.foreign += 1
            return True  # an operator may speak to us; nothing that it says is a vehicle's word
        known = self.routes.get(system)
        if known is None and self._introduces(frame):
            self.routes[system] = (frame.port, frame.address)
            return True
        self.foreign += 1
        if known is not None:
            if system not in self._given:
                self._compare(frame, known)
            if system not in self._told:
                self._told.add(system)
                there, here = ("{}:{}".format(*address) for address in (frame.address, known[1]))
                self._said = f"frames under its id from {there} are left out: it speaks from {here}"
        return False

    def heard(self, frame: Received) -> None:
        """Take note of a known place's HEARTBEAT, of which copies may come another way."""
        if isinstance(frame.value, Heartbeat):
            self._remember(self._own, frame)
            theirs = self._theirs.get(frame.system)
            if theirs and frame.frame in theirs:
                theirs.remove(frame.frame)

    def said(self) -> str:
        """What is to be told of strangers since the last call."""
        said, self._said = self._said, ""
        return said

    def _introduces(self, frame: Received) -> bool:
        value = frame.value
        if frame.system == TRACKER:
            return frame.component == COMPONENT and isinstance(value, Heartbeat | PayloadState | CableShape)
        autopilot = isinstance(value, Heartbeat) and value.autopilot != mavlink.MAV_AUTOPILOT_INVALID
        return autopilot and frame.component == 1

    def _compare(self, frame: Received, known: Place) -> None:
        if not self._introduces(frame) or frame.system == TRACKER or frame.frame in self._own.get(frame.system, []):
            return
        if len(self._remember(self._theirs, frame)) >= RIVAL_BEATS and self.rival is None:
            here, there = ("{}:{}".format(*address) for address in (known[1], frame.address))
            self.rival = f"two vehicles have system id {frame.system}: {here} and {there}; give each its own"

    def _remember(self, kept: dict[int, list[bytes]], frame: Received) -> list[bytes]:
        beats = kept.setdefault(frame.system, [])
        beats.append(frame.frame)
        del beats[:-BEATS_KEPT]
        return beats
