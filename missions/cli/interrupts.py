"""Ctrl-C, SIGTERM and a terminal that closes, while a command works: KeyboardInterrupt, where that does no harm.

While numba compiles or loads code, C calls Python; an exception there is lost, or crashes the process. An interrupt
waits until that is over; a second one ends the process at once.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

from missions.cli.exits import INTERRUPTED

ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
AGAIN_S = 0.02
COMPILERS = ("numba", "llvmlite")


def say_interrupted() -> None:
    """The one line that an interrupted command ends with."""
    print("cablequad: interrupted", file=sys.stderr, flush=True)


@contextlib.contextmanager
def interruptible() -> Iterator[list[int]]:
    """While inside, what ends a command raises KeyboardInterrupt; yields what came so far."""
    came: list[int] = []
    waiting = _Waiting()

    def interrupt(number: int, frame: FrameType | None) -> None:
        if not _compiling(frame):
            came.append(number)
            raise KeyboardInterrupt
        if waiting.for_another():
            say_interrupted()
            os._exit(INTERRUPTED)
        waiting.send_again(number)

    before = {number: signal.getsignal(number) for number in ENDING}
    for number, usual in before.items():
        if usual in (signal.default_int_handler, signal.SIG_DFL):  # whoever starts us may have us ignore it
            signal.signal(number, interrupt)
    try:
        yield came
    finally:
        waiting.end()
        for number, usual in before.items():
            signal.signal(number, usual)


class _Waiting:
    """A signal that is sent again until it finds nothing compiling."""

    def __init__(self) -> None:
        self._main = threading.main_thread().ident or 0
        self._timer: threading.Timer | None = None
        self._sent = False

    def for_another(self) -> bool:
        """Whether a signal waits, and the one that came is not that one."""
        was, self._sent = self._sent, False
        return self._timer is not None and not was

    def send_again(self, number: int) -> None:
        self._timer = threading.Timer(AGAIN_S, self._send, (number,))
        self._timer.daemon = True
        self._timer.start()

    def end(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _send(self, number: int) -> None:
        self._sent = True
        signal.pthread_kill(self._main, number)


def _compiling(frame: FrameType | None) -> bool:
    """Whether what runs in this frame was called to compile or to load compiled code."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0] in COMPILERS:
            return True
        frame = frame.f_back
    return False
