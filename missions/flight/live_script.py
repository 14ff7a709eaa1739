"""A mission that a running asyncio program flies: `async with Flying(flight, options) as fleet`.

The flight has a thread of its own. It stands still, the vehicles' clock with it, while the program awaits nothing of
the fleet; so the same program gives the same flight, as long as it awaits one thing of the fleet at a time.
"""

import asyncio
import contextlib
import queue
import threading
from collections.abc import Callable, Coroutine, Generator
from concurrent.futures import Future, InvalidStateError
from dataclasses import replace
from types import TracebackType
from typing import Any, NamedTuple, NoReturn, TypeVar

from bridge.mission.mission import Mission, MissionError, Until, Wait
from bridge.mission.phases import Phase
from missions.flight.options import Options, Progress
from missions.flight.run import run
from missions.flight.summary import Summary
from missions.scenario.flights import Flight, ScenarioError
from missions.scenario.script import OUTSIDE, FleetOf, ended_in_order
from missions.scenario.script_runner import ScriptStopped

T = TypeVar("T")


class _Job(NamedTuple):
    """Something to be done between two decisions."""

    job: Callable[[], Any]
    answer: "Future[Any]"


class _Until(NamedTuple):
    """Something that is awaited."""

    until: Until
    answer: "Future[None]"

    @property
    def over(self) -> bool:
        """Whether it has come, or the program waits no longer."""
        return self.answer.cancelled() or self.until()


class _Leave(NamedTuple):
    """The program asks for nothing more; why, where that is an error."""

    why: str | None


class Requests:
    """What a program asks of a flight in another thread, done between two decisions."""

    def __init__(self) -> None:
        self.begun: Future[Mission] = Future()
        self._asked: queue.SimpleQueue[_Job | _Until | _Leave] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._over: str | None = None
        self._waiting: list[_Until] = []

    # -- the program's side --------------------------------------------------------------------------------------------

    def call(self, job: Callable[[], T]) -> T:
        """Have the flight do `job`; what it returns. Raises what it raises; MissionError once the flight is over."""
        answer: Future[T] = Future()
        self._ask(_Job(job, answer))
        return answer.result()

    def wait(self, until: Until) -> "Future[None]":
        """Let the flight go on until something holds."""
        answer: Future[None] = Future()
        self._ask(_Until(until, answer))
        return answer

    def leave(self, why: str | None = None) -> None:
        """Ask for nothing more; with a reason, the flight comes to the ground from where it is."""
        self._asked.put(_Leave(why))

    def _ask(self, item: _Job | _Until) -> None:
        with self._lock:
            if self._over is not None:
                raise MissionError(f"the flight is over: {self._over}")
            self._asked.put(item)

    # -- the flight's side ---------------------------------------------------------------------------------------------

    def script(self, mission: Mission) -> Coroutine[Any, Any, None]:
        """What the mission runs."""
        return self._run(mission)

    def end(self, why: str) -> None:
        """Nothing is done any more; whoever waits hears why."""
        with self._lock:
            if self._over is not None:
                return
            self._over = why
        error = MissionError(f"the flight is over: {why}")
        left: list[_Until | _Job] = [*self._waiting]
        self._waiting = []
        while True:
            try:
                item = self._asked.get_nowait()
            except queue.Empty:
                break
            if not isinstance(item, _Leave):
                left.append(item)
        for waiting in left:
            with contextlib.suppress(InvalidStateError):
                waiting.answer.set_exception(error)
        if not self.begun.done():
            self.begun.set_exception(MissionError(why))

    async def _run(self, mission: Mission) -> None:
        if not self.begun.done():
            self.begun.set_result(mission)
        try:
            while (left := self._serve()) is None:
                await Wait(self._turns_up)
            if left.why is not None:
                raise MissionError(left.why)
            await ended_in_order(mission, "the program left its flight")
        finally:
            self.end(mission.failure or "it goes on without the program")

    def _serve(self) -> _Leave | None:
        """Do what is asked, until something is awaited; the last word, once it is said."""
        for awaited in [a for a in self._waiting if a.over]:
            self._waiting.remove(awaited)
            with contextlib.suppress(InvalidStateError):  # the program waits no longer
                awaited.answer.set_result(None)
        while True:
            try:
                item = self._asked.get(block=not self._waiting)
            except queue.Empty:
                return None
            if isinstance(item, _Leave):
                return item
            if isinstance(item, _Until):
                self._waiting.append(item)
                continue
            try:
                item.answer.set_result(item.job())
            except Exception as error:
                item.answer.set_exception(error)

    def _turns_up(self) -> bool:
        return not self._asked.empty() or any(a.over for a in self._waiting)


class _Awaited(Wait):
    """What a program awaits in its own event loop."""

    def __init__(self, until: Until, requests: Requests) -> None:
        super().__init__(until)
        self._requests = requests

    def __await__(self) -> Generator[Any, None, None]:
        return (yield from asyncio.wrap_future(self._requests.wait(self.until)).__await__())


class LiveFleet(FleetOf):
    """The fleet and its load, as a program sees and commands them: all that a mission script has.

    `summary` is what came of the flight, once the `async with` is left.
    """

    def __init__(self, mission: Mission, requests: Requests) -> None:
        super().__init__(mission, requests)
        self._requests = requests
        self.summary: Summary | None = None

    def abort(self, why: str = "the program gave up") -> NoReturn:
        """Come to the ground from here, in order; the `async with` is left."""
        self._requests.leave(str(why))
        raise ScriptStopped

    def _begin(self, phase: Phase, to: list[float] | None = None) -> Wait:
        return self._awaited(super()._begin(phase, to))

    def _for(self, what: Callable[[float], Wait], seconds: float) -> Wait:
        return self._awaited(super()._for(what, seconds))

    def _awaited(self, wait: Wait) -> Wait:
        return _Awaited(wait.until, self._requests)


class Flying:
    """A flight that goes on while an `async with` lasts."""

    def __init__(self, flight: Flight, options: Options, progress: Progress) -> None:
        """Raises ScenarioError where the scenario has no [mission]."""
        if flight.scenario.mission is None:
            raise ScenarioError(
                f"{flight.scenario.name}: no [mission] in it; fly ground-to-ground, or one with that table"
            )
        self._requests = Requests()
        self._flight = flight._replace(script=OUTSIDE)
        self._options, self._progress = replace(options, script=self._requests.script), progress
        self._ended: Future[Summary] = Future()
        self._fleet: LiveFleet | None = None

    async def __aenter__(self) -> LiveFleet:
        """Its fleet, standing (or held) as the scenario begins. Raises MissionError where no flight came about."""
        threading.Thread(target=self._fly, name="flight", daemon=True).start()
        try:
            mission = await asyncio.wrap_future(self._requests.begun)
        except BaseException:
            self._requests.leave("interrupted")
            raise
        self._fleet = LiveFleet(mission, self._requests)
        return self._fleet

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        """Come to the ground if it flies, and close the log."""
        gave_up = isinstance(error, ScriptStopped)
        if not gave_up:
            self._requests.leave(None if error is None else f"{type(error).__name__}: {error}".splitlines()[0])
        summary = await asyncio.shield(asyncio.wrap_future(self._ended))
        assert self._fleet is not None
        self._fleet.summary = summary
        return gave_up

    def _fly(self) -> None:
        try:
            summary = run(self._flight, self._options, self._progress)[0]
        except BaseException as error:
            self._requests.end(str(error))
            self._ended.set_exception(error)
            return
        self._requests.end(summary.reason)
        self._ended.set_result(summary)
