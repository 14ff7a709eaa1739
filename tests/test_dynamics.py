"""The equations of motion: two formulations, conservation laws, and the paper's misprints."""

from collections.abc import Callable

import numpy as np
import pytest
from conftest import irregular, random_state, random_system
from hypothesis import given, settings
from hypothesis import strategies as st

from cablequad.control.jerk import link_accelerations
from cablequad.model import lie
from cablequad.model.dynamics import accelerations, dense, energy, kinetic_energy, momentum
from cablequad.model.integrate import RotorOutput, advance, scratch, step
from cablequad.model.state import State, positions, velocities
from cablequad.model.system import System

SEEDS = st.integers(0, 2**32)


def dense_solution(system: System, state: State, force: np.ndarray) -> np.ndarray:
    return np.linalg.solve(*dense(system, state, force))


def tension_solution(system: System, state: State, force: np.ndarray) -> np.ndarray:
    acc = accelerations(system, state, force)
    q_ddot = link_accelerations(state, acc)
    parts = [q_ddot[i, : system.n_links[i]].ravel() for i in range(len(system.m))]
    return np.concatenate([acc.x0_ddot, acc.Omega0_dot, *parts])


@given(SEEDS)
@settings(max_examples=150)
def test_tension_form_equals_the_papers_matrix_form(seed: int) -> None:
    """n = 1..6, 1..8 links, any attitude and rate."""
    rng = np.random.default_rng(seed)
    system = random_system(rng)
    state, force = random_state(system, rng), 8 * rng.normal(size=(len(system.m), 3))
    a, b = tension_solution(system, state, force), dense_solution(system, state, force)
    assert np.abs(a - b).max() < 1e-9 * max(1.0, np.abs(b).max())  # measured 2e-11


@given(SEEDS)
@settings(max_examples=60)
def test_mechanical_power_equals_the_power_of_the_rotors(seed: int) -> None:
    """A cable or gyroscopic term that does work is a sign error."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, links=4)
    state = random_state(system, rng)
    n = len(system.m)
    command = RotorOutput(rng.uniform(2, 12, n), 0.05 * rng.normal(size=(n, 3)))
    h = 1e-5
    rate = (energy(system, step(system, state, command, h)) - energy(system, step(system, state, command, -h))) / (
        2 * h
    )
    force = -command.thrust[:, None] * state.R[:, :, 2]
    power = np.sum(force * velocities(system, state)[:, 0]) + np.sum(command.moment * state.Omega)
    assert rate == pytest.approx(power, rel=1e-5, abs=1e-5)


@given(SEEDS)
@settings(max_examples=40)
def test_forces_change_linear_and_angular_momentum_as_newton_says(seed: int) -> None:
    """Angular momentum sees a flipped Omega x J Omega, which does no work and so escapes the energy."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, links=4)
    state = random_state(system, rng)
    n = len(system.m)
    command = RotorOutput(rng.uniform(2, 12, n), 0.05 * rng.normal(size=(n, 3)))
    h = 1e-5
    before, after = (
        momentum(system, step(system, state, command, -h)),
        momentum(system, step(system, state, command, h)),
    )
    x = positions(system, state)
    force = -command.thrust[:, None] * state.R[:, :, 2]
    weight = np.array([0.0, 0.0, system.g])
    np.testing.assert_allclose(
        (after[0] - before[0]) / (2 * h), force.sum(axis=0) + system.M_T * weight, rtol=0, atol=2e-4
    )
    torque = np.cross(x[:, 0], force).sum(axis=0) + system.m0 * np.cross(state.x0, weight)
    torque += np.einsum("iab,ib->a", state.R, command.moment)
    for i in range(n):
        k = system.n_links[i]
        torque += system.m[i] * np.cross(x[i, 0], weight)
        torque += (system.m_link[i, :k, None] * np.cross(x[i, 1 : k + 1], weight)).sum(axis=0)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), torque, rtol=0, atol=2e-4)


