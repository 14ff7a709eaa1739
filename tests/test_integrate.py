"""The step: its order, its manifolds, and an independent integrator."""

import importlib
import os
from typing import Any

import numpy as np
import pytest
from conftest import irregular, random_state
from scipy.integrate import solve_ivp

from cablequad.model import lie
from cablequad.model.dynamics import accelerations
from cablequad.model.instant import Motion, motion_of, motion_shapes, places, row
from cablequad.model.integrate import RotorOutput, step
from cablequad.model.state import State
from cablequad.model.system import System

NUMBA_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"


def distance(a: State, b: State) -> float:
    return max(float(np.abs(x - y).max()) for x, y in zip(a, b, strict=True))


def run(system: System, state: State, command: RotorOutput, T: float, steps: int) -> State:
    for _ in range(steps):
        state = step(system, state, command, T / steps)
    return state


@pytest.mark.parametrize("system", [System.paper(1), irregular()], ids=["paper", "irregular"])
def test_halving_the_step_divides_the_error_by_sixteen(system: System, rng: np.random.Generator) -> None:
    n = len(system.m)
    state = random_state(system, rng)
    command = RotorOutput(rng.uniform(4, 10, n), 0.01 * rng.normal(size=(n, 3)))
    T, counts = 0.1, np.array([50, 100, 200, 400])
    reference = run(system, state, command, T, 6400)
    errors = [distance(run(system, state, command, T, int(k)), reference) for k in counts]
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    print(f"measured order {order:.3f}, errors {errors}")
    assert order == pytest.approx(4.0, abs=0.15)


def test_ten_thousand_steps_leave_every_constraint_to_rounding(rng: np.random.Generator) -> None:
    system = System.paper(1)
    state = random_state(system, rng, rate=1.0)
    command = RotorOutput(np.full(4, 9.0), 1e-4 * rng.normal(size=(4, 3)))
    worst = 0.0
    for _ in range(10_000):
        state = step(system, state, command, 1e-3)
        residuals = [
            np.abs(np.linalg.norm(state.q, axis=-1) - 1).max(),
            np.abs(np.sum(state.q * state.omega, axis=-1)).max() / max(1.0, np.abs(state.omega).max()),
            np.abs(state.R0.T @ state.R0 - np.eye(3)).max(),
            np.abs(np.einsum("iba,ibc->iac", state.R, state.R) - np.eye(3)).max(),
        ]
        worst = max(worst, *residuals)
    print(f"largest constraint residual {worst:.1e}")
    assert worst < 1e-12


def test_an_adaptive_integrator_in_plain_coordinates_arrives_at_the_same_place(rng: np.random.Generator) -> None:
    """DOP853 on the 9-number rotations and 3-number directions, without any Lie group."""
    system = irregular()
    n, L = system.length.shape
    start = State.hanging(system)
    omega = rng.normal(size=(n, L, 3)) * [1.0, 1.0, 0.0]
    omega[np.arange(L)[None, :] >= system.n_links[:, None]] = 0.0
    tilted = np.stack([lie.exp(0.2 * rng.normal(size=3)) for _ in range(n)])
    start = start._replace(omega=omega, R0=lie.exp(0.5 * rng.normal(size=3)), Omega0=rng.normal(size=3), R=tilted)
    command = RotorOutput(np.array([7.0, 9.0, 12.0]), 1e-3 * rng.normal(size=(n, 3)))
    shapes = [field.shape for field in start]
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])

    def unpack(y: np.ndarray) -> State:
        return State(*(part.reshape(s) for part, s in zip(np.split(y, ends[:-1]), shapes, strict=True)))

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        s = unpack(y)
        s = State(*(np.ascontiguousarray(a) for a in s))
        force = -command.thrust[:, None] * s.R[:, :, 2]
        acc = accelerations(system, s, force)
        JO = np.einsum("iab,ib->ia", system.J, s.Omega)
        Omega_dot = np.einsum("iab,ib->ia", system.J_inv, command.moment - np.cross(s.Omega, JO))
        R_dot = np.stack([s.R[i] @ lie.hat(s.Omega[i]) for i in range(n)])
        rates = (s.v0, acc.x0_ddot, s.R0 @ lie.hat(s.Omega0), acc.Omega0_dot, np.cross(s.omega, s.q), acc.omega_dot)
        return np.concatenate([a.ravel() for a in (*rates, R_dot, Omega_dot)])

    y0 = np.concatenate([a.ravel() for a in start])
    judge = unpack(solve_ivp(slope, (0.0, 0.5), y0, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1])
    ours = run(system, start, command, 0.5, 2000)
    print(f"0.5 s apart from DOP853 by {distance(ours, judge):.1e}")
    assert distance(ours, judge) < 1e-7


