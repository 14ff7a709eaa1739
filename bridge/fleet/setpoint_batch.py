"""The one setpoint that our bridge sends, for a whole fleet at once."""

from collections.abc import Sequence

import numpy as np

from bridge.wire.batches import Batch, put_targets
from bridge.wire.messages import encode
from bridge.wire.values import AttitudeTarget
from cablequad.types import Array

ATTITUDE_AND_THRUST = 7  # type mask: body rates ignored
COMPONENT = 1


class WireError(ValueError):
    """A value that may not go on the wire."""


class Setpoints(Batch):
    """SET_ATTITUDE_TARGET of vehicles 1 .. n: type mask 7, unit quaternion, component 1."""

    def __init__(self, n: int) -> None:
        level, still = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        targets = [AttitudeTarget(0, i + 1, COMPONENT, ATTITUDE_AND_THRUST, level, still, 0.0) for i in range(n)]
        super().__init__([encode(target) for target in targets])

    def tell(self, boot_ms: int, R_c: Array, thrust: Sequence[float]) -> None:
        """Fill in attitudes R_c (n, 3, 3) and the thrust fields (n,), 0..1, that answer the state of `boot_ms`.

        Raises WireError, which names the vehicle, where one is not finite.
        """
        wrong = put_targets(R_c, np.array(thrust), boot_ms, self.payload, self.floats, self.as_bytes)
        if wrong >= 0:
            R = R_c[wrong].ravel().tolist()
            raise WireError(f"vehicle {wrong + 1}: non-finite setpoint (thrust {thrust[wrong]}, attitude {R})")
