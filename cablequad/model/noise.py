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
    """What vehicles are always wrong by, of which the estimator knows nothing."""

    position: float = 0.0  # m, standard deviation of each component, each vehicle's own
    attitude: float = 0.0  # rad, of each body axis
    position_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, W, of all vehicles
    attitude_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad, of all vehicles: roll, pitch, heading
