"""Which sockets have something to read: epoll where the system has it, select() elsewhere."""

import select
import socket
from typing import Any

LONG_S = 0.02  # epoll counts milliseconds, which is too coarse for shorter waits; select() on it does not


class _Select:
    """What epoll does, by select()."""

    def __init__(self) -> None:
        self._numbers: list[int] = []

    def register(self, number: int, _: int) -> None:
        self._numbers.append(number)

    def unregister(self, number: int) -> None:
        self._numbers.remove(number)

    def poll(self, timeout: float, _: int) -> list[tuple[int, int]]:
        ready = select.select(self._numbers, (), (), timeout)[0]
        return [(number, 0) for number in ready]

    def close(self) -> None:
        self._numbers.clear()


_EPOLL: Any = getattr(select, "epoll", None)
_READ = getattr(select, "EPOLLIN", 0)


class Poller:
    """Sockets that are waited on together, each with the index of the port that it belongs to."""

    def __init__(self) -> None:
        self._poll: Any = (_EPOLL or _Select)()
        self._watched: dict[int, tuple[int, socket.socket]] = {}

    def add(self, new: socket.socket, index: int) -> None:
        """Wait on `new` as well."""
        self._poll.register(new.fileno(), _READ)
        self._watched[new.fileno()] = (index, new)

    def drop(self, old: socket.socket) -> None:
        """No longer wait on `old`, which is still open."""
        self._poll.unregister(old.fileno())
        del self._watched[old.fileno()]

    def ready(self, timeout: float) -> list[tuple[int, socket.socket]]:
        """Ports and sockets that have something, waiting up to `timeout` s for the first."""
        if _EPOLL is not None and 0.0 < timeout < LONG_S:
            select.select((self._poll,), (), (), timeout)
            timeout = 0.0
        watched = self._watched
        return [watched[number] for number, _ in self._poll.poll(timeout, len(watched) or 1)]

    def close(self) -> None:
        """Wait on nothing any more."""
        self._poll.close()
