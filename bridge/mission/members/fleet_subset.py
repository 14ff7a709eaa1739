"""Part of a fleet: its share of a state, what it bears of the load, and its decisions as ones for all."""

import numpy as np

from cablequad.control.control_step import Memory, Sample, first_memory
from cablequad.control.design import Design
from cablequad.control.estimator import Filter
from cablequad.model.attitude import Airframe
from cablequad.model.state import Error, State
from cablequad.model.system import System, without
from cablequad.types import Array


def state_of(s: State, rest: list[int], design: Design) -> State:
    """The members' part of a state."""
    L = design.system.length.shape[1]
    return State(
        s.x0,
        s.v0,
        s.R0,
        s.Omega0,
        s.q[rest, :L].copy(),
        s.omega[rest, :L].copy(),
        s.R[rest].copy(),
        s.Omega[rest].copy(),
    )


def static_shares(system: System, R0: Array) -> Array:
    """(n,) N: with what vertical pulls the vehicles bear a load that hangs as it does, none of them below zero."""
    from scipy import optimize  # here, as it takes longer to load than to use

    arms = system.rho @ R0.T
    weight = system.m0 * system.g
    rows = np.vstack([np.ones(len(arms)), arms[:, 0], arms[:, 1]])
    pulls, _ = optimize.nnls(rows, np.array([weight, 0.0, 0.0]))
    return np.asarray(pulls + (system.M_iT - system.m) * system.g)


def bare(design: Design, rest: list[int]) -> Design:
    """What is needed to fly the vehicles `rest` each by itself, where no law carries the load with them."""
    n = len(design.system.m)
    lost = [k for k in range(n) if k not in rest]
    system = without(design.system, lost)
    air = Airframe(*(np.ascontiguousarray(field[rest]) for field in design.airframe))
    rows = [3 * k + a for k in rest for a in range(3)]
    D = 6 + 2 * int(system.n_links.sum())
    m = len(rest)
    u = np.zeros((m, 3))
    u[:, 2] = -system.m * system.g
    hanging = design.hanging
    L = system.length.shape[1]
    return design._replace(
        system=system, airframe=air, u_star=u,
        K_x=np.zeros((len(rows), D)), K_xdot=np.zeros((len(rows), D)), K_phi=np.zeros((len(rows), 2 * m)),
        K_phidot=np.zeros((len(rows), 2 * m)), K_pending=np.zeros((len(rows), len(rows) * design.delay)),
        K_integral=np.zeros((len(rows), 6)), b1=design.b1[rest].copy(),
        hanging=hanging._replace(
            q=hanging.q[rest, :L].copy(), omega=hanging.omega[rest, :L].copy(), R=hanging.R[rest].copy(),
            Omega=hanging.Omega[rest].copy(),
        ),
        authority=design.authority._replace(
            least=design.authority.least[rest].copy(), most=design.authority.most[rest].copy()
        ),
    )  # fmt: skip


def blind(design: Design) -> Filter:
    """A filter of those for whom `design` is, which puts together what is seen and corrects nothing by it."""
    system, n = design.system, len(design.system.m)
    D = 6 + 2 * int(system.n_links.sum())
    return Filter(system, design.airframe, design.hanging, np.zeros((2 * D + 3 * n, 6 * n)), np.zeros((n, 2, 2)))


def expanded(sample: Sample, members: list[int], whole: Design) -> Sample:
    """A decision for some of the vehicles as one for all; the others' parts are at rest and zero."""
    n = len(whole.system.m)
    if len(members) == n:
        return sample
    blank = first_memory(whole)

    def put(into: Array, value: Array, axis: int = 0) -> Array:
        out = into.copy()
        at_ = (slice(None),) * axis + (members,)
        if into.ndim - axis > 1 and value.ndim > axis + 1 and value.shape[axis + 1] != into.shape[axis + 1]:
            out[(*at_, slice(0, value.shape[axis + 1]))] = value
        else:
            out[at_] = value
        return out

    hanging = State.hanging(whole.system)
    s = sample.state
    state = State(
        s.x0, s.v0, s.R0, s.Omega0, put(hanging.q, s.q), put(hanging.omega, s.omega), put(hanging.R, s.R),
        put(hanging.Omega, s.Omega),
    )  # fmt: skip
    m = sample.memory
    memory = Memory(
        put(blank.R_c, m.R_c, 1),
        put(0.0 * blank.f, m.f, 1),
        put(blank.pending, m.pending, 1),
        m.integral,
        m.damping_share,
    )
    D = 6 + 2 * int(whole.system.n_links.sum())
    x, x_dot = np.zeros(D), np.zeros(D)
    x[:6], x_dot[:6] = sample.error.x[:6], sample.error.x_dot[:6]
    return sample._replace(
        state=state, memory=memory, error=Error(x, x_dot), A=put(np.zeros((n, 3)), sample.A),
        R_c=put(hanging.R, sample.R_c), f=put(np.zeros(n), sample.f), Psi=put(np.zeros(n), sample.Psi),
    )  # fmt: skip
