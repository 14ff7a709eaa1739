"""References are smooth, keep their limits and ask a motion that the model agrees with."""

import itertools

import numpy as np
import pytest

from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.design import Weights, sampled_law
from cablequad.control.formation import formation
from cablequad.control.trajectory import (
    Limits,
    Reference,
    Trajectory,
    along,
    at,
    circle,
    joined,
    leg,
    lemniscate,
    waypoints,
)
from cablequad.model.attitude import Airframe
from cablequad.model.dynamics import accelerations
from cablequad.model.linear import equilibrium as hang
from cablequad.model.linear import equilibrium_forces
from cablequad.model.state import State
from cablequad.model.system import System

LIMITS = Limits()
SYSTEM = System.paper(1)
AIRFRAME = Airframe(np.full(4, 40.0), np.full(4, 0.9), np.full(4, 25.0))
EIGHT = along(lemniscate((0, 0, -1), 4.0, 2.0), 1.0, 1.0, LIMITS)
PATHS = {
    "leg": leg((1, 4.8, 0), (0.44, 0.78, -0.5, 0.5), LIMITS),
    "eight": EIGHT,
    "circle": along(circle((0, 0, -1), 1.5), 1.0, 1.0, LIMITS),
    "waypoints": waypoints([(0, 0, 0), (1, 0, 0), (1, 1, 0)], LIMITS, 1.0),
    "joined": joined([leg((0, 0, 0), (0, 0, -1), LIMITS), EIGHT]),
}


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS.keys())
def test_each_derivative_is_the_slope_of_the_one_before(path: Trajectory) -> None:
    """Differences over 2 ms; the largest of the measured gaps is 0.004 of the snap, in the middle of the eight's turns."""
    t = np.arange(-0.1, path.duration + 0.2, 0.002)
    found = [at(path, x) for x in t]
    derivatives = [np.array([getattr(r, name) for r in found]) for name in ("x0", "v0", "a0", "j0", "s0")]
    for low, high in itertools.pairwise(derivatives):
        slope = (low[2:] - low[:-2]) / 0.004
        np.testing.assert_allclose(slope, high[1:-1], rtol=0, atol=0.01 * max(1.0, np.abs(high).max()))


def test_a_leg_keeps_its_limits_and_reaches_one_of_them() -> None:
    for length in (0.1, 1.0, 10.0):
        path = leg((0, 0, 0), (length, 0, 0), LIMITS)
        found = [at(path, t) for t in np.linspace(0, path.duration, 2001)]
        used = [
            max(np.linalg.norm(r.v0) for r in found) / LIMITS.speed,
            max(np.linalg.norm(r.a0) for r in found) / LIMITS.acceleration,
            max(np.linalg.norm(r.j0) for r in found) / LIMITS.jerk,
        ]
        assert max(used) == pytest.approx(1.0, abs=1e-3)


def test_a_path_is_flown_at_its_speed_along_the_arc() -> None:
    speeds = [np.linalg.norm(at(EIGHT, t).v0) for t in np.linspace(0, EIGHT.duration, 500)]
    assert max(speeds) == pytest.approx(1.0, abs=1e-3)
    assert np.median(speeds) == pytest.approx(1.0, abs=1e-3)


def test_a_formation_under_constant_acceleration_is_one_motion_of_the_model() -> None:
    """Its forces give the load that acceleration and turn nothing: 4e-15 measured, by the equations of motion."""
    a = np.array([0.8, -0.5, 0.3])
    hanging = State.hanging(SYSTEM)
    u_star = equilibrium_forces(SYSTEM, hang(SYSTEM))
    form = formation(SYSTEM, hanging, u_star, AIRFRAME, 0.0, Reference(np.zeros(3), np.zeros(3), a))
    acc = accelerations(SYSTEM, form.target, form.u)
    np.testing.assert_allclose(acc.x0_ddot, a, rtol=0, atol=1e-12)
    np.testing.assert_allclose(acc.Omega0_dot, 0.0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(acc.omega_dot, 0.0, rtol=0, atol=1e-11)


def test_a_turn_of_the_load_is_followed_on_the_way() -> None:
    """60 degrees of yaw while it moves a metre: within 2 cm and 3.5 degrees throughout, 2.6 measured."""
    path = leg((0, 0, 0, 0), (1, 0.5, -0.3, np.radians(60)), LIMITS)
    design = sampled_law(SYSTEM, AIRFRAME, Weights(), 0.004, 1)
    samples = list(
        rollout(design, AIRFRAME, lambda t: at(path, t), State.hanging(SYSTEM), LoopTiming(0.004, 4, 1), 2500)
    )
    assert max(float(np.linalg.norm(s.error.x[:3])) for s in samples) < 0.02
    assert max(float(np.linalg.norm(s.error.x[3:6])) for s in samples) < np.radians(3.5)
    R0 = samples[-1].state.R0
    assert np.degrees(np.arctan2(R0[1, 0], R0[0, 0])) == pytest.approx(60, abs=0.5)
