"""What changes during a flight, and the one chart on it."""

from typing import NamedTuple

import numpy as np

from cablequad._jit import jit
from cablequad.model import lie
from cablequad.model.system import System
from cablequad.types import Array, Counts


class State(NamedTuple):
    """Configuration and velocities of payload, links and quadrotors."""

    x0: Array  # (3,) m, W: payload centre of mass
    v0: Array  # (3,) m/s, W
    R0: Array  # (3, 3) payload -> W
    Omega0: Array  # (3,) rad/s, payload frame
    q: Array  # (n, L, 3) unit, W: direction of link j, from quadrotor to payload; padding e3
    omega: Array  # (n, L, 3) rad/s, W, normal to q; padding 0
    R: Array  # (n, 3, 3) quadrotor -> W
    Omega: Array  # (n, 3) rad/s, body frames

    def __repr__(self) -> str:
        n, L = self.q.shape[-3:-1]
        where = f"load at {np.round(self.x0, 4).tolist()} m, " if self.x0.ndim == 1 else f"{len(self.x0)} instants, "
        return f"State({where}{n} vehicles, {L} links)"

    @classmethod
    def hanging(cls, system: System, x0: Array | tuple[float, float, float] = (0.0, 0.0, 0.0)) -> "State":
        """At rest at `x0` with a level payload, vertical cables and level quadrotors."""
        n, L = system.length.shape
        return cls(
            x0=np.array(x0, dtype=float),
            v0=np.zeros(3),
            R0=np.eye(3),
            Omega0=np.zeros(3),
            q=np.tile(np.array([0.0, 0.0, 1.0]), (n, L, 1)),
            omega=np.zeros((n, L, 3)),
            R=np.tile(np.eye(3), (n, 1, 1)),
            Omega=np.zeros((n, 3)),
        )

    def copy(self) -> "State":
        """The same values in arrays of their own, contiguous and of floats whatever they came in."""
        return State(*(np.array(a, dtype=float, order="C") for a in self))


@jit
def measured(links: Array, frames: Array) -> tuple[bool, Array, Array, Array, Array]:
    """Whether there is a state to what was measured, and its q, omega (n, L, 3), R (n, 3, 3) and Omega (n, 3).

    `links` (n, L, 6) holds directions of any length and their rates, `frames` (n, 7) quaternions (w, x, y, z) of any
    length and body rates. A direction that is none (shorter than 0.5) makes no state.
    """
    n, L = links.shape[0], links.shape[1]
    q, omega, R, Omega = np.empty((n, L, 3)), np.empty((n, L, 3)), np.empty((n, 3, 3)), np.empty((n, 3))
    for i in range(n):
        R[i] = lie.rotation_from_wxyz(frames[i, 0], frames[i, 1], frames[i, 2], frames[i, 3])
        for a in range(3):
            Omega[i, a] = frames[i, 4 + a]
        for j in range(L):
            for a in range(3):
                q[i, j, a], omega[i, j, a] = links[i, j, a], links[i, j, 3 + a]
    return lie.normalize(q), q, omega, R, Omega


class Error(NamedTuple):
    """A state's coordinates in the chart around a target, as the linear model orders them."""

    x: Array  # (6 + 2 N,) [dx_0 m, eta_0 rad, C'xi_ij rad ...], N links in all
    x_dot: Array  # (6 + 2 N,) [dv_0, Omega_0, C'omega_ij ...]


@jit
def local(system: System, target: State, state: State) -> Error:
    """Coordinates of `state` in the chart around `target`: payload and links; quadrotor attitudes are inputs there.

    eta_0 is the rotation vector of R_0d' R_0; xi_ij is the shortest rotation vector from q_ijd to q_ij in the basis C
    carried to q_ijd. To first order these are the variations of Proposition 2.
    """
    D = 6 + 2 * np.sum(system.n_links)
    x, x_dot = np.empty(D), np.empty(D)
    x[0:3] = state.x0 - target.x0
    x[3:6] = lie.log(np.ascontiguousarray(target.R0.T) @ state.R0)
    x_dot[0:3] = state.v0 - target.v0
    x_dot[3:6] = state.Omega0 - target.Omega0
    k = 6
    for i in range(system.m.shape[0]):
        for j in range(system.n_links[i]):
            d, e = target.q[i, j], state.q[i, j]
            q_d = (d[0], d[1], d[2])
            xi = lie.direction_triple(q_d, (e[0], e[1], e[2]))
            w, w_d = state.omega[i, j], target.omega[i, j]
            along = lie.tangent_pair(q_d)
            for b in range(2):
                c = along[b]
                x[k + b] = xi[0] * c[0] + xi[1] * c[1] + xi[2] * c[2]
                x_dot[k + b] = (w[0] - w_d[0]) * c[0] + (w[1] - w_d[1]) * c[1] + (w[2] - w_d[2]) * c[2]
            k += 2
    return Error(x, x_dot)


