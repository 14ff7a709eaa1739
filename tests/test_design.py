"""Gains and the sampled loop."""

from pathlib import Path
from typing import get_args

import control
import numpy as np
import pytest
from conftest import irregular
from scipy import linalg

from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control import riccati
from cablequad.control.control_step import Measurement, Memory, Sample, control_step, first_memory
from cablequad.control.design import (
    Design,
    Weights,
    continuous_law,
    flown_model,
    loop_gains,
    sampled_law,
    sampled_loop,
    state_space,
)
from cablequad.control.law import LAWS, SAMPLED, Loop
from cablequad.control.single_vehicle import Goals, fly_each, integrated, quickness
from cablequad.control.trajectory import Limits, Reference, at, leg
from cablequad.model.attitude import Airframe, Setpoint, flown
from cablequad.model.controllability import OUTPUTS, controllable, integrable_outputs
from cablequad.model.state import State
from cablequad.model.stiffness import stable_substep, stiffest_mode
from cablequad.model.system import Cable, Payload, Quadrotor, System
from missions.analysis.replay_control import redecide
from missions.flight.run import Options, Progress, run
from missions.scenario import flights, laws
from missions.scenario import loading as scenarios
from missions.scenario.mission_setup import contingencies
from missions.scenario.tables import ControlTable

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


@pytest.mark.parametrize(("bandwidth", "delay"), [(2.0, 5), (4.0, 8), (6.0, 0), (10.2, 2), (12.9, 2), (40.0, 1)])
def test_a_vehicle_by_itself_comes_to_its_goal_however_late_its_attitude_answers(bandwidth: float, delay: int) -> None:
    """A heavy one was flown by the gains of a light one, and circled about its goal."""
    period = 0.02
    design = sampled_law(PAPER, airframe(4, bandwidth), Weights(), period, delay)
    n, R = 4, np.tile(np.eye(3), (4, 1, 1))
    goals = Goals(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.ones(n))
    x, v, phi, rate, integral = (np.zeros((n, 3)) for _ in range(5))
    x[:, 0] = 0.3
    under_way = [np.zeros((n, 3))] * delay
    steps, way = 20, []
    slow = 1.0 / float(quickness(design)[0])
    for _ in range(round(12.0 * slow / period)):
        integral = integrated(design, integral, x, goals)
        A = fly_each(design, x, v, R, integral, goals, R).A / PAPER.m[:, None]
        under_way = [*under_way, A * [1.0, 1.0, 0.0]]
        acts = under_way.pop(0)
        for _ in range(steps):
            h = period / steps
            rate = rate + h * (bandwidth**2 * (acts - phi) - 2.0 * 0.9 * bandwidth * rate)
            phi = phi + h * rate
            v = v + h * phi
            x = x + h * v
        way.append(x[0, 0])
    assert min(way) > -0.15
    assert np.abs(way[-round(2.0 * slow / period) :]).max() < 0.01


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_sampled_gains_make_the_loop_as_flown_stable(delay: int) -> None:
    loop = sampled_loop(PAPER, airframe(4), 0.004, delay)
    gains = loop_gains(sampled_law(PAPER, airframe(4), Weights(), 0.004, delay), loop)
    assert np.abs(np.linalg.eigvals(loop.A - loop.B @ gains)).max() < 1


@pytest.mark.parametrize("system", [PAPER, System.paper(2), irregular()], ids=["1", "2", "irregular"])
def test_riccati_solutions_are_those_of_the_control_library(system: System) -> None:
    """Whose solvers are by the pencil's eigenvalues."""
    A, B = state_space(system)
    reached = controllable(system)
    onto, back = linalg.block_diag(*[reached.coordinates] * 2), linalg.block_diag(*[reached.shapes] * 2)
    A, B, R = onto @ A @ back, onto @ B, np.diag(np.linspace(0.5, 2.0, B.shape[1]))
    Q = back.T @ back
    G = B @ np.linalg.solve(R, B.T)
    theirs = control.care(A, B, Q, R)[0]
    assert riccati.continuous(A, G, Q) == pytest.approx(theirs, rel=1e-8, abs=1e-8 * np.abs(theirs).max())
    loop = sampled_loop(system, airframe(len(system.m)), 0.004, 1)
    Q, G = np.eye(len(loop.A)), loop.B @ np.linalg.solve(R, loop.B.T)
    X = riccati.discrete(loop.A, G, Q)
    K, theirs = np.linalg.solve(R + loop.B.T @ X @ loop.B, loop.B.T @ X @ loop.A), control.dlqr(loop.A, loop.B, Q, R)[0]
    assert np.linalg.norm(K - theirs) < 1e-3 * np.linalg.norm(theirs)  # links weigh much here: theirs are no more exact
    left = loop.A.T @ X @ np.linalg.solve(np.eye(len(X)) + G @ X, loop.A) + Q - X
    assert np.abs(left).max() < 1e-9 * np.abs(X).max()


