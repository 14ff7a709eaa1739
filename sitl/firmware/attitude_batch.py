"""How the vehicles of a fleet lie, for all of them at once."""

from collections.abc import Sequence

import numpy as np

from bridge.wire.batches import Batch, put_attitudes
from bridge.wire.messages import attitude
from cablequad.types import Array


class Attitudes(Batch):
    """Up to k messages ATTITUDE_QUATERNION of one instant."""

    def __init__(self, k: int) -> None:
        super().__init__([attitude(0, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))] * k)

    def tell(self, boot_ms: int, R: Sequence[Array], Omega: Sequence[Array]) -> None:
        """Fill in attitudes R (3, 3), B -> W, and body rates Omega (3,), rad/s, of as many as there are, k at most."""
        put_attitudes(np.array(R), np.array(Omega), boot_ms, self.payload, self.floats, self.as_bytes)
