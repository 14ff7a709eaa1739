"""PX4's HIL physics interface: a TCP server a vehicle; HIL_SENSOR and HIL_GPS out, HIL_ACTUATOR_CONTROLS in.

HIL_SENSOR sets the firmware's clock; what comes back carries the time of the HIL_SENSOR that it answers. Until its
allocator runs nothing comes back, and the clock goes on without it.

A motor's control 0..1 is its speed as a share of the highest, and thrust goes with the square: hover at the root of
m g / F_max, as for a stock quadrotor with THR_MDL_FAC 0.
"""

import math
import socket
from typing import NamedTuple

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.frames import Packed, checksum, frame, packed, unpack
from bridge.wire.ports import Address, bind
from cablequad.model import lie
from cablequad.model.earth import Home, altitude_m, geodetic
from sitl.external.seat import Own, PacketCounts, SeatError
from sitl.instruments import Fix, Instruments

PX4_PORT = 4560  # and 1 more for each instance
SENSOR_US = 4_000  # IMU_INTEG_RATE 250
MAG_US, BARO_US, TRUTH_US = 20_000, 20_000, 20_000
MOTORS = 4
UNANSWERED = 3  # sensors in a row that may get no answer before it is waited for
ACCEL_GYRO, MAG, BARO = 0x3F, 0x1C0, 0x1A00  # HIL_SENSOR_UPDATED_FLAGS
SYSTEM, COMPONENT = 1, 51  # of a simulator
MAGIC, LONGEST = 0xFD, 280  # of MAVLink 2 frames
CONTROLS = mavlink.MAVLink_hil_actuator_controls_message


def thrust_share(control: float) -> float:
    """0..1: of its greatest thrust, that a rotor gives for a motor's control."""
    return min(max(control, 0.0), 1.0) ** 2


class Controls(NamedTuple):
    """HIL_ACTUATOR_CONTROLS, as far as it is used."""

    time_us: int  # of the HIL_SENSOR that it answers
    motors: tuple[float, ...]


def split(data: bytes) -> tuple[list[Controls], bytes, int]:
    """What a stream of MAVLink 2 says of motors, the rest that may become a frame, and how often it made no sense.

    A frame that is not whole yet does not hide a whole one behind it: after damage nobody waits for bytes of a frame
    that never was.
    """
    out: list[Controls] = []
    at, end, refused, unfinished, damaged = 0, len(data), 0, -1, False
    while at < end:
        last = at + 12 + (data[at + 1] if at + 1 < end else 0)
        if data[at] != MAGIC:
            refused += not damaged
            at, damaged = at + 1, True
        elif last > end:
            unfinished = at if unfinished < 0 else unfinished
            at += 1
            damaged = True
        else:
            msgid = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
            kind = mavlink.mavlink_map.get(msgid)
            body = data[at + 1 : last - 2]
            right = (
                kind is not None and checksum(body + bytes((kind.crc_extra,))) == data[last - 2] | data[last - 1] << 8
            )
            if not right and unfinished < 0:
                refused += not damaged
            at, damaged = (last, False) if right else (at + 1, True)
            unfinished = -1 if right else unfinished
            if right and msgid == CONTROLS.id:
                time_us, _, *rest = unpack(CONTROLS, body[9:])
                out.append(Controls(time_us, tuple(rest[:MOTORS])))
    kept = data[unfinished:] if unfinished >= 0 else b""
    return out, kept[-LONGEST:], refused


