"""The linear model against the nonlinear one, and equilibria."""

import numpy as np
import pytest
from conftest import random_system
from hypothesis import given, settings
from hypothesis import strategies as st

from cablequad.model import lie
from cablequad.model.dynamics import accelerations
from cablequad.model.linear import EquilibriumError, equilibrium, equilibrium_forces, linearize, tension_split
from cablequad.model.state import Error, State, local, retract
from cablequad.model.system import Cable, Payload, Quadrotor, System


def centred(rng: np.random.Generator) -> System:
    """A random system whose attachments surround the centre of mass."""
    system = random_system(rng, n=int(rng.integers(3, 6)), links=4)
    n = len(system.m)
    angles = 2 * np.pi * (np.arange(n) + 0.3 * rng.uniform(size=n)) / n
    rho = np.stack([0.4 * np.cos(angles), 0.4 * np.sin(angles), rng.uniform(-0.2, 0.0, n)], axis=1)
    cables = [Cable(list(system.m_link[i, :k]), list(system.length[i, :k])) for i, k in enumerate(system.n_links)]
    quadrotors = [Quadrotor(float(system.m[i]), system.J[i]) for i in range(n)]
    return System.of(Payload(system.m0, system.J0, rho), quadrotors, cables)


def jacobians(system: System) -> tuple[np.ndarray, np.ndarray]:
    """d(xddot)/dx and d(xddot)/du of the nonlinear model at the hanging equilibrium, by central differences."""
    hung = equilibrium(system)
    hanging, u = State.hanging(system)._replace(R0=hung.R0), equilibrium_forces(system, hung)
    D = 6 + 2 * int(system.n_links.sum())

    def xddot(x: np.ndarray, force: np.ndarray) -> np.ndarray:
        state = retract(system, hanging, Error(x, np.zeros(D)))
        acc = accelerations(system, state, force)
        links = [acc.omega_dot[i, : system.n_links[i], :2].ravel() for i in range(len(system.m))]
        return np.concatenate([acc.x0_ddot, acc.Omega0_dot, *links])

    h = 1e-5
    by_x = np.stack([(xddot(h * e, u) - xddot(-h * e, u)) / (2 * h) for e in np.eye(D)], axis=1)
    steps = np.eye(u.size).reshape(-1, *u.shape)
    by_u = np.stack([(xddot(np.zeros(D), u + h * e) - xddot(np.zeros(D), u - h * e)) / (2 * h) for e in steps], axis=1)
    return by_x, by_u


@pytest.mark.parametrize("seed", range(6))
def test_M_G_B_are_the_jacobian_of_the_nonlinear_model(seed: int) -> None:
    system = System.paper(1) if seed == 0 else centred(np.random.default_rng(seed))
    M, G, B = linearize(system)
    by_x, by_u = jacobians(system)
    scale = np.abs(by_x).max()
    assert np.abs(by_x + np.linalg.solve(M, G)).max() < 1e-7 * scale  # measured 1e-9
    np.testing.assert_allclose(by_u, np.linalg.solve(M, B), rtol=0, atol=1e-7 * np.abs(by_u).max())


def test_mass_matrix_without_e3_hat_is_not_the_jacobian() -> None:
    """Misprint: M_Om0,ij = M_0ij l_ij hat(rho) C; its columns are turned by 90 degrees."""
    system = System.paper(1)
    M, G, _ = linearize(system)
    printed, at = M.copy(), 6
    for i in range(4):
        for j in range(5):
            printed[3:6, at : at + 2] = system.M_0[i, j] * system.length[i, j] * lie.hat(system.rho[i])[:, :2]
            at += 2
    by_x, _ = jacobians(system)
    assert np.abs(by_x + np.linalg.solve(printed, G)).max() > 1e-2 * np.abs(by_x).max()


