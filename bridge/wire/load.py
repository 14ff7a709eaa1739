"""What a payload tracker says at every tick, laid out once and filled in from then on."""

import numpy as np

from bridge.wire.dialect import CABLE_STATE, mavlink
from bridge.wire.messages import LINKS_PER_FRAME, encode
from bridge.wire.sheets import Sheet, put_load
from bridge.wire.values import CableShape, PayloadState
from cablequad.types import Array, Bytes, Counts, Floats


class LoadReport(Sheet):
    """CABLE_STATE of n cables, ten links a message, cable by cable; then ODOMETRY of the load, which closes a tick."""

    def __init__(self, n_links: Counts) -> None:
        many, most = n_links.tolist(), LINKS_PER_FRAME
        parts = [(i, first, min(most, k - first)) for i, k in enumerate(many) for first in range(0, k, most)]
        super().__init__([CABLE_STATE] * len(parts) + [mavlink.MAVLink_odometry_message])
        self._parts: Counts = np.array(parts, np.int64)
        self._shape = len(many), max(many)
        self._floats: Floats = np.zeros(1 + 6 * most, np.float32)
        self._as_bytes: Bytes = self._floats.view(np.uint8)
        links, still = np.ones((1, 6)), np.zeros(3)
        blank = [encode(CableShape(1, i + 1, many[i], first, 1.0, links)) for i, first, _ in parts]
        blank.append(encode(PayloadState(1, still, still, np.eye(3), still)))
        for row, message in zip(self.payload, blank, strict=True):
            row[: len(message.payload)] = np.frombuffer(message.payload, np.uint8)

    def tell(self, boot_us: int, row: Array) -> None:
        """Fill in the motion in `row` (`cablequad.instant.row`)."""
        put_load(row, boot_us, *self._shape, self._parts, self.payload, self._floats, self._as_bytes)
