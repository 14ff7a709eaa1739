"""Gains and the sampled loop."""

import numpy as np
import pytest
from conftest import irregular

from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.control_step import Measurement, control_step, first_memory
from cablequad.control.design import (
    Weights,
    continuous_law,
    flown_model,
    loop_gains,
    sampled_law,
    sampled_loop,
    state_space,
)
from cablequad.control.trajectory import Limits, Reference, at, leg
from cablequad.model.attitude import Airframe, Setpoint, flown
from cablequad.model.controllability import OUTPUTS, controllable, integrable_outputs
from cablequad.model.state import State
from cablequad.model.stiffness import stable_substep, stiffest_mode
from cablequad.model.system import Cable, Payload, Quadrotor, System

PAPER = System.paper(1)
TARGET = Reference(np.array([0.44, 0.78, -0.5]), np.zeros(3))


def airframe(n: int, bandwidth: float = 40.0) -> Airframe:
    return Airframe(np.full(n, bandwidth), np.full(n, 0.9), np.full(n, 25.0))


def test_continuous_gains_make_the_linear_model_stable() -> None:
    A, B = state_space(PAPER)
    design = continuous_law(PAPER, airframe(4), Weights(), 0.004, 1)
    K = np.hstack([design.K_x, design.K_xdot])
    assert np.linalg.eigvals(A).real.max() > -1e-6
    assert np.linalg.eigvals(A - B @ K).real.max() < 0


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_sampled_gains_make_the_loop_as_flown_stable(delay: int) -> None:
    loop = sampled_loop(PAPER, airframe(4), 0.004, delay)
    gains = loop_gains(sampled_law(PAPER, airframe(4), Weights(), 0.004, delay), loop)
    assert np.abs(np.linalg.eigvals(loop.A - loop.B @ gains)).max() < 1


def test_the_sampled_model_predicts_what_the_simulator_does() -> None:
    """One period of the nonlinear model with attitude loops, near hanging, against A_d z + B_d a."""
    rng = np.random.default_rng(0)
    design = sampled_law(PAPER, airframe(4), Weights(), 0.004, 0)
    _, B = flown_model(PAPER, airframe(4), 0.004, 0)
    a = 1e-3 * rng.normal(size=(4, 3))
    state = State.hanging(PAPER)
    force = design.u_star + a
    from cablequad.control.geometric import attitude_of_force

    R_c = np.stack([attitude_of_force(force[i], design.b1[i]) for i in range(4)])
    after = flown(PAPER, airframe(4), Setpoint.attitude(R_c, -force[:, 2]), state, 1e-5, 400)
    expected = B @ a.ravel()
    D = 46
    moved = np.concatenate([after.x0, after.v0])
    np.testing.assert_allclose(moved[:3], expected[:3], rtol=0, atol=1e-3 * np.abs(expected[:D]).max())
    np.testing.assert_allclose(moved[3:], expected[D : D + 3], rtol=0, atol=2e-3 * np.abs(expected[D : 2 * D]).max())
    f = -design.u_star[:, 2]
    phi = -f[:, None] * after.R[:, :2, 2]
    np.testing.assert_allclose(phi.ravel(), expected[2 * D : 2 * D + 8], rtol=0, atol=1e-2 * np.abs(phi).max())


def test_one_vehicle_cannot_turn_its_load_and_the_design_leaves_that_out() -> None:
    load = Payload(0.5, (1e-2,) * 3, [(0.0, 0.0, -0.1)])
    one = System.of(load, [Quadrotor(0.755, (5.57e-3, 5.57e-3, 1.05e-2))], [Cable([0.01] * 3, [0.2] * 3)])
    assert controllable(one).missing == ("load yaw",)
    assert [OUTPUTS[k] for k in integrable_outputs(one, controllable(one))] == ["load x", "load y", "load z"]
    design = sampled_law(one, airframe(1), Weights(), 0.004, 1)
    assert np.abs(design.K_x[:, 5]).max() < 1e-9
    target = leg((0.0, 0.0, 0.0), TARGET.x0, Limits())
    flight = rollout(design, airframe(1), lambda t: at(target, t), State.hanging(one), LoopTiming(0.004, 4, 1), 2000)
    last = list(flight)[-1]
    assert np.linalg.norm(last.error.x[:3]) < 0.01


@pytest.mark.parametrize("delay", [1, 2, 3])
def test_case_1_settles_and_its_links_stop_swinging(delay: int) -> None:
    """Designed for one tick of delay, flown with up to three."""
    design = sampled_law(PAPER, airframe(4), Weights(), 0.004, 1)
    start = State.hanging(PAPER, (1.0, 4.8, 0.0))
    way = leg(start.x0, TARGET.x0, Limits())
    samples = list(rollout(design, airframe(4), lambda t: at(way, t), start, LoopTiming(0.004, 4, delay), 2500))
    last = samples[-1]
    assert np.linalg.norm(last.error.x[:3]) < 0.02
    assert np.linalg.norm(last.state.v0) < 0.02
    assert last.e_q < 0.1
    assert last.e_omega < 0.2
    assert last.Psi.max() < 0.01
    assert max(s.f.max() for s in samples) < 25.0


def test_a_system_of_unequal_cables_flies_with_the_same_weights() -> None:
    system = irregular()
    n = len(system.m)
    rho = np.array([(0.4, 0.1, -0.1), (-0.3, 0.3, -0.05), (-0.1, -0.4, -0.1)])
    assert np.array_equal(system.rho, rho)
    design = sampled_law(system, airframe(n), Weights(), 0.004, 1)
    samples = list(rollout(design, airframe(n), lambda _: TARGET, State.hanging(system), LoopTiming(0.004, 4, 1), 2500))
    assert np.linalg.norm(samples[-1].error.x[:3]) < 0.02


def test_a_decision_depends_on_nothing_but_its_arguments() -> None:
    design = sampled_law(PAPER, airframe(4), Weights(), 0.004, 1)
    state = State.hanging(PAPER, (1.0, 4.8, 0.0))
    memory = first_memory(design)
    _, a = control_step(memory, Measurement(0.0, state), TARGET, design)
    next_memory, _ = control_step(memory, Measurement(0.0, state), TARGET, design)
    control_step(next_memory, Measurement(0.004, state), TARGET, design)
    _, b = control_step(memory, Measurement(0.0, state), TARGET, design)
    np.testing.assert_array_equal(a.A, b.A)
    np.testing.assert_array_equal(a.R_c, b.R_c)


def test_short_links_ask_for_shorter_steps() -> None:
    """80 links in 0.75 m swing at over 1000 rad/s."""
    chain = Cable([0.05 / 80] * 80, [0.75 / 80] * 80)
    stiff = System.of(Payload(0.5, (1e-2,) * 3, PAPER.rho), [Quadrotor(0.755, (5e-3, 5e-3, 9e-3))] * 4, [chain] * 4)
    assert stiffest_mode(stiff) > 1000
    assert stable_substep(stiff, 1000, 4000) * 1e-6 * stiffest_mode(stiff) < 0.5
    assert 4000 % stable_substep(stiff, 1000, 4000) == 0
    assert stable_substep(PAPER, 1000, 4000) == 1000
