"""How the physics behind autopilots waits for the controller: MAVLink's TIMESYNC after what it is told of each tick."""

import time
from collections.abc import Callable

from bridge.wire.link import Link
from bridge.wire.messages import encode
from bridge.wire.values import Timesync
from sitl import tracker
from sitl.addresses import CONTROLLER
from sitl.settings import Event

LEAD_US = 5000  # of the physics before a controller that deals with every state
ASK_AGAIN_S = 0.5  # wall clock, after which a controller without an answer is told the same state again


class ControllerTime:
    """The payload tracker asks the controller the time, and answers who asks for its own."""

    def __init__(self, link: Link, control_us: int, timeout_s: float, sink: Callable[[Event], None]) -> None:
        """`timeout_s` (wall clock): a controller that answers nothing for so long is not waited for any more."""
        self._link, self._control_us, self._timeout_s, self._sink = link, control_us, timeout_s, sink
        self._asked_us = 0  # of the last state that the controller was told, and asked the time after
        self._answered_us: int | None = None  # of the last such question that it answered; None: nobody does

    def ask(self, now_us: int) -> None:
        """Ask, after all that the controller is told of a tick: who answers has dealt with that."""
        self._asked_us = now_us
        self._put_question()

    def wait(self, now_us: int, stop: Callable[[], bool]) -> None:
        """Until a controller that answers has dealt with what it was told last: a busy computer stalls it too."""
        begun = asked = time.monotonic()
        while self._unanswered(now_us) and not stop():
            now = time.monotonic()
            if now - begun > self._timeout_s:
                self._answered_us = None
                text = f"no answer to TIMESYNC for {self._timeout_s:g} s; it is not waited for any more"
                self._sink(Event(now_us, "answer-missing", "controller", text))
                return
            if now - asked > ASK_AGAIN_S:
                asked = now
                self._put_question()
                self._link.flush()
            self.listen(now_us, ASK_AGAIN_S)

    def listen(self, now_us: int, timeout: float) -> None:
        """Answer who asks for the time; hear the controller answer."""
        for frame in self._link.poll(timeout):
            if not isinstance(frame.value, Timesync):
                continue
            tc1, ts1 = frame.value
            if (frame.system, frame.component) == CONTROLLER and tc1 != 0 and 0 < ts1 <= now_us * 1000:
                self._answered_us = max(self._answered_us or 0, ts1 // 1000)
            elif tc1 == 0:
                answer = encode(Timesync(now_us * 1000, frame.value.ts1))
                self._link.put(frame.port, tracker.SYSTEM, tracker.COMPONENT, answer)
                self._link.flush()

    def _put_question(self) -> None:
        question = encode(Timesync(0, self._asked_us * 1000))
        self._link.put(0, tracker.SYSTEM, tracker.COMPONENT, question)

    def _unanswered(self, now_us: int) -> bool:
        if self._answered_us is None:
            return False
        return self._answered_us + self._control_us <= min(self._asked_us, now_us - LEAD_US)
