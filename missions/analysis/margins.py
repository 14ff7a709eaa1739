"""`cablequad margins`: how much delay, loss and wrong modelling a scenario's loop stands, predicted and measured.

Predicted: the linear sampled loop (`cablequad.analysis.margins`) and what the rotors can carry. Measured: the
nonlinear model in flights without a wire, from rest beside the target, by bisection. A flight holds where it comes to
the target and its cables do not swing up.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cablequad.analysis.margins import largest_loss, margins, mismatched, unstable_from
from cablequad.analysis.rollout import LoopTiming, Mismatch, rollout
from cablequad.control.design import Design
from cablequad.control.trajectory import Reference
from cablequad.model.attitude import Airframe
from cablequad.model.linear import EquilibriumError, equilibrium, equilibrium_forces
from cablequad.model.state import State
from cablequad.model.system import System
from cablequad.types import Array
from missions.analysis.batch import spread
from missions.scenario import laws
from missions.scenario.flights import Flight, system_of

FLOWN_S, LAST_S = 25.0, 5.0
HELD_M = 0.05  # from the target at the end
KICK_M = (0.1, 0.1, 0.1)
QUIET_RAD_S, GROWN = 0.2, 1.15  # link rates: below is quiet, more than this times those before is growing
BISECTIONS = 6
MOST_TICKS = 25


class Quantity(NamedTuple):
    """Something that may be wrong, and how far it is tried."""

    name: str
    unit: str
    nominal: float
    far: float
    whole: bool = False  # ticks


QUANTITIES = (
    Quantity("delay on top", "ticks", 0.0, MOST_TICKS, True),
    Quantity("loss of setpoints", "share", 0.0, 0.99),
    Quantity("thrust stronger", "factor", 1.0, 6.0),
    Quantity("thrust weaker", "factor", 1.0, 0.05),
    Quantity("payload heavier", "factor", 1.0, 12.0),
    Quantity("payload lighter", "factor", 1.0, 0.02),
)


class Tried(NamedTuple):
    """One flight."""

    value: float
    held: bool
    error_m: float  # largest over the last seconds; inf where it flew apart


def measure(flight: Flight, design: Design | None = None, bisections: int = BISECTIONS) -> dict[str, Any]:
    """Predicted and measured margins of a flight as plain values, ready for JSON; the more `bisections` the finer."""
    design = design or laws.design(flight)
    period_ms = flight.control_us * 1e-3
    rows = spread(partial(_row, design, flight, bisections), range(len(QUANTITIES)))
    return {
        "scenario": flight.scenario.name,
        "law": flight.scenario.control.law,
        "period_ms": period_ms,
        "kick_m": list(KICK_M),
        "flown_s": FLOWN_S,
        "margins": rows,
    }


def _row(design: Design, flight: Flight, bisections: int, which: int) -> dict[str, Any]:
    quantity = QUANTITIES[which]
    predicted, bound = _predicted(design, flight, which)
    tried: list[Tried] = []

    def holds(value: float) -> bool:
        outcome = _flown(design, flight, which, value)
        tried.append(outcome)
        return outcome.held

    reached = _bisected(quantity, holds, bisections)
    more = reached == quantity.far
    return {
        **quantity._asdict(), "predicted": predicted, "bound": bound, "measured": reached, "tried_all": more,
        "flights": [t._asdict() for t in sorted(tried)],
    }  # fmt: skip


def _bisected(quantity: Quantity, holds: Callable[[float], bool], bisections: int = BISECTIONS) -> float:
    """The furthest value that holds; NaN where not even the nominal one does."""
    good, bad = quantity.nominal, quantity.far
    if not holds(good):
        return float("nan")
    if holds(bad):
        return bad
    while (abs(bad - good) > 1.0) if quantity.whole else (abs(bad - good) > abs(quantity.far - 1) / 2**bisections):
        middle = 0.5 * (good + bad)
        middle = float(round(middle)) if quantity.whole else middle
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good


def _predicted(design: Design, flight: Flight, which: int) -> tuple[float, str]:
    """The linear loop's answer, and what sets it."""
    quantity, airframe = QUANTITIES[which], flight.airframe
    period, delay = flight.control_us * 1e-6, flight.scenario.control.delay_ticks
    match which:
        case 0:
            return float(margins(design, airframe, period, delay).delay_ticks_all), "poles of the delayed loop"
        case 1:
            return largest_loss(design, airframe, period, delay), "mean square of the loop with held setpoints"
        case 2 | 3:

            def loop(value: float) -> Array:
                return mismatched(design, airframe, period, delay, value, design.system)

            def carried(value: float) -> bool:
                return _carries(design, design.system, airframe, value)
        case _:

            def loop(value: float) -> Array:
                return mismatched(design, airframe, period, delay, 1.0, system_of(flight.scenario, value))

            def carried(value: float) -> bool:
                return _carries(design, system_of(flight.scenario, value), airframe, 1.0)

    stable = unstable_from(loop, quantity.nominal, quantity.far, 12)
    lifts = _bisected(quantity, carried)
    if abs(lifts - quantity.nominal) < abs(stable - quantity.nominal):
        return lifts, "authority at rest"
    return stable, "poles of the loop" if stable != quantity.far else "nothing that was tried"


