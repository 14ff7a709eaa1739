"""Riccati equations of large systems whose slowest poles lie next to the stability boundary, by structured doubling.

Link modes that nothing damps and that forces hardly move leave poles so close to it that solvers by the pencil's
eigenvalues refuse, and take many seconds at 500 states.
"""

import numpy as np

from cablequad.types import Array

DOUBLINGS = 60
ENOUGH = 1e-13  # relative change of the solution in the last doubling
ROUNDING = 1e-9  # a change below this that no longer falls is rounding


def discrete(A: Array, G: Array, Q: Array) -> Array:
    """X (k, k) with X = A' X (I + G X)^-1 A + Q, the stabilising solution; G, Q symmetric, positive semidefinite.

    G = B R^-1 B' for a regulator with x+ = A x + B u; for a filter A' stands for A and H' S^-1 H for G. By doubling the
    horizon (Anderson & Moore, Optimal Filtering, 6.7). Raises LinAlgError where it does not converge.
    """
    a, g, x = A, G, Q
    one = np.eye(len(A))
    before = np.inf
    with np.errstate(all="ignore"):  # what does not converge overflows
        for _ in range(DOUBLINGS):
            inverse = np.linalg.inv(one + g @ x)
            through = a @ inverse
            more, wider = a.T @ x @ inverse @ a, through @ g @ a.T
            a, g, x = through @ a, g + 0.5 * (wider + wider.T), x + 0.5 * (more + more.T)
            change = float(np.abs(more).max() / np.abs(x).max())
            if not np.isfinite(change):
                break
            if change <= ENOUGH or before <= change <= ROUNDING:
                return x
            before = change
    raise np.linalg.LinAlgError("the Riccati equation has no stabilising solution")


def continuous(A: Array, G: Array, Q: Array) -> Array:
    """X (k, k) with A' X + X A - X G X + Q = 0, the stabilising solution; G, Q symmetric, positive semidefinite.

    By a Cayley transform to a discrete equation (Chu, Fan & Lin 2005). Raises LinAlgError where it does not converge.
    """
    gamma = max(1.0, float(np.sqrt(np.linalg.norm(A))))
    one = np.eye(len(A))
    shifted = np.linalg.inv(A - gamma * one)
    W = np.linalg.inv((A - gamma * one).T + Q @ shifted @ G)
    g, x = 2.0 * gamma * shifted @ G @ W, 2.0 * gamma * W @ Q @ shifted
    return discrete(one + 2.0 * gamma * W.T, 0.5 * (g + g.T), 0.5 * (x + x.T))