class Px4Seat:
    """One PX4 behind its TCP port."""

    def __init__(self, vehicle: int, here: Address, home: Home, instruments: Instruments) -> None:
        """`vehicle` counts from 1. Raises LinkError where the port is taken."""
        self.who = f"vehicle {vehicle} (PX4, tcp {here[0]}:{here[1]})"
        self.tally = PacketCounts()
        self.share = (0.0, 0.0, 0.0, 0.0)
        self._home, self._instruments = home, instruments
        self._seq = 0
        self._rest = b""
        self._fix = Fix(np.zeros(3), np.zeros(3))
        self._peer: socket.socket | None = None
        self._told_us = self._heard_us = -1
        self._lockstep = False  # it has answered once
        self._in_a_row = 0  # sensors without an answer
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._listener.setblocking(False)
        bind(self._listener, here, "tcp")
        self._listener.listen(1)

    @property
    def present(self) -> bool:
        return self._peer is not None

    @property
    def engaged(self) -> bool:
        return self._lockstep

    @property
    def settled(self) -> bool:
        return not self._lockstep or self._heard_us >= self._told_us

    def sockets(self) -> list[int]:
        return [self._listener.fileno()] + ([self._peer.fileno()] if self._peer is not None else [])

    def hear(self) -> None:
        self._accept()
        while self._peer is not None:
            try:
                data = self._peer.recv(65536)
            except BlockingIOError:
                return
            except OSError as error:
                raise SeatError(f"its connection broke: {error.strerror}") from None
            if not data:
                raise SeatError("closed its connection")
            said, self._rest, refused = split(self._rest + data)
            self.tally.refused += refused
            for controls in said:
                self._take(controls)

    def nudge(self) -> None:
        """A sensor that got no answer is followed by the next, a few times: then it is waited for."""
        if self._lockstep and self._in_a_row < UNANSWERED:
            self._in_a_row += 1
            self.tally.unanswered += 1
            self._heard_us = self._told_us

    def due(self, now_us: int) -> bool:
        return now_us % SENSOR_US == 0

    def tell(self, own: Own) -> None:
        self._told_us = own.time_us
        out = [self._sensor(own)]
        self._fix = self._instruments.fix(own.time_us, own.x, own.v)
        if own.time_us % self._instruments.fix_us == 0:
            out.append(self._gps(own))
        if own.time_us % TRUTH_US == 0:
            out.append(self._truth(own))
        assert self._peer is not None
        try:
            self._peer.sendall(
                b"".join(frame(message, self._seq + k & 255, SYSTEM, COMPONENT) for k, message in enumerate(out))
            )
            self._seq = self._seq + len(out) & 255
            self.tally.answered += 1
        except OSError as error:
            raise SeatError(f"does not take what it is told: {error.strerror}") from None

    def close(self) -> None:
        self._listener.close()
        if self._peer is not None:
            self._peer.close()

    def _accept(self) -> None:
        try:
            peer, _ = self._listener.accept()
        except BlockingIOError:
            return
        if self._peer is not None:
            peer.close()
            raise SeatError("began anew: it connected a second time")
        peer.setblocking(False)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._peer = peer

    def _take(self, said: Controls) -> None:
        possible = all(math.isfinite(c) and abs(c) <= 1.0 for c in said.motors)
        if not possible or said.time_us > self._told_us:
            self.tally.refused += 1
        elif said.time_us < self._heard_us:
            self.tally.stale += 1
        else:
            self.tally.repeated += said.time_us == self._heard_us
            self.tally.taken += 1
            self._heard_us, self._lockstep, self._in_a_row = said.time_us, True, 0
            a, b, c, d = (thrust_share(control) for control in said.motors)
            self.share = (a, b, c, d)

    def _sensor(self, own: Own) -> Packed:
        i, fields = self._instruments, ACCEL_GYRO
        altitude = self._home.altitude_m - float(own.x[2])
        mag, hPa = [0.0] * 3, 0.0
        if own.time_us % MAG_US == 0:
            fields |= MAG
            mag = i.field_gauss(own.R).tolist()
        if own.time_us % BARO_US == 0:
            fields |= BARO
            hPa = i.pressure_hPa(altitude)
            altitude = altitude_m(hPa)
        return packed(
            mavlink.MAVLink_hil_sensor_message,
            own.time_us, *i.acceleration(own.specific_force).tolist(), *i.rate(own.Omega).tolist(), *mag, hPa, 0.0,
            altitude, i.temperature_C, fields, 0,
        )  # fmt: skip

    def _gps(self, own: Own) -> Packed:
        x, v = self._fix
        lat, lon, alt = geodetic(self._home, x)
        north, east, down = (round(100 * c) for c in v.tolist())
        speed = math.hypot(north, east)
        course = round(math.degrees(math.atan2(east, north)) * 100) % 36000 if speed > 10 else 65535
        return packed(
            mavlink.MAVLink_hil_gps_message,
            own.time_us, 3, round(lat * 1e7), round(lon * 1e7), round(alt * 1e3), 30, 40, round(speed), north, east,
            down, course, 12,
        )  # fmt: skip

    def _truth(self, own: Own) -> Packed:
        lat, lon, alt = geodetic(self._home, own.x)
        cm_s = [max(-32768, min(32767, round(100 * c))) for c in own.v.tolist()]
        mg = [max(-32768, min(32767, round(a / 9.80665e-3))) for a in own.specific_force.tolist()]
        return packed(
            mavlink.MAVLink_hil_state_quaternion_message,
            own.time_us, lie.quat_from_rotation(own.R).tolist(), *own.Omega.tolist(), round(lat * 1e7),
            round(lon * 1e7), round(alt * 1e3), *cm_s, 0, 0, *mg,
        )  # fmt: skip