def test_stiffness_with_the_printed_sign_turns_hanging_cables_into_inverted_pendulums() -> None:
    system = System.paper(1)
    M, G, _ = linearize(system)
    printed = G.copy()
    printed[6:, 6:] *= -1
    hanging, inverted = np.linalg.eigvals(np.linalg.solve(M, G)), np.linalg.eigvals(np.linalg.solve(M, printed))
    assert hanging.real.min() > -1e-9
    assert inverted.real.min() < -100


def test_equilibrium_is_one() -> None:
    for seed in range(5):
        system = centred(np.random.default_rng(seed))
        acc = accelerations(system, State.hanging(system), equilibrium_forces(system, equilibrium(system)))
        assert np.abs(acc.x0_ddot).max() < 1e-10
        assert np.abs(acc.Omega0_dot).max() < 1e-9
        last = acc.tension[np.arange(len(system.m)), system.n_links - 1]
        below = last - system.m_tied * system.g  # the last link also carries the mass tied to the load
        np.testing.assert_allclose(below, tension_split(system), rtol=0, atol=1e-9)


Q, C = Quadrotor(0.7, (5e-3, 5e-3, 9e-3)), Cable([0.01, 0.02], [0.3, 0.4])


def hung(*attachments: tuple[float, float, float]) -> System:
    n = len(attachments)
    return System.of(Payload(0.5, np.diag([0.011, 0.012, 0.013]), attachments), [Q] * n, [C] * n)


OFF_CENTRE = {
    "one cable beside the centre": hung((0.1, 0.05, -0.1)),
    "two cables, centre beside their line": hung((0.1, 0.3, -0.1), (0.1, -0.3, -0.1)),
    "three cables, centre outside": hung((0.1, 0.3, -0.3), (0.1, -0.3, -0.3), (0.4, 0.0, -0.3)),
    "four cables, centre outside": hung((0.05, 0.3, -0.4), (0.05, -0.3, -0.4), (0.5, 0.2, -0.4), (0.5, -0.2, -0.4)),
}


@pytest.mark.parametrize("system", OFF_CENTRE.values(), ids=list(OFF_CENTRE))
def test_a_load_that_cannot_hang_level_hangs_tilted_with_every_cable_pulling(system: System) -> None:
    with pytest.raises(EquilibriumError):
        tension_split(system)
    found = equilibrium(system)
    assert found.tension.min() > 0
    state = State.hanging(system)._replace(R0=found.R0)
    acc = accelerations(system, state, equilibrium_forces(system, found))
    assert np.abs(acc.x0_ddot).max() < 1e-9
    assert np.abs(acc.Omega0_dot).max() < 1e-8
    M, G, B = linearize(system)
    by_x, by_u = jacobians(system)
    assert np.abs(by_x + np.linalg.solve(M, G)).max() < 1e-6 * np.abs(by_x).max()
    np.testing.assert_allclose(by_u, np.linalg.solve(M, B), rtol=0, atol=1e-6 * np.abs(by_u).max())


def test_a_load_that_cannot_hang_at_all_names_the_cable() -> None:
    """Two attachments on one side of the centre of mass: no tilt brings it between them."""
    with pytest.raises(EquilibriumError, match="cable 2 would have to push"):
        equilibrium(hung((0.1, 0.0, -0.1), (0.4, 0.0, -0.1)))
    with pytest.raises(EquilibriumError, match="cable 1 would have to push"):
        equilibrium(hung((0.4, 0.0, -0.1), (0.1, 0.0, -0.1)))


@given(st.integers(0, 2**32))
@settings(max_examples=50)
def test_the_chart_round_trips(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = random_system(rng, links=3)
    D = 6 + 2 * int(system.n_links.sum())
    error = Error(0.4 * rng.normal(size=D), rng.normal(size=D))
    back = local(system, State.hanging(system), retract(system, State.hanging(system), error))
    np.testing.assert_allclose(back.x, error.x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(back.x_dot, error.x_dot, rtol=0, atol=1e-10)
