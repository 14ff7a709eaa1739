"""How fast the links can swing, and the physics step that this asks for."""

import numpy as np
from scipy import linalg

from cablequad.model.linear import EquilibriumError, linearize
from cablequad.model.system import System

LEAST_STEP_US = 4  # a system that needs a shorter physics step is not simulated
STABLE = 0.5  # omega h: RK4 is stable up to 2.8 and accurate well below 1


def stiffest_mode(system: System) -> float:
    """rad/s of the fastest mode of the load, its vehicles and their cables about rest; of the cables alone, with their

    ends held and equal shares of the load, where nothing hangs at rest.
    """
    try:
        M, G, _ = linearize(system)
    except EquilibriumError:
        return _stiffest_of_the_cables(system)
    lengths = [system.length[i, j] for i, k in enumerate(system.n_links.tolist()) for j in range(k) for _ in "xy"]
    rows = np.concatenate([np.ones(6), lengths])[:, None]  # which make both symmetric
    M, G = rows * M, rows * G
    try:
        squares = linalg.eigh(0.5 * (G + G.T), 0.5 * (M + M.T), eigvals_only=True)
    except linalg.LinAlgError:  # masses are too far apart for the numbers
        return _stiffest_of_the_cables(system)
    return float(np.sqrt(max(float(np.abs(squares).max()), 1e-12)))


def _stiffest_of_the_cables(system: System) -> float:
    fastest = 0.0
    for i in range(len(system.m)):
        k = int(system.n_links[i])
        l = system.length[i, :k]
        M_0 = system.M_0[i, :k]
        M = np.minimum.outer(np.arange(k), np.arange(k))
        M = M_0[M] * np.outer(l, l)
        below = system.M_iT[i] + system.m0 / len(system.m) - M_0
        tension = np.maximum(below, 1e-9) * system.g
        # the payload holds the lower end: take the weighted mean motion of the chain's ends out
        G = np.diag(tension * l)
        fastest = max(fastest, float(np.sqrt(linalg.eigh(G, M, eigvals_only=True).max())))
    return fastest


def stable_substep(system: System, asked_us: int, tick_us: int) -> int:
    """The longest step in us, no longer than asked, that divides `tick_us` and keeps omega h below `STABLE`."""
    limit_us = STABLE / stiffest_mode(system) * 1e6
    parts = max(1, -(-tick_us // asked_us))
    while tick_us % parts or tick_us / parts > limit_us:
        parts += 1
        if parts > tick_us:
            return 1
    return tick_us // parts
