"""What is said before a flight: controllability, margins, Proposition 3 and its misprints."""

import json
from itertools import pairwise

import numpy as np
import pytest
from conftest import cablequad, irregular

from cablequad.analysis.certificate import AttitudeGains, attitude_gains, certify, higher_order_slope
from cablequad.analysis.margins import _loop_gain, margins, modes
from cablequad.analysis.rollout import LoopTiming, rollout
from cablequad.control.design import (
    HOVER_N,
    Weights,
    continuous_law,
    loop_gains,
    sampled_law,
    sampled_loop,
    state_space,
)
from cablequad.control.geometric import AttitudeCommand, attitude_error, moment
from cablequad.control.trajectory import Reference
from cablequad.model.attitude import Airframe
from cablequad.model.state import State
from cablequad.model.system import Cable, Payload, Quadrotor, System
from missions.analysis.check import check
from missions.scenario import laws
from missions.scenario import loading as scenario

PAPER = System.paper(1)
AIRFRAME = Airframe(np.full(4, 40.0), np.full(4, 0.9), np.full(4, 25.0))
WEIGHTS = Weights(1, 2, 2, 1, 1, 0.1, 1)
LAW = continuous_law(PAPER, AIRFRAME, WEIGHTS, 0.004, 1)
J = PAPER.J[0]
LOW, HIGH = 0.557e-2, 1.05e-2


def W_2(c: float, k_R: float, k_O: float, B_2: float) -> np.ndarray:
    off = -0.5 * c * (k_O + B_2)
    return np.array([[c * k_R, off], [off, k_O - 2 * c * HIGH]])


class TestMisprintsOfTheProof:
    """Each printed form fails in the way that shows it, the right one holds."""

    def test_printed_bound_on_c_2_does_not_make_W_2_positive(self) -> None:
        """4 k_Omega / (..) against 4 k_R k_Omega / (..): they part for k_R < 1."""
        k_R, k_O, B_2 = 0.2, 0.03, 0.005
        den = 8 * k_R * HIGH + (k_O + B_2) ** 2
        first = np.sqrt(k_R * LOW) / HIGH
        printed, right = min(first, 4 * k_O / den), min(first, 4 * k_R * k_O / den)
        assert printed > right
        assert np.linalg.eigvalsh(W_2(0.999 * printed, k_R, k_O, B_2))[0] < 0
        assert np.linalg.eigvalsh(W_2(0.999 * right, k_R, k_O, B_2))[0] > 0

    def test_certify_uses_the_bound_that_holds(self) -> None:
        gains = AttitudeGains(np.full(4, 0.2), np.full(4, 0.03), 0.3)
        attitude = certify(LAW, WEIGHTS, gains).attitude
        assert len(attitude) == 4
        for a in attitude:
            assert np.linalg.eigvalsh(W_2(0.999 * a.c_2_bound, 0.2, 0.03, a.B_2))[0] > 0
            assert a.lambda_W_2 > 0

    def test_higher_order_terms_enter_through_the_mass_matrix(self) -> None:
        """2 gamma |P| is printed where 2 gamma |P B_d| stands: it is smaller, so the printed condition is not one."""
        choices = certify(LAW, WEIGHTS, attitude_gains(PAPER, AIRFRAME, 2.0)).choices[:2]
        assert len(choices) == 2
        for choice in choices:
            assert choice.higher_order > np.linalg.norm(choice.P, 2)

    def test_V_2_holds_the_rate_not_its_derivative(self) -> None:
        """1/2 e_Omega . J e_Omega + k_R Psi + c_2 e_R . e_Omega lies between its quadratic bounds and falls in motion."""
        rng = np.random.default_rng(0)
        k_R, k_O = 5.0, 0.4
        c_2 = 0.3 * min(np.sqrt(k_R * LOW) / HIGH, 4 * k_R * k_O / (8 * k_R * HIGH + k_O**2))
        from cablequad.model import lie

        still = AttitudeCommand(np.eye(3), np.zeros(3), np.zeros(3))

        def V(R: np.ndarray, O: np.ndarray) -> float:
            e = attitude_error(R, O, still)
            return float(0.5 * e.e_Omega @ J @ e.e_Omega + k_R * e.Psi + c_2 * e.e_R @ e.e_Omega)

        for _ in range(200):
            R, O = lie.exp(rng.normal(size=3) * 0.6), rng.normal(size=3)
            h = 1e-6

            def after(s: float, R: np.ndarray = R, O: np.ndarray = O) -> float:
                M = moment(J, R, O, still, k_R, k_O)
                O_dot = np.linalg.solve(J, M - np.cross(O, J @ O))
                return V(R @ lie.exp(s * O + 0.5 * s * s * O_dot), O + s * O_dot)

            e = attitude_error(R, O, still)
            z = np.array([np.linalg.norm(e.e_R), np.linalg.norm(e.e_Omega)])
            rate = (after(h) - after(-h)) / (2 * h)
            assert rate <= -z @ W_2(c_2, k_R, k_O, 0.0) @ z + 1e-6
            # the printed 1/2 e_Omega . J e_Omega_dot depends on the moment: it is no function of the state
            printed = [0.5 * O @ (moment(J, R, O, still, k, k_O) - np.cross(O, J @ O)) for k in (k_R, 2 * k_R)]
            assert printed[0] != printed[1]

    def test_z1_dot_has_the_attitude_error_with_a_minus(self) -> None:
        """A force that is projected from A_i on R_i e3 is A_i - X_i, so M xddot + G x = B (du_A - X)."""
        rng = np.random.default_rng(1)
        from cablequad.model import lie

        A = np.array([0.3, -0.5, -9.0])
        R_c = np.stack([np.zeros(3), np.zeros(3), -A / np.linalg.norm(A)], axis=1)
        R = lie.exp(0.3 * rng.normal(size=3))
        f = -A @ R[:, 2]
        cosine = R_c[:, 2] @ R[:, 2]
        X = f / cosine * (cosine * R[:, 2] - R_c[:, 2])
        u = -f * R[:, 2]
        np.testing.assert_allclose(u, A - X, rtol=0, atol=1e-12)
        assert np.abs(u - (A + X)).max() > 1e-2

    def test_virtual_work_moves_quadrotors_by_xi_cross_q(self) -> None:
        """delta x_i = .. - sum l_ij xi_ij x q_ij: a rotation, where xi_dot is printed (a rate, in other units)."""
        from cablequad.model import lie
        from cablequad.model.state import positions

        state = State.hanging(PAPER)
        xi = np.array([0.4, -0.2, 0.0])
        h = 1e-6
        q = state.q.copy()
        q[2, 3] = lie.rotated(tuple(h * xi), tuple(q[2, 3]))
        moved = (positions(PAPER, state._replace(q=q)) - positions(PAPER, state))[2, 0] / h
        np.testing.assert_allclose(moved, -PAPER.length[2, 3] * np.cross(xi, state.q[2, 3]), rtol=0, atol=1e-6)

    def test_e_q_sums_over_every_cable(self) -> None:
        """The first sum runs to n (printed: m, which counts nothing here)."""
        design = sampled_law(PAPER, AIRFRAME, Weights(), 0.004, 1)
        state = State.hanging(PAPER)
        q = state.q.copy()
        q[3, 4] = [1.0, 0.0, 0.0]
        still = Reference(np.zeros(3), np.zeros(3))
        sample = next(rollout(design, AIRFRAME, lambda _: still, state._replace(q=q), LoopTiming(0.004, 4), 0))
        assert sample.e_q == pytest.approx(np.sqrt(2.0))


