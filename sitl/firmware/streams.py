"""Which messages a link gets and how often: SET_MESSAGE_INTERVAL over a persona's defaults."""

from collections.abc import Mapping
from heapq import heapify, heapreplace

DENIED_INTERVAL = -2


class Streams:
    """The streams of one link, on the vehicle's clock."""

    def __init__(self, defaults_hz: Mapping[int, float], tick_us: int) -> None:
        self._defaults = {msgid: round(1e6 / hz) for msgid, hz in defaults_hz.items()}
        self._tick_us = tick_us
        self.phase_us = 0  # of all streams: a firmware's clock does not begin with a controller's ticks
        self._interval = dict(self._defaults)
        self._next = dict.fromkeys(self._interval, 0)
        self._queue: list[tuple[int, int]] = []  # (when, message id) of every stream, as a heap
        self._line_up()

    def set_interval(self, msgid: int, interval_us: float) -> None:
        """MAV_CMD_SET_MESSAGE_INTERVAL: us between messages; 0 the default, -1 stops. No faster than the tick."""
        wanted = self._defaults.get(msgid, -1) if interval_us == 0 else round(interval_us)
        if wanted < 0:
            self._interval.pop(msgid, None)
            self._next.pop(msgid, None)
        else:
            self._interval[msgid] = max(wanted, self._tick_us)
            self._next[msgid] = 0
        self._line_up()

    def interval_us(self, msgid: int) -> int:
        """us between messages, -1 if stopped."""
        return self._interval.get(msgid, -1)

    def is_due(self, msgid: int, now_us: int) -> bool:
        """Whether this message will be due at `now_us`."""
        return self._next.get(msgid, now_us + 1) <= now_us

    def due(self, now_us: int) -> list[int]:
        """Message ids to send at this tick, in the order of their ids; streams of one rate keep the same time."""
        out, queue = [], self._queue
        while queue and queue[0][0] <= now_us:
            msgid = queue[0][1]
            interval = self._interval[msgid]
            phase = self.phase_us % interval
            at = self._next[msgid] = interval * ((now_us - phase) // interval + 1) + phase
            heapreplace(queue, (at, msgid))
            out.append(msgid)
        out.sort()
        return out

    def _line_up(self) -> None:
        self._queue = [(at, msgid) for msgid, at in self._next.items()]
        heapify(self._queue)
