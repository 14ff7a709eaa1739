"""SO(3) and S^2 on plain arrays.

Rotations are (3, 3) arrays R that take body vectors to the world frame; R' = R hat(Omega). Directions are (3,) unit
vectors q with q' = omega x q. Rotation vectors are radians.

The coefficients of the exponential map switch from trigonometric form to a power series below `SERIES` (rad^2), where
the series is exact to rounding and cheaper.
"""

import math

import numpy as np

from cablequad._jit import inlined, jit
from cablequad.types import Array, Triple

SERIES = 0.06  # rad^2: below it the first omitted term of every series is under 1e-16
SHORT = 0.01  # rad^2: the same for the shorter series of `sinc_pair`


@inlined
def sinc_pair(angle_sq: float) -> tuple[float, float]:
    """sin(a)/a and (1 - cos a)/a^2 for a^2 = `angle_sq` >= 0: what a rotation needs."""
    s = angle_sq
    if s < SHORT:
        a = 1.0 + s * (-1 / 6 + s * (1 / 120 + s * (-1 / 5040 + s * (1 / 362880))))
        b = 0.5 + s * (-1 / 24 + s * (1 / 720 + s * (-1 / 40320 + s * (1 / 3628800))))
        return a, b
    angle = math.sqrt(s)
    half = math.sin(0.5 * angle)
    return math.sin(angle) / angle, 2.0 * half * half / s


@jit
def sinc_terms(angle_sq: float) -> tuple[float, float, float]:
    """`sinc_pair` and (a - sin a)/a^3, which needs its series further out."""
    s = angle_sq
    a, b = sinc_pair(s)
    if s < SERIES:
        c = (1 - s / 20 * (1 - s / 42 * (1 - s / 72 * (1 - s / 110 * (1 - s / 156 * (1 - s / 210)))))) / 6
        return a, b, c
    return a, b, (1.0 - a) / s


@jit
def hat(v: Array) -> Array:
    """The skew matrix of v (3,): hat(v) w = v x w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@jit
def vee(S: Array) -> Array:
    """The inverse of `hat`, of the skew part of S (3, 3)."""
    return np.array([0.5 * (S[2, 1] - S[1, 2]), 0.5 * (S[0, 2] - S[2, 0]), 0.5 * (S[1, 0] - S[0, 1])])


@jit
def cross(a: Array, b: Array) -> Array:
    """a x b for (3,) arrays."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@inlined