def test_the_certificate_has_the_figures_of_the_notes() -> None:
    """|P| = 2445 and |P B_d| = 7481 for one design, whose force weight is 1 for the thrust at which these hover."""
    hover = -LAW.u_star[0, 2]
    weights = Weights(4, 6, 6, 3, 0.3, 0.1, (hover / HOVER_N) ** 2)
    c = certify(continuous_law(PAPER, AIRFRAME, weights, 0.004, 1), weights, attitude_gains(PAPER, AIRFRAME, 2.0))
    identity = c.choices[0]
    assert np.linalg.norm(identity.P, 2) == pytest.approx(2445, rel=0.01)
    assert identity.higher_order == pytest.approx(7481, rel=0.01)


def test_P_solves_the_lyapunov_equation_and_the_curve_falls_with_psi() -> None:
    c = certify(LAW, WEIGHTS, attitude_gains(PAPER, AIRFRAME, 2.0))
    assert c.hurwitz
    P = c.choices[0].P
    assert np.abs(c.loop.A.T @ P + P @ c.loop.A + np.eye(len(P))).max() < 1e-6
    gammas = [p.gamma for p in c.curve]
    assert all(a > b > 0 for a, b in pairwise(gammas))
    assert all(p.condition > 1 for p in c.curve)
    assert all(np.linalg.eigvalsh(p.W)[0] > 0 for p in c.curve)


def test_higher_order_terms_are_quadratic() -> None:
    rng = np.random.default_rng(0)
    slopes = [higher_order_slope(LAW, r, rng, 60) for r in (1e-2, 1e-3)]
    assert slopes[0] == pytest.approx(slopes[1], rel=0.3)


def test_a_loop_that_is_not_hurwitz_is_not_certified() -> None:
    c = certify(LAW._replace(K_x=-LAW.K_x), WEIGHTS, attitude_gains(PAPER, AIRFRAME, 2.0))
    assert not c.hurwitz
    assert c.psi_1_max == 0.0


