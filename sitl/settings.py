"""What a server of vehicles needs to know, and what it tells: the same for built-in vehicles and for autopilots."""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bridge.wire.link import Counters
from bridge.wire.link_faults import Faults
from cablequad.model.attitude import Airframe
from cablequad.model.earth import Home
from cablequad.model.noise import Biases, Noise
from cablequad.model.state import State
from cablequad.model.system import System
from sitl.batteries import Battery
from sitl.failures import Failure
from sitl.instruments import Grades, Instruments
from sitl.parts import Surroundings
from sitl.plant import AirMotion, Plant, Truth
from sitl.sensors import Sensors
from sitl.wind import Weather, Wind

if TYPE_CHECKING:
    from sitl.external.seats import External

HOST = "127.0.0.1"


class Settings(NamedTuple):
    """Everything the server needs to know; times are microseconds of the vehicles' clock."""

    system: System
    airframe: Airframe
    initial: State
    physics_us: int
    tick_us: int
    truth_us: int  # between the states that the sink is told; a tick is a whole number of them
    control_us: int  # the tracker's rate, which is the controller's
    delay_us: tuple[int, ...]  # of each vehicle
    phase_us: tuple[int, ...]  # of each vehicle's streams
    lockstep: bool
    await_controller: bool  # hold the clock at the first tick until a controller answers it
    speed: float  # wall-clock factor where nobody holds the clock
    answer_timeout_s: float  # wall clock: how long a tick waits for its answers
    port_offset: int = 0
    host: str = HOST
    home: Home = Home()
    firmware: tuple[str, ...] = ()  # the persona of each vehicle; px4 where it is not said
    parameters: tuple[dict[str, float], ...] = ()  # set before boot, for each vehicle
    density_ratio: float = 1.0  # of the air to that at sea level; ArduCopter makes up for it
    ready_us: tuple[int | None, ...] = ()  # when each estimator has a position; None: as the firmware takes
    untethered: bool = False  # the vehicles alone on the ground: no load, no cables, no tracker
    faults: tuple[Faults, ...] = ()  # of what each vehicle receives
    faults_down: tuple[Faults, ...] = ()  # of what each vehicle sends, for clients that have no faults of their own
    seed: int = 0
    signing_key: bytes | None = None
    accept_unsigned_telemetry: bool = False
    thrust_scale: tuple[float, ...] = ()  # N that each vehicle's rotors give for one that is asked; 1 where not said
    around: Surroundings = Surroundings()
    weather: Weather | None = None
    noise: Noise = Noise()
    biases: Biases = Biases()
    grades: Grades | None = None  # of the instruments; None: built-in vehicles have perfect ones
    batteries: tuple[Battery | None, ...] = ()
    failures: tuple[Failure, ...] = ()
    external: "External | None" = None  # autopilots of their own instead of the built-in vehicles


class Event(NamedTuple):
    """Something that happened among the vehicles."""

    boot_us: int
    kind: str
    subject: str
    text: str


class Report(NamedTuple):
    """How the server kept its time."""

    ticks: int
    missed_answers: int  # lockstep: ticks whose setpoint did not come in time
    missed_deadlines: int  # paced: ticks that began more than a tick late
    lateness_s: tuple[float, ...]  # paced: how late each tick began
    sent: int  # frames to whoever is on the vehicles' onboard links and the tracker's
    received: int  # frames on the vehicles' onboard links
    passed: int  # of those received, and let through by [faults]
    lost: int  # of those received, and taken by [faults]
    duplicated: int
    waiting: int
    refused: dict[str, int]  # frames on any port that nothing was made of, by what was wrong with them
    mishandled: dict[str, int]  # frames whose handler failed, by their message


def unread_frames(counters: Counters) -> dict[str, int]:
    """What a link made nothing of, by what was wrong with it."""
    unread = {
        "damaged": counters.bad,
        "of an unknown kind": counters.unknown,
        "with fields that make no sense": counters.meaningless,
    }
    return unread | {verdict.value: count for verdict, count in counters.refused.items()}


ServerOutput = Truth | Event | AirMotion  # what a server says to the recorder
Sink = Callable[[ServerOutput], None]


def own_generator(seed: int, what: str) -> np.random.Generator:
    """The generator of one part of the world, the same for the same seed whatever the other parts draw."""
    return np.random.default_rng([seed, *what.encode()])


def plant_of(s: Settings) -> Plant:
    """The world that the settings describe, with its load."""
    h = s.physics_us * 1e-6
    wind = Wind(s.weather, h, own_generator(s.seed, "wind")) if s.weather is not None else None
    scale = np.array(s.thrust_scale) if s.thrust_scale else None
    return Plant(s.system, s.airframe, s.initial, h, scale, s.around, wind)


def sensors_of(s: Settings) -> Sensors:
    """What is measured in that world."""
    n = len(s.system.m)
    wrong = None
    if s.biases != Biases():
        rng = own_generator(s.seed, "biases")
        b = s.biases
        wrong = (
            b.position * rng.normal(size=(n, 3)) + np.array(b.position_offset),
            b.attitude * rng.normal(size=(n, 3)) + np.array([*b.attitude_offset[:2], 0.0]),
            b.attitude_offset[2],
        )
    instruments = None
    if s.grades is not None:
        instruments = [Instruments(s.grades, own_generator(s.seed, f"instruments {i + 1}")) for i in range(n)]
    return Sensors(s.noise, own_generator(s.seed, "sensors"), wrong, instruments)