def cross_triple(a: Triple, b: Triple) -> Triple:
    """a x b for tuples: compiled loops keep them in registers."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def rotated(xi: Triple, q: Triple) -> Triple:
    """exp(hat(xi)) q: the action of SO(3) on S^2."""
    a, b = sinc_pair(xi[0] * xi[0] + xi[1] * xi[1] + xi[2] * xi[2])
    c = cross_triple(xi, q)
    d = cross_triple(xi, c)
    return q[0] + a * c[0] + b * d[0], q[1] + a * c[1] + b * d[1], q[2] + a * c[2] + b * d[2]


@inlined
def rotate_frame(out: Array, R: Array, xi: Array) -> None:
    """out = R exp(hat(xi)), in place, without allocation; `out` must not be R."""
    x, y, z = xi[0], xi[1], xi[2]
    a, b = sinc_pair(x * x + y * y + z * z)
    e00, e01, e02 = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    e10, e11, e12 = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    e20, e21, e22 = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    for r in range(3):
        r0, r1, r2 = R[r, 0], R[r, 1], R[r, 2]
        out[r, 0] = r0 * e00 + r1 * e10 + r2 * e20
        out[r, 1] = r0 * e01 + r1 * e11 + r2 * e21
        out[r, 2] = r0 * e02 + r1 * e12 + r2 * e22


@jit
def exp(xi: Array) -> Array:
    """The rotation by |xi| rad about xi, (3, 3)."""
    out = np.empty((3, 3))
    rotate_frame(out, np.eye(3), xi)
    return out


@inlined
def orthonormalize(R: Array) -> None:
    """One Newton step towards the nearest rotation, R (3 I - R'R) / 2, in place: removes rounding drift."""
    s00, s01, s02, s11, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for r in range(3):
        s00 += R[r, 0] * R[r, 0]
        s01 += R[r, 0] * R[r, 1]
        s02 += R[r, 0] * R[r, 2]
        s11 += R[r, 1] * R[r, 1]
        s12 += R[r, 1] * R[r, 2]
        s22 += R[r, 2] * R[r, 2]
    for r in range(3):
        a, b, c = R[r, 0], R[r, 1], R[r, 2]
        R[r, 0] = 1.5 * a - 0.5 * (a * s00 + b * s01 + c * s02)
        R[r, 1] = 1.5 * b - 0.5 * (a * s01 + b * s11 + c * s12)
        R[r, 2] = 1.5 * c - 0.5 * (a * s02 + b * s12 + c * s22)


@inlined
def _times_columns(a: Array, B: Array) -> Triple:
    """a'B for a (3,) and B (3, 3)."""
    return (
        a[0] * B[0, 0] + a[1] * B[1, 0] + a[2] * B[2, 0],
        a[0] * B[0, 1] + a[1] * B[1, 1] + a[2] * B[2, 1],
        a[0] * B[0, 2] + a[1] * B[1, 2] + a[2] * B[2, 2],
    )


@inlined
def relative(A: Array, B: Array) -> tuple[Triple, Triple, Triple]:
    """The rows of A'B for rotations A, B (3, 3)."""
    return _times_columns(A[:, 0], B), _times_columns(A[:, 1], B), _times_columns(A[:, 2], B)


@jit
def quat_of_rows(r: tuple[Triple, Triple, Triple]) -> tuple[float, float, float, float]:
    """The unit quaternion (w, x, y, z), w >= 0, of a rotation's rows, by the largest of the four squares."""
    r00, r11, r22 = r[0][0], r[1][1], r[2][2]
    trace = r00 + r11 + r22
    if trace >= max(r00, r11, r22):
        w, x, y, z = 1.0 + trace, r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]
    elif r00 >= max(r11, r22):
        w, x, y, z = r[2][1] - r[1][2], 1.0 + 2.0 * r00 - trace, r[0][1] + r[1][0], r[0][2] + r[2][0]
    elif r11 >= r22:
        w, x, y, z = r[0][2] - r[2][0], r[0][1] + r[1][0], 1.0 + 2.0 * r11 - trace, r[1][2] + r[2][1]
    else:
        w, x, y, z = r[1][0] - r[0][1], r[0][2] + r[2][0], r[1][2] + r[2][1], 1.0 + 2.0 * r22 - trace
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    scale = 1.0 / (norm if w >= 0.0 else -norm)
    return w * scale, x * scale, y * scale, z * scale


@jit
def log_of_rows(r: tuple[Triple, Triple, Triple]) -> Triple:
    """The rotation vector, |xi| <= pi, through the quaternion: accurate at 0 and near pi alike."""
    w, x, y, z = quat_of_rows(r)
    sin_half = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sin_half < 1e-8 else 2.0 * math.atan2(sin_half, w) / sin_half
    return scale * x, scale * y, scale * z


@jit
def quat_from_rotation(R: Array) -> Array:
    """The unit quaternion (w, x, y, z) of R with w >= 0."""
    return np.array(wxyz_from_rotation(R))


@jit
def wxyz_from_rotation(R: Array) -> tuple[float, float, float, float]:
    """`quat_from_rotation` as numbers one by one."""
    return quat_of_rows(((R[0, 0], R[0, 1], R[0, 2]), (R[1, 0], R[1, 1], R[1, 2]), (R[2, 0], R[2, 1], R[2, 2])))


