"""What a payload tracker says at every tick, laid out once and filled in from then on."""

import numpy as np

from bridge.wire.batches import Batch, put_load
from bridge.wire.messages import LINKS_PER_FRAME, encode
from bridge.wire.values import CableShape, PayloadState
from cablequad.types import Array, Counts


class LoadReport(Batch):
    """CABLE_STATE of n cables, ten links a message, cable by cable; then ODOMETRY of the load, which closes a tick."""

    def __init__(self, n_links: Counts) -> None:
        many, most = n_links.tolist(), LINKS_PER_FRAME
        parts = [(i, first, min(most, k - first)) for i, k in enumerate(many) for first in range(0, k, most)]
        link, still = np.zeros((1, 6)), np.zeros(3)
        cables = [encode(CableShape(0, i + 1, many[i], first, 0.0, link)) for i, first, _ in parts]
        super().__init__([*cables, encode(PayloadState(0, still, still, np.eye(3), still))])
        self._parts: Counts = np.array(parts, np.int64)
        self._shape = len(many), max(many)

    def tell(self, boot_us: int, row: Array) -> None:
        """Fill in the motion in `row` (`cablequad.model.instant.row`)."""
        put_load(row, boot_us, *self._shape, self._parts, self.payload, self.floats, self.as_bytes)
