"""How to fly, and whom to tell how it goes."""

import math
from dataclasses import dataclass
from pathlib import Path

from bridge.loop.fly import STALL_S
from bridge.mission.mission import Script
from bridge.wire.link import Endpoint
from missions.flight.processes.simulate import Backend


@dataclass(frozen=True)
class Options:
    """How to fly."""

    connect: tuple[Endpoint, ...] = ()
    out: Path = Path("runs")
    speed: float = math.inf  # inf: lockstep, as fast as the machine allows
    port_offset: int = 0
    configure: bool = True  # set the parameters that a vehicle needs to be flown
    signing_key: bytes | None = None
    accept_unsigned_telemetry: bool = False
    live: bool = False  # shown in the viewer that is open
    backend: Backend = "builtin"  # who flies the vehicles
    launch: Path | None = None  # the autopilots' binary or build folder; None: somebody else starts them
    in_process: bool = False  # vehicles and log in this process and thread, joined in memory
    stall_timeout_s: float = STALL_S  # wall clock, that a simulator in lockstep may stand still
    script: Script | None = None  # that flies a mission, instead of the flight's own


class Progress:
    """What a flight tells while it goes on; the base class is silent."""

    def say(self, text: str) -> None:
        """A line for the user."""

    def doing(self, text: str) -> None:
        """What is being done, or waited for, until something else is."""

    def flown(self, t: float, duration: float, error_m: float, factor: float) -> None:
        """How far the flight is."""
