"""Turns of a mission's script: asked for what it wants next as soon as what it waited for has come."""

from collections.abc import Callable, Coroutine, Generator
from typing import Any

Until = Callable[[], bool]


class MissionError(Exception):
    """Something that a script may not ask for now."""


class Wait:
    """What a script awaits."""

    def __init__(self, until: Until) -> None:
        self.until = until

    def __await__(self) -> Generator[Until, None, None]:
        yield self.until


class ScriptTurns:
    """The script that is asked, and what it waits for."""

    def __init__(self, script: Coroutine[Any, Any, None]) -> None:
        self._script = script
        self._until: Until | None = None
        self._asked: Coroutine[Any, Any, None] | None = None  # the last one
        self._running = False  # it is being asked

    def replace(self, script: Coroutine[Any, Any, None]) -> None:
        """From now on another one is asked."""
        before, self._script, self._until = self._script, script, None
        if not (self._running and before is self._asked):  # a script that gives up by itself ends by itself
            before.close()

    def close(self) -> None:
        """Ask no script any more."""
        self._script.close()

    @property
    def replaced(self) -> bool:
        """Whether another one has taken the place of the one that was asked last."""
        return self._asked is not self._script

    @property
    def ready(self) -> bool:
        """Whether what it waited for has come."""
        return self._until is None or self._until()

    def ask(self) -> bool:
        """Let it go on to what it awaits next; whether it is over. Raises MissionError as the script does."""
        script = self._asked = self._script
        self._running = True
        try:
            until = script.send(None)
        except StopIteration:
            return not self.replaced
        finally:
            self._running = False
        if self.replaced:
            script.close()  # it gave up, and something else goes on
        else:
            self._until = until
        return False
