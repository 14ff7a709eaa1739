"""CABLE_STATE of whole fleets, laid out once and filled in at every tick."""

import numpy as np

from bridge.wire.dialect import CABLE_STATE
from bridge.wire.frames import Packed
from cablequad.types import Array, Counts

LINKS_PER_FRAME = 10
ROW = np.dtype(
    [
        ("boot_us", "<u8"), ("tension_N", "<f4"), ("cable", "u1"), ("n_links", "u1"), ("first_link", "u1"),
        ("links", "<f4", (LINKS_PER_FRAME, 6)),  # q, omega
    ]
)  # fmt: skip


def packed_rows(rows: np.ndarray) -> list[Packed]:
    """The messages whose payloads stand in `rows` of `ROW`."""
    kind, whole = CABLE_STATE, rows.tobytes()
    return [
        Packed(kind.id, kind.msgname, kind.crc_extra, whole[at : at + ROW.itemsize].rstrip(b"\0"))
        for at in range(0, len(whole), ROW.itemsize)
    ]


class Cables:
    """What is said of n cables at an instant, ten links a message, cable by cable."""

    def __init__(self, n_links: Counts) -> None:
        parts = [(i, first) for i, k in enumerate(n_links.tolist()) for first in range(0, k, LINKS_PER_FRAME)]
        self._rows = np.zeros(len(parts), ROW)
        self._of = np.array([i for i, _ in parts])
        self._rows["cable"] = self._of + 1
        self._rows["n_links"] = n_links[self._of]
        self._rows["first_link"] = [first for _, first in parts]
        cable, link = np.nonzero(np.arange(int(n_links.max()))[None, :] < n_links[:, None])
        row = np.array(
            [parts.index((i, j - j % LINKS_PER_FRAME)) for i, j in zip(cable.tolist(), link.tolist(), strict=True)]
        )
        self._from, self._to = (cable, link), (row, link % LINKS_PER_FRAME)
        self._last = (np.arange(len(n_links)), n_links - 1)
        self._boot_us, self._tension, self._links = (self._rows[name] for name in ("boot_us", "tension_N", "links"))
        self._six = np.empty((len(cable), 6))

    def packed(self, boot_us: int, tension: Array, q: Array, omega: Array) -> list[Packed]:
        """The messages of tensions (n, L) N, directions and rates (n, L, 3) rad/s, W."""
        self._boot_us[:] = boot_us
        self._tension[:] = tension[self._last][self._of]
        self._six[:, :3], self._six[:, 3:] = q[self._from], omega[self._from]
        self._links[self._to] = self._six
        return packed_rows(self._rows)
