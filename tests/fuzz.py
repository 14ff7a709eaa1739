"""Hostile frames by the million against running vehicles: `python tests/fuzz.py [--frames N] [--seed S]`.

Everything goes through real UDP sockets into a server of two PX4 and two ArduCopter vehicles, in flight. Frames that
are damaged, foreign, replayed or not signed as they must be may change nothing; frames that are valid and absurd may do
what the firmware does with them, and nothing else: no exception, finite motor commands, a clock that goes on.
"""

import argparse
import json
import math
import resource
import socket
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from dialects import absurd_fields

from bridge.wire.dialect import mavlink
from bridge.wire.frames import Packed, Signer, checksum, frame
from missions.flight.processes.simulate import Serving, settings
from missions.scenario import loading as scenarios
from sitl.server import Server

BATCH = 200  # frames between two ticks; well inside what a socket's buffer holds
KEY = bytes(range(32))
OBEYED = (
    "COMMAND_LONG", "COMMAND_INT", "SET_MODE", "SET_ATTITUDE_TARGET", "PARAM_SET", "PARAM_REQUEST_READ",
    "PARAM_REQUEST_LIST", "REQUEST_DATA_STREAM", "MISSION_REQUEST_LIST", "MISSION_COUNT", "MISSION_CLEAR_ALL",
    "FILE_TRANSFER_PROTOCOL", "TIMESYNC", "PING", "HEARTBEAT", "SET_POSITION_TARGET_LOCAL_NED",
)  # fmt: skip
KINDS = [k for k in mavlink.mavlink_map.values() if k.msgname in OBEYED]
COMMANDS = (22, 20, 21, 17, 176, 192, 400, 410, 510, 511, 512, 520, 31000, 65535)


