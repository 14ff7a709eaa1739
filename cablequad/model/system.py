"""What never changes during a flight: bodies, cables, and the constants the equations are written in.

The parts (`Payload`, `Quadrotor`, `Cable`) are what a user describes; `System` holds the same as padded arrays under
the paper's letters, ready for compiled code.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cablequad.types import Array

G = 9.81  # m/s^2
LIGHT = 1e-4  # of the lighter end of a cable: links without mass are chains of this


class Payload(NamedTuple):
    """The rigid body that is carried."""

    mass: float  # kg
    inertia: npt.ArrayLike  # (3, 3) or the diagonal (3,), kg m^2, payload frame about its centre of mass
    attachments: npt.ArrayLike  # (n, 3) m, payload frame: where cable i is tied, from the centre of mass


class Quadrotor(NamedTuple):
    """One vehicle."""

    mass: float  # kg
    inertia: npt.ArrayLike  # (3, 3) or the diagonal (3,), kg m^2, body frame


class Cable(NamedTuple):
    """One cable as a chain of rigid links; link 1 is at the quadrotor, the last at the payload.

    A chain without mass has no motion of its own where it is taut, and none that is defined where it is slack: between
    two links there is at least `LIGHT` of the lighter end's mass, which changes what is seen by as little.
    """

    masses: Sequence[float]  # kg, each at the payload-side end of its link; 0 is allowed
    lengths: Sequence[float]  # m


class System(NamedTuple):
    """The bodies and cables as arrays; links beyond `n_links[i]` are padding."""

    g: float  # m/s^2
    m0: float  # kg, payload
    J0: Array  # (3, 3) kg m^2
    rho: Array  # (n, 3) m, payload frame
    m: Array  # (n,) kg, quadrotors
    J: Array  # (n, 3, 3) kg m^2
    J_inv: Array  # (n, 3, 3)
    n_links: npt.NDArray[np.int64]  # (n,)
    m_link: Array  # (n, L) kg, m_ij; padding 1
    length: Array  # (n, L) m, l_ij; padding 1
    inv_node: Array  # (n, L) 1/kg: inverse mass of the node at the quadrotor-side end of link j
    m_tied: Array  # (n,) kg, m_{i,n_i}: the last link's mass, which moves with the payload
    M_T: float  # kg, everything
    M_iT: Array  # (n,) kg, quadrotor i and its cable
    M_0: Array  # (n, L) kg, M_0ij = m_i + sum_{a<j} m_ia: what hangs above link j; padding 0
    Jbar0: Array  # (3, 3) kg m^2, J_0 - sum_i M_iT hat(rho_i)^2

    def __repr__(self) -> str:
        links = ", ".join(str(k) for k in sorted(set(self.n_links.tolist())))
        return f"System({len(self.m)} vehicles, cables of {links} links, load {self.m0:g} kg of {self.M_T:g} kg)"

    @classmethod
    def of(cls, payload: Payload, quadrotors: Sequence[Quadrotor], cables: Sequence[Cable], g: float = G) -> "System":
        """The system of these parts. Raises ValueError naming the part and value that cannot be."""
        n = len(quadrotors)
        rho = np.atleast_2d(np.asarray(payload.attachments, dtype=float))
        if n < 1:
            raise ValueError("quadrotors: at least one is needed")
        if len(cables) != n:
            raise ValueError(f"cables: {len(cables)} given for {n} quadrotors; each needs one")
        if rho.shape != (n, 3) or not np.all(np.isfinite(rho)):
            raise ValueError(f"payload.attachments: shape {rho.shape} given, {(n, 3)} finite metres needed")
        _positive("g", g)
        _positive("payload.mass", payload.mass)
        for i, cable in enumerate(cables, start=1):
            if len(cable.masses) == 0:
                raise ValueError(f"cable {i}: no links; a cable needs at least one")
            if len(cable.masses) != len(cable.lengths):
                raise ValueError(f"cable {i}: {len(cable.masses)} masses but {len(cable.lengths)} lengths")
            for j, (m_ij, l_ij) in enumerate(zip(cable.masses, cable.lengths, strict=True), start=1):
                if not (np.isfinite(m_ij) and m_ij >= 0.0):
                    raise ValueError(f"cable {i} link {j} mass: {m_ij:g} given; it must be zero or more")
                _positive(f"cable {i} link {j} length", l_ij)
        for i, quadrotor in enumerate(quadrotors, start=1):
            _positive(f"quadrotor {i} mass", quadrotor.mass)

        n_links = np.array([len(cable.masses) for cable in cables], dtype=np.int64)
        L = int(n_links.max())
        m = np.array([quadrotor.mass for quadrotor in quadrotors], dtype=float)
        J = np.stack([_inertia(f"quadrotor {i} inertia", q.inertia) for i, q in enumerate(quadrotors, start=1)])
        J0 = _inertia("payload.inertia", payload.inertia)
        m_link, length = np.ones((n, L)), np.ones((n, L))
        M_0, node = np.zeros((n, L)), np.ones((n, L))
        for i, cable in enumerate(cables):
            k = n_links[i]
            m_link[i, :k], length[i, :k] = cable.masses, cable.lengths
            m_link[i, : k - 1] = np.maximum(m_link[i, : k - 1], LIGHT * min(m[i], payload.mass))
            node[i, 0], node[i, 1:k] = m[i], m_link[i, : k - 1]
            M_0[i, :k] = np.cumsum(node[i, :k])
        m_tied = m_link[np.arange(n), n_links - 1]
        M_iT = M_0[np.arange(n), n_links - 1] + m_tied
        m0 = float(payload.mass)
        outer = np.einsum("ia,ib->iab", rho, rho)
        steiner = np.einsum("ia,ia->i", rho, rho)[:, None, None] * np.eye(3) - outer  # -hat(rho)^2
        return cls(
            g=float(g),
            m0=m0,
            J0=J0,
            rho=np.ascontiguousarray(rho),
            m=m,
            J=J,
            J_inv=np.ascontiguousarray(np.linalg.inv(J)),
            n_links=n_links,
            m_link=m_link,
            length=length,
            inv_node=1.0 / node,
            m_tied=m_tied,
            M_T=m0 + float(M_iT.sum()),
            M_iT=M_iT,
            M_0=M_0,
            Jbar0=J0 + np.einsum("i,iab->ab", M_iT, steiner),
        )

    @classmethod
    def paper(cls, case: int) -> "System":
        """The system of the paper's numerical example 1 or 2 (Section V); the box is taken as homogeneous."""
        if case not in (1, 2):
            raise ValueError(f"case: {case} given; the paper has 1 and 2")
        mass, box = (0.5, (0.6, 0.8, 0.2)) if case == 1 else (1.0, (1.0, 1.2, 0.2))
        x, y, z = 0.5 * box[0], 0.5 * box[1], 0.5 * box[2]
        attachments = [(x, -y, -z), (x, y, -z), (-x, -y, -z), (-x, y, -z)]
        quadrotor = Quadrotor(0.755, (0.557e-2, 0.557e-2, 1.05e-2))
        cable = Cable([0.01] * 5, [0.15] * 5)
        return cls.of(Payload(mass, box_inertia(mass, box), attachments), [quadrotor] * 4, [cable] * 4)


