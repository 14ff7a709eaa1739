"""How other processes begin."""

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, wait
from multiprocessing import connection, resource_tracker
from multiprocessing.process import BaseProcess

from cablequad._threads import children_with_one_thread

FROM_TERMINAL = frozenset({signal.SIGINT, signal.SIGHUP})  # sent to all processes of a terminal


def leave_to_parent() -> None:
    """In a child: what a terminal sends to all is the parent's to act on, which decides when a flight ends."""
    for number in FROM_TERMINAL:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def without_main() -> Iterator[None]:
    """Processes that start meanwhile do not run the program of the user again, as they do to find what it defines.

    A script that flies, without `if __name__ == "__main__"`, would fly in each of them.
    """
    main = sys.modules["__main__"]
    kept = {name: vars(main)[name] for name in ("__file__", "__spec__") if name in vars(main)}
    try:
        for name in kept:
            setattr(main, name, None)
        yield
    finally:
        for name, value in kept.items():
            setattr(main, name, value)


@contextlib.contextmanager
def worker_pool(count: int) -> Iterator[ProcessPoolExecutor]:
    """Processes for independent work, which end with this one, however it ends, and where an error leaves the block."""
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    with children_with_one_thread(), without_main(), ProcessPoolExecutor(count, context, initializer=_work) as pool:
        with _interrupts_later():
            begun = [pool.submit(int) for _ in range(count)]  # each starts a process, as none is idle yet
        workers = set(multiprocessing.active_children()) - others
        try:
            wait(begun)
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.kill()
            raise


def _work() -> None:
    leave_to_parent()
    end_with_parent()


def end_with_parent() -> None:
    """In a child: end at once where the parent has ended; it has nobody to tell what it finds."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow, name="follows its parent", daemon=True).start()


def begin(process: BaseProcess) -> None:
    """Start `process` with what a terminal sends to all blocked: it is this process's to decide what ends.

    It comes with the interrupt blocked, as it cannot ignore one before its own code runs, and that takes a second to
    load. What interrupts us meanwhile does so once it is told all that it needs.
    """
    with _interrupts_later(), without_main(), children_with_one_thread():
        process.start()


@contextlib.contextmanager
def _interrupts_later() -> Iterator[None]:
    """Meanwhile what a terminal sends to all is blocked, here and for good in what starts; then it comes."""
    resource_tracker.ensure_running()  # it lets interrupts through again when it starts
    came: list[int] = []
    try:  # a library's thread may take what is blocked in this one
        handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    except ValueError:  # not in the main thread: whoever runs us handles signals
        handler = None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, FROM_TERMINAL)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
    if came:
        signal.raise_signal(signal.SIGINT)
