"""The controller's side of the wire: n autopilots and a payload tracker, over MAVLink 2."""
