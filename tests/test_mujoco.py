"""Accelerations and motion against MuJoCo (the same systems, built by benchmarks/peer.py)."""

import mujoco
import numpy as np
import pytest
from conftest import irregular

from benchmarks.peer import apply_forces, model_of, set_state
from cablequad.model import lie
from cablequad.model.dynamics import accelerations
from cablequad.model.integrate import RotorOutput, step
from cablequad.model.state import State, positions
from cablequad.model.system import System


def gentle(system: System, rng: np.random.Generator) -> State:
    """Curled, turning, moving, within reach of a 2 s comparison (nothing chaotic)."""
    state = State.hanging(system, (0.3, -0.2, 0.1))
    n, L = system.length.shape
    q = state.q + 0.15 * rng.normal(size=(n, L, 3))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    omega = 0.5 * rng.normal(size=(n, L, 3))
    omega -= np.sum(omega * q, axis=-1, keepdims=True) * q
    for i, k in enumerate(system.n_links):
        q[i, k:], omega[i, k:] = (0.0, 0.0, 1.0), 0.0
    return state._replace(
        v0=np.array([0.2, 0.1, -0.1]), R0=lie.exp(np.array([0.1, -0.2, 0.3])), Omega0=np.array([0.2, -0.1, 0.1]),
        q=q, omega=omega,
    )  # fmt: skip


@pytest.mark.parametrize("system", [System.paper(1), irregular()], ids=["paper", "irregular"])
def test_accelerations_agree_with_mujoco(system: System) -> None:
    rng = np.random.default_rng(8)
    model = model_of(system)
    data = mujoco.MjData(model)
    worst = 0.0
    for _ in range(20):
        state = gentle(system, rng)
        force = rng.normal((0.0, 0.0, -9.0), 1.0, (len(system.m), 3))
        set_state(system, model, data, state)
        apply_forces(system, model, data, force)
        mujoco.mj_forward(model, data)
        ours = accelerations(system, state, force)
        mine = np.concatenate([ours.x0_ddot, ours.Omega0_dot])
        theirs = data.qacc[:6]
        worst = max(worst, float(np.abs(mine - theirs).max() / np.abs(mine).max()))
    print(f"accelerations differ from MuJoCo's by {worst:.1e} (relative)")
    assert worst < 2e-5


@pytest.mark.parametrize("system", [System.paper(1), irregular()], ids=["paper", "irregular"])
def test_two_seconds_of_motion_agree_with_mujoco(system: System) -> None:
    rng = np.random.default_rng(9)
    n = len(system.m)
    state = gentle(system, rng)
    thrust = (system.M_iT + system.m0 / n) * system.g
    model = model_of(system)
    data = mujoco.MjData(model)
    set_state(system, model, data, state)
    apply_forces(system, model, data, np.stack([np.zeros(n), np.zeros(n), -thrust], axis=1))
    for _ in range(20_000):
        mujoco.mj_step(model, data)
    for _ in range(4_000):
        state = step(system, state, RotorOutput(thrust, np.zeros((n, 3))), 5e-4)
    mujoco.mj_forward(model, data)
    theirs = [data.body(f"b{i}_0").xipos.copy() for i in range(n)]
    ours = positions(system, state)[:, 0]
    gap = max(float(np.abs(data.qpos[:3] - state.x0).max()), float(np.abs(np.array(theirs) - ours).max()))
    print(f"after 2 s the load and the quadrotors are within {gap:.1e} m of MuJoCo's")
    assert gap < 2e-4
