"""Which cables are slack, from the truth: told where that changes, not at every swing of a link."""

from typing import NamedTuple

import numpy as np

from cablequad.model.system import System
from cablequad.types import Array

PUSHES_N = 0.05  # links are rigid: one that pushes with more is one of a cable that is slack
CURLED, STRAIGHT = 0.9, 0.95  # of a cable's length: how far its ends are apart
LASTS_US = 200_000  # that a cable must be straight and pull before it is taut again


class Change(NamedTuple):
    """A cable that is slack, or taut again."""

    kind: str  # slack or taut
    cable: int  # from 1
    text: str


class SlackCables:
    """The cables of one run; all are taken for taut until they are seen."""

    def __init__(self, system: System) -> None:
        self._length, self._total = system.length, system.length.sum(axis=1)
        self._slack: set[int] = set()
        self._taut_since: dict[int, int] = {}

    def suspects(self, tension: Array, q: Array) -> Array:
        """(T,) whether something may change at a row of tensions (T, n, L) N and link directions (T, n, L, 3)."""
        if self._slack:
            return np.ones(len(tension), dtype=bool)
        pushes = (tension < -PUSHES_N).any(axis=(1, 2))
        return np.asarray(pushes | (self._apart(q) < CURLED * self._total).any(axis=1))

    def look(self, boot_us: int, tension: Array, q: Array) -> list[Change]:
        """What changes at an instant: tensions (n, L) N, infinite where there is no link, and directions (n, L, 3)."""
        out: list[Change] = []
        apart = self._apart(q)
        for i, link in enumerate(tension.argmin(axis=1).tolist()):
            least, share = float(tension[i, link]), float(apart[i] / self._total[i])
            if i not in self._slack and (least < -PUSHES_N or share < CURLED):
                self._slack.add(i)
                pushes = f"link {link + 1} pushes with {-least:.2f} N: the cable is slack"
                curled = f"it is curled: its ends are {apart[i]:.2f} m apart, it is {self._total[i]:.2f} m long"
                out.append(Change("slack", i + 1, curled if share < CURLED else pushes))
            elif i in self._slack:
                if least < PUSHES_N or share < STRAIGHT:
                    self._taut_since.pop(i, None)
                elif boot_us - self._taut_since.setdefault(i, boot_us) >= LASTS_US:
                    self._slack.discard(i)
                    del self._taut_since[i]
                    out.append(Change("taut", i + 1, "it is straight, and every link pulls"))
        return out

    def _apart(self, q: Array) -> Array:
        """(..., n) m: how far a cable's ends are apart, at link directions (..., n, L, 3)."""
        return np.asarray(np.linalg.norm((self._length[..., None] * q).sum(axis=-2), axis=-1))
