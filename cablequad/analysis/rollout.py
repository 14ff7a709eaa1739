"""A flight with no wire in it: tick and step in a for-loop, with the same rates, delay and attitude loops."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from cablequad.control.control_step import Measurement, Sample
from cablequad.control.design import Design
from cablequad.control.geometric import AttitudeCommand
from cablequad.control.law import SAMPLED, Controller
from cablequad.control.paper_law import Gains, commands
from cablequad.control.trajectory import Reference
from cablequad.model.attitude import Airframe, Setpoint, fly
from cablequad.model.integrate import scratch, step
from cablequad.model.state import State
from cablequad.model.system import System
from cablequad.types import Array

HELD_TICKS = 200


class LoopTiming(NamedTuple):
    """The rates of a sampled loop."""

    period: float  # s between decisions
    steps: int  # physics steps per period
    delay: int = 1  # ticks: a setpoint computed from tick k acts from tick k + delay


class Mismatch(NamedTuple):
    """What flies, where it differs from what the design was told."""

    system: System | None = None
    thrust_scale: float = 1.0  # N made per N asked
    loss: float = 0.0  # share of ticks whose setpoints never arrive; those before hold
    seed: int = 0


def rollout(
    design: Design,
    airframe: Airframe,
    plan: Callable[[float], Reference],
    initial: State,
    timing: LoopTiming,
    ticks: int,
    real: Mismatch | None = None,
    law: Controller = SAMPLED,
) -> Iterator[Sample]:
    """The samples of ticks 0 .. `ticks`, the state stepped between them by the design's own model or by what is `real`.

    Before the release the pilot already answers the initial state, for long enough that its commands under way at t = 0
    are steady.
    """
    real = real or Mismatch()
    system = real.system or design.system
    rng = np.random.default_rng(real.seed)
    h = timing.period / timing.steps
    state = initial.copy()
    work = scratch(system, state)
    at_start = Measurement(0.0, initial, restrained=True)
    memory, sample = law.step(design, law.first(design), at_start, plan(0.0))
    for _ in range(HELD_TICKS):
        memory, sample = law.step(design, memory, at_start, plan(0.0))
    under_way = [Setpoint.attitude(sample.R_c, real.thrust_scale * sample.f)] * timing.delay
    last = Setpoint.attitude(sample.R_c, real.thrust_scale * sample.f)
    for k in range(ticks + 1):
        t = k * timing.period
        memory, sample = law.step(design, memory, Measurement(t, state.copy()), plan(t))
        yield sample
        sent = Setpoint.attitude(sample.R_c, real.thrust_scale * sample.f)
        last = last if real.loss > 0.0 and rng.random() < real.loss else sent
        under_way.append(last)
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
