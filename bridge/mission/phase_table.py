"""What is done in each phase of a mission: when it begins, while vehicles fly by themselves, and when it is over.

One row a phase, in `ACTIONS`; what may follow what, and how long it may take, is in `phases.RULES`.
"""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bridge.mission.members.cable_geometry import yaw_of
from bridge.mission.members.per_vehicle import clear_of
from bridge.mission.observation import Observation
from bridge.mission.phases import LOADED, Phase
from bridge.mission.protection.preflight_checks import preflight_faults
from bridge.mission.touch_down import TouchDown
from cablequad.control.trajectory import joined, leg
from cablequad.types import Array

if TYPE_CHECKING:
    from bridge.mission.mission import Mission

SPIN_UP_S = 2.0
STRAIGHT = 0.97  # of a cable's length
STANDS_M_S, STANDS_S = 0.05, 0.2


class Entry(NamedTuple):
    """How a phase is entered; places of the load are x, y, z (m), yaw (rad)."""

    before: Phase | None
    led: list[float]  # where the reference had come to
    to: list[float] | None  # where a script wants it


Enter = Callable[["Mission", Entry], None]
Over = Callable[["Mission", Observation], bool]
Power = Callable[["Mission"], float]


class Actions(NamedTuple):
    """What a phase does; `power`: of the thrust that vehicles by themselves ask for."""

    over: Over
    enter: Enter = lambda m, entry: None
    power: Power = lambda m: 1.0
    spin_up_s: float = 0.0  # before its way begins


# -- on the ground -----------------------------------------------------------------------------------------------------


def _arm(m: "Mission", _: Entry) -> None:
    m.fleet.may_arm = True


def _take_off(m: "Mission", _: Entry) -> None:
    x = m.here.x
    up = [[*p[:2], p[2] - m.plan.scale.clear_m, 0.0] for p in x.tolist()]
    slack = m.geometry.above(m.here.state, m.plan.slack)
    limits = m.limits_at(m.plan.take_off_speed)
    m.control.singles.go(
        [
            joined([leg([*a, 0.0], b, limits), leg(b, [*c, 0.0], limits)])
            for a, b, c in zip(x.tolist(), up, slack.tolist(), strict=True)
        ]
    )
    m.hang(m.geometry.chains(0.5), m.geometry.chains(0.5))
    m.control.singles.forget()


def _taken_off(m: "Mission", i: Observation) -> bool:
    off = i.x - m.goals().x
    ready = m.progress.clock.time >= SPIN_UP_S + m.control.singles.duration
    return ready and m.progress.at_rest(float(np.linalg.norm(off, axis=1).max()), i.v)


def _spinning_up(m: "Mission") -> float:
    time = m.progress.clock.time
    return 1.0 if time >= SPIN_UP_S else 0.1 + 0.8 * time / SPIN_UP_S


# -- cables taut -------------------------------------------------------------------------------------------------------


def _tension(m: "Mission", _: Entry) -> None:
    m.move_to(m.geometry.above(m.here.state, 1.0), m.plan.lift_speed)
    m.hang(m.geometry.chains(0.5), m.geometry.chains(0.5))


def _taut(m: "Mission", i: Observation) -> bool:
    progress, singles, geometry = m.progress, m.control.singles, m.geometry
    reached = progress.clock.time >= singles.duration
    far = np.linalg.norm(i.x - geometry.ends(m.here.state), axis=1)
    straight = bool((far > STRAIGHT * geometry.length).all())
    if reached and straight and not progress.taking:
        m.hang(singles.hung(m.now), geometry.chains(1.0) + m.plan.pretension * geometry.bears)
        progress.taking = True
    return progress.taking and straight and singles.handed_over(m.now)


def _release(m: "Mission", entry: Entry) -> None:
    singles = m.control.singles
    share = m.shares() if entry.before in LOADED else singles.hung(m.now)
    if entry.before in LOADED:
        singles.aim = m.here.x.copy()
    m.move_to(singles.aim, 1.0)
    m.hang(np.maximum(share, 0.0), m.geometry.chains(0.5))
    singles.forget()


def _released(m: "Mission", i: Observation) -> bool:
    progress = m.progress
    if progress.lasted_s < m.plan.scale.share_s:
        return False
    if not progress.taking:
        progress.taking = True
        m.move_to(m.geometry.above(m.here.state, m.plan.slack), m.plan.lift_speed)
    reached = progress.clock.time >= m.control.singles.duration
    return reached and progress.at_rest(float(np.linalg.norm(i.x - m.goals().x, axis=1).max()), i.v)


# -- the load in the air -----------------------------------------------------------------------------------------------


