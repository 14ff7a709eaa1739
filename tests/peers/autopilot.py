"""A stand-in for ArduPilot SITL or PX4, written from the protocols alone: it imports nothing of ours.

    python autopilot.py ardupilot --instance 0 --physics 9002 --mavlink 14540
    python autopilot.py px4 --instance 1 --physics 4561 --mavlink 14541

It has a clock, an estimator, attitude and rate loops, a mixer, modes, arming and the parameters that the real one has.
As ArduPilot it is told its motion and only integrates time; as PX4 it makes its attitude from gyroscope, accelerometer
and magnetometer, and its position from GPS and accelerometer.

It is as odd as flights with the real ones showed them to be (tests/test_flown.py compares them): ArduPilot reads its
defaults file, does not arm with an accelerometer calibrated that is not there, divides thrust by the air's density, cuts
PWM to whole microseconds, streams at 3 ms of 20, and refuses messages that it does not have. PX4 needs its start
scripts, streams at 8 ms of 20, and leaves a HIL_SENSOR unanswered now and then. Both pause, and answer an attitude
setpoint late.
"""

import argparse
import json
import math
import pathlib
import socket
import struct
import sys
import time
from typing import Any

from pymavlink.dialects.v20 import common as mav

G = 9.81
ARM, DRAG = 0.17, 0.02  # m
SIDE = ((1, 1), (-1, -1), (1, -1), (-1, 1))  # forward, right: front right, rear left, front left, rear right
TURN = (1, 1, -1, -1)  # of their drag on the body: the first two turn counter-clockwise
RESPONSE = {False: (12.9, 0.85, 0.014), True: (10.2, 1.07, 0.004)}  # rad/s, damping, s until a setpoint acts; by px4
RESTS = 0.05  # rad/s, below which a gyroscope at rest shows its bias and its noise
MOVES = 0.3  # m/s^2, by GPS, at which the accelerometer counts half
HOLD_S = {False: 0.0006, True: 0.002}  # half of what lies between two torques; by px4
PHASE_US = {False: 3_000, True: 8_000}  # of streams, modulo 20 ms
DENSITY = (1 - 2.25577e-5 * 488.0) ** 4.25588  # at the default home, to that at sea level
IMUS = 2  # that SITL has
UNANSWERED, PAUSE = 2_000, 1_700  # frames between such moments
BOOT = ("Calibrating barometer", "Barometer 1 calibration complete", "Barometer 2 calibration complete",
        "ArduPilot Ready", "AHRS: DCM active")  # fmt: skip
HERE = pathlib.Path(__file__).parent
FIELD = (0.2158, 0.0121, 0.4335)  # gauss, NED


def mul(a: Any, b: Any) -> Any:
    w, x, y, z = a
    p, q, r, s = b
    return (w*p - x*q - y*r - z*s, w*q + x*p + y*s - z*r, w*r - x*s + y*p + z*q, w*s + x*r - y*q + z*p)  # fmt: skip


def rotate(q: Any, v: Any) -> Any:
    """v of the body in the world."""
    w, x, y, z = q
    a, b, c = v
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return (a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx)


def conj(q: Any) -> Any:
    return (q[0], -q[1], -q[2], -q[3])


def cross(a: Any, b: Any) -> Any:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(q: Any) -> Any:
    n = math.sqrt(sum(c * c for c in q))
    return tuple(c / n for c in q)


class Estimate:
    """q (body to NED), gyro, x, v, and whether they may be used."""

    def __init__(self) -> None:
        self.q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
        self.w: tuple[float, ...] = (0.0, 0.0, 0.0)
        self.x: tuple[float, ...] = (0.0, 0.0, 0.0)
        self.v: tuple[float, ...] = (0.0, 0.0, 0.0)
        self.f = (0.0, 0.0, -G)
        self.origin: Any = None  # lat, lon, alt
        self.begun = False


