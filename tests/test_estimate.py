"""The observer: what is hidden is named, and what is estimated comes close to what is true."""

import numpy as np
import pytest

from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.control_step import Measurement, control_step, first_memory
from cablequad.control.design import Weights, sampled_law
from cablequad.control.estimator import Belief, corrected, estimator, first_belief, nothing_measured, predicted
from cablequad.control.trajectory import Limits, Reference, at, leg
from cablequad.model import lie
from cablequad.model.attitude import Airframe, Setpoint
from cablequad.model.noise import Noise
from cablequad.model.state import State, positions, velocities
from cablequad.model.system import Cable, Payload, Quadrotor, System, box_inertia

NOISE = Noise(0.01, 0.02, np.radians(0.5), np.radians(1.0))


def carried(attachments: list[tuple[float, float, float]]) -> System:
    n = len(attachments)
    quadrotor, cable = Quadrotor(0.755, (0.557e-2, 0.557e-2, 1.05e-2)), Cable([0.01] * 5, [0.15] * 5)
    load = Payload(0.5, box_inertia(0.5, (0.6, 0.8, 0.2)), attachments)
    return System.of(load, [quadrotor] * n, [cable] * n)


def airframe(n: int) -> Airframe:
    return Airframe(np.full(n, 10.0), np.full(n, 0.9), np.full(n, 25.0))


def test_what_the_vehicles_do_not_show_is_named() -> None:
    one, four = carried([(0.0, 0.0, -0.1)]), System.paper(1)
    assert estimator(one, airframe(1), 0.01, "vehicles", NOISE).hidden == ("load yaw",)
    assert estimator(one, airframe(1), 0.01, "fleet", NOISE).hidden == ()
    assert estimator(four, airframe(4), 0.01, "vehicles", NOISE).hidden == ()


@pytest.mark.parametrize(("sensing", "limit_deg"), [("full", 1.0), ("fleet", 3.0), ("vehicles", 5.0)])
def test_links_are_estimated_from_noisy_measurements(sensing: str, limit_deg: float) -> None:
    """Along a leg at 100 Hz; measured 0.2, 0.8 and 1.2 degrees rms after the first second."""
    system, rng = System.paper(1), np.random.default_rng(4)
    air = airframe(4)
    design = sampled_law(system, air, Weights(), 0.01, 1)
    path = leg((0, 0, 0), (2, 1, -0.5), Limits())
    filter = estimator(system, air, 0.01, sensing, NOISE).filter  # type: ignore[arg-type]
    belief, before, errors = None, None, []
    for sample in rollout(design, air, lambda t: at(path, t), State.hanging(system), LoopTiming(0.01, 10, 1), 500):
        s = sample.state
        seen = nothing_measured(system)._replace(
            x=positions(system, s)[:, 0] + NOISE.position * rng.normal(size=(4, 3)),
            v=velocities(system, s)[:, 0] + NOISE.velocity * rng.normal(size=(4, 3)),
            R=np.stack([R @ lie.exp(NOISE.attitude * rng.normal(size=3)) for R in s.R]),
            Omega=s.Omega + NOISE.rate * rng.normal(size=(4, 3)),
        )
        if sensing != "vehicles":
            seen = seen._replace(
                x0=s.x0 + NOISE.position * rng.normal(size=3), v0=s.v0 + NOISE.velocity * rng.normal(size=3),
                R0=s.R0 @ lie.exp(NOISE.attitude * rng.normal(size=3)), Omega0=s.Omega0 + NOISE.rate * rng.normal(size=3),
            )  # fmt: skip
        if sensing == "full":
            seen = seen._replace(q=s.q, omega=s.omega)
        if belief is None:
            belief = first_belief(filter, seen)
        elif before is not None:
            belief = corrected(filter, predicted(filter, belief, before, 0.001, 10), seen)
        assert belief is not None
        before = Setpoint.attitude(sample.memory.R_c[0], sample.memory.f[0])  # acts from this tick on
        if sample.t > 1.0:
            cosine = np.clip(np.sum(belief.state.q * s.q, axis=-1), -1, 1)
            errors.append(np.mean(np.arccos(cosine) ** 2))
    assert np.degrees(np.sqrt(np.mean(errors))) < limit_deg


def test_a_steady_wind_on_the_load_is_found_and_its_cables_lean_as_they_do() -> None:
    """0.5 N on a load of 0.5 kg: supposed to hang straight, its cables would be 6 degrees off for good."""
    system, air = System.paper(1), airframe(4)
    design = sampled_law(system, air, Weights(), 0.01, 1)
    filter = estimator(system, air, 0.01, "fleet", NOISE).filter
    wind = np.zeros((5, 3))
    wind[4] = 0.5, 0.0, 0.0
    truth, belief = Belief(State.hanging(system), wind), None
    memory, still = first_memory(design), Reference(np.zeros(3), np.zeros(3))
    for k in range(1200):
        s = truth.state
        seen = nothing_measured(system)._replace(
            x=positions(system, s)[:, 0], v=velocities(system, s)[:, 0], R=s.R, Omega=s.Omega,
            x0=s.x0, v0=s.v0, R0=s.R0, Omega0=s.Omega0,
        )  # fmt: skip
        belief = first_belief(filter, seen) if belief is None else corrected(filter, belief, seen)
        assert belief is not None
        acts = Setpoint.attitude(memory.R_c[0], memory.f[0])
        memory, _ = control_step(memory, Measurement(0.01 * k, s), still, design)
        truth, belief = predicted(filter, truth, acts, 0.001, 10), predicted(filter, belief, acts, 0.001, 10)
    assert belief is not None
    leans = np.degrees(np.arccos(truth.state.q[:, :, 2]))
    off = np.degrees(np.linalg.norm(belief.state.q - truth.state.q, axis=2))
    assert leans.min() > 4.0
    assert off.max() < 0.1
    assert belief.force[4] == pytest.approx(wind[4], abs=0.02)


@pytest.mark.parametrize("n", [4, 6])
def test_forces_that_only_share_the_load_differently_are_not_estimated(n: int) -> None:
    """Nothing measured shows them: a belief of them would grow without end, and its gains with it."""
    ring = 2.0 * np.pi * np.arange(n) / n
    system = carried([(0.4 * np.cos(a), 0.4 * np.sin(a), -0.1) for a in ring])
    gain = estimator(system, airframe(n), 0.02, "fleet", NOISE).filter.gain
    on_forces = gain[-3 * (n + 1) :]
    turned = np.zeros((3 * (n + 1), 3))
    for k, weights in enumerate((np.ones(n), np.cos(ring), np.sin(ring))):
        turned[2 : 3 * n : 3, k] = weights
    vertical = np.zeros((len(turned), n))
    vertical[2 : 3 * n : 3] = np.eye(n)
    sharing = vertical - turned @ np.linalg.lstsq(turned, vertical, rcond=None)[0]
    assert np.abs(sharing.T @ on_forces).max() < 1e-9 * np.abs(on_forces).max()
    assert np.abs(gain).max() < 100.0
