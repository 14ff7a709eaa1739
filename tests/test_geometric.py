"""Section IV: commanded frames, their rates, forces and moments."""

import numpy as np
import pytest
from conftest import random_state
from hypothesis import given
from hypothesis import strategies as st

from cablequad.analysis.rollout import paper_flight
from cablequad.control.design import Weights, continuous_law
from cablequad.control.geometric import (
    AttitudeCommand,
    attitude_command,
    attitude_error,
    attitude_of_force,
    moment,
    thrust,
)
from cablequad.control.paper_law import Gains, commands, ideal_forces
from cablequad.model import lie
from cablequad.model.attitude import Airframe
from cablequad.model.integrate import step
from cablequad.model.state import State
from cablequad.model.system import System

GAINS = Gains(np.full(4, 900 * 0.557e-2), np.full(4, 54 * 0.557e-2))
E1 = np.array([1.0, 0.0, 0.0])


@given(st.integers(0, 2**32))
def test_commanded_frame_is_a_rotation_with_thrust_along_the_ideal_force(seed: int) -> None:
    A = np.random.default_rng(seed).normal(size=3) * 5 + [0, 0, -9]
    R_c = attitude_of_force(A, E1)
    np.testing.assert_allclose(R_c.T @ R_c, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(R_c) == pytest.approx(1.0)
    np.testing.assert_allclose(-R_c[:, 2], A / np.linalg.norm(A), rtol=0, atol=1e-14)
    assert thrust(A, R_c) == pytest.approx(np.linalg.norm(A))
    assert abs(R_c[:, 0] @ np.cross(R_c[:, 2], E1)) < 1e-14  # the nose lies in the plane of b_3 and b_1


@given(st.integers(0, 2**32))
def test_commanded_rates_are_the_derivatives_of_the_commanded_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(3, 3))

    def A(t: float) -> np.ndarray:
        return np.array([0, 0, -9.0]) + a * np.sin(t) + b * np.cos(2 * t) + c * t**2

    def at(t: float) -> AttitudeCommand:
        A_dot = a * np.cos(t) - 2 * b * np.sin(2 * t) + 2 * c * t
        A_ddot = -a * np.sin(t) - 4 * b * np.cos(2 * t) + 2 * c
        return attitude_command(A(t), A_dot, A_ddot, E1)

    h, now = 1e-5, at(0.3)
    turned = lie.log(at(0.3 - h).R_c.T @ at(0.3 + h).R_c) / (2 * h)
    np.testing.assert_allclose(now.Omega_c, turned, rtol=0, atol=1e-7)
    np.testing.assert_allclose(
        now.Omega_c_dot, (at(0.3 + h).Omega_c - at(0.3 - h).Omega_c) / (2 * h), rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(now.R_c, attitude_of_force(A(0.3), E1), rtol=0, atol=1e-14)


def airframe(max_thrust: float) -> Airframe:
    return Airframe(np.full(4, 40.0), np.full(4, 0.9), np.full(4, max_thrust))


@pytest.mark.parametrize("curl", [0.002, 0.3, 1.0])
def test_ideal_forces_derivatives_are_those_along_the_true_closed_loop(curl: float) -> None:
    """From R_i, through accelerations and jerks, to A_ddot: against differences of the flown motion."""
    rng = np.random.default_rng(3)
    system = System.paper(1)
    design = continuous_law(system, airframe(1e9), Weights(), 0.004, 1)
    state = random_state(system, rng, rate=1.0)
    q = np.array([0.0, 0.0, 1.0]) + curl * rng.normal(size=state.q.shape)
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    omega = state.omega - np.sum(state.omega * q, axis=-1, keepdims=True) * q
    small = np.stack([lie.exp(0.3 * rng.normal(size=3)) for _ in range(4)])
    state = state._replace(q=q, omega=omega, R=small, R0=lie.exp(curl * rng.normal(size=3)))
    x0_d = np.zeros(3)

    def after(h: float) -> State:
        s = state
        for _ in range(10):
            command, _ = commands(design, GAINS, x0_d, s)
            s = step(system, s, command, h / 10)
        return s

    h = 1e-4
    now = ideal_forces(design, x0_d, state)
    back, ahead = ideal_forces(design, x0_d, after(-h)), ideal_forces(design, x0_d, after(h))
    first, second = (ahead.A - back.A) / (2 * h), (ahead.A_dot - back.A_dot) / (2 * h)
    assert np.abs(first - now.A_dot).max() < 1e-5 * np.abs(first).max()  # measured 5e-7
    assert np.abs(second - now.A_ddot).max() < 1e-4 * np.abs(second).max()  # measured 2e-6


@given(st.integers(0, 2**32))
def test_moment_gives_the_papers_error_dynamics(seed: int) -> None:
    """J e_Omega' = (J e_Omega + d)^ e_Omega - k_R e_R - k_Omega e_Omega with d = (2 J - tr J) R'R_c Omega_c."""
    rng = np.random.default_rng(seed)
    J = np.diag([0.557e-2, 0.557e-2, 1.05e-2])
    R, Omega = lie.exp(rng.normal(size=3)), rng.normal(size=3)
    command = AttitudeCommand(lie.exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3))
    k_R, k_Omega = 5.0, 0.3
    M = moment(J, R, Omega, command, k_R, k_Omega)
    Omega_dot = np.linalg.solve(J, M - np.cross(Omega, J @ Omega))
    e = attitude_error(R, Omega, command)
    relative = R.T @ command.R_c
    rate = relative @ command.Omega_c
    e_dot = Omega_dot + np.cross(Omega, rate) - relative @ command.Omega_c_dot
    d = (2 * J - np.trace(J) * np.eye(3)) @ rate
    np.testing.assert_allclose(
        J @ e_dot, np.cross(J @ e.e_Omega + d, e.e_Omega) - k_R * e.e_R - k_Omega * e.e_Omega, rtol=0, atol=1e-12
    )


def test_the_papers_continuous_law_flies_its_first_case() -> None:
    """Moments commanded directly, perfect state: 8 s at 2.5 ms."""
    system = System.paper(1)
    design = continuous_law(system, airframe(25.0), Weights(1, 2, 2, 1, 1, 0.1, 1), 0.004, 1)
    target = np.array([0.44, 0.78, -0.5])
    flight = list(paper_flight(design, GAINS, target, State.hanging(system, (1.0, 4.8, 0.0)), 2.5e-3, 3201))
    errors = [float(np.linalg.norm(s.x0 - target)) for s, _ in flight]
    worst = max(attitude_error(s.R[i], s.Omega[i], frames[i]).Psi for s, frames in flight[400:] for i in range(4))
    print(f"after 8 s {100 * errors[-1]:.2f} cm from the target; Psi_i after 1 s at most {worst:.1e}")
    assert errors[-1] < 0.02  # measured 0.5 cm
    assert worst < 1e-3
