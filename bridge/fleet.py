"""n autopilots, from the first heartbeat to OFFBOARD and armed, and to hold at the end. No socket and no clock in here.

Each vehicle walks the same stages; a stage sends its request every `RETRY_S` until what it waits for is seen, and gives
up after `GIVE_UP_S` with one line that names the vehicle and why. Mode and arming are judged by HEARTBEAT alone. Times
are seconds of the vehicles' clock.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

from bridge.thrust import ThrustLaw
from bridge.wire.dialect import mavlink
from bridge.wire.messages import TEXT_BYTES, attitude_target
from bridge.wire.values import (
    IN_AIR,
    Command,
    CommandAck,
    Heartbeat,
    LandedState,
    ParamRequestRead,
    ParamValue,
    StatusText,
)
from cablequad import lie
from cablequad.pilot import Sample

SYSTEM, COMPONENT = 250, 191
TRACKER = 200
RETRY_S = 0.5
GIVE_UP_S = 8.0
STREAM_FIRST_S = 1.0  # setpoints flow this long before OFFBOARD is asked for
HEARTBEAT_S = 1.0
SILENT_S = 3.0
POSITION_GAP_M = 0.5  # a vehicle further than this from where its cable puts it is not flown

OFFBOARD = 6 << 16
HOLD = 4 << 16 | 3 << 24
CONTROL_RATE = 0  # us: stands for the control period
STOP = -1
STREAMS_US = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: CONTROL_RATE,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 40_000,  # a check on the tracker, not in the loop
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: 20_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 100_000,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 100_000,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 200_000,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 200_000,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1_000_000,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 2_000_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: STOP,  # ATTITUDE_QUATERNION says the same
    mavlink.MAVLINK_MSG_ID_ODOMETRY: STOP,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: STOP,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: STOP,
}
NEEDED_STREAMS = frozenset(
    {mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED}
)  # a vehicle that refuses one of these is not flown; of the others it may have its own mind
WANTED_PARAMETER = "THR_MDL_FAC"
_RESULTS = {1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed"}


class Stage(IntEnum):
    """How far a vehicle is; it moves on only when what the stage waits for has been seen."""

    HEARTBEAT = 0
    STREAMS = 1
    PARAMETERS = 2
    SETPOINTS = 3
    OFFBOARD = 4
    ARM = 5
    FLY = 6
    HOLD = 7
    DONE = 8


WAITS_FOR = {
    Stage.HEARTBEAT: "a heartbeat",
    Stage.STREAMS: "its streams (SET_MESSAGE_INTERVAL)",
    Stage.PARAMETERS: f"parameter {WANTED_PARAMETER}",
    Stage.SETPOINTS: "a complete state of vehicles, load and cables",
    Stage.OFFBOARD: "mode OFFBOARD",
    Stage.ARM: "arming",
    Stage.HOLD: "mode HOLD",
}
TOGETHER = frozenset({Stage.OFFBOARD, Stage.ARM})  # entered only when every vehicle has finished the stage before


class Request(NamedTuple):
    """A value for one vehicle, or for every system (None)."""

    system: int | None
    value: Any


class _Vehicle:
    def __init__(self, system: int) -> None:
        self.system = system
        self.stage = Stage.HEARTBEAT
        self.since = 0.0
        self.next_try = 0.0
        self.heartbeat: Heartbeat | None = None
        self.heard_at = 0.0
        self.landed = 1
        self.streams_left = sorted(STREAMS_US, key=lambda msgid: (msgid not in NEEDED_STREAMS, msgid))
        self.refusal = ""
        self.text = ""  # of a STATUSTEXT that comes in chunks
        self.model_factor: float | None = None


class Fleet:
    """The protocol side of n vehicles: `feed` what they say, send what is `due`."""

    def __init__(self, max_thrust_N: list[float], period_s: float) -> None:
        self.n = len(max_thrust_N)
        self.failure: str | None = None
        self.released_at: float | None = None
        self._vehicles = [_Vehicle(i + 1) for i in range(self.n)]
        self._laws = [ThrustLaw(limit) for limit in max_thrust_N]
        self._interval_us = round(period_s * 1e6)
        self._setpoints_since: float | None = None
        self._next_heartbeat = 0.0
        self._tracker_heard = False
        self._texts: list[tuple[int, StatusText]] = []

    @property
    def stages(self) -> list[Stage]:
        """Where each vehicle is."""
        return [v.stage for v in self._vehicles]

    @property
    def flying(self) -> bool:
        """Whether every vehicle carries itself under our command."""
        return self.released_at is not None and all(v.stage is Stage.FLY for v in self._vehicles)

    @property
    def at_rest(self) -> bool:
        """Whether every vehicle that answers has taken over by itself (hold), or never was in command."""
        return all(v.stage is Stage.DONE or v.stage <= Stage.ARM for v in self._vehicles)

    def unheard(self) -> list[str]:
        """Who has not been heard yet: `vehicle k` or `the payload tracker`."""
        missing = [f"vehicle {v.system}" for v in self._vehicles if v.stage is Stage.HEARTBEAT]
        return missing if self._tracker_heard else [*missing, "the payload tracker"]

    def feed(self, source: int, component: int, value: Any, now: float) -> None:
        """Take one value from system `source`."""
        if source == TRACKER:
            self._tracker_heard = True
        if not 1 <= source <= self.n or component != 1:
            return
        v = self._vehicles[source - 1]
        v.heard_at = now
        match value:
            case Heartbeat():
                self._heartbeat(v, value, now)
            case CommandAck():
                self._ack(v, value)
            case ParamValue() if value.name == WANTED_PARAMETER:
                v.model_factor = value.value
                self._laws[source - 1] = self._laws[source - 1]._replace(model_factor=value.value)
            case LandedState():
                v.landed = value.landed
                if self.released_at is None and all(u.landed == IN_AIR for u in self._vehicles):
                    self.released_at = now
            case StatusText():
                v.text = v.text + value.text if value.chunk > 0 else value.text
                if value.id == 0 or len(value.text) < TEXT_BYTES:
                    self._texts.append((source, value._replace(text=v.text)))
                    if value.severity <= 4:
                        v.refusal = v.text
            case _:
                pass

    def texts(self) -> list[tuple[int, StatusText]]:
        """STATUSTEXTs since the last call, with their vehicle."""
        out, self._texts = self._texts, []
        return out

    def observed(self, now: float, gaps_m: list[float]) -> None:
        """A complete state was seen and answered; `gaps_m` is each vehicle's distance from where its cable puts it."""
        if self._setpoints_since is None:
            self._setpoints_since = now
        for v, gap in zip(self._vehicles, gaps_m, strict=True):
            if gap > POSITION_GAP_M and v.stage is Stage.SETPOINTS:
                self._fail(f"vehicle {v.system} reports a position {gap:.2f} m from where its cable puts it")

    def due(self, now: float) -> list[Request]:
        """What to send now; also moves stages on and notices who is silent or stuck."""
        out: list[Request] = []
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + HEARTBEAT_S
            beat = Heartbeat(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
            )
            out.append(Request(None, beat))
        for v in self._vehicles:
            self._advance(v, now)
        for v in self._vehicles:
            if v.stage in _ASK and now >= v.next_try:
                v.next_try = now + RETRY_S
                out += [Request(v.system, value) for value in _ASK[v.stage](v, self._interval_us)]
            self._watch(v, now)
        return out

    def setpoints(self, sample: Sample, boot_ms: int) -> list[Request]:
        """The attitude-and-thrust setpoints of a decision, one a vehicle. Raises WireError where one is not finite."""
        quats = lie.quats_from_rotations(sample.R_c).tolist()
        thrusts = sample.f.tolist()
        return [
            Request(i + 1, attitude_target(boot_ms, i + 1, quats[i], law.field(thrusts[i])))
            for i, law in enumerate(self._laws)
        ]

    def hold(self, now: float) -> None:
        """Ask every vehicle in command to take over by itself."""
        for v in self._vehicles:
            if v.stage is Stage.FLY:
                v.heartbeat = None  # only what is heard from now on says that it holds
                self._enter(v, Stage.HOLD, now)

    # -- inside --------------------------------------------------------------------------------------------------------

    def _fail(self, text: str) -> None:
        if self.failure is None:
            self.failure = text

    def _enter(self, v: _Vehicle, stage: Stage, now: float) -> None:
        v.stage, v.since, v.next_try, v.refusal = stage, now, now, ""

    def _heartbeat(self, v: _Vehicle, beat: Heartbeat, now: float) -> None:
        v.heartbeat = beat
        if beat.autopilot != mavlink.MAV_AUTOPILOT_PX4:
            self._fail(f"vehicle {v.system} is autopilot type {beat.autopilot}; only PX4 (12) can be flown")
        if v.stage is Stage.HEARTBEAT:
            self._enter(v, Stage.STREAMS, now)
        elif v.stage is Stage.FLY and not beat.armed:
            self._fail(f"vehicle {v.system} disarmed in flight{_because(v)}")
        elif v.stage is Stage.FLY and beat.custom_mode != OFFBOARD:
            self._fail(f"vehicle {v.system} left OFFBOARD{_because(v)}")

    def _ack(self, v: _Vehicle, ack: CommandAck) -> None:
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

    def _done(self, v: _Vehicle, now: float) -> bool:
        """Whether what the vehicle's stage waits for has been seen."""
        beat = v.heartbeat
        match v.stage:
            case Stage.STREAMS:
                return not v.streams_left
            case Stage.PARAMETERS:
                return v.model_factor is not None
            case Stage.SETPOINTS:
                return self._setpoints_since is not None and now - self._setpoints_since >= STREAM_FIRST_S
            case Stage.OFFBOARD:
                return beat is not None and beat.custom_mode == OFFBOARD
            case Stage.ARM:
                return v.landed == IN_AIR or (beat is not None and beat.armed)  # who flies is armed
            case Stage.HOLD:
                return beat is not None and (beat.custom_mode == HOLD or not beat.armed)
            case _:
                return False

    def _advance(self, v: _Vehicle, now: float) -> None:
        if not self._done(v, now):
            return
        following = Stage(v.stage + 1)
        others_done = all(u.stage > v.stage or (u.stage is v.stage and self._done(u, now)) for u in self._vehicles)
        if following in TOGETHER and not others_done:
            v.since = now  # its own part is done; it waits for the others
            return
        self._enter(v, following, now)

    def _watch(self, v: _Vehicle, now: float) -> None:
        if v.stage in WAITS_FOR and v.stage is not Stage.HEARTBEAT and now - v.since > GIVE_UP_S:
            self._fail(f"vehicle {v.system}: waited {GIVE_UP_S:.0f} s for {WAITS_FOR[v.stage]}{_because(v)}")
            if v.stage is Stage.HOLD:
                v.stage = Stage.DONE
        if v.stage > Stage.HEARTBEAT and v.stage is not Stage.DONE and now - v.heard_at > SILENT_S:
            self._fail(f"vehicle {v.system} is silent since t = {v.heard_at:.2f} s of its clock")
            if v.stage is Stage.HOLD:
                v.stage = Stage.DONE


def _because(v: _Vehicle) -> str:
    return f" ({v.refusal})" if v.refusal else ""


def _command(v: _Vehicle, command: int, *params: float) -> Command:
    p = (*params, *([0.0] * (7 - len(params))))
    return Command(v.system, 1, command, p[:7])  # type: ignore[arg-type]


def _ask_streams(v: _Vehicle, interval_us: int) -> list[Any]:
    msgid = v.streams_left[0]
    asked_us = STREAMS_US[msgid] or interval_us
    return [_command(v, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, msgid, asked_us)]


_ASK: dict[Stage, Callable[[_Vehicle, int], list[Any]]] = {
    Stage.STREAMS: _ask_streams,
    Stage.PARAMETERS: lambda v, _: [ParamRequestRead(v.system, 1, WANTED_PARAMETER)],
    Stage.OFFBOARD: lambda v, _: [_command(v, mavlink.MAV_CMD_DO_SET_MODE, 1, 6)],
    Stage.ARM: lambda v, _: [_command(v, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)],
    Stage.HOLD: lambda v, _: [_command(v, mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 3)],
}