class Filter(Estimate):
    """From gyroscope, accelerometer, magnetometer and GPS."""

    def __init__(self) -> None:
        super().__init__()
        self.bias = [0.0, 0.0, 0.0]
        self.before = (0.0, 0.0, 0.0)  # of the gyroscope, so that what it turned between two is the mean of both
        self.a: tuple[float, ...] = (0.0, 0.0, 0.0)  # from GPS, NED
        self.still = True  # disarmed, on the ground
        self.last_v: Any = None
        self.fixes = 0
        self.rested = 0  # samples

    def imu(self, m: Any, dt: float) -> None:
        acc, gyro = (m.xacc, m.yacc, m.zacc), (m.xgyro, m.ygyro, m.zgyro)
        if m.fields_updated & 0x1C0:
            self.mag = (m.xmag, m.ymag, m.zmag)
        if not self.begun and hasattr(self, "mag"):  # at rest: level from gravity, heading from the field
            roll, pitch = math.atan2(-acc[1], -acc[2]), math.atan2(acc[0], math.hypot(acc[1], acc[2]))
            q = mul((math.cos(pitch / 2), 0, math.sin(pitch / 2), 0), (math.cos(roll / 2), math.sin(roll / 2), 0, 0))
            h = rotate(q, self.mag)
            yaw = math.atan2(FIELD[1], FIELD[0]) - math.atan2(h[1], h[0])
            self.q, self.begun = mul((math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)), q), True
        if not self.begun:
            return
        wanted = rotate(conj(self.q), (self.a[0], self.a[1], self.a[2] - G))
        norm = sum(c * c for c in wanted) + 1.0
        tilt = [c / norm for c in cross(acc, wanted)]
        seen = rotate(self.q, self.mag)
        off = (seen[0] * FIELD[1] - seen[1] * FIELD[0]) / (FIELD[0] ** 2 + FIELD[1] ** 2)
        turn = rotate(conj(self.q), (0.0, 0.0, off))
        error = [a + b for a, b in zip(tilt, turn)]
        moves = (
            1 + (math.sqrt(sum(c * c for c in self.a)) / MOVES) ** 2
        )  # an accelerometer that is moved shows no level
        trust, learn = (0.5, 0.0) if self.still else (0.1 / moves, 0.005 / moves)
        self.bias = [b - learn * e * dt for b, e in zip(self.bias, error)]
        if self.still and max(map(abs, gyro)) < RESTS:  # the gyroscope's mean at rest is its bias
            self.rested += 1
            self.bias = [b + (c - b) / self.rested for b, c in zip(self.bias, gyro)]
        self.w = tuple(w - b for w, b in zip(gyro, self.bias))
        mean = [0.5 * (now + before) - b for now, before, b in zip(gyro, self.before, self.bias)]
        self.before = gyro
        step = [0.5 * dt * (w + trust * e) for w, e in zip(mean, error)]
        self.q = unit(mul(self.q, (1.0, *step)))
        self.f = acc
        f = rotate(self.q, acc)
        a = (f[0], f[1], f[2] + G)
        self.x = tuple(x + v * dt for x, v in zip(self.x, self.v))
        self.v = tuple(v + c * dt for v, c in zip(self.v, a))

    def gps(self, m: Any) -> None:
        v = (m.vn / 100, m.ve / 100, m.vd / 100)
        place = (m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3)
        if self.origin is None:
            self.origin = place
        lat, lon, alt = self.origin
        x = (math.radians(place[0] - lat) * 6378137.0,
             math.radians(place[1] - lon) * 6378137.0 * math.cos(math.radians(lat)), alt - place[2])  # fmt: skip
        if self.last_v is not None:
            self.a = tuple(0.7 * a + 0.3 * (b - c) / 0.1 for a, b, c in zip(self.a, v, self.last_v))
        self.last_v = v
        self.fixes += 1
        k = 1.0 if self.fixes < 3 else 0.3
        self.x = tuple(a + k * (b - a) for a, b in zip(self.x, x))
        self.v = tuple(a + k * (b - a) for a, b in zip(self.v, v))


