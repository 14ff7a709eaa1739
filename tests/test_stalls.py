"""A computer that stands still decides nothing: in lockstep a stall of any process changes no flight and no log."""

import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from conftest import Command, cablequad, flown, next_offset
from strangers import COMPARED
from test_autopilots import BACKEND, Fleet

from bridge.wire.ports import Address, DatagramPort
from logs.reading.records import entries
from missions.flight.run import Options, Progress, run
from missions.scenario import loading as scenarios

pytestmark = pytest.mark.alone

STALL_S = 8.0  # longer than every wall-clock limit of a flight that is not in lockstep


def children(pid: int) -> list[int]:
    """The processes that a flight has started, but for Python's own tracker of resources."""
    out = []
    for entry in Path("/proc").iterdir():
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            command = (entry / "cmdline").read_text()
        except (OSError, ValueError, IndexError):
            continue
        if parent == pid and "resource_tracker" not in command:
            out.append(int(entry.name))
    return sorted(out)


def in_flight(tmp_path: Path, flying: Command) -> list[int]:
    """Wait until a flight writes its log; its processes."""
    until = time.monotonic() + 120
    while time.monotonic() < until:
        parts = list(tmp_path.glob("*.part"))
        if parts and parts[0].stat().st_size > 200_000:
            return children(flying.process.pid)
        time.sleep(0.05)
    raise AssertionError("no log is written")


def told(log: Path) -> dict[str, list[tuple[int, bytes]]]:
    """What a log says, by topic; how topics lie between each other in the file is the recording's affair."""
    out: dict[str, list[tuple[int, bytes]]] = {}
    for e in entries(log):
        if e.topic in COMPARED or "/mavlink/" in e.topic:
            out.setdefault(e.topic, []).append((e.log_time, e.data))
    return out


ARGUMENTS = ("paper-case-1", "--duration", "14", "--no-replay")


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[int, bytes]]]:
    """The same flight on a computer that does not stand still."""
    s = flown(*ARGUMENTS, "--out", str(tmp_path_factory.mktemp("quiet")), "--port-offset", str(next_offset()))
    return told(Path(s["log"]))


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds processes by /proc")
@pytest.mark.parametrize("which", [0, 1, None], ids=["first child", "second child", "the controller"])
def test_a_process_that_stands_still_for_eight_seconds_changes_nothing(
    which: int | None, tmp_path: Path, quiet: dict[str, list[tuple[int, bytes]]]
) -> None:
    folder = tmp_path / "stalled"
    flying = Command("fly", "--json", *ARGUMENTS, "--out", str(folder), "--port-offset", str(next_offset()))
    own = in_flight(folder, flying)
    assert len(own) == 2
    stopped = flying.process.pid if which is None else own[which]
    os.kill(stopped, signal.SIGSTOP)
    time.sleep(STALL_S)
    os.kill(stopped, signal.SIGCONT)
    code, out, err = flying.wait()
    assert code == 0, out + err
    ours = told(next(folder.glob("*.mcap")))
    assert set(ours) == set(quiet)
    assert [topic for topic in ours if ours[topic] != quiet[topic]] == []


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds processes by /proc")
@pytest.mark.parametrize(("scenario", "kinds"), [("one-vehicle", "a"), ("two-vehicles", "pp")])
def test_whoever_stands_still_the_physics_behind_autopilots_waits_for_all(
    scenario: str, kinds: str, tmp_path: Path
) -> None:
    """The controller, the physics, the log and the autopilots, a second each and again, at 250 decisions a second."""
    offset = next_offset()
    with Fleet(kinds, offset) as autopilots:
        flying = Command(
            "fly", scenario, "--json", "--backend", BACKEND[kinds[0]], "--firmware", "auto", "--speed", "max",
            "--no-replay", "--out", str(tmp_path), "--port-offset", str(offset),
        )  # fmt: skip
        own = in_flight(tmp_path, flying)
        for pid in [flying.process.pid, *own, *(a.pid for a in autopilots.processes)] * 2:
            if flying.process.poll() is None:
                os.kill(pid, signal.SIGSTOP)
                time.sleep(1.0)
                os.kill(pid, signal.SIGCONT)
                time.sleep(0.2)
        code, out, err = flying.wait()
    s = json.loads(out)
    assert s["state_age_ms"] < 5.0, err
    assert code in (0, 1), err
    assert s["final_position_error_m"] < 0.01, s["reason"]  # 0.1 m and more where a second of flight goes undecided


def test_a_simulator_that_never_goes_on_ends_a_flight_untested(tmp_path: Path) -> None:
    flying = Command(
        "fly", "paper-case-1", "--duration", "60", "--no-replay", "--stall-timeout", "4", "--out", str(tmp_path),
        "--port-offset", str(next_offset()),
    )  # fmt: skip
    own = in_flight(tmp_path, flying)
    stopped = max(own, key=lambda pid: sum(map(int, Path(f"/proc/{pid}/stat").read_text().split()[13:15])))
    os.kill(stopped, signal.SIGSTOP)
    code, out, err = flying.wait(60)
    assert code == 3, out + err
    assert "not tested: the simulator stands still at t = " in err
    assert "stall: nothing from the simulator" in err
    assert "NOT TESTED" in out or out == ""  # no table where nothing was flown yet


def test_a_port_in_use_is_no_verdict_on_the_flight(tmp_path: Path, offset: int) -> None:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 14581 + offset))
        code, _, err = cablequad("fly", "--no-replay", "--out", str(tmp_path), "--port-offset", str(offset))
        inside = flown("--no-replay", "--out", str(tmp_path), "--port-offset", str(offset))
    assert inside["passed"]  # as every flight of preflight, which needs no ports
    assert code == 3
    assert f"127.0.0.1:{14581 + offset}" in err
    assert "Traceback" not in err


def test_a_lockstep_whose_datagrams_are_lost_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system may drop a datagram also on this machine; a loss that [faults] asks for is another thing."""
    sends, receives = DatagramPort.send, DatagramPort.receive
    count = {"sent": 0, "received": 0}

    def send(self: DatagramPort, data: bytes, address: Address) -> bool:
        count["sent"] += 1
        return count["sent"] % 997 == 0 or sends(self, data, address)

    def receive(self: DatagramPort, ready: Any) -> list[tuple[Address, bytes]]:
        count["received"] += 1
        came = receives(self, ready)
        return [] if count["received"] % 1499 == 0 else came

    monkeypatch.setattr(DatagramPort, "send", send)
    monkeypatch.setattr(DatagramPort, "receive", receive)
    flight = scenarios.load("paper-case-1", duration_s=6.0)
    summary, _ = run(flight, Options(out=tmp_path, port_offset=next_offset()), Progress())
    assert count["sent"] > 5 * 997
    assert count["received"] > 4 * 1499
    assert summary.passed, summary.reason
    assert (
        summary.messages_late <= 4 * count["received"] // 1499
    )  # a tick of which a vehicle's word is lost is left out
