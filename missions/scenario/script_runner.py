"""Runs a mission script in a thread of its own, so that nothing it does can keep the flight from going on.

The script's thread runs only while the control loop waits for it (or, where the vehicles' clock does not wait, beside
it), and everything that it asks of the fleet is done by the control loop, between two decisions. A script that computes
or blocks without awaiting anything is given up after a bounded time of its own: processor time, and time in which this
process runs; a computer that stands still is nobody's fault.
"""

import ctypes
import queue
import sys
import threading
import time
from collections.abc import Callable, Coroutine, Generator
from functools import partial
from types import FrameType
from typing import Any, NamedTuple, TypeVar

from bridge.mission.mission import MissionError, Until

COMPUTES_S = 2.0  # of processor time, that a script may take without awaiting anything
BLOCKS_S = 10.0  # that it may stand still, in looks that are this far apart:
LOOK_S = 0.05
STOPS = 5  # exceptions that a runaway is sent

T = TypeVar("T")


class ScriptStopped(BaseException):
    """Ends a script from outside; no script's `except Exception` takes it."""


class _Call(NamedTuple):
    """Something that the script asks of the fleet."""

    job: Callable[[], Any]


class _Awaits(NamedTuple):
    until: Until


class _Ended(NamedTuple):
    error: BaseException | None


class Ended(NamedTuple):
    """How a script ended: what it raised, if anything, and the line that it came to last."""

    error: BaseException | None
    line: int | None
    stuck: str = ""  # why it was given up


class ScriptRunner:
    """One script; `resume` it until it has ended."""

    def __init__(
        self, main: Callable[[Any], Coroutine[Any, Any, Any]], name: str, waits: bool, clock: Callable[[], float]
    ) -> None:
        """`name` is the script's file name; `waits`: the vehicles' `clock` (s) stands still while the script runs."""
        self._main, self._name, self._waits, self._clock = main, name, waits, clock
        self._to_loop: queue.SimpleQueue[_Call | _Awaits | _Ended] = queue.SimpleQueue()
        self._to_script: queue.SimpleQueue[tuple[bool, Any]] = queue.SimpleQueue()
        self._stopped = False
        self._frame: FrameType | None = None  # of main, also once it has ended
        self._thread: threading.Thread | None = None

    # -- the script's side ---------------------------------------------------------------------------------------------

    def call(self, job: Callable[[], T]) -> T:
        """Have the control loop do `job`; what it returns, or raises."""
        if threading.current_thread() is not self._thread:
            raise MissionError("the fleet may be asked by the thread of main(fleet) alone")
        if self._stopped:
            raise ScriptStopped
        self._to_loop.put(_Call(job))
        good, value = self._to_script.get()
        if not good:
            raise value
        out: T = value
        return out

    def _work(self, fleet: Any) -> None:
        error: BaseException | None = None
        try:
            self._await_all(self._main(fleet))
        except BaseException as raised:
            error = raised
        self._to_loop.put(_Ended(error))

    def _await_all(self, script: Coroutine[Any, Any, Any]) -> None:
        self._frame = getattr(script, "cr_frame", None)
        try:
            wish = script.send(None)
            while True:
                if not callable(wish):
                    wish = script.throw(TypeError("only what the fleet gives can be awaited here"))
                    continue
                self._to_loop.put(_Awaits(wish))
                good, value = self._to_script.get()
                wish = script.send(None) if good else script.throw(value)
        except StopIteration:
            return
        finally:
            script.close()

    # -- the control loop's side ---------------------------------------------------------------------------------------

    def run(self, fleet: Any) -> Generator[Until, None, Ended]:
        """What the script awaits, one after the other; how it ended. To be closed where it is to end early."""
        self._thread = threading.Thread(target=self._work, args=(fleet,), name="mission script", daemon=True)
        self._thread.start()
        try:
            while True:
                item = yield from self._next()
                if isinstance(item, Ended):
                    return item
                yield item.until
                self._to_script.put((True, None))
        finally:
            self._stop()

    def _next(self) -> Generator[Until, None, _Awaits | Ended]:
        """Do what the script asks until it awaits something, or has ended."""
        used, still = self._processor_s(), 0.0
        while True:
            now = self._clock()
            try:
                item = self._to_loop.get(timeout=LOOK_S if self._waits else 0.0)
            except queue.Empty:
                if not self._waits:  # the vehicles fly on; at the next decision it is looked again
                    yield partial(self._later_than, now)
                still += LOOK_S if self._waits else self._clock() - now
                if stuck := self._stuck(used, still):
                    return Ended(None, self._here(), stuck)
                continue
            if isinstance(item, _Call):
                self._do(item)
                used, still = self._processor_s(), 0.0
            elif isinstance(item, _Ended):
                return Ended(item.error, self._line)
            else:
                return item

    def _do(self, call: _Call) -> None:
        try:
            self._to_script.put((True, call.job()))
        except Exception as error:
            self._to_script.put((False, error))

    def _later_than(self, then: float) -> bool:
        return self._clock() > then

    def _stuck(self, used: float | None, still_s: float) -> str:
        now = self._processor_s()
        if used is not None and now is not None and now - used > COMPUTES_S:
            return f"computes for more than {COMPUTES_S:g} s without awaiting anything"
        if still_s > BLOCKS_S:
            return f"stands still for more than {BLOCKS_S:g} s without awaiting anything (await fleet.wait to wait)"
        return ""

    def _processor_s(self) -> float | None:
        """What the script's thread has used of a processor; None where the system does not tell, or it has ended."""
        thread = self._thread
        clock_of: Callable[[int], int] | None = getattr(time, "pthread_getcpuclockid", None)
        if clock_of is None or thread is None or thread.ident is None or not thread.is_alive():
            return None
        return time.clock_gettime(clock_of(thread.ident))

    def _here(self) -> int | None:
        """The line that the script's thread is at."""
        thread = self._thread
        frame = None if thread is None else sys._current_frames().get(thread.ident or 0)
        return _line_in(frame, self._name) or self._line

    @property
    def _line(self) -> int | None:
        """The line of main that was executed last."""
        return None if self._frame is None else self._frame.f_lineno

    def _stop(self) -> None:
        """End the script where it is; one that does not let itself be ended is left behind."""
        thread = self._thread
        self._stopped = True
        self._to_script.put((False, ScriptStopped()))
        if thread is None:
            return
        for _ in range(STOPS):
            before = self._processor_s()
            thread.join(LOOK_S)
            now = self._processor_s()
            if before is None or now is None or now - before < 0.2 * LOOK_S:
                return  # it has ended, or is blocked: an exception that waits for it would slow all other threads
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(thread.ident or 0), ctypes.py_object(ScriptStopped)
            )


def _line_in(frame: FrameType | None, name: str) -> int | None:
    """The line of the innermost frame that is the script's."""
    while frame is not None:
        if frame.f_code.co_filename == name:
            return frame.f_lineno
        frame = frame.f_back
    return None
