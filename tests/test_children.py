"""Ctrl-C before anything flies: while processes start, and while libraries load."""

import os
import signal
import subprocess
import sys
import threading
import time
from typing import Any, cast

import psutil
import pytest

from missions.cli import main as cli
from missions.cli.exits import INTERRUPTED
from missions.flight.processes.child_process import begin

COMPILES = """
import signal, time
signal.raise_signal(signal.SIGINT)
time.sleep(0.1)
loaded.append("whole")
"""


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


@pytest.mark.parametrize("becomes", [KeyboardInterrupt, RuntimeError])
def test_an_interrupt_is_one_whatever_a_library_makes_of_it(
    becomes: type[BaseException], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def load() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            raise becomes("while it loads") from error

    monkeypatch.setattr(cli, "app", load)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == INTERRUPTED
    assert capsys.readouterr().err == "cablequad: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_waits_until_compiled_code_is_loaded(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """C calls Python meanwhile: an exception there was lost, or ended the process with a segmentation fault."""
    loaded: list[str] = []

    def load() -> None:
        exec(COMPILES, {"__name__": "numba.core.dispatcher", "loaded": loaded})
        time.sleep(10.0)
        loaded.append("never interrupted")

    monkeypatch.setattr(cli, "app", load)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == INTERRUPTED
    assert loaded == ["whole"]
    assert capsys.readouterr().err == "cablequad: interrupted\n"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_interrupt_does_not_wait() -> None:
    code = f"""
from missions.cli import main as cli
def load():
    exec({COMPILES + COMPILES!r}, {{"__name__": "llvmlite.binding", "loaded": []}})
    print("compiled", flush=True)
cli.app = load
cli.main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (INTERRUPTED, "", "cablequad: interrupted\n")


def test_who_works_for_a_process_ends_with_it_however_it_ends() -> None:
    """An interrupted preflight left a process behind."""
    code = "import time; from missions.analysis.batch import spread; spread(time.sleep, [600.0, 600.0], 2)"
    parent = psutil.Process(subprocess.Popen([sys.executable, "-c", code]).pid)
    end = time.monotonic() + 60
    while len(working := [p for p in parent.children() if "--multiprocessing-fork" in p.cmdline()]) < 2:
        assert time.monotonic() < end
        time.sleep(0.1)
    for p in working:
        while p.num_threads() < 2:  # it has begun its work
            assert time.monotonic() < end
            time.sleep(0.1)
    parent.kill()
    _, left = psutil.wait_procs(working, timeout=30)
    assert not left


@pytest.mark.parametrize("after_s", [0.5, 1.2, 2.0, 4.0])
def test_ctrl_c_ends_who_works_for_a_command_at_once_and_without_a_word(after_s: float) -> None:
    """A first start compiled on for minutes."""
    code = """
import time
from missions.analysis.batch import spread
from missions.cli import main as cli
print("begun", flush=True)
cli.app = lambda: spread(time.sleep, [600.0, 600.0], 2)
cli.main()
"""
    command = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert command.stdout is not None
    command.stdout.readline()
    time.sleep(after_s)
    working = psutil.Process(command.pid).children(recursive=True)
    os.killpg(command.pid, signal.SIGINT)
    _, err = command.communicate(timeout=30)
    assert (command.returncode, err) == (INTERRUPTED, "cablequad: interrupted\n")
    _, left = psutil.wait_procs(working, timeout=30)
    assert not left


def test_what_fails_by_itself_is_no_interrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise RuntimeError("of its own")

    monkeypatch.setattr(cli, "app", fail)
    with pytest.raises(RuntimeError, match="of its own"):
        cli.main()
