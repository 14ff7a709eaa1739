"""What a mission is to do, as values."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from bridge.mission.phases import Phase
from bridge.mission.protection.guards import Guard
from bridge.mission.scale import USUAL, Scale
from cablequad.control.trajectory import Limits, Trajectory
from cablequad.types import Array


class MissionPlan(NamedTuple):
    """What is to be done, and how."""

    rest_z: float  # m: of the load, standing
    stands: Array  # (n, 3) m, where vehicles stand, from the load, in its frame
    hangs: Array  # (3, 3) the load's attitude where it hangs at rest
    target: list[float]  # x, y, z (m), yaw (rad): where it is set down
    route: Callable[[list[float], list[float]], Trajectory]  # from above one place to above another
    limits: Limits  # of a way that a script asks for
    lift_m: float
    slack: float  # of a cable's length: where vehicles hover before and after
    pretension: float  # of the share of the load's weight
    lift_speed: float  # m/s
    set_down_speed: float
    take_off_speed: float
    limits_s: Mapping[Phase, float]  # that the scenario states
    guards: tuple[Guard, ...]
    fence: Array  # (2, 3) m
    battery: float  # 0 .. 1: with less no vehicle is armed
    hooks: bool  # a vehicle can let go of its cable (MAV_CMD_DO_GRIPPER)
    protect: bool  # False: whatever happens, carry on as planned
    airborne: bool  # begins with a load that hangs
    hold_s: float  # how long it hangs still before it is carried
    scale: Scale = USUAL