class Copter:
    """Everything of a flight controller but its physics interface."""

    def __init__(self, options: argparse.Namespace, px4: bool) -> None:
        self.o, self.px4 = options, px4
        self.system = options.instance + 1
        self.out = mav.MAVLink(None, self.system, 1)
        self.parser = mav.MAVLink(None)
        self.parser.robust_parsing = True
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.peer = ("127.0.0.1", options.mavlink)
        self.e: Any = Filter() if px4 else Estimate()
        self.us = 0  # since boot
        self.every = {0: 1_000_000}
        self.next = {0: 0}
        self.armed, self.mode = False, (4 << 16 | 3 << 24) if px4 else 0
        self.target, self.target_us = None, -(10**9)
        self.hold: Any = None
        self.pwm = [0] * 4
        self.sum = [0.0, 0.0, 0.0]
        self.landed, self.quiet_us = True, 0.0
        names = (HERE / ("px4-parameters.txt" if px4 else "arducopter-parameters.txt")).read_text().split("\n")
        self.kinds = {line.split()[0]: line.endswith("int32_t") for line in names if line}
        self.parameters = dict.fromkeys(self.kinds, 0.0)
        self.parameters |= {"THR_MDL_FAC": 0.0} if px4 else {"GUID_OPTIONS": 0.0, "ATC_ANGLE_BOOST": 1.0}
        if options.defaults is None:
            self.calibrate()
        else:
            self.load(options.defaults)
        w, z, self.delay_s = RESPONSE[px4]
        w, z = options.bandwidth or w, options.damping or z
        self.delay_s = self.delay_s if options.delay is None else options.delay
        held = HOLD_S[px4]  # a torque stands until the next: half of that is a delay in both loops
        self.rate_p = 1 / (held + 1 / (2 * z * w + held * w * w))
        self.angle_p = w * w * (1 / self.rate_p - held)
        self.coming: list[Any] = []  # setpoints that do not act yet
        self.booted = False
        self.share = 0.0
        self.answered = 0

    # -- parameters ---------------------------------------------------------------------------------------------------

    def calibrate(self) -> None:
        """As one that somebody calibrated."""
        for k in ("", "2"):
            self.parameters |= {f"INS_ACC{k}OFFS_X": 0.001, f"INS_ACC{k}SCAL_X": 1.001, f"COMPASS_OFS{k}_X": 5.0}

    def load(self, path: Any) -> None:
        """A file of defaults, or of PX4's PX4_PARAM_ variables: what it does not know it tells on its terminal."""
        for line in pathlib.Path(path).read_text().splitlines():
            name, value = line.split()
            if name in self.parameters:
                self.parameters[name] = float(value)
            else:
                print("Ignored unknown param", name, flush=True)

    @property
    def calibrated(self) -> Any:
        """No accelerometer that is there may be without a calibration, none that is not may have one."""
        done = [self.parameters[f"INS_ACC{k}OFFS_X"] != 0.0 for k in ("", "2", "3")]
        return done == [k < IMUS for k in range(3)]

    # -- MAVLink ------------------------------------------------------------------------------------------------------

    def say(self, message: Any) -> None:
        self.socket.sendto(message.pack(self.out), self.peer)
        self.out.seq = (self.out.seq + 1) % 256

    def text(self, words: str, severity: int = 2) -> None:
        self.say(mav.MAVLink_statustext_message(severity, words.encode()))

    def hear(self) -> None:
        while True:
            try:
                data = self.socket.recv(4096)
            except (BlockingIOError, ConnectionRefusedError):
                return
            for m in self.parser.parse_buffer(data) or []:
                self.take(m)

    def take(self, m: Any) -> None:
        kind = m.get_type()
        if kind == "SET_ATTITUDE_TARGET" and m.target_system == self.system:
            if m.type_mask == 7 and abs(sum(c * c for c in m.q) - 1) < 1e-3:
                self.coming.append((self.us + self.delay_s * 1e6, (tuple(m.q), m.thrust)))
                self.target_us = self.us
        elif kind == "TIMESYNC" and m.tc1 == 0:
            self.say(mav.MAVLink_timesync_message(self.us * 1000, m.ts1))
        elif kind == "COMMAND_LONG" and m.target_system == self.system:
            for result in self.obey(m.command, m.param1, m.param2, m.param3):
                self.say(
                    mav.MAVLink_command_ack_message(m.command, result, 0, 0, m.get_srcSystem(), m.get_srcComponent())
                )
        elif kind == "PARAM_REQUEST_READ" and m.target_system == self.system:
            self.tell(m.param_id)
        elif kind == "PARAM_SET" and m.target_system == self.system and m.param_id in self.parameters:
            whole = self.px4 and self.kinds[m.param_id]
            self.parameters[m.param_id] = bits(m.param_value) if whole else m.param_value
            self.tell(m.param_id)

    def tell(self, name: str) -> None:
        if name in self.parameters:
            value, kind = self.parameters[name], 9
            if self.px4 and self.kinds[name]:
                value, kind = struct.unpack("<f", struct.pack("<i", int(value)))[0], 6
            self.say(mav.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), 0))

    def obey(self, command: int, a: Any, b: Any, c: Any) -> Any:
        if command == 511:
            number = int(a)
            if number not in (PX4_HAS if self.px4 else COPTER_HAS):
                if not self.px4:
                    self.text(f"No ap_message for mavlink id ({number})", 6)
                return [4 if self.px4 else 2]
            if number not in STREAMS:
                return [0]
            if b > 0:
                phase = PHASE_US[self.px4] % int(b)
                self.every[number], self.next[number] = int(b), self.us // int(b) * int(b) + phase
            else:
                self.every.pop(number, None)
            return [0]
        if command == 176:
            wish = int(b) << 16 | int(c) << 24 if self.px4 else int(b)
            offboard = 6 << 16 if self.px4 else 4
            if self.px4 and wish == offboard and self.us - self.target_us > 500_000 and self.armed:
                return [0, 1]
            self.mode, self.hold, self.sum = wish, None, [0.0, 0.0, 0.0]
            return [0, 0] if self.px4 else [0]
        if command == 400:
            if a == 1 and not self.px4 and not self.calibrated:
                self.text("Arm: 3D Accel calibration needed")
                return [4]
            if a == 1 and not self.ready:
                self.text("Arm: Need Position Estimate")
                return [1 if self.px4 else 4]
            if a == 0 and not self.landed and int(b) != 21196:
                return [1 if self.px4 else 4]
            self.armed = a == 1
            return [0]
        if command == 21:  # NAV_LAND
            self.mode, self.hold = (4 << 16 | 6 << 24) if self.px4 else 9, None
            return [0]
        return [3]

    @property
    def ready(self) -> Any:
        return self.us > self.o.ready * 1e6 and (self.e.begun or not self.px4)

    def stream(self) -> None:
        for number, every in list(self.every.items()):
            if self.us >= self.next[number]:
                self.next[number] += every * max(1, math.ceil((self.us - self.next[number] - every) / every))
                STREAMS[number](self)

    def heartbeat(self) -> None:
        base = 1 | (128 if self.armed else 0) | (16 if self.armed else 0)
        self.say(mav.MAVLink_heartbeat_message(2, 12 if self.px4 else 3, base, self.mode, 4 if self.armed else 3, 3))

    def attitude(self) -> None:
        self.say(mav.MAVLink_attitude_quaternion_message(self.us // 1000, *self.e.q, *self.e.w))

    def position(self) -> None:
        if self.ready:
            self.say(mav.MAVLink_local_position_ned_message(self.us // 1000, *self.e.x, *self.e.v))

    def origin(self) -> None:
        if self.e.origin is not None:
            lat, lon, alt = self.e.origin
            self.say(mav.MAVLink_gps_global_origin_message(round(lat * 1e7), round(lon * 1e7), round(alt * 1e3)))

    def imu(self) -> None:
        self.say(mav.MAVLink_highres_imu_message(self.us, *self.e.f, *self.e.w, 0, 0, 0, 0, 0, 0, 0, 63))

    def landed_state(self) -> None:
        self.say(mav.MAVLink_extended_sys_state_message(0, 1 if self.landed else 2))

    def servos(self) -> None:
        self.say(mav.MAVLink_servo_output_raw_message(self.us % 2**32, 0, *self.pwm, 0, 0, 0, 0))

    def battery(self) -> None:
        self.say(mav.MAVLink_sys_status_message(0, 0, 0, 100, 16000, 100, 90, 0, 0, 0, 0, 0, 0))

    # -- flying -------------------------------------------------------------------------------------------------------

    def control(self, dt: float) -> Any:
        """Shares of the greatest thrust of the four rotors."""
        while self.coming and self.coming[0][0] <= self.us:
            self.target = self.coming.pop(0)[1]
        if not self.px4 and not self.booted:
            self.booted = True
            for words in BOOT:
                self.text(words, 6)
        if not self.armed:
            self.share = 0.0
            self.note(dt)
            return (0.0,) * 4
        commanded = self.mode == (6 << 16 if self.px4 else 4)
        if commanded and self.target is not None and (self.px4 or int(self.parameters["GUID_OPTIONS"]) & 8):
            q, thrust = self.target
            if self.px4:
                share = min(max(thrust, 0.0), 1.0) ** 2
            else:
                up = 1 - 2 * (q[1] ** 2 + q[2] ** 2)
                share = min(max(thrust, 0.0), 1.0) * (
                    min(1 / max(up, 0.1), 10.0) if self.parameters["ATC_ANGLE_BOOST"] else 1
                )
                share /= DENSITY
        else:
            q, share = self.by_itself(dt)
        self.share = min(share, 1.0)
        self.note(dt)
        e = mul(conj(self.e.q), q)
        sign = 2.0 if e[0] >= 0 else -2.0
        J = self.o.inertia
        rates = [max(-4.0, min(4.0, self.angle_p * sign * c)) for c in e[1:]]
        torque = [J[k] * self.rate_p * (rates[k] - self.e.w[k]) for k in range(3)]
        lever, most = ARM / math.sqrt(2), DENSITY * self.o.max_thrust / 4
        tilt = [(f * torque[1] - r * torque[0]) / (4 * lever * most) for f, r in SIDE]
        turn = [t * torque[2] / (4 * DRAG * most) for t in TURN]
        room = max(0.0, min(self.share, 1 - self.share))
        scale = min(1.0, room / max(1e-9, max(abs(c) for c in tilt)))
        turn = [max(-0.1, min(0.1, c)) for c in turn]
        return tuple(min(1.0, max(0.0, self.share + scale * a + b)) for a, b in zip(tilt, turn))

    def by_itself(self, dt: float) -> Any:
        """Hold the place, or come down."""
        if self.hold is None:
            self.hold = list(self.e.x)
        landing = self.mode in ((4 << 16 | 6 << 24), 9)
        if landing:
            self.hold[2] += 0.3 * dt
        off = [h - x for h, x in zip(self.hold, self.e.x)]
        self.sum = [max(-3.0, min(3.0, s + 0.8 * c * dt)) for s, c in zip(self.sum, off)]
        a = [2.0 * c - 2.5 * v + s for c, v, s in zip(off, self.e.v, self.sum)]
        f = (a[0], a[1], min(a[2], 5.0) - G)
        n = math.sqrt(sum(c * c for c in f))
        z = [-c / n for c in f]  # body down
        q = unit((1 + z[2], -z[1], z[0], 0.0))
        return q, self.o.mass * n / (DENSITY * self.o.max_thrust)

    def note(self, dt: float) -> None:
        """Whether it stands: little thrust for a while."""
        low = self.share * DENSITY * self.o.max_thrust < 0.6 * self.o.mass * G
        self.quiet_us = self.quiet_us + dt * 1e6 if low else 0
        self.landed = self.quiet_us > 300_000 or (self.landed and low)
        if self.landed and self.armed and self.mode in ((4 << 16 | 6 << 24), 9) and self.quiet_us > 1_000_000:
            self.armed = False


def bits(value: float) -> Any:
    """The integer whose bits stand in a float."""
    return float(struct.unpack("<i", struct.pack("<f", value))[0])


COPTER_HAS = {0, 1, 24, 27, 30, 31, 32, 33, 36, 49, 74, 83, 85, 105, 147, 242, 245}
PX4_HAS = COPTER_HAS - {0} | {141, 331}
STREAMS = {
    0: Copter.heartbeat, 31: Copter.attitude, 32: Copter.position, 49: Copter.origin, 105: Copter.imu,
    245: Copter.landed_state, 36: Copter.servos, 1: Copter.battery,
}  # fmt: skip


class Capture:
    """Packets of a stretch of time, a line each: in or out as the physics sees it, and hex."""

    def __init__(self, o: argparse.Namespace) -> None:
        self.o = o
        self.lines: list[str] = []

    def note(self, t: float, way: str, data: bytes) -> None:
        if self.o.capture and self.o.capture_from <= t < self.o.capture_from + self.o.capture_for:
            self.lines.append(f"{way} {data.hex()}")
        elif self.lines:
            with open(self.o.capture, "w") as out:
                out.write("\n".join(self.lines) + "\n")
            self.lines = []


def throw(to: Any, data: bytes) -> None:
    """Send, whether anybody is there yet or not."""
    try:
        to.send(data)
    except ConnectionRefusedError:
        time.sleep(0.05)


def ardupilot(o: argparse.Namespace) -> None:
    copter = Copter(o, False)
    physics = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    physics.connect(("127.0.0.1", o.physics))
    physics.settimeout(1.0)
    frame, last, boot, shares = 0, None, None, (0.0,) * 4
    home = (47.397742, 8.545594, 488.0)
    start: Any = None
    begun, capture = time.monotonic(), Capture(o)
    while True:
        if time.monotonic() - begun > 120:
            return
        pwm = [1000] * 16
        if copter.armed:
            for k, s in enumerate(shares):
                c = (-0.35 + math.sqrt(0.35**2 + 4 * 0.65 * s)) / (2 * 0.65)
                pwm[k] = int(1000 + 1000 * (0.15 + 0.8 * c))
        copter.pwm = pwm[:4]
        packet = struct.pack("<HHI16H", 18458, 1000, frame, *pwm)
        if o.hostile and frame % 50 == 7:
            for bad in (
                b"",
                b"\x00" * 40,
                packet[:-3],
                packet + b"x" * 2000,
                struct.pack("<HHI16H", 18458, 1000, frame, *[65535] * 16),
            ):
                throw(physics, bad)
            throw(physics, packet)  # and once more than needed
        throw(physics, packet)
        try:
            data = physics.recv(4096)
        except (TimeoutError, ConnectionRefusedError):
            if start is None:
                time.sleep(0.1)
            continue
        if not data:
            continue
        begun = time.monotonic()
        if not (data.startswith(b"\n") and data.endswith(b"\n")) or b": " in data:
            sys.exit(f"not as SIM_JSON reads it: {data!r}")
        m = json.loads(data)
        t = m["timestamp"]
        first = last is None
        if first:
            last, boot, start = t, t, (t, time.monotonic())
            copter.e.origin = (home[0] + math.degrees(m["position"][0] / 6378137.0),
                               home[1] + math.degrees(m["position"][1] / (6378137.0 * math.cos(math.radians(home[0])))),
                               home[2] - m["position"][2])  # fmt: skip
            place = m["position"]
        dt, last = t - last, t
        capture.note(t, "in", packet)
        capture.note(t, "out", data)
        e = copter.e
        e.q, e.w, e.v = tuple(m["quaternion"]), tuple(m["imu"]["gyro"]), tuple(m["velocity"])
        e.f = tuple(m["imu"]["accel_body"])
        e.x = tuple(a - b for a, b in zip(m["position"], place))
        if first or dt > 0:  # an answer that was answered before says the same time again
            frame += 1
            if frame % PAUSE == PAUSE - 1:
                time.sleep(0.05 + 0.1 * (frame // PAUSE % 2))
            copter.us = round((t - boot + o.boot) * 1e6)
            copter.hear()
            shares = copter.control(dt)
            copter.stream()
        if o.die_at and t > o.die_at:
            return
        if o.restart_at and t > o.restart_at:
            frame, o.restart_at = 0, 0
        if o.speedup:
            ahead = start[1] + (t - start[0]) / o.speedup - time.monotonic()
            if ahead > 0:
                time.sleep(ahead)


def px4(o: argparse.Namespace) -> None:
    if o.etc is not None and not (
        pathlib.Path(o.etc).is_absolute() and (pathlib.Path(o.etc) / "init.d-posix/rcS").exists()
    ):
        sys.exit(f"ERROR: no start script at {o.etc}/init.d-posix/rcS")
    copter = Copter(o, True)
    deadline = time.monotonic() + 120
    while True:
        physics = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            physics.connect(("127.0.0.1", o.physics))
            break
        except OSError:
            physics.close()
            time.sleep(0.1)
            if time.monotonic() > deadline:
                return
    physics.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    capture = Capture(o)
    out, parser, sensors = mav.MAVLink(None, o.instance + 1, 1), mav.MAVLink(None), 0
    physics.sendall(mav.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3).pack(out))
    physics.sendall(mav.MAVLink_command_long_message(0, 0, 511, 0, 115, 5000, 0, 0, 0, 0, 0).pack(out))
    while True:
        data = physics.recv(65536)
        if not data:
            return
        for m in parser.parse_buffer(data) or []:
            kind = m.get_type()
            capture.note(m.time_usec * 1e-6 if hasattr(m, "time_usec") else 0.0, "out", bytes(m.get_msgbuf()))
            if kind == "HIL_GPS":
                copter.e.gps(m)
            if kind != "HIL_SENSOR":
                continue
            dt = (m.time_usec - copter.us) * 1e-6 if copter.us else 0.004
            copter.us = m.time_usec
            sensors += 1
            copter.e.still = not copter.armed
            copter.e.imu(m, dt)
            copter.hear()
            shares = copter.control(dt)
            copter.stream()
            if o.die_at and m.time_usec > o.die_at * 1e6:
                return
            if sensors < 20:  # nothing comes before the allocator runs
                continue
            if sensors % PAUSE == PAUSE - 1:
                time.sleep(0.05 + 0.1 * (sensors // PAUSE % 2))
            if sensors % UNANSWERED == UNANSWERED - 1:
                continue
            controls = [math.sqrt(s) for s in shares] + [0.0] * 12
            copter.pwm = [round(1000 + 1000 * c) for c in controls[:4]]
            flags = 129 if copter.armed else 1
            if o.hostile and sensors % 50 == 7:
                physics.sendall(b"\xfd\x10garbage" + bytes(30))
                for c in ([math.nan] * 16, [1e30] * 16):
                    physics.sendall(mav.MAVLink_hil_actuator_controls_message(m.time_usec, c, flags, 1).pack(out))
                physics.sendall(
                    mav.MAVLink_hil_actuator_controls_message(m.time_usec + 10**9, controls, flags, 1).pack(out)
                )
            answer = mav.MAVLink_hil_actuator_controls_message(m.time_usec, controls, flags, 1).pack(out)
            capture.note(m.time_usec * 1e-6, "in", answer)
            physics.sendall(answer)


def main() -> None:
    p = argparse.ArgumentParser()
    p.add_argument("kind", choices=("ardupilot", "px4"))
    p.add_argument("--instance", type=int, default=0)
    p.add_argument("--physics", type=int, required=True)
    p.add_argument("--mavlink", type=int, required=True)
    p.add_argument("--speedup", type=float, default=0.0)
    p.add_argument("--ready", type=float, default=3.0, help="s after boot, when the estimator has a position")
    p.add_argument("--boot", type=float, default=0.0, help="s that its clock is ahead, as ArduPilot")
    p.add_argument("--mass", type=float, default=0.755)
    p.add_argument("--max-thrust", type=float, default=25.0)
    p.add_argument("--inertia", type=float, nargs=3, default=(0.557e-2, 0.557e-2, 1.05e-2))
    p.add_argument("--defaults", help="a file of parameters; without it, it has been set up")
    p.add_argument("--etc", help="PX4's folder of start scripts")
    p.add_argument("--bandwidth", type=float, default=0.0)
    p.add_argument("--damping", type=float, default=0.0)
    p.add_argument("--delay", type=float)
    p.add_argument("--die-at", type=float, default=0.0)
    p.add_argument("--restart-at", type=float, default=0.0)
    p.add_argument("--capture")
    p.add_argument("--capture-from", type=float, default=10.0)
    p.add_argument("--capture-for", type=float, default=0.1)
    p.add_argument("--hostile", action="store_true")
    o = p.parse_args()
    (ardupilot if o.kind == "ardupilot" else px4)(o)


if __name__ == "__main__":
    main()
