"""pymavlink's `common` dialect with our CABLE_STATE grafted in; MAVLink 2 only, never `mavutil`."""

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from bridge.wire import cable_dialect

Kind = Any  # a pymavlink message class

mavlink.mavlink_map.update(cable_dialect.mavlink_map)
CABLE_STATE = cable_dialect.MAVLink_cable_state_message

__all__ = ["CABLE_STATE", "Kind", "mavlink"]
