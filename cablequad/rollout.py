"""A flight with no wire in it: tick and step in a for-loop, with the same rates, delay and attitude loops."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from cablequad.attitude import Airframe, Setpoint, fly
from cablequad.design import Design
from cablequad.geometric import AttitudeCommand
from cablequad.integrate import scratch, step
from cablequad.paper_law import Gains, commands
from cablequad.pilot import Measurement, Sample, first_memory, tick
from cablequad.state import State
from cablequad.trajectory import Reference
from cablequad.types import Array

HELD_TICKS = 200


class Timing(NamedTuple):
    """The rates of a sampled loop."""

    period: float  # s between decisions
    steps: int  # physics steps per period
    delay: int = 1  # ticks: a setpoint computed from tick k acts from tick k + delay


def rollout(
    design: Design,
    airframe: Airframe,
    plan: Callable[[float], Reference],
    initial: State,
    timing: Timing,
    ticks: int,
) -> Iterator[Sample]:
    """The samples of ticks 0 .. `ticks`, the state stepped between them by the design's own model.

    Before the release the pilot already answers the initial state, for long enough that its commands under way at t = 0
    are steady.
    """
    system = design.system
    h = timing.period / timing.steps
    state = initial.copy()
    work = scratch(system, state)
    memory, sample = tick(first_memory(design), Measurement(0.0, initial, held=True), plan(0.0), design)
    for _ in range(HELD_TICKS):
        memory, sample = tick(memory, Measurement(0.0, initial, held=True), plan(0.0), design)
    under_way = [Setpoint.attitude(sample.R_c, sample.f)] * timing.delay
    for k in range(ticks + 1):
        t = k * timing.period
        memory, sample = tick(memory, Measurement(t, state.copy()), plan(t), design)
        yield sample
        under_way.append(Setpoint.attitude(sample.R_c, sample.f))
        fly(system, airframe, under_way.pop(0), state, h, timing.steps, work)


def paper_flight(
    design: Design, gains: Gains, x0_d: Array, initial: State, h: float, steps: int
) -> Iterator[tuple[State, list[AttitudeCommand]]]:
    """The paper's own loop: f_i and M_i of Section IV computed at every physics step of `h` s and held over it."""
    state = initial.copy()
    for _ in range(steps):
        command, frames = commands(design, gains, x0_d, state)
        yield state, frames
        state = step(design.system, state, command, h)