def test_a_system_that_cannot_be_stabilised_has_no_riccati_solution() -> None:
    grows, nothing = np.diag([1.5, 0.5]), np.zeros((2, 2))
    for solve, A in ((riccati.discrete, grows), (riccati.continuous, np.diag([0.5, -0.5]))):
        with pytest.raises(np.linalg.LinAlgError, match="no stabilising solution"):
            solve(A, nothing, np.eye(2))


@pytest.mark.parametrize("link_kg", [5e-5, 1e-6, 0.0])
def test_threads_beside_30_g_vehicles_have_gains(link_kg: float) -> None:
    """Their undamped modes lie at the stability boundary, where solvers by eigenvalues refuse."""
    load = Payload(0.048, (2e-4, 2e-4, 3e-4), [(0.1, 0.1, 0.0), (-0.1, 0.1, 0.0), (-0.1, -0.1, 0.0), (0.1, -0.1, 0.0)])
    quadrotor, cable = Quadrotor(0.03, (1.6e-5, 1.6e-5, 2.9e-5)), Cable([link_kg] * 5, [0.1] * 5)
    system = System.of(load, [quadrotor] * 4, [cable] * 4)
    stock = Airframe(np.full(4, 10.0), np.full(4, 0.9), np.full(4, 0.62))
    loop = sampled_loop(system, stock, 0.02, 1)
    gains = loop_gains(sampled_law(system, stock, Weights(), 0.02, 1), loop)
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


class Counting:
    """A law of somebody else's: ours, and it counts."""

    def __init__(self) -> None:
        self.designed = self.begun = self.decided = 0

    def design(self, system: System, loop: Loop) -> Design:
        self.designed += 1
        return SAMPLED.design(system, loop)

    def first(self, design: Design) -> Memory:
        self.begun += 1
        return SAMPLED.first(design)

    def step(
        self, design: Design, memory: Memory, measurement: Measurement, reference: Reference
    ) -> tuple[Memory, Sample]:
        self.decided += 1
        return SAMPLED.step(design, memory, measurement, reference)


@pytest.mark.parametrize("scenario", ["paper-case-1-50hz", "ground-to-ground"])
def test_a_row_in_the_table_of_laws_is_flown_rolled_out_and_replayed(
    scenario: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    law = Counting()
    monkeypatch.setitem(LAWS, "sampled", law)
    flight = scenarios.load(scenario, duration_s=2.0 if scenario.startswith("paper") else None)
    summary, _ = run(flight, Options(out=tmp_path, in_process=True), Progress())
    assert summary.log is not None
    assert law.decided > 90
    flown, law.decided = law.decided, 0
    assert redecide(Path(summary.log)).decisions <= law.decided + 1
    assert law.decided > 0.8 * flown
    n = len(flight.system.m)
    assert law.designed in (1, n + 1)  # also for those that are left where one is lost; the replay knows them


def test_the_law_of_those_that_are_left_is_that_of_all() -> None:
    base = scenarios.load("ground-to-ground").scenario
    printed = base.model_copy(update={"control": base.control.model_copy(update={"law": "paper"})})
    flight = flights.flight_of(printed, "printed")
    planned = contingencies(flight, laws.design(flight))
    assert planned.law is LAWS["paper"]
    assert len(planned.designs) > 1
    for design in planned.designs.values():
        assert not design.K_integral.any()


def test_a_scenario_may_name_every_law_that_there_is() -> None:
    assert set(get_args(ControlTable.model_fields["law"].annotation)) == set(LAWS)
