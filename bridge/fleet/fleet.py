"""n autopilots, from the first heartbeat to armed in OFFBOARD (PX4) or GUIDED (ArduCopter), and to hold at the end.

No socket and no clock in here. Each vehicle walks the same stages; a stage sends its request every `RETRY_S` until what
it waits for is seen, and gives up after `GIVE_UP_S` with one line that names the vehicle and why. Mode and arming are
judged by HEARTBEAT alone. Times are seconds of the vehicles' clock.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from bridge.fleet.profiles import NEEDED_STREAMS, PROFILES, STREAMS_US
from bridge.fleet.readback import Readback
from bridge.fleet.setpoint_batch import Setpoints
from bridge.fleet.thrust_commands import ThrustCommands
from bridge.fleet.vehicle import ASK, RETRIES_S, TOGETHER, Request, Stage, Vehicle, because, command
from bridge.wire.dialect import mavlink
from bridge.wire.messages import TEXT_BYTES
from bridge.wire.values import (
    IN_AIR,
    BatteryStatus,
    CommandAck,
    GpsFix,
    Heartbeat,
    LandedState,
    ParamSet,
    ParamValue,
    StatusText,
    Timesync,
    VehicleAttitude,
    VehiclePosition,
)
from cablequad.control.control_step import Sample
from cablequad.control.estimator import Sensing
from cablequad.types import Array

SYSTEM, COMPONENT = 250, 191
TRACKER = 200
RETRY_S = 0.5
STREAM_FIRST_S = 1.0  # setpoints flow this long before the mode is asked for
HEARTBEAT_S = 1.0
SILENT_S = 3.0
GAP_S = 0.5  # a clock that goes on by more at once was not heard meanwhile
POSITION_GAP_M = 0.5  # a vehicle further than this from where its cable puts it is not flown

REBOOT_MS = 1000  # a vehicle's clock that goes back by more has begun anew
LOST_TWICE = 2
RETURNS_S = 1.5  # a vehicle that its failsafe took may come back when it hears us again
PATIENT_TICKS = 40  # that a stage may take beside its seconds: what is asked is answered a tick later
FORCE = 21196.0  # of a disarming in flight
FIX_3D = 3
THRUST_NOT_CLIMB = 8  # in ArduCopter's GUID_OPTIONS


class FleetOptions(NamedTuple):
    """How a fleet is flown."""

    configure: bool = False  # parameters that a vehicle needs to be flown are set, not only asked for
    sensing: Sensing = "full"  # "vehicles": no payload tracker is needed
    grounded: bool = False  # a mission, which says when to arm and may go on without a vehicle
    airborne: bool = False  # a mission that begins with a load that hangs
    density_ratio: float = 1.0  # of the air where it flies to that at sea level
    attitude_rate: int = 1  # attitudes a control period
    expected: tuple[Mapping[str, float], ...] = ()  # parameters that each vehicle was started with: they are read back


USUAL = FleetOptions()
_RESULTS = {1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed"}


class _Outbox:
    """What waits to be sent or told."""

    def __init__(self) -> None:
        self.requests: list[Request] = []
        self.heartbeat_at = 0.0
        self.texts: list[tuple[int, StatusText]] = []
        self.setpoints_since = math.inf


class _Heard:
    """What was heard of the payload tracker, and of the clock."""

    def __init__(self) -> None:
        self.tracker = False
        self.on_stands = False  # as far as the tracker says
        self.now = 0.0  # of the vehicles' clock


class Fleet:
    """The protocol side of n vehicles: `feed` what they say, send what is `due`."""

    def __init__(self, max_thrust_N: list[float], period_s: float, options: FleetOptions = USUAL) -> None:
        """`max_thrust_N` of each vehicle, in the air where it flies.

        A flight begins when all carry themselves, a mission from the ground when all are armed. Without cables
        measured, positions are in the loop.
        """
        self.failure: str | None = None
        self.incomplete = ""  # what keeps the state from being whole, in words
        self.released_at: float | None = None
        self.flying = False  # whether every vehicle that is not lost carries itself under our command
        self.may_arm = not options.grounded
        self.departed: dict[int, tuple[float, str]] = {}  # vehicles (from 0) that do something else: when to act, why
        self.astray: set[int] = set()  # vehicles (from 0) that do not know where they are
        self._options, self._period_s = options, period_s
        self._vehicles = [Vehicle(i + 1) for i in range(len(max_thrust_N))]
        self._thrust = ThrustCommands(max_thrust_N, options.density_ratio)
        self._readbacks = [Readback(expected) for expected in options.expected]
        self._outbox = _Outbox()
        self._lost: set[int] = set()
        self._heard = _Heard()

    @property
    def _intervals_us(self) -> dict[int, int]:
        """Of the messages that are asked for."""
        o, period_us = self._options, round(self._period_s * 1e6)
        intervals = {msgid: asked or period_us for msgid, asked in STREAMS_US.items()}
        intervals[mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION] = period_us // o.attitude_rate
        if o.sensing != "full" or o.grounded:
            intervals[mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED] = period_us
        return intervals

    @property
    def stages(self) -> list[Stage]:
        """Where each vehicle is."""
        return [v.stage for v in self._vehicles]

    @property
    def _airborne(self) -> bool:
        """Whether a flight begins in the air."""
        return self._options.airborne or not self._options.grounded

    @property
    def _own(self) -> list[Vehicle]:
        """Those that are not lost."""
        return [v for v in self._vehicles if v.system - 1 not in self._lost]

    @property
    def all_landed(self) -> bool:
        """Whether every vehicle that is not lost says that it stands on the ground."""
        return all(v.landed != IN_AIR for v in self._own)

    def place(self, i: int) -> Array | None:
        """Where vehicle i (from 0) said last that it is, (3,) m, W; a lost one goes on saying so."""
        return self._vehicles[i].place

    @property
    def n(self) -> int:
        """How many vehicles there are."""
        return len(self._vehicles)

    @property
    def batteries(self) -> list[float]:
        """What each vehicle says is left of its battery, 0 .. 1; 1 where it says nothing."""
        return [v.battery for v in self._vehicles]

    def not_ready(self) -> list[str]:
        """What keeps vehicles from being armed, one line each."""
        waiting = [
            v for v in self._vehicles if v.stage < Stage.CONTROL or (v.stage is Stage.CONTROL and not self._done(v, 0))
        ]
        if self.incomplete and any(v.stage is Stage.SETPOINTS for v in waiting):
            return [f"a complete state of vehicles, load and cables: {self.incomplete}"]
        return [f"vehicle {v.system} waits for {v.waits_for() or 'its first heartbeat'}{because(v)}" for v in waiting]

    def disarm(self, now: float) -> None:
        """Stop the motors of everyone, on the ground."""
        for v in self._own:
            if v.stage < Stage.ARM:
                self._move(v, Stage.DONE)
            elif v.stage in (Stage.ARM, Stage.FLY):
                self._enter(v, Stage.DISARM, now)

    def lose(self, i: int, hooks: bool, stop: bool) -> None:
        """Vehicle i (from 0) is given up: where there are hooks it lets go of its cable, and it stops its motors

        (`stop`) or lands by itself.
        """
        self._lost.add(i)
        v = self._vehicles[i]
        self._move(v, Stage.DONE)
        if stop:
            end = command(v, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, FORCE)
        else:
            end = command(v, mavlink.MAV_CMD_NAV_LAND)
        for _ in range(LOST_TWICE):  # a frame may be lost
            if hooks:
                self._outbox.requests.append(Request(v.system, command(v, mavlink.MAV_CMD_DO_GRIPPER, 1, 0)))
            self._outbox.requests.append(Request(v.system, end))

    @property
    def at_rest(self) -> bool:
        """Whether every vehicle that answers has taken over by itself (hold), or never was in command."""
        return all(v.stage is Stage.DONE or v.stage <= Stage.ARM for v in self._vehicles)

    def unheard(self) -> list[str]:
        """Who has not been heard yet: `vehicle k` or `the payload tracker`."""
        missing = [f"vehicle {v.system}" for v in self._vehicles if v.stage is Stage.HEARTBEAT]
        return (
            missing if self._heard.tracker or self._options.sensing == "vehicles" else [*missing, "the payload tracker"]
        )

    def feed(self, source: int, component: int, value: Any, now: float) -> None:
        """Take one value from system `source`."""
        self._hear_clock(now)
        if source == TRACKER:
            self._heard.tracker = True
            if isinstance(value, LandedState):
                self._heard.on_stands = value.landed != IN_AIR
                self._begin_in_air(now)
        if not 1 <= source <= len(self._vehicles) or component != 1:
            return
        v = self._vehicles[source - 1]
        v.heard_at = now
        match value:
            case VehicleAttitude():
                self._clock(v, value.boot_ms)
            case Heartbeat():
                self._heartbeat(v, value, now)
            case CommandAck():
                self._ack(v, value)
            case ParamValue() if v.profile is not None:
                if self._readbacks:
                    self._readbacks[source - 1].take(value, v.profile.bytewise)
                if value.name in v.profile.parameters:
                    self._parameter(v, value)
            case Timesync() if value.tc1 == 0:
                self._outbox.requests.append(Request(source, Timesync(round(now * 1e9), value.ts1)))
            case LandedState():
                v.landed = value.landed
                self._begin_in_air(now)
            case VehiclePosition():
                v.place = value.x
            case BatteryStatus():
                v.battery = value.remaining if value.remaining >= 0.0 else v.battery
            case GpsFix():
                (self.astray.discard if value.fix >= FIX_3D else self.astray.add)(source - 1)
            case StatusText():
                v.text = v.text + value.text if value.chunk > 0 else value.text
                if value.id == 0 or len(value.text) < TEXT_BYTES:
                    self._outbox.texts.append((source, value._replace(text=v.text)))
                    if value.severity <= 4:
                        v.refusal = v.text
            case _:
                pass

    def _begin_in_air(self, now: float) -> None:
        """A flight that starts in the air begins when everyone says that it flies, and no stand holds them."""
        flies = all(u.landed == IN_AIR for u in self._vehicles) and not self._heard.on_stands
        if self._airborne and self.released_at is None and flies:
            self.released_at = now
            self._consider()

    def texts(self) -> list[tuple[int, StatusText]]:
        """STATUSTEXTs since the last call, with their vehicle."""
        out, self._outbox.texts = self._outbox.texts, []
        return out

    def not_taken(self) -> list[tuple[int, list[str]]]:
        """Parameters that a vehicle was started with and did not take, with its system, once all of its are read."""
        out = []
        for k, readback in enumerate(self._readbacks):
            if readback.done and readback.wrong:
                out.append((k + 1, readback.wrong))
                readback.wrong = []
        return out

    def observed(self, now: float, gaps_m: list[float]) -> None:
        """A complete state was seen and answered; `gaps_m` is each vehicle's distance from where its cable puts it."""
        self._outbox.setpoints_since = min(self._outbox.setpoints_since, now)
        for v, gap in zip(self._vehicles, gaps_m, strict=True):
            if gap > POSITION_GAP_M and v.stage is Stage.SETPOINTS:
                self._fail(f"vehicle {v.system} reports a position {gap:.2f} m from where its cable puts it")

    def due(self, now: float) -> list[Request]:
        """What to send now; also moves stages on and notices who is silent or stuck."""
        self._hear_clock(now)
        out, self._outbox.requests = self._outbox.requests, []
        if now >= self._outbox.heartbeat_at:
            self._outbox.heartbeat_at = now + HEARTBEAT_S
            beat = Heartbeat(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
            )
            out.append(Request(None, beat))
        for v in self._vehicles:
            if v.stage is not Stage.FLY:
                self._advance(v, now)
        for v in self._vehicles:
            if v.stage in ASK and now >= v.next_try:
                v.next_try = now + RETRIES_S.get(v.stage, RETRY_S)
                out += [Request(v.system, value) for value in ASK[v.stage](v, self._intervals_us)]
            self._watch(v, now)
            if self._readbacks and v.stage > Stage.PARAMETERS and not self._readbacks[v.system - 1].done:
                out += [Request(v.system, value) for value in self._readbacks[v.system - 1].due(v.system, now)]
        return out

    def setpoints(self, sample: Sample, boot_ms: int) -> Setpoints:
        """The attitude-and-thrust setpoints of a decision. Raises WireError where one is not finite."""
        return self._thrust.setpoints(sample, boot_ms)

    def hold(self, now: float) -> None:
        """Ask every vehicle in command to take over by itself."""
        for v in self._vehicles:
            if v.stage is Stage.FLY:
                v.heartbeat = None  # only what is heard from now on says that it holds
                self._enter(v, Stage.HOLD, now)

    # -- inside --------------------------------------------------------------------------------------------------------

    def _hear_clock(self, now: float) -> None:
        """Time that went by unheard (before the first word of the clock, or while its sender was silent) is nobody's

        fault: no vehicle was silent or slow in it.
        """
        gap = now - self._heard.now
        if gap <= 0.0:
            return
        if gap > GAP_S:
            for v in self._vehicles:
                v.heard_at += gap
                v.since += gap
            self.departed = {k: (act_at + gap, why) for k, (act_at, why) in self.departed.items()}
        self._heard.now = now

    def _fail(self, text: str) -> None:
        if self.failure is None:
            self.failure = text

    def _depart(self, v: Vehicle, text: str, now: float, patience_s: float = 0.0) -> None:
        """A mission may go on without a vehicle that does something else; any other flight ends."""
        if self._options.grounded:
            self.departed.setdefault(v.system - 1, (now + patience_s, text))
        else:
            self._fail(f"vehicle {v.system} {text}")

    def _enter(self, v: Vehicle, stage: Stage, now: float) -> None:
        v.since, v.next_try, v.refusal = now, now, ""
        self._move(v, stage)

    def _move(self, v: Vehicle, stage: Stage) -> None:
        v.stage = stage
        self._consider()

    def _consider(self) -> None:
        """Whether they fly is asked many times a tick, and changes a few times in a flight."""
        self.flying = self.released_at is not None and all(v.stage is Stage.FLY for v in self._own)

    def _heartbeat(self, v: Vehicle, beat: Heartbeat, now: float) -> None:
        v.heartbeat = beat
        if v.profile is None:
            profile = PROFILES.get(beat.autopilot)
            if profile is None:
                known = " and ".join(f"{p.name} ({number})" for number, p in PROFILES.items())
                self._fail(f"vehicle {v.system} is autopilot type {beat.autopilot}; {known} can be flown")
                return
            v.is_a(profile)
        assert v.profile is not None
        if v.stage is Stage.HEARTBEAT:
            self._enter(v, Stage.STREAMS, now)
        elif v.system - 1 in self._lost:
            pass
        elif v.stage is Stage.FLY and not beat.armed and self.released_at is None and v.landed != IN_AIR:
            self._enter(v, Stage.ARM, now)  # idle for too long while others got ready
        elif v.stage is Stage.FLY and beat.armed and beat.custom_mode == v.profile.control[1]:
            self.departed.pop(v.system - 1, None)
        elif v.stage is Stage.FLY and not beat.armed:
            self._depart(v, f"disarmed in flight{because(v)}", now)
        elif v.stage is Stage.FLY and beat.custom_mode != v.profile.control[1]:
            self._depart(v, f"left {v.profile.control[0]}{because(v)}", now, RETURNS_S)

    def _parameter(self, v: Vehicle, value: ParamValue) -> None:
        number = value.value
        if not math.isfinite(number):
            v.refusal = f"parameter {value.name} is {number:g}"
            return
        if value.name == "GUID_OPTIONS" and not int(number) & THRUST_NOT_CLIMB:
            if not self._options.configure:
                self._fail(
                    f"vehicle {v.system}: GUID_OPTIONS is {number:g}, so thrust would mean climb rate; "
                    f"set it to {int(number) | THRUST_NOT_CLIMB}, or fly with --configure"
                )
                return
            wish = float(int(number) | THRUST_NOT_CLIMB)
            self._outbox.requests.append(Request(v.system, ParamSet(v.system, 1, value.name, wish, value.type)))
            return  # the vehicle's answer to this one says whether it took it
        v.parameters[value.name] = number
        if v.profile is not None:
            self._thrust.learn(v)

    def _clock(self, v: Vehicle, boot_ms: int) -> None:
        if boot_ms < v.clock_ms - REBOOT_MS and v.stage < Stage.HOLD:
            self._fail(
                f"vehicle {v.system} rebooted: its clock went back from {v.clock_ms / 1000:.2f} s "
                f"to {boot_ms / 1000:.2f} s"
            )
        v.clock_ms = max(v.clock_ms, boot_ms)

    def _ack(self, v: Vehicle, ack: CommandAck) -> None:
        if ack.system not in (0, SYSTEM):
            return
        if ack.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL and v.streams_left:
            msgid = v.streams_left[0]  # one question at a time: an ack does not say which message it is about
            if ack.result == 0 or msgid not in NEEDED_STREAMS:
                v.streams_left.pop(0)
                v.next_try = 0.0
            else:
                v.refusal = f"message {msgid} {_RESULTS.get(ack.result, ack.result)}"
        elif ack.result in _RESULTS and not v.refusal:
            v.refusal = f"command {ack.command} {_RESULTS[ack.result]}"

    def _done(self, v: Vehicle, now: float) -> bool:
        """Whether what the vehicle's stage waits for has been seen."""
        beat = v.heartbeat
        match v.stage:
            case Stage.STREAMS:
                return not v.streams_left
            case Stage.PARAMETERS:
                return v.missing_parameter() is None
            case Stage.SETPOINTS:
                return now - self._outbox.setpoints_since >= STREAM_FIRST_S
            case Stage.CONTROL:
                return beat is not None and v.profile is not None and beat.custom_mode == v.profile.control[1]
            case Stage.ARM:
                return v.landed == IN_AIR or (beat is not None and beat.armed)  # who flies is armed
            case Stage.DISARM:
                return beat is not None and not beat.armed
            case Stage.HOLD:
                holding = v.profile is not None and beat is not None and beat.custom_mode == v.profile.hold[1]
                return holding or (beat is not None and not beat.armed)
            case _:
                return False

    def _advance(self, v: Vehicle, now: float) -> None:
        if not self._done(v, now):
            return
        following = Stage.DONE if v.stage in (Stage.HOLD, Stage.DISARM) else Stage(v.stage + 1)
        if following is Stage.ARM and not self.may_arm:
            v.since = now
            return
        others_done = all(u.stage > v.stage or (u.stage is v.stage and self._done(u, now)) for u in self._vehicles)
        if following in TOGETHER and not others_done:
            v.since = now  # its own part is done; it waits for the others
            return
        self._enter(v, following, now)
        if not self._airborne and self.released_at is None and all(u.stage is Stage.FLY for u in self._vehicles):
            self.released_at = now
            self._consider()

    def _watch(self, v: Vehicle, now: float) -> None:
        limit = v.gives_up_s() + PATIENT_TICKS * self._period_s
        if now - v.since > limit and (wait := v.waits_for()):
            if v.stage is Stage.SETPOINTS and self.incomplete:
                self._fail(f"waited {limit:.0f} s for {wait}: {self.incomplete}")
            self._fail(f"vehicle {v.system}: waited {limit:.0f} s for {wait}{because(v)}")
            if v.stage in (Stage.HOLD, Stage.DISARM):
                self._move(v, Stage.DONE)
        if v.stage > Stage.HEARTBEAT and v.stage is not Stage.DONE and now - v.heard_at > SILENT_S:
            self._depart(v, f"is silent since t = {v.heard_at:.2f} s of its clock", now)
            if v.stage in (Stage.HOLD, Stage.DISARM):
                self._move(v, Stage.DONE)
