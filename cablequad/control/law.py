"""What a law of control is, and the laws there are: another one is a file and a row of `LAWS`.

Flights, rollouts, margins, drills and replays all decide through `Controller`; parameters and memory are values.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from cablequad.control.control_step import Measurement, Memory, Sample, control_step, first_memory
from cablequad.control.design import Design, Weights, continuous_law, sampled_law
from cablequad.control.trajectory import Reference
from cablequad.model.attitude import Airframe
from cablequad.model.system import System


class Loop(NamedTuple):
    """What a law is designed for, beside the system."""

    airframe: Airframe
    weights: Weights
    period: float  # s
    delay: int  # ticks until a command acts


class Controller(Protocol):
    """A law of control."""

    def design(self, system: System, loop: Loop) -> Design:
        """Its parameters. Raises DesignError where none stabilise, EquilibriumError where there is no equilibrium."""

    def first(self, design: Design) -> Memory:
        """What it knows before its first decision."""

    def step(
        self, design: Design, memory: Memory, measurement: Measurement, reference: Reference
    ) -> tuple[Memory, Sample]:
        """What it knows afterwards, and its decision; nothing that is passed in changes."""


class StateFeedback:
    """A law of gains on the state around the formation that the reference asks."""

    def __init__(self, gains: Callable[[System, Airframe, Weights, float, int], Design]) -> None:
        self._gains = gains

    def design(self, system: System, loop: Loop) -> Design:
        """The gains; see `Controller`."""
        return self._gains(system, loop.airframe, loop.weights, loop.period, loop.delay)

    def first(self, design: Design) -> Memory:
        """Nothing under way, no integrals."""
        return first_memory(design)

    def step(
        self, design: Design, memory: Memory, measurement: Measurement, reference: Reference
    ) -> tuple[Memory, Sample]:
        """One decision; see `control_step`."""
        return control_step(memory, measurement, reference, design)


SAMPLED: Controller = StateFeedback(sampled_law)
LAWS: dict[str, Controller] = {"sampled": SAMPLED, "paper": StateFeedback(continuous_law)}
