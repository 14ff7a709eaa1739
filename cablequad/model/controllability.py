"""What the vehicles' forces can reach: motions of the linear model that no force moves are named and left out."""

from typing import NamedTuple

import numpy as np
from scipy import linalg

from cablequad.model.linear import equilibrium, linearize
from cablequad.model.system import System
from cablequad.types import Array

SAME = 1e-6  # relative: squared frequencies this close belong to one mode shape's family
NOTHING = 1e-7  # relative to the best reached motion
OUTPUTS = ("load x", "load y", "load z", "load yaw", "load roll", "load pitch")
OUTPUT_AT = (0, 1, 2, 5, 3, 4)  # where they stand in x


class Modes(NamedTuple):
    """The coordinates of the motions that forces reach: x = shapes xi, xi = coordinates x."""

    shapes: Array  # (D, k)
    coordinates: Array  # (k, D)
    missing: tuple[str, ...]  # what lies outside, in words


def coordinate_names(system: System) -> list[str]:
    """Names of the coordinates of x, in their order."""
    out = ["load x", "load y", "load z", "load roll", "load pitch", "load yaw"]
    for i, k in enumerate(system.n_links.tolist()):
        out += [f"cable {i + 1} link {j + 1} about {axis}" for j in range(k) for axis in "xy"]
    return out


def controllable(system: System) -> Modes:
    """The undamped modes of `linearize` that B excites; of a family of equal frequency, the part that it excites."""
    return _split(system, linearize(system)[2], None)


def observable(system: System, C: Array) -> Modes:
    """The undamped modes that `C` (m, D) shows; of a family of equal frequency, the part that it shows."""
    return _split(system, None, C)


def _symmetric(system: System) -> tuple[Array, Array, Array]:
    """The rows (D, 1), those of the links multiplied by their lengths, that make M and G symmetric, and both."""
    M, G, _ = linearize(system)
    lengths = [system.length[i, j] for i in range(len(system.m)) for j in range(int(system.n_links[i])) for _ in "xy"]
    rows = np.concatenate([np.ones(6), lengths])[:, None]
    M, G = rows * M, rows * G
    return rows, 0.5 * (M + M.T), 0.5 * (G + G.T)


def squared_frequencies(system: System) -> Array:
    """(D,) rad^2/s^2, ascending: of the undamped modes of `linearize`; below zero for one that falls over."""
    _, M, G = _symmetric(system)
    return np.asarray(linalg.eigh(G, M, eigvals_only=True))


def _split(system: System, B: Array | None, C: Array | None) -> Modes:
    """Modes by whether they touch the columns of B (forces) or the rows of C (measurements).

    With M and G symmetric modes are real and M-orthogonal.
    """
    rows, M, G = _symmetric(system)
    squares, modes = linalg.eigh(G, M)
    excited = modes.T @ (rows * B) if B is not None else (np.asarray(C) @ modes).T
    best = float(np.linalg.norm(excited, axis=1).max())
    scale = float(np.abs(squares).max())
    kept, lost = [], []
    first = 0
    for k in range(1, len(squares) + 1):
        if k < len(squares) and squares[k] - squares[k - 1] < SAME * scale:
            continue
        left, sizes, _ = np.linalg.svd(excited[first:k])
        reached = np.zeros(k - first, dtype=bool)
        reached[: len(sizes)] = sizes > NOTHING * best
        family, own = modes[:, first:k], left[:, reached]
        _, turned = np.linalg.eigh(own.T * squares[first:k] @ own)  # of frequencies nearly equal, each by itself
        kept.append(family @ own @ turned)
        lost.append(family @ left[:, ~reached])
        first = k
    shapes, outside = np.hstack(kept), np.hstack(lost)
    names = coordinate_names(system)
    outside[3:6] = equilibrium(system).R0 @ outside[3:6]  # a tilted load's turns are named by the world's axes
    missing = tuple(names[int(np.argmax(np.abs(shape)))] for shape in outside.T)
    return Modes(shapes, shapes.T @ M, missing)


def integrable_outputs(system: System, reached: Modes) -> list[int]:
    """Which of `OUTPUTS` constant forces can set, each on top of those before it: they can be free of lasting error."""
    _, G, B = linearize(system)
    still = reached.shapes @ (reached.coordinates @ linalg.null_space(np.hstack([G, -B]))[: len(G)])
    chosen: list[int] = []
    for k, at in enumerate(OUTPUT_AT):
        rows = still[[OUTPUT_AT[c] for c in chosen] + [at]]
        if np.linalg.matrix_rank(rows, tol=1e-6) == len(rows):
            chosen.append(k)
    return chosen
