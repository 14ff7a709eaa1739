"""Vehicles that no longer carry: found by what they say, where they are, and how they answer."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bridge.mission.observation import Observation
from cablequad.model.system import G
from cablequad.types import Array

NO_FOLLOW_RAD, NO_FOLLOW_S = 0.7, 0.2
SAGGED, FALLEN, CUT, CUT_M, GONE_S = 0.8, 0.2, 1.06, 0.1, 0.08  # of a cable's length
SILENT_S = 0.5  # after which what goes wrong is put down to who is silent
APART_S = 1.5  # for which it must look lost where every vehicle flies by itself, or the load swings between them
SWINGS = 3.0  # periods of a pendulum on its cable, for which a load swings that has lost a vehicle
FRESH_S = 0.15  # old is a vehicle's word of where it is


class Loss(NamedTuple):
    """A vehicle that is lost, and why."""

    member: int  # its place among those that carry
    why: str
    off: bool  # its cable is off the load
    sound: bool  # it flies, and may land by itself


class FaultInputs(NamedTuple):
    """What faults are found in, of one instant.

    Where cables need not be `taut` every vehicle flies by itself: it may be near its end of one, and what a load that
    topples does to it for a moment is not its doing.
    """

    members: list[int]
    observation: Observation
    ends: Array  # (n, 3) m, where the cables are tied to the load
    lengths: Array  # (n,) m
    R_c: Array | None  # (n, 3, 3), commanded last
    taut: bool
    departed: Mapping[int, tuple[float, str]]  # by the vehicle: when to act, and why
    astray: set[int]  # who does not know where it is
    touches: bool = False  # the load may stand on a part of itself, and leave cables slack


class FaultDetector:
    """What is wrong with each vehicle, and since when."""

    def __init__(self) -> None:
        self._since: dict[int, float] = {}
        self._swings_until = -math.inf

    def look(self, now: float, f: FaultInputs) -> Loss | None:
        """The first member that is lost at `now`, s of the vehicles' clock."""
        observation = f.observation
        far = np.linalg.norm(observation.x - f.ends, axis=1)
        steady = f.taut and now > self._swings_until
        for own, k in enumerate(f.members):
            act_at, why = f.departed.get(k, (math.inf, ""))
            loss, wait = Loss(own, why, False, True), 0.0
            if now < act_at:
                trusted = k not in f.astray and observation.x_age_s[own] < FRESH_S
                loss, wait = _seen(own, float(far[own] if trusted else f.lengths[own]), f, steady)
            if not loss.why:
                self._since.pop(k, None)
            elif now - self._since.setdefault(k, now) >= wait:
                period = 2.0 * math.pi * math.sqrt(float(f.lengths.max()) / G)
                self._swings_until = now + SWINGS * period
                silent = int(np.argmax(observation.x_age_s))
                age_s = float(observation.x_age_s[silent])
                if age_s > SILENT_S and now < act_at:  # where the others are is its doing
                    return Loss(
                        silent, f"nothing heard of it for {age_s:.1f} s, and the load does not hang", False, False
                    )
                return loss
        return None


def _seen(own: int, far: float, f: FaultInputs, steady: bool) -> tuple[Loss, float]:
    """What is wrong with a vehicle `far` m from its end of a cable, and how long that is waited for.

    `steady`: the load hangs and does not swing.
    """
    length, taut = float(f.lengths[own]), f.taut
    gone_s = GONE_S if steady else APART_S
    if far > CUT * length + CUT_M:
        return Loss(own, f"it is {far:.2f} m from the load: its cable is off", True, True), gone_s
    above = float(f.ends[own, 2] - f.observation.x[own, 2])
    if taut and far < SAGGED * length and (not f.touches or above < FALLEN * length):
        return Loss(own, "it is where its cable cannot hold the load", False, False), gone_s
    if f.R_c is not None:
        cosine = float(f.R_c[own, :, 2] @ f.observation.state.R[own, :, 2])
        if math.acos(min(1.0, max(-1.0, cosine))) > NO_FOLLOW_RAD:
            return Loss(own, "it does not follow its attitude", False, False), max(
                NO_FOLLOW_S, gone_s if not taut else 0.0
            )
    return Loss(own, "", False, True), 0.0