def without(system: System, lost: Sequence[int]) -> System:
    """The system that is left when the cables of the vehicles `lost` (from 0) come off the load."""
    kept = [i for i in range(len(system.m)) if i not in lost]
    if not kept:
        raise ValueError("no vehicle is left")
    return System.of(
        Payload(system.m0, system.J0, system.rho[kept]),
        [Quadrotor(float(system.m[i]), system.J[i]) for i in kept],
        [_cable(system, i) for i in kept],
        system.g,
    )


def cut_off(system: System, i: int) -> System:
    """Vehicle i with its cable, which ends in the last link's mass: half of it tied, half as a load without size."""
    k = int(system.n_links[i]) - 1
    cable, half = _cable(system, i), 0.5 * max(float(system.m_link[i, k]), LIGHT * float(system.m[i]))
    point = Payload(half, [1e-6] * 3, [[0.0, 0.0, 0.0]])
    vehicle = Quadrotor(float(system.m[i]), system.J[i])
    return System.of(point, [vehicle], [Cable([*cable.masses[:-1], half], cable.lengths)], system.g)


def _cable(system: System, i: int) -> Cable:
    k = int(system.n_links[i])
    return Cable(system.m_link[i, :k].tolist(), system.length[i, :k].tolist())


def box_inertia(mass: float, box: Sequence[float]) -> Array:
    """(3, 3) kg m^2 of a homogeneous box of `mass` kg and edge lengths `box` (x, y, z) m about its centre."""
    x, y, z = box
    return np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) * (mass / 12.0)


def _positive(name: str, value: float) -> None:
    if not np.isfinite(value) or value <= 0.0:
        raise ValueError(f"{name}: {value} given; it must be finite and above 0")


def _inertia(name: str, value: npt.ArrayLike) -> Array:
    J = np.asarray(value, dtype=float)
    J = np.diag(J) if J.shape == (3,) else J.copy()
    if J.shape != (3, 3) or not np.all(np.isfinite(J)) or not np.allclose(J, J.T, rtol=0, atol=1e-12):
        raise ValueError(f"{name}: a symmetric (3, 3) matrix or its diagonal (3,) is needed")
    principal = np.linalg.eigvalsh(J)
    if principal[0] <= 0.0:
        raise ValueError(f"{name}: principal moments {principal.tolist()} must all be above 0")
    if principal[2] > (principal[0] + principal[1]) * (1 + 1e-9):
        raise ValueError(
            f"{name}: principal moments {principal.tolist()} belong to no body (the largest exceeds the sum)"
        )
    return J
