"""How a flight's other processes begin."""

import signal
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess


def begin(process: BaseProcess) -> None:
    """Start `process` deaf to Ctrl-C, which a terminal sends to all: it is this process's to decide what ends.

    It comes with the interrupt blocked, as it cannot ignore one before its own code runs, and that takes a second to
    load. What interrupts us meanwhile does so once it is told all that it needs.
    """
    resource_tracker.ensure_running()  # it lets interrupts through again when it starts
    came: list[int] = []
    try:  # a library's thread may take what is blocked in this one
        handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    except ValueError:  # not in the main thread: whoever runs us handles signals
        handler = None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
    if came:
        signal.raise_signal(signal.SIGINT)
