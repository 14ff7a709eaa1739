"""Wind: what drag does to the model's momentum, and what Dryden's gusts look like."""

import numpy as np
import pytest
from conftest import irregular, random_state

from cablequad.environment.air import Air, drag
from cablequad.model.dynamics import accelerations
from cablequad.model.integrate import scratch
from cablequad.model.state import State, velocities
from cablequad.model.system import System
from sitl.wind import Weather, Wind, turbulence


def test_forces_from_outside_change_momentum_by_their_sum(rng: np.random.Generator) -> None:
    """On the load, on nodes and on vehicles, through tensions: d/dt of the whole momentum, 1e-12 measured."""
    system = irregular()
    n, L = system.length.shape
    s = random_state(system, rng)
    force, on_payload, on_nodes = rng.normal(size=(n, 3)), rng.normal(size=3), rng.normal(size=(n, L, 3))
    used = np.arange(L)[None, :] < system.n_links[:, None]
    on_nodes[~used] = 0.0
    acc = accelerations(system, s, force, on_payload, on_nodes)
    h = 1e-6
    total = np.zeros(3)
    for sign in (1.0, -1.0):
        moved = s._replace(
            v0=s.v0 + sign * h * acc.x0_ddot, Omega0=s.Omega0 + sign * h * acc.Omega0_dot,
            omega=s.omega + sign * h * acc.omega_dot, x0=s.x0 + sign * h * s.v0,
            R0=s.R0 @ (np.eye(3) + sign * h * np.array([[0, -s.Omega0[2], s.Omega0[1]], [s.Omega0[2], 0, -s.Omega0[0]], [-s.Omega0[1], s.Omega0[0], 0]])),
            q=s.q + sign * h * np.cross(s.omega, s.q),
        )  # fmt: skip
        v = velocities(system, moved)
        mass = np.concatenate([system.m[:, None], np.where(used, system.m_link, 0.0)], axis=1)[..., None]
        total += sign * (system.m0 * moved.v0 + np.sum(mass * v, axis=(0, 1))) / (2 * h)
    outside = force.sum(axis=0) + on_payload + on_nodes.sum(axis=(0, 1))
    outside[2] += system.M_T * system.g
    np.testing.assert_allclose(total, outside, rtol=0, atol=1e-6)


def test_a_body_that_moves_with_the_wind_feels_none_and_drag_grows_with_its_square() -> None:
    system = System.paper(1)
    air = Air(1.225, 0.1, np.full(4, 0.03), np.full((4, 5), 4e-4))
    s = State.hanging(system)
    work, force = scratch(system, s), np.zeros((4, 3))
    drag(system, s._replace(v0=np.array([3.0, 0, 0])), air, np.array([3.0, 0.0, 0.0]), force, work)
    assert np.abs(force).max() == 0
    drag(system, s, air, np.array([3.0, 0.0, 0.0]), force, work)
    assert work.work.on_payload[0] == pytest.approx(0.5 * 1.225 * 0.1 * 9.0)
    once = force.copy()
    drag(system, s, air, np.array([6.0, 0.0, 0.0]), force, work)
    np.testing.assert_allclose(force, 4 * once, rtol=1e-12)


def test_gusts_have_the_intensities_and_scales_of_the_specification() -> None:
    """20 ft, 3 m/s: sigma_w 0.3, sigma_u 0.58 m/s; measured over 20,000 s within 6 %."""
    weather = Weather(np.array([3.0, 0.0, 0.0]), True, 6.096)
    air = turbulence(weather)
    assert air.sigma[2] == pytest.approx(0.3)
    assert air.sigma[0] == pytest.approx(0.3 / (0.177 + 0.000823 * 20) ** 0.4)
    assert air.L[2] == pytest.approx(6.096)
    v = Wind(weather, 0.1, np.random.default_rng(1)).next(200_000) - weather.mean
    np.testing.assert_allclose(v.std(axis=0), air.sigma, rtol=0.06)
    # a first-order gust keeps 1/e of itself over L / V
    lag = round(air.L[0] / 3.0 / 0.1)
    u = v[:, 0]
    assert np.mean(u[lag:] * u[:-lag]) / u.var() == pytest.approx(np.exp(-1), abs=0.06)


def test_steady_wind_has_no_gusts() -> None:
    weather = Weather(np.array([1.0, 2.0, 0.0]), False, 6.0)
    assert np.array_equal(Wind(weather, 0.001, np.random.default_rng(0)).next(3), np.tile(weather.mean, (3, 1)))
