"""`cablequad check`: what can be said of a scenario before anything flies."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from cablequad.analysis.certificate import Certificate, attitude_gains, certify, higher_order_slope
from cablequad.analysis.margins import WEAK, closed_loop_poles, largest_loss, margins, modes
from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.control_step import Sample
from cablequad.control.design import Design, Weights, loop_gains, sampled_cost, sampled_loop
from cablequad.control.law import LAWS
from cablequad.control.trajectory import Reference, at
from cablequad.model import lie
from cablequad.model.controllability import controllable
from cablequad.model.linear import equilibrium
from cablequad.model.state import State
from cablequad.model.stiffness import stiffest_mode
from missions.analysis.batch import spread
from missions.scenario import laws
from missions.scenario.feasibility import strays
from missions.scenario.flights import Flight

SETTLE_S, SETTLED_M, SETTLED_TILT = 15.0, 0.05, 0.02
BISECTIONS = 7
JUDGED_STATES = 200  # up to which `control.dlqr` takes about a second
FORCE_FACTORS = (0.1, 1.0, 10.0, 100.0, 1000.0, 10000.0)


class Direction(NamedTuple):
    """A family of initial states, and how far along it is tried."""

    name: str
    unit: str
    limit: float


DIRECTIONS = (
    Direction("load displaced along x", "m", 64.0),
    Direction("load displaced upwards", "m", 64.0),
    Direction("load rolled", "deg", 170.0),
    Direction("load yawed", "deg", 170.0),
    Direction("cables curled, the vehicle's end by", "deg", 170.0),
    Direction("vehicles pitched", "deg", 170.0),
)


def check(flight: Flight, quick: bool, tell: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
    """Everything as plain values, ready for JSON. `quick` leaves out what needs many simulated flights.

    `tell` hears what is being done.
    """
    tell("the design")
    system, c = flight.system, flight.scenario.control
    design = laws.design(flight)
    period = flight.control_us * 1e-6
    hung = equilibrium(system)
    tilt = float(np.linalg.norm(lie.log(hung.R0)))
    listed = modes(system)
    strongest = max(mode.pbh for mode in listed)
    poles = closed_loop_poles(design, flight.airframe, period, c.delay_ticks)
    # delay states at z = 0 have no continuous counterpart
    rates = np.log(poles[np.abs(poles) > 1e-9].astype(complex)) / period
    swinging = rates[np.abs(rates.imag) > 1e-6]
    tell("the nominal flight")
    nominal = _nominal(design, flight)
    tell("margins")
    out: dict[str, Any] = {
        "scenario": flight.scenario.name,
        "cannot_fly": strays(np.array([float(np.linalg.norm(s.error.x[:3])) for s in nominal])),
        "law": c.law,
        "period_ms": flight.control_us * 1e-3,
        "equilibrium": {
            "load_tilt_deg": math.degrees(tilt),
            "tension_N": hung.tension.tolist(),
            "thrust_N": (-design.u_star[:, 2]).tolist(),
            "thrust_share": (-design.u_star[:, 2] / flight.airframe.max_thrust).tolist(),
        },
        "stiffest_link_mode_rad_s": stiffest_mode(system),
        "physics_step_us": flight.physics_us,
        "modes": [
            {"pole": [m.pole.real, m.pole.imag], "pbh": m.pbh, "motion": m.motion, "weak": m.pbh < WEAK * strongest}
            for m in listed
        ],
        "out_of_reach": list(controllable(system).missing),
        "hidden": list(laws.estimator_of(flight).hidden),
        "sensing": c.sensing,
        "controllable": all(m.pbh >= WEAK * strongest for m in listed),
        "gains": {
            "K_x_norm": float(np.linalg.norm(design.K_x, 2)),
            "K_xdot_norm": float(np.linalg.norm(design.K_xdot, 2)),
            "difference_to_dlqr": _difference_to_dlqr(design, flight),
        },
        "closed_loop": {
            "spectral_radius": float(np.abs(poles).max()),
            "slowest_time_constant_s": float(-1.0 / rates.real.max()) if rates.real.max() < 0 else None,
            "least_damping_ratio": float((-swinging.real / np.abs(swinging)).min()) if len(swinging) else None,
            "poles_per_s": [[float(r.real), float(r.imag)] for r in sorted(rates, key=lambda r: -r.real)[:12]],
        },
        "margins": margins(design, flight.airframe, period, c.delay_ticks)._asdict(),
        "largest_loss": largest_loss(design, flight.airframe, period, c.delay_ticks),
        "nominal_flight": {
            "largest_psi": max(float(s.Psi.max()) for s in nominal),
            "largest_commanded_rate_rad_s": _largest_rate(nominal, period),
            "initial_z1": float(np.linalg.norm(np.concatenate([nominal[0].error.x, nominal[0].error.x_dot]))),
        },
    }
    tell("the certificate of Proposition 3")
    out["certificate"] = _certificate(flight, out["nominal_flight"], quick)
    if not quick:
        tell("what settles in simulated flights")
        out["region_of_attraction"] = spread(partial(_reach, design, flight), range(len(DIRECTIONS)))
    return out


def _paper_law(flight: Flight, weights: Weights) -> Design:
    loop = laws.designed_for(flight, flight.airframe)
    return LAWS["paper"].design(flight.system, loop._replace(weights=weights))


def _difference_to_dlqr(design: Design, flight: Flight) -> float | None:
    """How far, in relation, the gains are from those of `control.dlqr`; None for another law, or beyond its sizes."""
    period, delay = flight.control_us * 1e-6, flight.scenario.control.delay_ticks
    loop = sampled_loop(design.system, flight.airframe, period, delay)
    if flight.scenario.control.law != "sampled" or len(loop.A) > JUDGED_STATES:
        return None
    import control  # here, as it takes a second

    Q, R = sampled_cost(design.system, flight.airframe, laws.weights(flight), loop)
    try:
        K = control.dlqr(loop.A, loop.B, Q, R)[0]
    except (np.linalg.LinAlgError, ValueError, control.ControlDimension):  # poles too near to the circle for it
        return None
    return float(np.linalg.norm(loop_gains(design, loop) - K) / np.linalg.norm(K))


def _nominal(design: Design, flight: Flight) -> list[Sample]:
    """The scenario's own flight without a wire, up to 10 s."""
    period = flight.control_us * 1e-6
    timing = LoopTiming(period, flight.control_us // flight.physics_us, flight.scenario.control.delay_ticks)
    ticks = round(min(10.0, flight.scenario.duration_s) / period)
    plan = partial(at, flight.trajectory)
    law = laws.law_of(flight)
    return list(rollout(design, flight.airframe, plan, flight.initial, timing, ticks, law=law))


def _largest_rate(samples: list[Sample], period: float) -> float:
    R = np.stack([s.R_c for s in samples])
    turned = np.einsum("tiba,tibc->tiac", R[:-1], R[1:])
    cosine = np.clip(0.5 * (np.trace(turned, axis1=2, axis2=3) - 1.0), -1.0, 1.0)
    return float(np.arccos(cosine).max() / period) if len(samples) > 1 else 0.0


def _certificate(flight: Flight, nominal: dict[str, float], quick: bool) -> dict[str, Any]:
    """Proposition 3 for the paper's law with this scenario's weights, against what the nominal flight needs."""
    weights = laws.weights(flight)
    design = _paper_law(flight, weights)
    rate = nominal["largest_commanded_rate_rad_s"]
    gains = attitude_gains(flight.system, flight.airframe, rate)
    c = certify(design, weights, gains)
    slope = higher_order_slope(design, 0.01, np.random.default_rng(flight.scenario.seed), 40 if quick else 150)
    reach = [float(p.gamma / slope) for p in c.curve]
    needed_psi, needed_z = nominal["largest_psi"], nominal["initial_z1"]
    conditions = _conditions(c, reach, needed_psi, needed_z)
    certified = bool(all(condition["holds"] for condition in conditions.values()))
    out: dict[str, Any] = {
        "law": "paper's law with these weights and attitude gains",
        "certified": certified,
        "locally_stable": c.hurwitz and c.psi_1_max > 0,
        "conditions": conditions,
        "k_R": gains.k_R.tolist(),
        "k_Omega": gains.k_Omega.tolist(),
        "higher_order_slope_per_radius": slope,
    } | _figures(c, reach)
    if not certified:
        out["advice"] = _advice(flight, weights, out, rate, needed_psi=needed_psi, needed_z=needed_z, quick=quick)
    return out


def _conditions(c: Certificate, reach: list[float], needed_psi: float, needed_z: float) -> dict[str, dict[str, Any]]:
    """What the proposition asks, with the value, its bound and whether it holds."""
    conditions = {
        "A Hurwitz": [c.spectral_abscissa, "below", 0.0, c.hurwitz],
        "c_2i below its bound, W_2i positive": [
            min(a.lambda_W_2 for a in c.attitude), "above", 0.0, bool(all(a.lambda_W_2 > 0 for a in c.attitude)),
        ],
        "psi_1 for which the conditions hold covers the flight's largest Psi_i": [
            c.psi_1_max, "above", needed_psi, bool(c.psi_1_max > needed_psi),
        ],
        "region |z_1| < r(gamma) covers the initial error": [
            max(reach, default=0.0), "above", needed_z, bool(max(reach, default=0.0) > needed_z),
        ],
    }  # fmt: skip
    return {k: {"value": v[0], "side": v[1], "bound": v[2], "holds": v[3]} for k, v in conditions.items()}


def _figures(c: Certificate, reach: list[float]) -> dict[str, Any]:
    """The numbers that the certificate rests on."""
    a = c.attitude[0]
    return {
        "K_max": c.loop.K_max,
        "B_1": c.loop.B_1,
        "B_2": [x.B_2 for x in c.attitude],
        "c_2_bound": [x.c_2_bound for x in c.attitude],
        "c_2": [x.c_2 for x in c.attitude],
        "W_2": a.W_2.tolist(),
        "lambda_W_2": [x.lambda_W_2 for x in c.attitude],
        "lyapunov": [
            {
                "Q": q.name, "lambda_min_Q": q.lambda_Q, "norm_P": float(np.linalg.norm(q.P, 2)), "c_3": q.c_3,
                "norm_P_B_d": q.higher_order, "alpha_max": q.alpha_max,
            }
            for q in c.choices
        ],
        "psi_1_max": c.psi_1_max,
        "curve": [
            {
                "psi_1": p.psi_1, "gamma": p.gamma, "Q": p.Q, "scale": p.scale, "W": p.W.tolist(),
                "lambda_W_2_over_needed": p.condition, "radius": r,
            }
            for p, r in zip(c.curve, reach, strict=True)
        ],
    }  # fmt: skip


def _advice(
    flight: Flight, weights: Weights, found: dict, rate: float, needed_psi: float, needed_z: float, quick: bool
) -> list[str]:
    """Which condition fails by how much, and what gains or bandwidth would do."""
    if not found["locally_stable"]:
        return ["A is not Hurwitz: no region is certified with these gains"]
    lines = []
    psi = found["psi_1_max"]
    if psi < needed_psi:
        bandwidth = float(2 * flight.airframe.damping.max() * rate / math.sqrt(2 * psi))
        lines.append(
            f"psi_1 may be at most {psi:.1e}, the flight reaches {needed_psi:.1e}: {needed_psi / psi:.0e} times too "
            f"much. With these gains the attitude loops would need about {bandwidth:.0e} rad/s to follow {rate:.1f} "
            "rad/s that closely, and vehicles that start in their commanded attitude"
        )
    reach = max(p["radius"] for p in found["curve"])
    if reach < needed_z:
        lines.append(
            f"the certified region is |z_1| < {reach:.1e} (estimated slope), the flight starts at {needed_z:.2f}"
        )
    if not quick:
        rows = []
        for factor in FORCE_FACTORS:
            scaled = weights._replace(force=weights.force * factor)
            design = _paper_law(flight, scaled)
            c = certify(design, scaled, attitude_gains(flight.system, flight.airframe, rate))
            rows.append((c.psi_1_max, factor))
        best, factor = max(rows)
        enough = "which would do" if best > needed_psi else "which is not enough either"
        scanned = f"{FORCE_FACTORS[0]:g} .. {FORCE_FACTORS[-1]:g}"
        lines.append(
            f"of the force weights {scanned} times the scenario's, {factor:g} allows the most: psi_1 = {best:.1e}, "
            + enough
        )
    return lines


def _start(design: Design, flight: Flight, direction: int, amplitude: float) -> State:
    """At rest at the target, but for one thing that is off by `amplitude`: displaced, tilted, curled or pitched."""
    system = flight.system
    base = State.hanging(system, np.array(flight.scenario.target.position_m))._replace(R0=design.hanging.R0)
    n = len(system.m)
    turn = np.radians(amplitude)
    match direction:
        case 0:
            return base._replace(x0=base.x0 + np.array([amplitude, 0.0, 0.0]))
        case 1:
            return base._replace(x0=base.x0 - np.array([0.0, 0.0, amplitude]))
        case 2:
            return base._replace(R0=base.R0 @ lie.exp(np.array([turn, 0.0, 0.0])))
        case 3:
            return base._replace(R0=base.R0 @ lie.exp(np.array([0.0, 0.0, turn])))
        case 4:
            q = base.q.copy()
            for i in range(n):
                k = int(system.n_links[i])
                angle = turn * np.linspace(1.0, 0.1, k)
                q[i, :k] = np.stack([-np.sin(angle), np.zeros(k), np.cos(angle)], axis=1)
            return base._replace(q=q)
        case _:
            return base._replace(R=np.tile(lie.exp(np.array([0.0, turn, 0.0])), (n, 1, 1)))


def _reach(design: Design, flight: Flight, direction: int) -> dict[str, Any]:
    """The largest amplitude that settles, by bisection from the largest that is tried."""
    family = DIRECTIONS[direction]
    low, high = 0.0, family.limit
    if _settles(design, flight, _start(design, flight, direction, high)):
        low = high
    else:
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            if _settles(design, flight, _start(design, flight, direction, middle)):
                low = middle
            else:
                high = middle
    return {"direction": family.name, "unit": family.unit, "settles_up_to": low, "tried_up_to": family.limit}


def _settles(design: Design, flight: Flight, start: State) -> bool:
    period = flight.control_us * 1e-6
    timing = LoopTiming(period, flight.control_us // flight.physics_us, flight.scenario.control.delay_ticks)
    target = Reference(np.array(flight.scenario.target.position_m), np.zeros(3))
    last: Sample | None = None
    law, ticks = laws.law_of(flight), round(SETTLE_S / period)
    for last in rollout(design, flight.airframe, lambda _: target, start, timing, ticks, law=law):
        if not np.isfinite(last.e_omega) or last.e_omega > 1e4:
            return False
    return (
        last is not None
        and float(np.linalg.norm(last.error.x[:3])) < SETTLED_M
        and last.Psi_0 < SETTLED_TILT
        and float(np.linalg.norm(last.error.x_dot[:3])) < SETTLED_M
    )