@pytest.mark.parametrize("system", [System.paper(1), irregular()], ids=["paper", "irregular"])
def test_free_motion_keeps_energy_and_angular_momentum_for_ten_seconds(system: System) -> None:
    """Falling freely from a moderately curled and turning state, 1 ms steps."""
    rng = np.random.default_rng(1)
    state = State.hanging(system)
    n, L = system.length.shape
    omega = 0.6 * rng.normal(size=(n, L, 3))
    omega -= np.sum(omega * state.q, axis=-1, keepdims=True) * state.q
    omega[np.arange(L)[None, :] >= system.n_links[:, None]] = 0.0
    state = state._replace(omega=omega, Omega0=np.array([0.3, -0.2, 0.4]), Omega=0.5 * rng.normal(size=(n, 3)))
    system = system._replace(g=1e-12)  # without gravity every momentum is kept
    idle = RotorOutput(np.zeros(n), np.zeros((n, 3)))
    E, (p, H) = energy(system, state), momentum(system, state)

    def drift(steps: int) -> np.ndarray:
        out = state.copy()
        advance(system, out, idle, 10.0 / steps, steps, scratch(system, out))
        after_p, after_H = momentum(system, out)
        return np.array(
            [
                abs(energy(system, out) - E) / E,
                np.abs(after_H - H).max() / np.linalg.norm(H),
                np.abs(after_p - p).max() / np.sqrt(2 * E * system.M_T),
            ]
        )

    coarse, fine = drift(10_000), drift(20_000)
    print(f"10 s of free motion, energy, angular, linear momentum: {coarse} at 1 ms, {fine} at 0.5 ms")
    assert coarse.max() < 1e-4  # measured 1e-5
    assert (fine < coarse / 8).all()  # what drifts is the integrator's fourth order, not the model


def test_hanging_load_pulls_with_its_weight() -> None:
    """At rest under equilibrium thrust every link carries what hangs below it."""
    system = System.paper(1)
    state = State.hanging(system)
    force = np.zeros((4, 3))
    force[:, 2] = -(system.M_iT + system.m0 / 4) * system.g
    acc = accelerations(system, state, force)
    below = 0.01 * np.arange(5, 0, -1) + system.m0 / 4
    np.testing.assert_allclose(acc.tension, np.tile(below * system.g, (4, 1)), rtol=0, atol=1e-12)
    assert np.abs(acc.x0_ddot).max() < 1e-13
    assert np.abs(acc.omega_dot).max() < 1e-10


def test_a_pushed_cable_has_negative_tension_and_stays_rigid() -> None:
    """Thrust below weight: the vehicle would fall on its cable, the links push."""
    system = System.paper(1)
    acc = accelerations(system, State.hanging(system), np.tile([0.0, 0.0, 5.0], (4, 1)))
    assert acc.tension.max() < 0


