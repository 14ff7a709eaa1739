"""How a flight's other processes begin."""

import signal
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess


def begin(process: BaseProcess) -> None:
    """Start `process` deaf to Ctrl-C, which a terminal sends to all: it is this process's to decide what ends.

    It comes with the interrupt blocked, as it cannot ignore one before its own code runs, and that takes a second to
    load.
    """
    resource_tracker.ensure_running()  # it lets interrupts through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
