"""The one setpoint that our bridge sends, for a whole fleet at once."""

from collections.abc import Sequence

import numpy as np

from bridge.wire.dialect import mavlink
from bridge.wire.sheets import Sheet, put_targets
from cablequad.types import Array, Bytes, Floats

ATTITUDE_AND_THRUST = 7  # type mask: body rates ignored
COMPONENT = 1


class WireError(ValueError):
    """A value that may not go on the wire."""


class Setpoints(Sheet):
    """SET_ATTITUDE_TARGET of vehicles 1 .. n: type mask 7, unit quaternion, component 1."""

    def __init__(self, n: int) -> None:
        super().__init__([mavlink.MAVLink_set_attitude_target_message] * n)
        self._floats: Floats = np.zeros(8, np.float32)
        self._as_bytes: Bytes = self._floats.view(np.uint8)
        for i, row in enumerate(self.payload):
            row[36:39] = i + 1, COMPONENT, ATTITUDE_AND_THRUST

    def tell(self, boot_ms: int, R_c: Array, thrust: Sequence[float]) -> None:
        """Fill in attitudes R_c (n, 3, 3) and the thrust fields (n,), 0..1, that answer the state of `boot_ms`.

        Raises WireError, which names the vehicle, where one is not finite.
        """
        wrong = put_targets(R_c, np.array(thrust), boot_ms, self.payload, self._floats, self._as_bytes)
        if wrong >= 0:
            R = R_c[wrong].ravel().tolist()
            raise WireError(f"vehicle {wrong + 1}: non-finite setpoint (thrust {thrust[wrong]}, attitude {R})")
