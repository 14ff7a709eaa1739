"""A mission from the ground to the ground: phases, plan, guards and fault detection."""
