"""SO(3) and S^2: the maps are what they are called, on both sides of every seam."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from cablequad.model import lie

SEAMS = [0.0, 1e-9, 1e-4, 0.1, math.sqrt(lie.SERIES) * 0.999999, math.sqrt(lie.SERIES) * 1.000001, 1.0, 3.0]
NEAR_PI = [math.pi - 1e-3, math.pi - 1e-7, math.pi - 1e-10]


def axes() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    random = rng.normal(size=(20, 3))
    return [*np.eye(3), *(a / np.linalg.norm(a) for a in random)]


@pytest.mark.parametrize("angle", SEAMS + NEAR_PI)
def test_exp_is_the_matrix_exponential_of_hat(angle: float) -> None:
    for axis in axes():
        np.testing.assert_allclose(lie.exp(angle * axis), expm(lie.hat(angle * axis)), rtol=0, atol=4e-15 * 10)


@pytest.mark.parametrize("angle", SEAMS)
def test_series_coefficients_equal_high_precision_values(angle: float) -> None:
    """rtol matters here: an absolute tolerance would let a wrong last coefficient live."""
    from fractions import Fraction

    s = Fraction(angle) ** 2

    def series(first: int) -> float:
        total, term, k = Fraction(0), Fraction(1, math.factorial(first)), 0
        while k < 40:
            total += term
            k += 1
            term *= -s / ((first + 2 * k) * (first + 2 * k - 1))
        return float(total)

    np.testing.assert_allclose(lie.sinc_terms(float(s)), [series(1), series(2), series(3)], rtol=3e-15 * 20, atol=0)


@pytest.mark.parametrize("angle", SEAMS + NEAR_PI)
def test_log_inverts_exp_up_to_pi(angle: float) -> None:
    for axis in axes():
        np.testing.assert_allclose(
            lie.log(lie.exp(angle * axis)), angle * axis, rtol=0, atol=1e-8 if angle > 3.1 else 1e-14
        )


def test_log_of_a_half_turn_has_angle_pi() -> None:
    for axis in axes():
        R = 2 * np.outer(axis, axis) - np.eye(3)
        assert np.linalg.norm(lie.log(R)) == pytest.approx(math.pi, rel=0, abs=1e-12)


@given(st.integers(0, 2**32))
def test_right_jacobian_is_the_derivative_of_exp(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xi, d = rng.normal(size=3), rng.normal(size=3)
    h = 1e-6
    moved = lie.log(lie.exp(xi).T @ lie.exp(xi + h * d)) - lie.log(lie.exp(xi).T @ lie.exp(xi - h * d))
    np.testing.assert_allclose(moved / (2 * h), lie.right_jacobian(xi) @ d, rtol=0, atol=1e-8)


@given(st.integers(0, 2**32))
def test_quaternions_agree_with_scipy_and_round_trip(seed: int) -> None:
    R = lie.exp(2.5 * np.random.default_rng(seed).normal(size=3))
    quat = lie.quat_from_rotation(R)
    x, y, z, w = Rotation.from_matrix(R).as_quat()
    assert abs(quat @ np.array([w, x, y, z])) == pytest.approx(1.0, rel=0, abs=1e-12)
    np.testing.assert_allclose(lie.rotation_from_quat(3.7 * quat), R, rtol=0, atol=1e-14)


@given(st.integers(0, 2**32))
def test_shortest_turn_takes_one_direction_to_the_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 3))
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    xi = lie.direction_to(a, b)
    out = lie.rotated(tuple(xi), tuple(a))
    np.testing.assert_allclose(out, b, rtol=0, atol=1e-13)
    assert abs(xi @ a) < 1e-13
    np.testing.assert_allclose(lie.rotated(tuple(lie.direction_to(a, -a)), tuple(a)), -a, rtol=0, atol=1e-12)


@given(st.integers(0, 2**32))
def test_tangent_basis_is_orthonormal_and_normal_to_its_direction(seed: int) -> None:
    q = np.random.default_rng(seed).normal(size=3)
    q /= np.linalg.norm(q)
    for direction in (q, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])):
        C = lie.tangent_basis(direction)
        np.testing.assert_allclose(C.T @ C, np.eye(2), rtol=0, atol=1e-9)
        np.testing.assert_allclose(C.T @ direction, 0, rtol=0, atol=1e-9)


def test_orthonormalize_removes_drift() -> None:
    R = lie.exp(np.array([0.3, -0.7, 1.1])) + 1e-9 * np.arange(9).reshape(3, 3)
    lie.orthonormalize(R)
    np.testing.assert_allclose(R.T @ R, np.eye(3), rtol=0, atol=1e-15 * 8)