def _carries(design: Design, system: System, airframe: Airframe, scale: float) -> bool:
    """Whether `system` hangs at rest on thrusts that the rotors make and the design asks without its integrals."""
    try:
        asked = -equilibrium_forces(system, equilibrium(system))[:, 2] / scale
    except EquilibriumError:
        return False
    limits = design.authority
    return bool(np.all((asked <= airframe.max_thrust) & (asked <= limits.most) & (asked >= limits.least)))


def _flown(design: Design, flight: Flight, which: int, value: float) -> Tried:
    period, delay = flight.control_us * 1e-6, flight.scenario.control.delay_ticks
    real, extra = Mismatch(seed=flight.scenario.seed), 0
    match which:
        case 0:
            extra = round(value)
        case 1:
            real = real._replace(loss=value)
        case 2 | 3:
            real = real._replace(thrust_scale=value)
        case _:
            real = real._replace(system=system_of(flight.scenario, value))
    target = np.array(flight.scenario.target.position_m)
    hung = State.hanging(design.system, target)
    start = hung._replace(R0=design.hanging.R0, x0=target + np.array(KICK_M)).copy()
    timing = LoopTiming(period, flight.control_us // flight.physics_us, delay + extra)
    errors, rates = [], []
    still, ticks, law = Reference(target, np.zeros(3)), round(FLOWN_S / period), laws.law_of(flight)
    for sample in rollout(design, flight.airframe, lambda _: still, start, timing, ticks, real=real, law=law):
        if not np.isfinite(sample.e_omega) or sample.e_omega > 1e4:
            return Tried(value, False, float("inf"))
        errors.append(float(np.linalg.norm(sample.state.x0 - target)))
        rates.append(sample.e_omega)
    last = round(LAST_S / period)
    swing, before = (float(np.sqrt(np.mean(np.square(part)))) for part in (rates[-last:], rates[-2 * last : -last]))
    worst = max(errors[-last:])
    return Tried(value, worst < HELD_M and (swing < QUIET_RAD_S or swing < GROWN * before), worst)


def plot(result: dict[str, Any], path: Path) -> None:
    """One panel a quantity: every flight's largest error at its end, and the margin as predicted and as measured."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 3)
    outcomes = ((True, "o", "#0072b2", "comes to rest"), (False, "x", "#d55e00", "does not"))
    for ax, row in zip(axes.T.ravel(), result["margins"], strict=True):
        for held, marker, shade, label in outcomes:
            points = [(f["value"], f["error_m"]) for f in row["flights"] if f["held"] == held]
            x = [p[0] for p in points]
            y = [min(max(100 * p[1], 1e-2), 1e4) for p in points]
            ax.plot(x, y, marker, color=shade, label=label)
        ax.axvline(row["predicted"], color="0.35", linestyle="--", label="predicted")
        ax.axvline(row["measured"], color="#0072b2", linewidth=1.2, label="measured")
        ax.axhline(100 * HELD_M, color="0.8", linewidth=0.8)
        ax.set(yscale="log", ylim=(8e-3, 2e4), xlabel=f"{row['name']} [{row['unit']}]")
        ax.set_ylabel(f"largest error, last {LAST_S:.0f} s [cm]")
        ax.grid(alpha=0.25)
    axes[0, 0].legend(loc="upper left", fontsize=8)
    figure.suptitle(f"{result['scenario']}: margins of the sampled loop ({result['period_ms']:g} ms)")
    figure.savefig(path, dpi=130)