@pytest.mark.parametrize(
    ("rho", "weakest"),
    [([(0.0, 0.0, -0.1)], "load yaw"), ([(0.0, 0.3, 0.0), (0.0, -0.3, 0.0)], "load pitch")],
    ids=["one cable: yaw", "two level cables: about their line"],
)
def test_motions_out_of_reach_are_found(rho: list, weakest: str) -> None:
    """Facts of the notes: n = 1 cannot yaw its load; n = 2 level with the centre cannot turn it about their line."""
    n = len(rho)
    system = System.of(
        Payload(0.5, (0.01, 0.012, 0.014), rho),
        [Quadrotor(0.7, (5e-3, 5e-3, 9e-3))] * n,
        [Cable([0.01] * 2, [0.3] * 2)] * n,
    )
    listed = modes(system)
    assert listed[0].pbh < 1e-8
    assert listed[0].motion == weakest
    assert listed[1].pbh > 1e-2


def test_four_cables_reach_everything_and_the_top_modes_least() -> None:
    listed = modes(PAPER)
    assert listed[0].pbh > 1e-2
    assert abs(listed[0].pole.imag) == pytest.approx(max(abs(m.pole.imag) for m in listed), rel=0.01)


@pytest.mark.parametrize("system", [PAPER, irregular()], ids=["paper", "irregular"])
def test_pbh_margins_are_singular_values_of_the_whole_pencil(system: System) -> None:
    A, B = state_space(system)
    for mode in modes(system):
        whole = np.hstack([A - mode.pole * np.eye(len(A)), B])
        assert mode.pbh == pytest.approx(np.linalg.svd(whole, compute_uv=False)[-1], rel=1e-3)


@pytest.mark.parametrize("system", [PAPER, irregular()], ids=["paper", "irregular"])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_loop_gain_by_parts_is_that_of_the_whole_matrix(system: System, delay: int) -> None:
    n = len(system.m)
    airframe = Airframe(np.full(n, 40.0), np.full(n, 0.9), np.full(n, 25.0))
    design = sampled_law(system, airframe, Weights(), 0.004, delay)
    loop = sampled_loop(system, airframe, 0.004, delay)
    K, z = loop_gains(design, loop), np.exp(1j * np.array([0.01, 0.2, 1.2, 3.0]))
    whole = [K @ np.linalg.solve(at * np.eye(len(loop.A)) - loop.A, loop.B) for at in z]
    assert _loop_gain(loop, K, z) == pytest.approx(np.array(whole), rel=1e-6, abs=1e-6)


def test_predicted_delay_margin_is_what_simulation_shows() -> None:
    """Extra ticks on every input: the loop settles with as many as the margin says, and not with more."""
    design = sampled_law(PAPER, AIRFRAME, Weights(), 0.004, 1)
    extra = margins(design, AIRFRAME, 0.004, 1).delay_ticks_all
    target = Reference(np.zeros(3), np.zeros(3))
    start = State.hanging(PAPER, (0.05, 0.02, 0.0))

    def ringing(delay: int) -> float:
        samples = list(rollout(design, AIRFRAME, lambda _: target, start, LoopTiming(0.004, 4, delay), 4000))
        e_omega = np.array([s.e_omega for s in samples])
        return float(e_omega[-250:].max() / e_omega[1750:2000].max())

    assert 1 <= extra < 20
    assert ringing(1 + extra) < 0.9
    assert ringing(1 + extra + 5) > 1.1


def test_an_unstable_sampled_loop_has_no_margins() -> None:
    """The paper's continuous law, sampled with one tick of delay, rings up."""
    assert margins(LAW, AIRFRAME, 0.004, 1).delay_ticks_all == -1


def test_check_prints_a_page_and_an_object() -> None:
    code, out, err = cablequad("check", "paper-case-1", "--quick")
    assert code == 0, err
    assert "verdict: not certified for this flight; exponentially stable near the equilibrium" in out
    code, out, _ = cablequad("check", "paper-case-2", "--quick", "--json")
    assert code == 0
    result = json.loads(out)
    assert result["controllable"]
    assert result["closed_loop"]["spectral_radius"] < 1
    assert not result["certificate"]["certified"]
    assert result["certificate"]["advice"]


def test_region_of_attraction_by_simulation_is_larger_than_what_is_certified() -> None:
    from missions.analysis.check import DIRECTIONS, _reach
    from missions.scenario import loading as scenario

    flight = scenario.load("paper-case-1")
    row = _reach(laws.design(flight), flight, len(DIRECTIONS) - 1)
    assert row["settles_up_to"] > 30


def test_a_check_names_what_one_vehicle_cannot_turn() -> None:
    found = check(scenario.load("one-vehicle"), quick=True)
    assert found["out_of_reach"] == ["load yaw"]
    assert found["hidden"] == []