@jit
def retract(system: System, target: State, error: Error) -> State:
    """The state with coordinates `error` around `target`: the inverse of `local` (link rates made normal to q)."""
    out = State(
        target.x0 + error.x[0:3],
        target.v0 + error.x_dot[0:3],
        target.R0 @ lie.exp(error.x[3:6]),
        target.Omega0 + error.x_dot[3:6],
        target.q.copy(),
        target.omega.copy(),
        target.R.copy(),
        target.Omega.copy(),
    )
    k = 6
    for i in range(system.m.shape[0]):
        for j in range(system.n_links[i]):
            qd = target.q[i, j]
            C = lie.tangent_basis(qd)
            xi = error.x[k] * C[:, 0] + error.x[k + 1] * C[:, 1]
            out.q[i, j] = lie.rotated((xi[0], xi[1], xi[2]), (qd[0], qd[1], qd[2]))
            w = target.omega[i, j] + error.x_dot[k] * C[:, 0] + error.x_dot[k + 1] * C[:, 1]
            q = out.q[i, j]
            # the component along q is chosen so that q . omega = 0 while C'omega stays as given
            along = q[0] * qd[0] + q[1] * qd[1] + q[2] * qd[2]
            wq = w[0] * q[0] + w[1] * q[1] + w[2] * q[2]
            out.omega[i, j] = w - (wq / along) * qd if abs(along) > 1e-3 else w - wq * q
            k += 2
    return out


@jit
def positions(system: System, state: State) -> Array:
    """(n, L + 1, 3) m, W: the quadrotor, then the payload-side end of each link (the last is the attachment point).

    The paper's x_i and x_ij; entries beyond `n_links[i]` repeat the attachment point.
    """
    n, L = system.length.shape
    out = np.empty((n, L + 1, 3))
    for i in range(n):
        for a in range(3):
            end = state.x0[a]
            for b in range(3):
                end += state.R0[a, b] * system.rho[i, b]
            out[i, L, a] = end
            for j in range(L - 1, -1, -1):
                if j < system.n_links[i]:
                    end -= system.length[i, j] * state.q[i, j, a]
                out[i, j, a] = end
    return out


@jit
def velocities(system: System, state: State) -> Array:
    """(n, L + 1, 3) m/s, W: the velocities of `positions`."""
    n, L = system.length.shape
    out = np.empty((n, L + 1, 3))
    for i in range(n):
        spin = lie.cross(state.Omega0, system.rho[i])
        for a in range(3):
            end = state.v0[a]
            for b in range(3):
                end += state.R0[a, b] * spin[b]
            out[i, L, a] = end
        for j in range(L - 1, -1, -1):
            used = j < system.n_links[i]
            turn = lie.cross(state.omega[i, j], state.q[i, j])
            for a in range(3):
                out[i, j, a] = out[i, j + 1, a] - (system.length[i, j] * turn[a] if used else 0.0)
    return out


@jit
def link_poses(system: System, states: State) -> tuple[Array, Array, Array]:
    """Where everything is at K instants, with a row of `states` for each.

    (K, n, L + 1, 3) m, W: their `positions`; (K, n, L, 3) m, W: the middle of every link; (K, n, L, 4): the quaternion
    (w, x, y, z) from e3 to its direction.
    """
    K, n, L = states.q.shape[0], states.q.shape[1], states.q.shape[2]
    nodes, middle, quat = np.empty((K, n, L + 1, 3)), np.empty((K, n, L, 3)), np.empty((K, n, L, 4))
    e3 = np.array([0.0, 0.0, 1.0])
    for k in range(K):
        nodes[k] = positions(system, _instant(states, k))
        for i in range(n):
            for j in range(L):
                for a in range(3):
                    middle[k, i, j, a] = 0.5 * (nodes[k, i, j, a] + nodes[k, i, j + 1, a])
                quat[k, i, j] = lie.quat_from_rotation(lie.exp(lie.direction_to(e3, states.q[k, i, j])))
    return nodes, middle, quat


@jit
def _instant(rows: State, k: int) -> State:
    return State(rows.x0[k], rows.v0[k], rows.R0[k], rows.Omega0[k], rows.q[k], rows.omega[k], rows.R[k], rows.Omega[k])


class Difference(NamedTuple):
    """How far one state is from another, part by part."""

    position: Array  # (3,) m
    velocity: Array  # (3,) m/s
    attitude: Array  # (3,) rad, rotation vector in the other load's frame
    rate: Array  # (3,) rad/s
    link_direction: Array  # (n, L) rad, angle
    link_rate: Array  # (n,) rad/s, root mean square over the links of a cable


@jit
def difference(known: State, true: State, n_links: Counts) -> Difference:
    """`known` less `true`."""
    n, L = known.q.shape[0], known.q.shape[1]
    angle, rate = np.zeros((n, L)), np.zeros(n)
    for i in range(n):
        for j in range(n_links[i]):
            cosine = 0.0
            for b in range(3):
                cosine += known.q[i, j, b] * true.q[i, j, b]
                rate[i] += (known.omega[i, j, b] - true.omega[i, j, b]) ** 2
            angle[i, j] = np.arccos(min(max(cosine, -1.0), 1.0))
        rate[i] = np.sqrt(rate[i] / n_links[i])
    turned = lie.log(np.ascontiguousarray(true.R0.T) @ known.R0)
    return Difference(known.x0 - true.x0, known.v0 - true.v0, turned, known.Omega0 - true.Omega0, angle, rate)


@jit
def differences(known: State, true: State, n_links: Counts) -> Difference:
    """`difference` of states with a row for every instant."""
    K, n, L = known.q.shape[0], known.q.shape[1], known.q.shape[2]
    none = (K, 3)
    out = Difference(
        np.empty(none), np.empty(none), np.empty(none), np.empty(none), np.empty((K, n, L)), np.empty((K, n))
    )
    for k in range(K):
        d = difference(_instant(known, k), _instant(true, k), n_links)
        out.position[k], out.velocity[k], out.attitude[k], out.rate[k] = d.position, d.velocity, d.attitude, d.rate
        out.link_direction[k], out.link_rate[k] = d.link_direction, d.link_rate
    return out
