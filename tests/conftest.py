"""What the tests share: random systems and states, a place among the ports, the command line."""

import contextlib
import fcntl
import itertools
import json
import os
import signal
import subprocess
import sysconfig
import tempfile
import threading
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  it brings a BLAS of its own
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits

from cablequad._threads import one_thread
from cablequad.model import lie
from cablequad.model.state import State
from cablequad.model.system import Cable, Payload, Quadrotor, System

for ending in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # whoever starts us may ignore them, and so would all
    signal.signal(ending, signal.default_int_handler if ending == signal.SIGINT else signal.SIG_DFL)
threadpool_limits(1, "blas")
one_thread()  # what starts here
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes start here: what one compiles, all may load

settings.register_profile("default", deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
settings.load_profile("default")


def random_system(rng: np.random.Generator, n: int | None = None, links: int = 8) -> System:
    """n = 1..6 vehicles, 1..`links` links a cable, everything unequal."""
    n = int(rng.integers(1, 7)) if n is None else n
    inertia = np.diag(rng.uniform(0.02, 0.03, 3))
    turn = lie.exp(rng.normal(size=3))
    quadrotors = [Quadrotor(rng.uniform(0.4, 1.5), np.diag(rng.uniform(4e-3, 7e-3, 3))) for _ in range(n)]
    cables = []
    for _ in range(n):
        k = int(rng.integers(1, links + 1))
        cables.append(Cable(list(rng.uniform(5e-3, 0.05, k)), list(rng.uniform(0.05, 0.4, k))))
    payload = Payload(rng.uniform(0.3, 2.0), turn @ inertia @ turn.T, rng.uniform(-0.5, 0.5, (n, 3)))
    return System.of(payload, quadrotors, cables)


def random_state(system: System, rng: np.random.Generator, rate: float = 2.0) -> State:
    """Any attitude, any link direction, rates of size `rate` rad/s."""
    n, L = system.length.shape
    q = rng.normal(size=(n, L, 3))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    omega = rate * rng.normal(size=(n, L, 3))
    omega -= np.sum(omega * q, axis=-1, keepdims=True) * q
    for i, k in enumerate(system.n_links):
        q[i, k:], omega[i, k:] = (0.0, 0.0, 1.0), 0.0
    return State(
        rng.normal(size=3), rng.normal(size=3), lie.exp(2 * rng.normal(size=3)), rng.normal(size=3), q, omega,
        np.stack([lie.exp(2 * rng.normal(size=3)) for _ in range(n)]), rng.normal(size=(n, 3)),
    )  # fmt: skip


def irregular() -> System:
    """n = 3, cables of 2, 5 and 7 links, unequal masses and lengths."""
    rng = np.random.default_rng(5)
    cables = [Cable(list(rng.uniform(8e-3, 0.03, k)), list(rng.uniform(0.1, 0.3, k))) for k in (2, 5, 7)]
    quadrotors = [Quadrotor(m, (5e-3, 6e-3, 9e-3)) for m in (0.6, 0.9, 1.3)]
    payload = Payload(0.8, (0.03, 0.02, 0.04), [(0.4, 0.1, -0.1), (-0.3, 0.3, -0.05), (-0.1, -0.4, -0.1)])
    return System.of(payload, quadrotors, cables)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261122)


_given = itertools.count()


def next_offset() -> int:
    """A port offset that no flight of this process has had, well away from everyone's defaults."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    room = int(worker.removeprefix("gw")) if worker else os.getpid()
    return 6000 + room % 8 * 1000 + next(_given) * 7 % 40 * 4


@contextlib.contextmanager
def _shared_computer(alone: bool) -> Iterator[None]:
    """While inside no test is that needs the computer to itself, or no other test at all where this is one.

    Who waits holds the gate, so that nobody else goes in before.
    """
    locks = f"{tempfile.gettempdir()}/cablequad-tests-{os.getuid()}"
    with open(f"{locks}-gate", "w") as gate, open(f"{locks}-room", "w") as room:
        fcntl.flock(gate, fcntl.LOCK_EX)
        fcntl.flock(room, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        fcntl.flock(gate, fcntl.LOCK_UN)
        yield


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    with _shared_computer(item.get_closest_marker("alone") is not None):
        return (yield)


@pytest.fixture
def offset() -> int:
    """A port offset of this test's own."""
    return next_offset()


@pytest.fixture(autouse=True)
def _nothing_left_running() -> Iterator[None]:
    yield
    for command in Command.started:
        if command.process.poll() is None:
            command.process.kill()
            command.process.wait()
    Command.started.clear()


COMMAND = str(Path(sysconfig.get_path("scripts")) / "cablequad")


class Command:
    """The `cablequad` command in a process of its own; killed at the end of the test that started it."""

    started: ClassVar[list["Command"]] = []

    def __init__(self, *arguments: str, cwd: Path | None = None) -> None:
        self.started.append(self)
        self.process = subprocess.Popen(
            [COMMAND, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=cwd,
            start_new_session=True,  # a group of its own, as in a terminal
        )

    def wait(self, timeout: float = 180) -> tuple[int, str, str]:
        """Exit code, stdout, stderr."""
        out, err = self.process.communicate(timeout=timeout)
        return self.process.returncode, out, err

    def interrupt(self) -> None:
        """Ctrl-C, which a terminal sends to all of its processes."""
        self.signal_all(signal.SIGINT)

    def signal_all(self, number: int) -> None:
        """Send a signal to the command and every process that it has started."""
        with contextlib.suppress(ProcessLookupError):  # all have ended
            os.killpg(self.process.pid, number)


def cablequad(*arguments: str) -> tuple[int, str, str]:
    """Run the command to its end: exit code, stdout, stderr."""
    return Command(*arguments).wait()


SOCKETS = frozenset({"--connect", "--backend", "--speed", "--live", "--launch"})  # flights that need them


def flown(*arguments: str, sockets: bool = False) -> dict:
    """`cablequad fly --json ...`: its one object; in one process where no `sockets` are needed."""
    needed = any(argument.partition("=")[0] in SOCKETS for argument in arguments)
    inside = () if sockets or needed else ("--in-process",)
    code, out, err = cablequad("fly", "--json", *inside, *arguments)
    assert out, err
    summary = json.loads(out)
    summary["exit_code"] = code
    return summary


def wait_for_line(command: Command, text: str, timeout: float = 60) -> None:
    """Read stdout until a line holds `text`."""
    assert command.process.stdout is not None
    late = threading.Timer(timeout, command.process.kill)  # ends the reading below
    late.start()
    try:
        for line in iter(command.process.stdout.readline, ""):
            if text in line:
                return
    finally:
        late.cancel()
    raise AssertionError(f"no line with {text!r}; exit code {command.process.poll()}")
