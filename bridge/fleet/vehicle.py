"""One autopilot's way from its first heartbeat to holding or disarmed: its stages, and what each asks for."""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

from bridge.fleet.profiles import NEEDED_STREAMS, Profile
from bridge.wire.dialect import mavlink
from bridge.wire.values import Command, Heartbeat, ParamRequestRead
from cablequad.types import Array

GIVE_UP_S = 8.0


class Stage(IntEnum):
    """How far a vehicle is; it moves on only when what the stage waits for has been seen."""

    HEARTBEAT = 0
    STREAMS = 1
    PARAMETERS = 2
    SETPOINTS = 3
    CONTROL = 4
    ARM = 5
    FLY = 6
    HOLD = 7
    DISARM = 8
    DONE = 9


TOGETHER = frozenset({Stage.CONTROL, Stage.ARM})  # entered only when every vehicle has finished the stage before
RETRIES_S = {Stage.ARM: 2.0}  # a refused arming is told in a STATUSTEXT each time


class Request(NamedTuple):
    """A value for one vehicle, or for every system (None)."""

    system: int | None
    value: Any


class Vehicle:
    """What is known of one autopilot, and how far it is."""

    def __init__(self, system: int) -> None:
        self.system = system
        self.stage = Stage.HEARTBEAT
        self.since = 0.0
        self.next_try = 0.0
        self.heartbeat: Heartbeat | None = None
        self.heard_at = 0.0
        self.landed = 1
        self.battery = 1.0
        self.place: Array | None = None
        self.streams_left: list[int] = []
        self.refusal = ""
        self.text = ""  # of a STATUSTEXT that comes in chunks
        self.profile: Profile | None = None
        self.parameters: dict[str, float] = {}
        self.clock_ms = -1

    def is_a(self, profile: Profile) -> None:
        """Its first heartbeat says what it is, and so what is asked of it."""
        self.profile = profile
        self.streams_left = sorted(profile.streams, key=lambda msgid: (msgid not in NEEDED_STREAMS, msgid))

    def missing_parameter(self) -> str | None:
        """The next parameter that is not known yet."""
        wanted = self.profile.parameters if self.profile is not None else ()
        return next((name for name in wanted if name not in self.parameters), None)

    def waits_for(self) -> str:
        """What the stage waits for, in words; nothing where it waits for nobody."""
        profile = self.profile
        if profile is None or self.stage is Stage.FLY:
            return ""
        return {
            Stage.STREAMS: "its streams (SET_MESSAGE_INTERVAL)",
            Stage.PARAMETERS: f"parameter {self.missing_parameter() or profile.parameters[0]}",
            Stage.SETPOINTS: "a complete state of vehicles, load and cables",
            Stage.CONTROL: f"mode {profile.control[0]}",
            Stage.ARM: "arming",
            Stage.HOLD: f"mode {profile.hold[0]}",
            Stage.DISARM: "disarming",
        }.get(self.stage, "")

    def gives_up_s(self) -> float:
        """How long the stage waits: what needs a position, as long as its estimator may take."""
        patient = self.stage in (Stage.SETPOINTS, Stage.ARM)
        return self.profile.arming_s if self.profile is not None and patient else GIVE_UP_S


def because(v: Vehicle) -> str:
    """The last refusal, in brackets."""
    return f" ({v.refusal})" if v.refusal else ""


def command(v: Vehicle, number: int, *params: float) -> Command:
    """COMMAND_LONG to the vehicle's flight controller."""
    p = (*params, *([0.0] * (7 - len(params))))
    return Command(v.system, 1, number, p[:7])  # type: ignore[arg-type]


def _ask_streams(v: Vehicle, intervals_us: dict[int, int]) -> list[Any]:
    msgid = v.streams_left[0]
    return [command(v, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, msgid, intervals_us[msgid])]


def _ask_parameter(v: Vehicle, _: dict[int, int]) -> list[Any]:
    name = v.missing_parameter()
    return [] if name is None else [ParamRequestRead(v.system, 1, name)]


def _ask_mode(v: Vehicle, mode: tuple[str, int, tuple[float, ...]]) -> list[Any]:
    return [command(v, mavlink.MAV_CMD_DO_SET_MODE, *mode[2])]


ASK: dict[Stage, Callable[[Vehicle, dict[int, int]], list[Any]]] = {
    Stage.STREAMS: _ask_streams,
    Stage.PARAMETERS: _ask_parameter,
    Stage.CONTROL: lambda v, _: [] if v.profile is None else _ask_mode(v, v.profile.control),
    Stage.ARM: lambda v, _: [command(v, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)],
    Stage.DISARM: lambda v, _: [command(v, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)],
    Stage.HOLD: lambda v, _: [] if v.profile is None else _ask_mode(v, v.profile.hold),
}