@jit
def normalize(directions: Array) -> bool:
    """Scale each of `directions` (n, L, 3) to length 1, in place; False if one is no direction (shorter than 0.5)."""
    for i in range(directions.shape[0]):
        for j in range(directions.shape[1]):
            x, y, z = directions[i, j, 0], directions[i, j, 1], directions[i, j, 2]
            size = math.sqrt(x * x + y * y + z * z)
            if not size > 0.5:
                return False
            for a in range(3):
                directions[i, j, a] /= size
    return True


@jit
def quats_from_rotations(R: Array) -> Array:
    """`quat_from_rotation` of each of R (k, 3, 3), (k, 4)."""
    out = np.empty((R.shape[0], 4))
    for i in range(R.shape[0]):
        a = R[i]
        rows = (a[0, 0], a[0, 1], a[0, 2]), (a[1, 0], a[1, 1], a[1, 2]), (a[2, 0], a[2, 1], a[2, 2])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = quat_of_rows(rows)
    return out


@jit
def rotation_from_quat(quat_wxyz: Array) -> Array:
    """The rotation of a quaternion (w, x, y, z) of any non-zero norm, (3, 3)."""
    return rotation_from_wxyz(quat_wxyz[0], quat_wxyz[1], quat_wxyz[2], quat_wxyz[3])


@jit
def rotation_from_wxyz(w: float, x: float, y: float, z: float) -> Array:
    """`rotation_from_quat` of numbers one by one, which cost less to hand over."""
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
        ]
    )


@jit
def log(R: Array) -> Array:
    """The rotation vector of R, (3,), |xi| <= pi."""
    return np.array(
        log_of_rows(((R[0, 0], R[0, 1], R[0, 2]), (R[1, 0], R[1, 1], R[1, 2]), (R[2, 0], R[2, 1], R[2, 2])))
    )


@jit
def right_jacobian(xi: Array) -> Array:
    """J_r(xi): exp(xi + d) = exp(xi) exp(J_r d) to first order in d, (3, 3)."""
    _, b, c = sinc_terms(xi[0] ** 2 + xi[1] ** 2 + xi[2] ** 2)
    S = hat(xi)
    return np.eye(3) - b * S + c * (S @ S)


@jit
def direction_to(q_from: Array, q_to: Array) -> Array:
    """The shortest rotation vector xi, normal to q_from, with exp(hat(xi)) q_from = q_to, (3,) rad."""
    return np.array(direction_triple((q_from[0], q_from[1], q_from[2]), (q_to[0], q_to[1], q_to[2])))


@inlined
def direction_triple(q_from: Triple, q_to: Triple) -> Triple:
    """`direction_to` of tuples."""
    x, y, z = cross_triple(q_from, q_to)
    sin = math.sqrt(x * x + y * y + z * z)
    cos = q_from[0] * q_to[0] + q_from[1] * q_to[1] + q_from[2] * q_to[2]
    if sin > 1e-12:
        scale = math.atan2(sin, cos) / sin
    elif cos > 0.0:
        scale = 1.0
    else:  # opposite: any normal axis
        (x, y, z), _ = tangent_pair(q_from)
        scale = math.pi
    return scale * x, scale * y, scale * z


@jit
def tangent_basis(q: Array) -> Array:
    """Two orthonormal columns normal to q, (3, 2): the paper's C = [e1 e2] carried from e3 to q by the shortest way."""
    a, b = tangent_pair((q[0], q[1], q[2]))
    return np.array([[a[0], b[0]], [a[1], b[1]], [a[2], b[2]]])


@inlined
def tangent_pair(q: Triple) -> tuple[Triple, Triple]:
    """`tangent_basis` of a tuple, column by column."""
    if q[2] < -1.0 + 1e-12:
        return (1.0, 0.0, 0.0), (0.0, -1.0, 0.0)
    k = 1.0 / (1.0 + q[2])
    aside = -k * q[0] * q[1]
    return (1.0 - k * q[0] * q[0], aside, -q[0]), (aside, 1.0 - k * q[1] * q[1], -q[1])