def _lift(m: "Mission", _: Entry) -> None:
    m.control.begin()
    state = m.here.state
    start = [*state.x0.tolist(), yaw_of(state, m.plan.hangs)]
    lift = 0.0 if m.plan.airborne else m.plan.lift_m
    m.control.track = leg(start, [*start[:2], start[2] - lift, start[3]], m.limits_at(m.plan.lift_speed))


def _carry(m: "Mission", entry: Entry) -> None:
    start, to = entry.led, entry.to
    end = to if to is not None else [*m.plan.target[:2], start[2], m.plan.target[3]]
    m.control.track = m.plan.route(start, end) if to is None else leg(start, to, m.plan.limits)


def _arrived(m: "Mission", i: Observation) -> bool:
    off = math.dist(i.state.x0.tolist(), m.led[:3])
    return m.progress.clock.time >= m.control.track.duration and m.progress.at_rest(off, i.state.v0[None])


def _set_down(m: "Mission", entry: Entry) -> None:
    start, to = entry.led, entry.to
    near = [*start[:2], min(start[2], m.plan.rest_z - m.plan.scale.slowly_m), start[3]]
    if to is not None:
        near = [*to[:2], near[2], to[3]]
    m.figures.mark = near[0], near[1]
    low = [*near[:2], m.plan.rest_z + m.plan.scale.below_m, near[3]]
    slowly = m.limits_at(m.plan.set_down_speed)
    m.control.track = joined([leg(start, near, m.limits_at(m.plan.lift_speed)), leg(near, low, slowly)])


def _stands(m: "Mission", i: Observation) -> bool:
    """Whether the load has come to stand: led further down than it goes.

    No model of hanging cables knows the ground: a load that stands seems to move, or to sink into it.
    """
    z, scale = float(i.state.x0[2]), m.plan.scale
    low = z > m.plan.rest_z - scale.near_m
    if low and m.figures.touch_down_m_s is None and z > m.plan.rest_z - 0.02:
        m.figures.touch_down_m_s = abs(float(i.state.v0[2]))
    slow = float(np.linalg.norm(i.state.v0)) < STANDS_M_S
    below = z > m.plan.rest_z + scale.pushed_m
    pushed = m.by_itself or m.led[2] - z > scale.pushed_m or below
    return m.progress.lasting(low and pushed and (slow or below), STANDS_S)


# -- landing -----------------------------------------------------------------------------------------------------------


def _land(m: "Mission", _: Entry) -> None:
    m.progress.touch_down, m.progress.touched_at = TouchDown(m.plan.scale.pushed_m), None
    spots = _landing_places(m)
    limits, down = m.limits_at(m.plan.take_off_speed), m.limits_at(m.plan.set_down_speed)
    ways = []
    for a, b in zip(m.control.singles.aim.tolist(), spots.tolist(), strict=True):
        over, low = [*b[:2], b[2] - m.plan.scale.clear_m, 0.0], [*b[:2], b[2] + m.plan.scale.below_m, 0.0]
        ways.append(joined([leg([*a, 0.0], over, limits), leg(over, low, down)]))
    m.control.singles.go(ways)


def _landing_places(m: "Mission") -> Array:
    R0, x0, stands = m.here.state.R0, m.here.state.x0, m.plan.stands[m.members]
    wrecks = [p for k in m.lost if (p := m.fleet.place(k)) is not None]
    spots = clear_of(wrecks, x0 + stands @ R0.T, x0, m.plan.scale)
    spots[:, 2] = m.plan.rest_z + stands[:, 2]
    return spots


def _landed(m: "Mission", i: Observation) -> bool:
    if m.progress.touched_at is None:
        stand = m.progress.touch_down.stands(m.now, i.x[:, 2], m.goals().x[:, 2])
        m.progress.touched_at = m.now if stand else None
    return m.fleet.all_landed


def _fading(m: "Mission") -> float:
    at = m.progress.touched_at
    return 1.0 if at is None else max(0.0, 0.6 - (m.now - at))


def _off(_: "Mission") -> float:
    return 0.0


ACTIONS: dict[Phase, Actions] = {
    Phase.PREFLIGHT: Actions(lambda m, i: not preflight_faults(i, m.geometry, m.plan, m.fleet), power=_off),
    Phase.ARM: Actions(lambda m, _: m.fleet.flying, _arm, _off),
    Phase.TAKE_OFF: Actions(_taken_off, _take_off, _spinning_up, SPIN_UP_S),
    Phase.TENSION: Actions(_taut, _tension),
    Phase.LIFT: Actions(_arrived, _lift),
    Phase.CARRY: Actions(_arrived, _carry),
    Phase.SET_DOWN: Actions(_stands, _set_down),
    Phase.RELEASE: Actions(_released, _release),
    Phase.LAND: Actions(_landed, _land, _fading),
    Phase.DISARM: Actions(lambda m, _: m.fleet.at_rest, lambda m, _: m.fleet.disarm(m.now), _off),
}
