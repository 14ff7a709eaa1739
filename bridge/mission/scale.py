"""Lengths, speeds and times of a mission, from the size of what flies.

The values of `USUAL` are those of a vehicle with arms of 0.17 m on a cable of 0.75 m. Lengths along a cable grow with
its length, speeds and times with the period of a pendulum on it; what a vehicle needs around it grows with its arms.
"""

import math
from typing import NamedTuple

CABLE_M, ARM_M = 0.75, 0.17
FENCED_CABLES = 8.0  # of 0.75 m: cables up to 6 m have the usual fence


class Scale(NamedTuple):
    """What counts as near, slow or long."""

    near_m: float = 0.12  # from where something is to be, to be there
    slow_m_s: float = 0.15  # to be at rest
    clear_m: float = 0.35  # straight up first, and down last
    below_m: float = 0.15  # how far below the ground a load or a vehicle is led that comes down
    slowly_m: float = 0.12  # above the ground, from where a load is set down slowly
    pushed_m: float = 0.05  # below what it stands on, that a thing is led to, to count as standing
    share_s: float = 1.5  # for what hangs on a vehicle to be taken or given
    off_wreck_m: float = 0.7  # between who lands and a wreck
    off_others_m: float = 0.5  # between vehicles that land
    take_off_m_s: float = 0.5
    lift_m_s: float = 0.4
    set_down_m_s: float = 0.15
    separation_m: float = 0.3  # of two vehicles, at least
    hit_m: float = 0.25  # of two vehicles that hit each other
    off_plan_m: float = 0.5  # of the load, at most
    around_m: float = 50.0  # the fence, from where the load begins
    above_m: float = 30.0  # the ground, of the fence


USUAL = Scale()


def scale_of(cable_m: float, arm_m: float) -> Scale:
    """For cables of this mean length and vehicles with these arms."""
    cable, arm = round(cable_m / CABLE_M, 6), round(arm_m / ARM_M, 6)
    pendulum, u = math.sqrt(cable), USUAL

    def along(low: float, high: float) -> float:
        return min(max(cable, low), high)

    def swinging(low: float, high: float) -> float:
        return min(max(pendulum, low), high)

    return Scale(
        near_m=u.near_m * along(0.4, 4.0),
        slow_m_s=u.slow_m_s * swinging(0.6, 2.0),
        clear_m=u.clear_m * min(max(arm, 0.3), 6.0),
        below_m=u.below_m * along(0.5, 2.0),
        slowly_m=u.slowly_m * along(0.5, 3.0),
        pushed_m=u.pushed_m * along(0.5, 2.0),
        share_s=u.share_s * swinging(0.7, 3.0),
        off_wreck_m=u.off_wreck_m * arm,
        off_others_m=u.off_others_m * arm,
        take_off_m_s=u.take_off_m_s * swinging(0.6, 3.0),
        lift_m_s=u.lift_m_s * swinging(0.6, 3.0),
        set_down_m_s=u.set_down_m_s * swinging(0.7, 1.0),
        separation_m=u.separation_m * arm,
        hit_m=u.hit_m * arm,
        off_plan_m=u.off_plan_m * along(0.4, 4.0),
        around_m=u.around_m * max(1.0, cable / FENCED_CABLES),
        above_m=u.above_m * max(1.0, cable / FENCED_CABLES),
    )
