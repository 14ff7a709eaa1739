"""The firmware that vehicles may have: one row for each, that everything else looks up here.

By `cablequad identify` with four ArduCopter 4.7-dev and four PX4 main of August 2025 at their usual gains, hovering on
slack cables behind our physics: 12.4 to 13.4 rad/s, damping 0.83 to 0.86, 43 to 55 ms; 10.1 to 10.4 rad/s, 1.06 to
1.08, 33 to 37 ms. Attitudes and positions against the truth of flights of Case 1 and ground-to-ground: the tilt of each
PX4 is off by its own 0.09 to 0.24 deg; that of all ArduCopters by the same 0.08 to 0.19 deg, which leans no cable
against another, and their heading by 0.8 to 1 deg. All ArduCopters say that they are 12 to 14 cm higher than they are.
"""

from collections.abc import Callable
from typing import NamedTuple

from sitl.firmware.arducopter import ArduCopter
from sitl.firmware.parameters import Parameters, arducopter_parameters, px4_parameters
from sitl.firmware.px4 import Px4


class Known(NamedTuple):
    """How an autopilot answers an attitude setpoint, and how well it knows its attitude."""

    name: str
    bandwidth_rad_s: float
    damping: float
    delay_s: float  # from the state that a setpoint answers to its first effect, rotors of 30 ms included
    own_delay_s: float  # without those: the autopilot's own, and the wire's
    wander_deg: float  # how far the estimated tilt of one vehicle is off from the others', at most
    bias_deg: float  # about each axis, one standard deviation of it
    position_offset_m: tuple[float, float, float]  # of the positions of all vehicles, by the origin that they take
    attitude_offset_deg: tuple[float, float, float]  # of all: about x and y of the body, heading
    phase_ms: float  # of its streams, modulo 20 ms
    fastest_attitude_us: int  # between two attitudes that it sends


class Persona(NamedTuple):
    """A firmware that vehicles answer as, and what is known of the real one."""

    vehicle: type[Px4] | type[ArduCopter]
    parameters: Callable[[int, float], Parameters]  # of a system id and a hover throttle
    known: Known
    backend: str  # the word for it of `--backend`
    setpoint_timeout: tuple[str, float]  # the parameter that says how long a setpoint counts, and its default, s
    serves_tcp: bool  # it waits for clients on a TCP port of its own


PERSONAS = {
    "px4": Persona(
        Px4,
        px4_parameters,
        Known("PX4", 10.2, 1.07, 0.035, 0.008, 0.2, 0.13, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 8.0, 5_000),
        "px4",
        ("COM_OF_LOSS_T", 1.0),
        False,
    ),
    "arducopter": Persona(
        ArduCopter,
        arducopter_parameters,
        Known(
            "ArduCopter", 12.9, 0.85, 0.049, 0.019, 0.02, 0.01, (-0.02, 0.005, -0.128), (0.11, 0.09, 0.86), 3.0, 5_000
        ),
        "ardupilot",
        ("GUID_TIMEOUT", 3.0),
        True,
    ),
}
