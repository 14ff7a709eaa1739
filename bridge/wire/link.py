"""Bytes <-> values: ids, sequence numbers, checksums, signatures. The only clock and the only wait.

Every datagram is split and checked by itself, so a bad one never disturbs the next. Frames are MAVLink 2 out, 1 or 2
in; what goes to one address in one breath shares a datagram.
"""

import select
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

from bridge.wire.batches import Batch
from bridge.wire.frames import SIGNED, Packed, Signer, Verdict, checksum, frame, targeted, whole_payload
from bridge.wire.memory import MemoryNetwork, MemoryPort
from bridge.wire.messages import KINDS
from bridge.wire.poller import Poller
from bridge.wire.ports import Address, Endpoint, LinkError, Port, StreamPort, open_port

__all__ = ["Address", "Counters", "Endpoint", "Link", "LinkError", "Mishandled", "Received"]

GRACE_S = 0.002
DATAGRAM_BYTES = 1400  # fits every network
LATELY_KEPT = 128  # frames of one sender that are known again, half of those after which numbers begin anew
SENT_KEPT = 100  # frames to one receiver that may be sent again
DATAGRAMS_KEPT = 8
SENDERS_KEPT = 4096  # whose sequence numbers are remembered
MOST_TURNS = 64  # of the other side of a network in memory, in which it may have nothing to say
MOST_ROUNDS = 512  # a flood must not keep the loop from its own work


class Received(NamedTuple):
    """One frame that passed its checksum."""

    port: int  # index of the port it came in on
    address: Address
    system: int
    component: int
    seq: int
    msgid: int
    name: str
    frame: bytes
    value: Any  # from bridge.wire.values, or None for a message nobody here reads


class Counters:
    """What a link has seen, in frames."""

    def __init__(self, ports: int) -> None:
        self.sent = 0
        self.sent_on = [0] * ports  # by port, a frame as often as it has receivers
        self.received_on = [0] * ports
        self.unsent = 0  # that the system did not take
        self.received = 0
        self.lost_from: dict[tuple[int, Address], int] = {}  # by gaps in sequence numbers, by port and sender
        self.bad = 0  # that did not parse or failed their checksum
        self.unknown = 0  # of a kind that the dialect does not have
        self.meaningless = 0  # whole, but with fields that nothing can be made of; they count as received too
        self.refused = dict.fromkeys(Verdict, 0)  # by their signature
        del self.refused[Verdict.GOOD]


