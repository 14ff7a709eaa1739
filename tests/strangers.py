"""The whole dialect thrown at a flight: `python tests/strangers.py [--minutes M] [--seed S]`.

A flight over sockets in lockstep, recorded, is flown twice: undisturbed, and while strangers send every kind of message
of the dialect and of those that others speak, well-formed and absurd, as another vehicle, as the receiver itself, as
ground stations and gimbals and systems 0 and 255, to every port of vehicles, tracker and controller. What may change
a vehicle is addressed to systems that are not there. Every decision and the whole motion must be the same, bit for bit.
"""

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from dialects import FOREIGN, OURS, absurd

from bridge.wire.frames import frame
from bridge.wire.ports import GROUND_PORT, LISTEN_PORT, TRACKER_PORTS, vehicle_ports
from logs.reading.records import entries

VEHICLES = 4
COMPARED = ("/control/state", "/control/reference", "/plant/state", "/event", "/plant/event")
ASKS = frozenset({"COMMAND_LONG", "COMMAND_INT", "SET_MODE", "PARAM_SET", "SET_ATTITUDE_TARGET", "REQUEST_DATA_STREAM",
                  "SET_POSITION_TARGET_LOCAL_NED", "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ"})  # fmt: skip
NOBODY = 77  # a system that is not there
SENDERS = ((2, 1), (1, 1), (255, 190), (1, 154), (0, 0), (255, 255), (200, 191), (200, 1), (NOBODY, 1))
PER_SECOND = 3000  # of wall clock, frames


def ports(offset: int) -> list[int]:
    """Every UDP port of a flight with four PX4s."""
    own = [port for i in range(VEHICLES) for port in vehicle_ports(i)]
    ground = [18570 + i for i in range(VEHICLES)]
    return [port + offset for port in (*own, *ground, *TRACKER_PORTS, 18540, LISTEN_PORT, GROUND_PORT)]


def fly(scenario: str, seconds: float, out: Path, offset: int, *more: str) -> subprocess.Popen[str]:
    """Start the flight, as the command line does."""
    command = [
        sys.executable, "-m", "missions.cli.main", "fly", scenario, "--json", "--no-replay", "--out", str(out),
        "--port-offset", str(offset), *more,
    ]  # fmt: skip
    if seconds:
        command += ["--duration", f"{seconds:g}"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def hostile(rng: np.random.Generator) -> Iterator[tuple[str, bytes]]:
    """Frames without end, every kind in turn."""
    kinds: list[Any] = [*OURS.values(), *FOREIGN.values()]
    while True:
        for k in rng.permutation(len(kinds)).tolist():
            kind = kinds[k]
            for_whom = NOBODY if kind.msgname in ASKS else int(rng.choice((0, 1, 2, 200, 250, 255, NOBODY)))
            system, component = SENDERS[int(rng.integers(len(SENDERS)))]
            message = absurd(kind, rng, {"target_system": for_whom})
            yield kind.msgname, frame(message, int(rng.integers(256)), system, component)


def throw(done: threading.Event, offset: int, seed: int, sent: Counter[str]) -> None:
    """Send until `done`, at a bounded rate, from one socket that never reads."""
    rng = np.random.default_rng(seed)
    to = ports(offset)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for name, whole in hostile(rng):
            if done.is_set():
                return
            stranger.sendto(whole, ("127.0.0.1", to[int(rng.integers(len(to)))]))
            sent[name] += 1
            if sum(sent.values()) % 30 == 0:
                time.sleep(30 / PER_SECOND)


def told(log: Path) -> dict[str, list[tuple[int, bytes]]]:
    """What a log says of decisions, motion and events."""
    out: dict[str, list[tuple[int, bytes]]] = {}
    for entry in entries(log):
        if entry.topic in COMPARED:
            out.setdefault(entry.topic, []).append((entry.log_time, entry.data))
    return out


def strangers(minutes: float, offset: int, seed: int = 1, scenario: str = "paper-case-1", *more: str) -> dict[str, Any]:
    """Both flights; the figures. Raises AssertionError where they differ."""
    with tempfile.TemporaryDirectory(prefix="strangers-") as folder:
        results, sent, logs = [], Counter[str](), []
        for disturbed in (False, True):
            out = Path(folder) / ("disturbed" if disturbed else "quiet")
            process = fly(scenario, 60 * minutes, out, offset, *more)
            done = threading.Event()
            thread = threading.Thread(target=throw, args=(done, offset, seed, sent), daemon=True)
            if disturbed:
                thread.start()
            printed, err = process.communicate(timeout=1800)
            done.set()
            if disturbed:
                thread.join()
            assert printed, err
            results.append(json.loads(printed))
            logs.append(told(Path(results[-1]["log"])))
        quiet, beset = results
        assert quiet["passed"], quiet["reason"]
        assert beset["passed"], beset["reason"]
        same = ("criteria", "final_position_error_m", "max_psi", "messages_lost", "messages_late", "flown_s")
        for topic in COMPARED:
            ours, theirs = ([r for r in log.get(topic, []) if b"stranger" not in r[1]] for log in logs)
            first = next((k for k, pair in enumerate(zip(ours, theirs, strict=False)) if pair[0] != pair[1]), None)
            where = f"from its row {first} on, {ours[first][0] * 1e-9:.3f} s" if first is not None else "in its length"
            assert theirs == ours, f"{topic} differs from the undisturbed flight's {where} ({logs[1].get('/event')})"
        for key in same:
            assert quiet[key] == beset[key], f"{key}: {quiet[key]} undisturbed, {beset[key]} among strangers"
        kinds = len(OURS) + len(FOREIGN)
        assert len(sent) == kinds, f"{len(sent)} of {kinds} kinds were sent"
        return {
            "frames": sum(sent.values()), "kinds": len(sent), "simulated_s": beset["flown_s"],
            "decisions_compared": len(logs[0]["/control/state"]), "passed": True,
        }  # fmt: skip


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--minutes", type=float, default=10.0, help="of simulated time")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--offset", type=int, default=5200)
    asked = arguments.parse_args()
    print(json.dumps(strangers(asked.minutes, asked.offset, asked.seed)))
