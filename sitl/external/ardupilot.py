"""ArduPilot's JSON physics interface: 40-byte servo packets in, one line of JSON out, a UDP port a vehicle.

SITL sends one packet and waits for its answer. Unanswered, it sends the same frame_count again: that one is answered
again and not stepped again. A frame_count that begins anew is an autopilot that did.

Rotors give the share of their greatest thrust that ArduCopter's own curve makes of a PWM with the default parameters:
t = (1 - e) c + e c^2 with c = (pwm' - MOT_SPIN_MIN) / (MOT_SPIN_MAX - MOT_SPIN_MIN), pwm' = (pwm - 1000) / 1000 and
e = MOT_THST_EXPO. Rotor speed goes with the root of t. So a throttle of F / F_max gives F.
"""

import errno
import socket
import struct
import sys
from typing import NamedTuple

from bridge.wire.ports import Address, bind
from cablequad.model import lie
from sitl.external.seat import Own, PacketCounts, SeatError

ARDUPILOT_PORT = 9002  # and 10 more for each instance
MAGIC_16, MAGIC_32 = 18458, 29569
HEADER = struct.Struct("<HHI")
SIZE = {MAGIC_16: HEADER.size + 2 * 16, MAGIC_32: HEADER.size + 2 * 32}
HIGHEST_PWM = 2500  # us; 0 is a channel without output
MOTORS = 4
EXPO, SPIN_MIN, SPIN_MAX = 0.65, 0.15, 0.95  # ArduCopter's defaults
CUT_US = 0.5
IP_RECVERR = 11  # of Linux, for SOL_IP


class Servos(NamedTuple):
    """One servo packet."""

    rate_hz: int  # frame_rate that SITL expects to be answered at
    frame: int
    pwm: tuple[int, ...]  # us, 16 or 32 of them


class PacketError(ValueError):
    """Bytes that are no servo packet."""


def servos(data: bytes) -> Servos:
    """The servo packet in a datagram. Raises PacketError saying what is wrong with it."""
    if len(data) < HEADER.size:
        raise PacketError(f"{len(data)} bytes are too few")
    magic, rate_hz, frame = HEADER.unpack_from(data)
    if magic not in SIZE:
        raise PacketError(f"magic {magic}, {MAGIC_16} or {MAGIC_32} was expected")
    if len(data) != SIZE[magic]:
        raise PacketError(f"{len(data)} bytes, {SIZE[magic]} were expected")
    pwm = struct.unpack_from(f"<{(len(data) - HEADER.size) // 2}H", data, HEADER.size)
    if max(pwm[:MOTORS]) > HIGHEST_PWM:
        raise PacketError(f"a motor's PWM of {max(pwm[:MOTORS])} us")
    return Servos(rate_hz, frame, pwm)


def thrust_share(pwm: int) -> float:
    """0..1: of its greatest thrust, that a rotor gives at `pwm` us.

    SITL cuts what it commands to whole microseconds: half of one is what it cut off in the mean.
    """
    c = ((pwm + CUT_US - 1000) / 1000 - SPIN_MIN) / (SPIN_MAX - SPIN_MIN)
    c = min(max(c, 0.0), 1.0)
    return (1.0 - EXPO) * c + EXPO * c * c


LINE = (
    '\n{"timestamp":%.6f,"imu":{"gyro":[%.9g,%.9g,%.9g],"accel_body":[%.9g,%.9g,%.9g]},"position":[%.9g,%.9g,%.9g],'
    '"quaternion":[%.9g,%.9g,%.9g,%.9g],"velocity":[%.9g,%.9g,%.9g]}\n'
)


def line(own: Own) -> bytes:
    """The answer to a servo packet: no space after a colon, each key once, a newline before and after."""
    numbers = (
        *own.Omega.tolist(), *own.specific_force.tolist(), *own.x.tolist(), *lie.quat_from_rotation(own.R).tolist(),
        *own.v.tolist(),
    )  # fmt: skip
    return (LINE % (own.time_us * 1e-6, *numbers)).encode()


class ArduPilotSeat:
    """One ArduPilot behind its UDP port."""

    def __init__(self, vehicle: int, here: Address) -> None:
        """`vehicle` counts from 1. Raises LinkError where the port is taken."""
        self.who = f"vehicle {vehicle} (ArduPilot, udp {here[0]}:{here[1]})"
        self.tally = PacketCounts()
        self.share = (0.0, 0.0, 0.0, 0.0)
        self._frame = -1
        self._address: Address | None = None
        self._waits = False  # for the answer to its newest frame
        self._answer = b""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        bind(self._socket, here, "udp")

    @property
    def present(self) -> bool:
        return self._address is not None

    @property
    def engaged(self) -> bool:
        return self.present

    @property
    def settled(self) -> bool:
        return self._waits

    def sockets(self) -> list[int]:
        return [self._socket.fileno()]

    def hear(self) -> None:
        while not self._waits and self._hear_one():
            pass

    def _hear_one(self) -> bool:
        """Whether there was a packet."""
        try:
            data, address = self._socket.recvfrom(2048)
        except (BlockingIOError, ConnectionRefusedError):
            return False
        try:
            packet = servos(data)
        except PacketError:
            self.tally.refused += 1
        else:
            self._take(packet, address)
        return True

    def nudge(self) -> None:
        """An empty datagram, which SITL takes no notice of, is refused where its port is closed (as Linux tells)."""
        if self._address is None:
            return
        if sys.platform == "linux":  # of a socket that is not connected, what is refused is told on request alone
            self._socket.setsockopt(socket.SOL_IP, IP_RECVERR, 1)
        self._send(b"")
        refused = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == errno.ECONNREFUSED
        if sys.platform == "linux":
            self._socket.setsockopt(socket.SOL_IP, IP_RECVERR, 0)  # and forgets what it told
        if refused:
            raise SeatError("no longer runs: its port is closed")

    def due(self, now_us: int) -> bool:
        del now_us
        return self._waits

    def tell(self, own: Own) -> None:
        while self._hear_one():  # if it has asked again meanwhile: one answer for all, as each makes it ask once more
            pass
        self._answer = line(own)
        self._waits = False
        self._reply()

    def close(self) -> None:
        self._socket.close()

    def _take(self, packet: Servos, address: Address) -> None:
        if self._address is not None and packet.frame < self._frame and (address != self._address or packet.frame == 0):
            raise SeatError(f"began anew: its frame count went back from {self._frame} to {packet.frame}")
        if packet.frame < self._frame or (self._address is not None and address != self._address):
            self.tally.stale += 1
            return
        if packet.frame == self._frame:
            self.tally.repeated += 1
            if not self._waits:
                self._reply()
            return
        self.tally.taken += 1
        self._address, self._frame, self._waits = address, packet.frame, True
        a, b, c, d = (thrust_share(p) for p in packet.pwm[:MOTORS])
        self.share = (a, b, c, d)

    def _reply(self) -> None:
        if self._send(self._answer):
            self.tally.answered += 1

    def _send(self, data: bytes) -> bool:
        """Whether the system took it; what it did not take is asked for again."""
        assert self._address is not None
        try:
            self._socket.sendto(data, self._address)
        except OSError:
            return False
        return True