class Mishandled:
    """The last line of defence: a frame whose handler failed costs itself alone; counted, and told once a kind."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}  # by the message's name

    def take(self, frame: Received, error: Exception) -> str | None:
        """Count it; what to tell of it, the first time."""
        first = frame.name not in self.counts
        self.counts[frame.name] = self.counts.get(frame.name, 0) + 1
        if not first:
            return None
        return (
            f"{frame.name} of {frame.system}/{frame.component} could not be handled and is left out "
            f"({type(error).__name__}: {error}); this is a fault of cablequad, please report it"
        )


class Link:
    """Ports that are waited on together, and the clock."""

    def __init__(
        self, endpoints: list[Endpoint], signer: Signer | None = None, network: MemoryNetwork | None = None
    ) -> None:
        """`network`: instead of sockets. Raises LinkError where an address is taken."""
        self._network = network
        self.go_on: Callable[[], bool] | None = None  # in memory: let the other side work; whether it could
        self._arrived: deque[tuple[int, Address, bytes]] = deque()  # datagrams of a network in memory
        self.ports: list[Port | MemoryPort] = []
        self.counters = Counters(len(endpoints))
        self.signer = signer
        self._poller = Poller()
        self._next_seq: dict[int, int] = {}  # by port, system and component
        self._last_seq: dict[tuple[int, Address], int] = {}
        self._queue: dict[tuple[int, Address], list[bytes]] = {}
        self.reliable = False  # whether what is lost may be sent again, and what came already is left out
        self.repeated = False  # something came again since this was cleared: whoever sent it waits for our answer
        self._lately: dict[int, dict[bytes, None]] = {}  # by port, system and component: the last frames
        self._sent: dict[tuple[int, Address], deque[tuple[bytes, int]]] = {}  # the last datagrams, and their frames
        try:
            for index, endpoint in enumerate(endpoints):
                if network is not None:
                    self.ports.append(network.open(endpoint, index, self._arrived))
                else:
                    self.ports.append(open_port(endpoint, self._poller, index))
            self._streams = [port for port in self.ports if isinstance(port, StreamPort)]
        except BaseException:
            self.close()
            raise
        if signer is not None:
            signer.at(time.time())

    def advance(self, now_us: int) -> None:
        """Simulated time has come to `now_us`."""
        if self.signer is not None:
            self.signer.advance(now_us)

    def now(self) -> float:
        """Wall-clock seconds, monotonic."""
        return time.monotonic()

    def sleep_until(self, deadline: float) -> None:
        """Wait for a wall-clock time of `now`, doing nothing."""
        time.sleep(max(0.0, deadline - time.monotonic()))

    def poll(self, timeout: float, closing: int | None = None) -> list[Received]:
        """Frames that have arrived, waiting up to `timeout` s for the first.

        `closing` is the port on which the last of a burst is expected: whoever is woken by the first reads on while
        the rest is on its way, and sleeps once more at most, not before every datagram; no longer than `GRACE_S`.
        """
        if self._network is not None:
            return self._poll_memory(timeout)
        now = time.monotonic()
        for stream in self._streams:
            stream.tend(now)
        out: list[Received] = []
        ready = self._poller.ready(max(0.0, timeout))
        rounds = 0
        while ready and rounds < MOST_ROUNDS:
            for index, read_from in ready:
                if index == closing:
                    closing = None
                port = self.ports[index]
                assert not isinstance(port, MemoryPort)
                for address, data in port.receive(read_from):
                    frames = self._split(index, address, data)
                    if frames:
                        port.learn(address)
                        out += frames
            # asking once whether there is more costs less than being told by every socket that there is none
            ready = self._poller.ready(0.0)
            if not ready and closing is not None:
                last, closing = self.ports[closing], None
                waits_on = [] if isinstance(last, MemoryPort) else last.listening()
                if waits_on and select.select(waits_on, (), (), GRACE_S)[0]:
                    ready = self._poller.ready(0.0)
            rounds += 1
        return out

    def _poll_memory(self, timeout: float) -> list[Received]:
        """What has arrived; where nothing has, and there is time to wait, what arrives when the other side goes on."""
        if timeout > 0.0 and self.go_on is not None:
            turns = 0
            while not self._arrived and turns < MOST_TURNS and self.go_on():
                turns += 1
        out: list[Received] = []
        while self._arrived:
            index, address, data = self._arrived.popleft()
            frames = self._split(index, address, data)
            if frames:
                self.ports[index].learn(address)
                out += frames
        return out

    def put(
        self, port: int, system: int, component: int, message: Packed, to: Address | None = None
    ) -> tuple[int, bytes]:
        """Queue one message as (system, component) for one address, or for everyone on the port; see `flush`.

        Its sequence number, and its frame.
        """
        seq = self._numbered(port, system, component)
        whole = frame(message, seq, system, component, self.signer, port & 255)
        self._enqueue(port, whole, to)
        return seq, whole

    def put_all(
        self, routes: Sequence[tuple[int, Address | None]], systems: bytes, component: int, batch: Batch
    ) -> list[bytes]:
        """`put` of a batch's first messages, one for each route, on its port as its system, for its address."""
        seqs = bytes([self._numbered(port, who, component) for (port, _), who in zip(routes, systems, strict=True)])
        frames = batch.framed(seqs, systems, component, 0 if self.signer is None else SIGNED)
        if self.signer is not None:
            sign = self.signer.signature
            frames = [whole + sign(whole, port & 255) for (port, _), whole in zip(routes, frames, strict=True)]
        for (port, to), whole in zip(routes, frames, strict=True):
            self._enqueue(port, whole, to)
        return frames

    def flush(self) -> None:
        """Put what is queued on the wire, in as few datagrams as hold it, port by port: the last one closes a burst."""
        if not self._queue:
            return
        for (port, address), frames in sorted(self._queue.items()):
            start, size = 0, 0
            for k, whole in enumerate(frames):
                if size and size + len(whole) > DATAGRAM_BYTES:
                    self._put(port, frames[start:k], address)
                    start, size = k, 0
                size += len(whole)
            self._put(port, frames[start:], address)
        self._queue.clear()
        if self.signer is not None:
            self.signer.at(time.time())

    def resend(self, ports: Collection[int]) -> None:
        """Send the last datagrams of `ports` again, byte for byte: a `reliable` receiver leaves out what it has."""
        for (port, address), datagrams in self._sent.items():
            for data, _ in datagrams if port in ports else ():
                self.ports[port].send(data, address)

    def close(self) -> None:
        """Send what waits and release the sockets."""
        if self.ports:
            self.flush()
        self._poller.close()
        for port in self.ports:
            port.close()

    def _numbered(self, port: int, system: int, component: int) -> int:
        key = port << 16 | system << 8 | component
        seq = self._next_seq.get(key, 0)
        self._next_seq[key] = (seq + 1) & 255
        return seq

    def _enqueue(self, port: int, whole: bytes, to: Address | None) -> None:
        queue = self._queue
        for address in (to,) if to is not None else self.ports[port].addresses():
            waiting = queue.get((port, address))
            if waiting is None:
                queue[port, address] = [whole]
            else:
                waiting.append(whole)
            self.counters.sent_on[port] += 1
        self.counters.sent += 1

    def _put(self, port: int, frames: list[bytes], address: Address) -> None:
        data = b"".join(frames)
        if self.reliable:
            self._keep(port, data, len(frames), address)
        if not self.ports[port].send(data, address):
            self.counters.unsent += len(frames)

    def _keep(self, port: int, data: bytes, frames: int, address: Address) -> None:
        kept = self._sent.get((port, address))
        if kept is None:
            kept = self._sent[port, address] = deque()
        kept.append((data, frames))
        while len(kept) > 1 and (sum(count for _, count in kept) > SENT_KEPT or len(kept) > DATAGRAMS_KEPT):
            kept.popleft()

    def _split(self, port: int, address: Address, data: bytes) -> list[Received]:
        out: list[Received] = []
        counters = self.counters
        at, end = 0, len(data)
        while at < end:
            magic = data[at]
            if magic == 0xFD and at + 12 <= end:
                flags = data[at + 2]
                tail = at + 10 + data[at + 1]
                last = tail + 2 + (13 if flags & 1 else 0)
                seq, system, component = data[at + 4], data[at + 5], data[at + 6]
                msgid = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
            elif magic == 0xFE and at + 8 <= end:
                flags = 0
                tail = at + 6 + data[at + 1]
                last = tail + 2
                seq, system, component, msgid = data[at + 2], data[at + 3], data[at + 4], data[at + 5]
            else:
                at += 1
                counters.bad += 1
                continue
            kind = KINDS.get(msgid)
            if last > end or flags & ~1 or kind is None:
                if kind is None and last <= end and not flags & ~1:
                    counters.unknown += 1
                else:
                    counters.bad += 1
                at = last if last <= end else at + 1
                continue
            name, crc_extra, read, size = kind
            if checksum(data[at + 1 : tail] + crc_extra) != data[tail] | data[tail + 1] << 8:
                counters.bad += 1
                at += 1
                continue
            whole, payload = data[at:last], data[at + (10 if magic == 0xFD else 6) : tail]
            at = last
            if self.reliable and self._came_before(port << 16 | system << 8 | component, whole):
                continue
            if self.signer is not None and not self._believed(self.signer, msgid, whole):
                continue
            value = None
            if read is not None:
                try:
                    value = read(payload if len(payload) == size else whole_payload(payload, size))
                except Exception:  # whatever a stranger put into its fields, it costs this frame alone
                    counters.meaningless += 1
            self._count(port, address, system, component, seq)
            out.append(Received(port, address, system, component, seq, msgid, name, whole, value))
        return out

    def _came_before(self, sender: int, whole: bytes) -> bool:
        """Whether this very frame, number and all, was among the sender's last ones."""
        lately = self._lately.get(sender)
        if lately is None:
            lately = self._lately[sender] = {}
        if whole in lately:
            self.repeated = True
            return True
        lately[whole] = None
        if len(lately) > LATELY_KEPT:
            del lately[next(iter(lately))]
        return False

    def _believed(self, signer: Signer, msgid: int, whole: bytes) -> bool:
        verdict = signer.judge(whole)
        if verdict is Verdict.GOOD:
            return True
        if verdict is Verdict.UNSIGNED and signer.accept_unsigned_telemetry and not targeted(msgid):
            return True
        self.counters.refused[verdict] += 1
        return False

    def _count(self, port: int, address: Address, system: int, component: int, seq: int) -> None:
        key = (port << 16 | system << 8 | component, address)  # who else sends under this id has numbers of its own
        last = self._last_seq.get(key)
        if last is not None:
            gap = (seq - last - 1) & 255
            if 0 < gap < 128:  # more means an old frame that came late
                lost = self.counters.lost_from
                lost[port, address] = lost.get((port, address), 0) + gap
        elif len(self._last_seq) >= SENDERS_KEPT:
            del self._last_seq[next(iter(self._last_seq))]
        self._last_seq[key] = seq
        self.counters.received += 1
        self.counters.received_on[port] += 1