class Mutator:
    """Makes frames, by kind of hostility."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.seq = 0
        self.old: list[bytes] = []

    def fields(self, kind: Any, system: int | None) -> tuple[Any, ...]:
        """Absurd values of every field, in wire order; `system` is whom it is for."""
        given = {} if system is None else {"target_system": system}
        given["target_component"] = int(self.rng.integers(2))
        given["command"] = int(self.rng.choice(COMMANDS))
        return absurd_fields(kind, self.rng, given)

    def valid(self, system: int | None, signer: Signer | None = None) -> bytes:
        """A frame with a right checksum."""
        kind = KINDS[int(self.rng.integers(len(KINDS)))]
        values = self.fields(kind, system)
        payload = kind.unpacker.pack(*values).rstrip(b"\0") or b"\0"
        self.seq = (self.seq + 1) & 255
        return frame(Packed(kind.id, kind.msgname, kind.crc_extra, payload), self.seq, 255, 190, signer)

    def to(self, low: int, high: int, signer: Signer | None) -> bytes:
        """A valid frame for a system from `low` up to, not including, `high`."""
        return self.valid(int(self.rng.integers(low, high)), signer)

    def one_of(self, frames: list[bytes]) -> bytes:
        """One that was sent before."""
        return frames[int(self.rng.integers(len(frames)))]

    def damaged(self) -> bytes:
        """A frame that no parser may take: cut, flipped, too long, wrongly summed, or noise."""
        rng, whole = self.rng, bytearray(self.valid(int(self.rng.integers(1, 5))))
        while True:
            match int(rng.integers(6)):
                case 0:
                    out = bytes(whole[: int(rng.integers(0, len(whole)))])
                case 1:
                    flipped = bytearray(whole)
                    for _ in range(int(rng.integers(1, 9))):
                        flipped[int(rng.integers(len(flipped)))] ^= 1 << int(rng.integers(8))
                    out = bytes(flipped)
                case 2:
                    out = bytes(whole[:1]) + b"\xff" + bytes(whole[2:]) + bytes(rng.integers(0, 256, 300).tolist())
                case 3:
                    out = bytes(whole[:-2]) + bytes((whole[-2] ^ 0x55, whole[-1]))
                case 4:
                    out = bytes(rng.integers(0, 256, int(rng.integers(0, 1200))).tolist())
                case _:
                    out = b"\xfd" * int(rng.integers(1, 400))
            if not holds_a_frame(out):
                return out


def holds_a_frame(data: bytes) -> bool:
    """Whether a frame with a right checksum starts anywhere: a checksum of 16 bits lets one in 65,536 pass."""
    for at in range(len(data)):
        if data[at] not in (0xFD, 0xFE) or len(data) < at + 8:
            continue
        two = data[at] == 0xFD
        if two and len(data) < at + 12:
            continue
        msgid = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16 if two else data[at + 5]
        tail = at + (10 if two else 6) + data[at + 1]
        kind = mavlink.mavlink_map.get(msgid)
        if kind is None or tail + 2 > len(data):
            continue
        if checksum(data[at + 1 : tail] + bytes((kind.crc_extra,))) == data[tail] | data[tail + 1] << 8:
            return True
    return False


def state(server: Server) -> list:
    """Everything about the vehicles that a message may change."""
    out = []
    for v in server.vehicles:
        values = [v.parameters.report(k) for k in range(len(v.parameters))]
        streams = [dict(s._interval) for s in v.streams]
        out.append((v.mode_name, v.armed, v.failsafe, repr(values), streams, repr(v._target.value), v._ground_heard_us))
    return out


def a_server(offset: int, key: bytes | None) -> Server:
    flight = scenarios.load("mixed-fleet")
    ready = flight.scenario.vehicle.model_copy(update={"estimator_ready_s": 0.0})
    flight = flight._replace(scenario=flight.scenario.model_copy(update={"vehicle": ready}))
    serving = Serving(lockstep=False, port_offset=offset, untethered=True, signing_key=key)
    return Server(settings(flight, serving), lambda _: None)


def in_flight(server: Server) -> None:
    """Armed and climbing, so that there is something to disturb."""
    server._tick += 1
    for v in server.vehicles:
        v._now_us = server.now_us
        v._set_armed(True, server.now_us)


def fuzz(frames: int, seed: int, offset: int, told: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
    """Send `frames` hostile frames; the figures. Raises AssertionError where something changed that must not."""
    mutator, counts = Mutator(seed), Counter[str]()
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    begun, memory = time.monotonic(), [0.0, 0.0]
    for signed in (False, True):
        server = a_server(offset + 40 * signed, KEY if signed else None)
        addresses = [server.link.ports[k].endpoint.bind for k in range(9) if not server.link.ports[k].endpoint.stream]
        in_flight(server)
        good, foreign = Signer(KEY), Signer(bytes(32))
        good.at(time.time())
        foreign.at(time.time())
        replays = [mutator.valid(k % 4 + 1, good) for k in range(BATCH)]
        key = good if signed else None
        kinds: list[tuple[str, bool, Callable[[], bytes]]] = [
            ("damaged", False, mutator.damaged),
            ("for somebody else", False, partial(mutator.to, 5, 256, key)),
            ("absurd", True, partial(mutator.to, 0, 5, key)),
        ]
        if signed:
            kinds += [
                ("unsigned", False, partial(mutator.to, 1, 5, None)),
                ("wrongly signed", False, partial(mutator.to, 1, 5, foreign)),
                ("replayed", False, partial(mutator.one_of, replays)),
            ]
            hear(server, sender, addresses, replays, mutator)
        share = math.ceil(frames / 2 / len(kinds))
        for name, may_change, make in kinds:
            done = 0
            while done < share:
                batch = [make() for _ in range(min(BATCH, share - done))]
                done += len(batch)
                counts[name] += len(batch)
                if name == "for somebody else":  # what asks everyone (TIMESYNC, PING, HEARTBEAT) is for nobody else
                    batch = [b for b in batch if b[7] not in (0, 4, 111)]
                before = None if may_change else state(server)
                hear(server, sender, addresses, batch, mutator)
                if not may_change:
                    assert state(server) == before, f"{name} frames changed a vehicle"
                check(server)
            told(f"{name}{' (signed link)' if signed else ''}: {counts[name]} frames")
            memory[1] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            memory[0] = memory[0] or memory[1]
        link = server.link.counters
        counts["received"] += link.received
        counts["bad"] += link.bad + link.unknown + link.meaningless
        counts["refused"] += sum(link.refused.values())
        server.close()
    return {
        "frames": sum(counts[k] for k in counts if k not in ("received", "bad", "refused")),
        "seconds": round(time.monotonic() - begun, 1),
        "memory_growth_MB": round(memory[1] - memory[0], 1),
        **counts,
    }


def hear(server: Server, sender: socket.socket, addresses: list, batch: list[bytes], mutator: Mutator) -> None:
    for datagram in batch:
        sender.sendto(datagram, addresses[int(mutator.rng.integers(len(addresses)))])
    server._receive(0.0)
    server._receive(0.0)
    for i, vehicle in enumerate(server.vehicles):
        server.links.inbox[i] = [(0, received) for _, received in server.links.inbox[i]]
        server._deliver(i, vehicle, server.now_us)


def check(server: Server) -> None:
    """A tick goes on as ever: finite motor commands between 0 and 1, no exception."""
    server._one_tick()
    server._tick += 1
    for v in server.vehicles:
        assert 0.0 <= v._shown[0] <= 1.0
    assert not server.links.mishandled.counts
    assert np.isfinite(server.plant.thrust).all()
    x, v_ = server.plant.kinematics()
    if not (np.abs(x) < 1e4).all() or not np.isfinite(v_).all():
        assert np.isfinite(x).all()
        server.plant.reset()
    server.link._queue.clear()


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--frames", type=int, default=1_000_000)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--offset", type=int, default=5000)
    arguments.add_argument("--out", type=Path, help="write the figures here as JSON")
    asked = arguments.parse_args()
    figures = fuzz(asked.frames, asked.seed, asked.offset, lambda line: print(line, flush=True))
    print(json.dumps(figures))
    if asked.out:
        asked.out.write_text(json.dumps(figures, indent=1) + "\n")
