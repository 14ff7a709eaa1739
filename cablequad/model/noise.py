"""How well things are measured: the simulated sensors and the observer share the one description."""

from typing import NamedTuple


class Noise(NamedTuple):
    """Standard deviations of what is measured, each component."""

    position: float = 0.0  # m
    velocity: float = 0.0  # m/s
    attitude: float = 0.0  # rad, of each body axis
    rate: float = 0.0  # rad/s
    link_direction: float = 0.0  # rad, of each axis across the link
    link_rate: float = 0.0  # rad/s


class Biases(NamedTuple):
    """Standard deviations of what a vehicle is always wrong by, each component; the observer knows nothing of it."""

    position: float = 0.0  # m
    attitude: float = 0.0  # rad, of each body axis
