"""What is done in a mission when something goes wrong: guards that are broken, vehicles that are lost."""

import math
from typing import TYPE_CHECKING

import numpy as np

from bridge.mission.members.fleet_subset import static_shares
from bridge.mission.observation import Observation
from bridge.mission.phases import FLYING, LOADED, ON_PLAN, SLACK, Phase
from bridge.mission.protection.fault_detection import FaultDetector, FaultInputs, Loss
from bridge.mission.protection.guards import Guard, GuardInputs, GuardMonitor, guard_values, separation
from cablequad.control.trajectory import sink
from cablequad.types import Array

if TYPE_CHECKING:
    from bridge.mission.mission import Mission

EMERGENCY_M_S = 0.4


class Protection:
    """Looks at every instant of a mission."""

    def __init__(self, guards: tuple[Guard, ...]) -> None:
        self._monitor = GuardMonitor(guards)
        self._faults = FaultDetector()

    def look(self, m: "Mission", i: Observation) -> None:
        """Act where something is wrong in what is known of this instant."""
        if m.phase not in FLYING:
            return
        tension = tensions(m, i)
        if m.phase in LOADED:
            m.figures.largest_tension_N = max(m.figures.largest_tension_N, float(np.nanmax(tension)))
        m.figures.smallest_separation_m = min(m.figures.smallest_separation_m, separation(i.x))
        self._guard(m, i, tension)
        if m.plan.protect and m.phase in SLACK:
            gone = [(k, m.fleet.departed[k]) for k in m.members if k in m.fleet.departed]
            for k, (at, why) in gone:
                if m.now >= at:
                    lose(m, Loss(m.members.index(k), why, off=False, sound=True))
        if m.plan.protect and m.phase in LOADED:
            R_c = None if m.control.last is None else m.control.last.R_c
            ends = m.geometry.ends(m.here.state)
            touches = float((ends[:, 2] - m.geometry.system.rho[:, 2]).max()) > m.plan.rest_z - m.plan.scale.near_m
            inputs = FaultInputs(
                m.members, i, ends, m.geometry.length, R_c, not m.by_itself, m.fleet.departed, m.fleet.astray, touches
            )
            loss = self._faults.look(m.now, inputs)
            if loss is not None:
                lose(m, loss)

    def _guard(self, m: "Mission", i: Observation, tension: Array) -> None:
        last = m.control.last
        reserve = 1.0 if last is None else float((1.0 - last.f / m.design.airframe.max_thrust).min())
        batteries = [m.fleet.batteries[k] for k in m.members]
        off = math.dist(i.state.x0.tolist(), m.reference.x0.tolist()) if m.phase in ON_PLAN else 0.0
        reading = GuardInputs(
            i.x, i.state.R, i.state.x0, i.state.R0, tension, reserve, i.age_s, off, min(batteries), m.plan.fence
        )
        broken, healed = self._monitor.look(m.now, guard_values(reading))
        for b in broken:
            action = b.guard.action if m.plan.protect else "warn"
            m.tell("guard", b.guard.name, f"{b.value:.3g}, limit {b.guard.limit:g}: {action}")
            if action == "pause":
                m.pause(b.guard.name)
            elif action == "set-down":
                m.abort(f"guard {b.guard.name}: {b.value:.3g}, limit {b.guard.limit:g}; set down here")
        for guard in healed:
            m.tell("guard", guard.name, "holds again")
            m.resume(guard.name)


def tensions(m: "Mission", i: Observation) -> Array:
    """(members,) N: at the load as the tracker tells, or what vehicles give beyond their weight."""
    if m.control.last is None or np.isfinite(i.tension).all():
        return i.tension
    return np.asarray(np.linalg.norm(m.geometry.pulled(m.control.last), axis=1))


def lose(m: "Mission", loss: Loss) -> None:
    """Go on without a vehicle where the rest can, else set down in order."""
    k = m.members[loss.member]
    m.tell("lost", f"vehicle {k + 1}", loss.why)
    end = "it was told to land" if loss.sound else "its motors were told to stop"
    m.fleet.lose(k, m.plan.hooks, stop=not loss.sound)
    rest = m.membership.lose(k, loss.why, f"lost in phase {m.phase}: {loss.why}; {end}")
    if not rest:
        m.failure, m.finished = f"vehicle {k + 1}: {loss.why}; nobody is left", True
        return
    m.keep(rest)
    if m.phase in SLACK:
        none = np.zeros(len(rest))
        m.hang(none, none)
        m.progress.done = True
        m.abort(f"vehicle {k + 1}: {loss.why}; the others land")
        return
    off = m.plan.hooks or loss.off
    if off and not m.by_itself and m.geometry.can_carry():
        m.tell("crew", "all", f"{len(rest)} vehicles carry the load on")
        return
    m.tell("crew", "all", f"{len(rest)} vehicles cannot carry the load on; they set it down")
    _sink(m)
    m.abort(f"vehicle {k + 1}: {loss.why}; the load is set down here")
    if m.phase is Phase.SET_DOWN:
        m.progress.restart()


def _sink(m: "Mission") -> None:
    """Every vehicle by itself comes down until the load stands."""
    m.by_itself = True
    depth = max(0.0, m.plan.rest_z + m.plan.scale.below_m - float(m.here.state.x0[2]))
    m.control.singles.go([sink([*x, 0.0], depth, EMERGENCY_M_S) for x in m.here.x.tolist()])
    m.progress.clock.time = 0.0
    hung = static_shares(m.design.system, m.here.state.R0)
    m.hang(hung, hung)
