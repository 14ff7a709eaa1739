"""Values <-> MAVLink messages, both directions side by side; the only room with MAVLink's units and numbers."""
