"""Processes that a flight starts."""

import signal
import threading
import time
from typing import Any, cast

import pytest

from missions.children import begin


def test_what_interrupts_the_start_of_a_process_waits_until_it_has_begun() -> None:
    """Also where a thread takes it that does not block it, as a library's may."""
    go = threading.Event()

    def interrupt() -> None:
        go.wait()
        signal.raise_signal(signal.SIGINT)

    class Process:
        begun = False

        def start(self) -> None:
            go.set()
            other.join()
            time.sleep(0.01)
            self.begun = True

    other, process = threading.Thread(target=interrupt), Process()
    other.start()
    with pytest.raises(KeyboardInterrupt):
        begin(cast(Any, process))
    assert process.begun
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
