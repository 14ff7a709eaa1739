"""What a flight controller sends: streams, answers, texts and parameters, in the order of a tick."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from bridge.wire.dialect import mavlink
from bridge.wire.frames import Packed
from bridge.wire.messages import encode, text_frames
from bridge.wire.values import Heartbeat, StatusText, Timesync
from sitl.firmware.parameters import Parameters
from sitl.firmware.streams import Streams
from sitl.firmware.telemetry import BUILD, Snapshot
from sitl.firmware.transitions import CRITICAL

ATTITUDE_QUATERNION = mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
HEARTBEAT_US = 1_000_000
PARAMS_PER_TICK = 4


class Outgoing(NamedTuple):
    """A message for one of the vehicle's links; None means all of them."""

    link: int | None
    message: Packed


class Outbox:
    """What waits to be sent on the links of one vehicle."""

    def __init__(self, streams: list[Streams], parameters: Parameters) -> None:
        """`streams` of each link."""
        self.closing: list[int] = []  # links on which the attitude quaternion ends what is said at this tick
        self.warned = ""  # the last danger that was told, which is told once
        self._streams, self._parameters = streams, parameters
        self._ready: list[Outgoing] = []
        self._asked_for: list[tuple[int | None, int]] = []  # (link, message id) to build from the tick's snapshot
        self._parameter_queue: list[tuple[int, int]] = []  # (link, index)
        self._next_heartbeat_us = 0
        self._texts_said = 0

    def reply(self, link: int | None, value: Any) -> None:
        """Send a value on a link, None for all of them."""
        self._ready.append(Outgoing(link, encode(value)))

    def put(self, link: int, message: Packed) -> None:
        """Send a message on a link."""
        self._ready.append(Outgoing(link, message))

    def text(self, severity: int, text: str) -> None:
        """STATUSTEXT on every link, in chunks where it is long."""
        self._texts_said = self._texts_said % 65535 + 1
        for part in text_frames(StatusText(severity, text), self._texts_said):
            self.reply(None, part)

    def warn(self, text: str) -> None:
        """Say something dangerous once."""
        if text != self.warned:
            self.warned = text
            self.text(CRITICAL, text)

    def ask_for(self, link: int, msgid: int) -> None:
        """Send a message of this kind once, built from the coming snapshot."""
        self._asked_for.append((link, msgid))

    def list_parameters(self, link: int) -> None:
        """Send every parameter, a few a tick; a list that was being sent on this link begins anew."""
        self._parameter_queue = [entry for entry in self._parameter_queue if entry[0] != link]
        self._parameter_queue += [(link, index) for index in range(len(self._parameters))]

    def will_tell(self, msgid: int, now_us: int) -> bool:
        """Whether a message of this kind goes out at this tick, as things stand."""
        for streams in self._streams:
            if streams.is_due(msgid, now_us):
                return True
        return bool(self._asked_for) and any(asked == msgid for _, asked in self._asked_for)

    def take(
        self, s: Snapshot, audible: Sequence[bool], heartbeat: Callable[[int], Heartbeat],
        timesync: Callable[[int], Timesync],
    ) -> list[Outgoing]:  # fmt: skip
        """What to send at this tick, but for the attitude quaternion, which closes it on the links in `closing`.

        Links that are not `audible` (nobody there yet) get no streams. `heartbeat` and `timesync` say what those hold.
        """
        now_us = s.boot_us
        out = self._ready + [Outgoing(link, BUILD[msgid](s)) for link, msgid in self._asked_for]
        self._ready, self._asked_for = [], []
        if now_us >= self._next_heartbeat_us:
            self._next_heartbeat_us += HEARTBEAT_US * (1 + (now_us - self._next_heartbeat_us) // HEARTBEAT_US)
            out.append(Outgoing(None, encode(heartbeat(now_us))))
        if self._parameter_queue:
            for link, index in self._parameter_queue[:PARAMS_PER_TICK]:
                out.append(Outgoing(link, encode(self._parameters.report(index))))
            del self._parameter_queue[:PARAMS_PER_TICK]
        built: dict[int, Packed] = {}
        self.closing = []
        for link, streams in enumerate(self._streams):
            for msgid in streams.due(now_us) if audible[link] else ():
                if msgid == ATTITUDE_QUATERNION:
                    self.closing.append(link)
                elif msgid == mavlink.MAVLINK_MSG_ID_TIMESYNC:
                    out.append(Outgoing(link, encode(timesync(now_us))))
                else:
                    if msgid not in built:
                        built[msgid] = BUILD[msgid](s)
                    out.append(Outgoing(link, built[msgid]))
        return out