def test_padding_never_moves() -> None:
    system = irregular()
    state = random_state(system, np.random.default_rng(2))
    after = run(system, state, RotorOutput(np.full(3, 9.0), np.zeros((3, 3))), 0.05, 50)
    for i, k in enumerate(system.n_links):
        np.testing.assert_array_equal(after.q[i, k:], np.tile([0.0, 0.0, 1.0], (7 - k, 1)))
        np.testing.assert_array_equal(after.omega[i, k:], 0.0)


def test_a_step_leaves_its_arguments_alone() -> None:
    system = System.paper(1)
    state = random_state(system, np.random.default_rng(3))
    before = state.copy()
    step(system, state, RotorOutput(np.full(4, 9.0), np.zeros((4, 3))), 1e-3)
    assert distance(state, before) == 0.0


def test_a_step_allocates_nothing() -> None:
    runtime: Any = importlib.import_module("numba.core.runtime")

    from cablequad.model.integrate import advance, scratch

    system = irregular()
    state = random_state(system, np.random.default_rng(4))
    work = scratch(system, state)
    command = RotorOutput(np.full(3, 9.0), np.zeros((3, 3)))
    if NUMBA_OFF:
        pytest.skip("without the compiler there is nothing to count")
    advance(system, state, command, 1e-4, 1, work)
    runtime._nrt_python.memsys_enable_stats()

    def allocations(steps: int) -> int:
        before = runtime.rtsys.get_allocation_stats().alloc
        advance(system, state, command, 1e-4, steps, work)
        return int(runtime.rtsys.get_allocation_stats().alloc - before)

    assert allocations(500) == allocations(1)  # what remains are the arguments of the call


def test_a_state_of_integers_lists_and_views_moves_like_one_of_floats() -> None:
    system = System.paper(1)
    whole = State.hanging(system, (1.0, 2.0, 3.0))
    odd = State(
        [1, 2, 3], np.zeros(3, dtype=int), np.eye(3, dtype=int), np.zeros(6)[::2],  # type: ignore[arg-type]
        whole.q.astype(np.float32), np.asfortranarray(whole.omega), whole.R.tolist(), np.zeros((4, 3)),
    )  # fmt: skip
    plain, other = RotorOutput(np.full(4, 9.0), np.zeros((4, 3))), RotorOutput([9, 9, 9, 9], [[0, 0, 0]] * 4)  # type: ignore[arg-type]
    assert distance(step(system, whole, plain, 1e-3), step(system, odd, other, 1e-3)) == 0.0
    force = np.tile([0, 0, -9], (4, 1))
    a, b = accelerations(system, whole, force.astype(float)), accelerations(system, odd, force)
    np.testing.assert_array_equal(a.tension, b.tension)


@pytest.mark.parametrize(("n", "L"), [(1, 1), (4, 5), (3, 7)])
def test_a_row_of_numbers_holds_a_motion_where_it_says(n: int, L: int, rng: np.random.Generator) -> None:
    shapes, at = motion_shapes(n, L), places(n, L)
    fields = [rng.normal(size=shape) for shape in shapes]
    motion = Motion(State(*fields[:8]), *fields[8:])
    told = row(motion.state, motion.x, motion.v, motion.tension, motion.thrust)
    back = motion_of(np.stack([told, 2.0 * told]), shapes)
    for had, got in zip(fields, (*back.state, *back[1:]), strict=True):
        assert (got[0] == had).all()
        assert (got[1] == 2.0 * had).all()
    behind = [*motion.state[4:], motion.x, motion.v, motion.tension, motion.thrust]
    for begin, had in zip(at, behind, strict=True):
        assert (told[begin : begin + had.size] == had.ravel()).all()