class TestMisprints:
    """Each printed form fails in the way that shows it, the right one holds."""

    def setup_method(self) -> None:
        rng = np.random.default_rng(11)
        self.system = System.paper(1)
        self.state = random_state(self.system, rng, rate=3.0)
        self.force = 5 * rng.normal(size=(4, 3))

    def test_mass_matrix_with_the_printed_index_is_singular(self) -> None:
        # with every direction the same, links cannot be told apart: the chain loses its own inertia
        hanging = State.hanging(self.system)
        N0, _ = dense(self.system, hanging, self.force)
        printed0 = N0.copy()
        for i in range(4):
            for j in range(5):
                for k in range(5):
                    block = np.s_[6 + 15 * i + 3 * j : 9 + 15 * i + 3 * j, 6 + 15 * i + 3 * k : 9 + 15 * i + 3 * k]
                    printed0[block] *= self.system.M_0[i, j] / self.system.M_0[i, min(j, k)]
        assert np.linalg.cond(N0) < 1e6
        assert np.linalg.cond(printed0) > 1e12

    def test_centripetal_term_without_the_length_breaks_the_unit_sphere(self) -> None:
        N, P = dense(self.system, self.state, self.force)
        q_dot = np.cross(self.state.omega, self.state.q)
        printed = P.copy()
        at = 6
        for i in range(4):
            for j in range(5):
                factor = self.system.M_0[i, j] * (1 - self.system.length[i, j])
                printed[at : at + 3] += factor * (q_dot[i, j] @ q_dot[i, j]) * self.state.q[i, j]
                at += 3

        def violation(x: np.ndarray) -> float:
            q_ddot = x[6:].reshape(4, 5, 3)
            return float(np.abs(np.sum(self.state.q * q_ddot, axis=-1) + np.sum(q_dot**2, axis=-1)).max())

        assert violation(np.linalg.solve(N, P)) < 1e-10
        assert violation(np.linalg.solve(N, printed)) > 10

    def test_quadrotor_rotation_is_second_order(self) -> None:
        """Printed J Omega + .. = M would give a body at rest under no moment no rate to keep: units differ."""
        n = 4
        state = State.hanging(self.system)
        M = np.tile([0.01, -0.02, 0.005], (n, 1))
        after = step(self.system, state, RotorOutput(np.zeros(n), M), 1e-3)
        np.testing.assert_allclose(after.Omega, 1e-3 * M @ np.linalg.inv(self.system.J[0]), rtol=1e-6, atol=1e-12)

    def test_kinetic_energys_second_form_needs_half_min_index_and_both_lengths(self) -> None:
        s, m = self.state, self.system
        q_dot = np.cross(s.omega, s.q)
        R0_dot = s.R0 @ lie.hat(s.Omega0)
        T = 0.5 * m.M_T * s.v0 @ s.v0 + 0.5 * s.Omega0 @ m.J0 @ s.Omega0
        T += 0.5 * np.einsum("ia,iab,ib->", s.Omega, m.J, s.Omega)
        links_right = links_printed = 0.0
        for i in range(4):
            rho_dot = R0_dot @ m.rho[i]
            T += 0.5 * m.M_iT[i] * rho_dot @ rho_dot + m.M_iT[i] * s.v0 @ rho_dot
            for j in range(5):
                T -= m.M_0[i, j] * m.length[i, j] * (s.v0 + rho_dot) @ q_dot[i, j]
                for k in range(5):
                    dot = q_dot[i, j] @ q_dot[i, k]
                    links_right += 0.5 * m.M_0[i, min(j, k)] * m.length[i, j] * m.length[i, k] * dot
                    links_printed += m.M_0[i, j] * m.length[i, k] * dot
        truth = kinetic_energy(m, s)
        assert T + links_right == pytest.approx(truth, rel=1e-12)
        assert abs(T + links_printed - truth) > 0.1 * truth


def test_zero_link_cables_and_massless_parts_are_refused_by_name() -> None:
    from cablequad.model.system import Cable, Payload, Quadrotor

    q, c = Quadrotor(0.7, (5e-3, 5e-3, 9e-3)), Cable([0.01], [0.3])
    load = Payload(0.5, (1e-2, 1e-2, 1e-2), [(0.1, 0.0, -0.1)])
    cases: list[tuple[Callable[[], object], str]] = [
        (lambda: System.of(load, [q], [Cable([], [])]), "cable 1: no links"),
        (lambda: System.of(load, [q], [Cable([0.01, 0.01], [0.3])]), "2 masses but 1 lengths"),
        (lambda: System.of(load, [q], [Cable([-0.01], [0.3])]), "cable 1 link 1 mass: -0.01"),
        (lambda: System.of(load._replace(mass=0.0), [q], [c]), "payload.mass: 0.0"),
        (lambda: System.of(load, [q._replace(mass=-1.0)], [c]), "quadrotor 1 mass: -1.0"),
        (lambda: System.of(load, [q, q], [c, c]), "payload.attachments"),
        (lambda: System.of(load._replace(inertia=(1e-2, 1e-2, 5e-2)), [q], [c]), "belong to no body"),
        (lambda: System.paper(3), "case: 3"),
    ]
    for wrong, text in cases:
        with pytest.raises(ValueError, match=text):
            wrong()
