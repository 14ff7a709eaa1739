"""A mission from the ground to the ground: what a script may ask for, and one decision per measured state.

No socket and no clock in here. While cables are slack every vehicle flies by itself; from lifting to setting down the
load is flown (`load_control`). What comes next is up to a script, which asks for phases (`phase_table`) and waits for
them; what goes wrong is up to `protection`.
"""

from collections.abc import Callable, Coroutine, Sequence
from typing import Any

import numpy as np

from bridge.fleet.fleet import Fleet
from bridge.mission.load_control import LoadControl
from bridge.mission.members.cable_geometry import CableGeometry, yaw_of
from bridge.mission.members.members import Contingencies, Members
from bridge.mission.observation import Observation
from bridge.mission.phase_table import ACTIONS, Entry
from bridge.mission.phases import FLYING, LOADED, RULES, Phase
from bridge.mission.plan import MissionPlan
from bridge.mission.progress import Figures, Progress
from bridge.mission.protection.guards import outside_fence
from bridge.mission.protection.preflight_checks import preflight_faults
from bridge.mission.protection.protection import Protection, tensions
from bridge.mission.script_turns import MissionError, ScriptTurns, Until, Wait
from bridge.wire.dialect import mavlink
from cablequad.control.control_step import Measurement, Sample
from cablequad.control.design import Design
from cablequad.control.estimator import Filter
from cablequad.control.single_vehicle import Goals
from cablequad.control.trajectory import Limits, Reference, at, leg, still
from cablequad.model import lie
from cablequad.types import Array

__all__ = ["Mission", "MissionError", "Script", "Until", "Wait"]

ACCEPTED, TEMPORARILY_REJECTED, UNSUPPORTED = 0, 1, 3  # MAV_RESULT
SOME_S = 10.0  # beside twice its way, that a phase may take
HURRY = 1.6  # how much faster everything goes that brings an aborted mission down

Script = Callable[["Mission"], Coroutine[Any, Any, None]]


class Mission:
    """The state of one mission."""

    def __init__(
        self, plan: MissionPlan, fleet: Fleet, planned: Contingencies, period_s: float, script: Script
    ) -> None:
        self.plan: MissionPlan = plan
        self.fleet: Fleet = fleet
        self.membership = Members(planned)
        self.progress, self.figures = Progress(period_s, plan.scale), Figures()
        self.control = LoadControl(planned.law, self.design, plan.scale.share_s, self.tell)
        self.failure: str | None = None
        self.finished = False
        self.by_itself = False  # the load is set down with every vehicle by itself
        self.events: list[tuple[str, str, str]] = []
        self._aborted = False
        self._protection = Protection(plan.guards)
        self._heard: Observation | None = None
        self._turns = ScriptTurns(script(self))

    # -- what scripts ask ----------------------------------------------------------------------------------------------

    def begin(self, phase: Phase, to: list[float] | None = None) -> Wait:
        """Start a phase; await what comes back for its end. Raises MissionError where it may not follow."""
        if self.phase not in RULES[phase].after and not self._aborted:
            here = "the start" if self.phase is None else f"phase {self.phase}"
            allowed = ", ".join(sorted("the start" if p is None else str(p) for p in RULES[phase].after))
            raise MissionError(f"{phase} may not follow {here}; it may follow {allowed}")
        if self.phase is not None and not self.progress.done and not self._aborted:
            raise MissionError(f"{phase} may not begin while phase {self.phase} is under way; await that first")
        if to is not None and not self._aborted:
            self._reachable(phase, to)
        self._enter(phase, to)
        return Wait(lambda: self.progress.done)

    def _reachable(self, phase: Phase, to: list[float]) -> None:
        """Raise MissionError where the load cannot be brought to x, y, z (m), yaw (rad), before anything moves."""
        where = "({:g}, {:g}, {:g}) m".format(*to[:3])
        if to[2] > self.plan.rest_z:
            raise MissionError(
                f"{phase} to {where}: below the ground; the load stands at z = {self.plan.rest_z:.2f} m, and up is "
                "negative"
            )
        hung = self.here.state._replace(x0=np.array(to[:3]), R0=lie.exp(np.array([0.0, 0.0, to[3]])) @ self.plan.hangs)
        outside = outside_fence(self.plan.fence, [np.array(to[:3]), *self.geometry.above(hung, 1.0)])
        if outside > 0.0:
            raise MissionError(
                f"{phase} to {where}: the load or a vehicle above it would be {outside:.1f} m outside the fence"
            )
        seconds, limit = leg(self.led, to, self.plan.limits).duration, self.plan.limits_s.get(phase)
        if limit is not None and seconds > limit:
            raise MissionError(
                f"{phase} to {where}: it takes {seconds:.0f} s within the limits of [plan], and the phase may take "
                f"{limit:g} s (mission.limits_s)"
            )

    def wait(self, seconds: float) -> Wait:
        """For a while, on the vehicles' clock."""
        end = self.now + seconds
        return Wait(lambda: self.now >= end - 1e-9)

    def tilt(self, turn: list[float], seconds: float) -> Wait:
        """Turn every vehicle by a rotation vector (rad, of its body) beyond what it is commanded, for a while.

        Raises MissionError where they do not hover on slack cables.
        """
        if self.phase is not Phase.TAKE_OFF or not self.progress.done:
            raise MissionError("tilt: only while all hover on slack cables, after take off")
        self.control.tilt(turn, self.now + seconds)
        return self.wait(seconds)

    def pause(self, who: str = "operator") -> None:
        """Stop the load where it is on its way, for as long as `who` wants."""
        if self.progress.clock.stop(who):
            self.tell("pause", who, f"the plan's clock stops in phase {self.phase}")

    def resume(self, who: str = "operator") -> None:
        """Go on, unless somebody else wants it to stand."""
        if self.progress.clock.go(who):
            self.tell("resume", who, f"the plan's clock goes on in phase {self.phase}")

    def abort(self, why: str) -> None:
        """Give up what was planned and come to the ground from here, in order."""
        if self._aborted or self.finished:
            return
        self._aborted = True
        self.progress.clock.run()
        self.failure = self.failure or why
        self.tell("abort", "all", why)
        self._turns.replace(self._come_down())

    def command(self, command: int, params: Sequence[float]) -> int:
        """Obey a MAVLink command of an operator; the MAV_RESULT to acknowledge."""
        if self.phase is None or self.finished:
            return TEMPORARILY_REJECTED
        if command == mavlink.MAV_CMD_DO_PAUSE_CONTINUE and params[0] in (0.0, 1.0):
            (self.pause if params[0] == 0.0 else self.resume)()
            return ACCEPTED
        if command == mavlink.MAV_CMD_NAV_LAND:
            self.abort("told to come down")
            return ACCEPTED
        return UNSUPPORTED

    async def _come_down(self) -> None:
        if self.phase is None:
            return
        if self.phase is Phase.ARM and self.plan.airborne and self.released:  # the load hangs where it was held
            self.control.track = still([*self.here.state.x0.tolist(), yaw_of(self.here.state, self.plan.hangs)])
            await self.begin(Phase.SET_DOWN)
            await self.begin(Phase.RELEASE)
        elif self.phase in LOADED:
            if self.phase is not Phase.SET_DOWN:
                await self.begin(Phase.SET_DOWN, self._below())
            else:
                await Wait(lambda: self.progress.done)
            await self.begin(Phase.RELEASE)
        elif self.phase is Phase.TENSION:
            await self.begin(Phase.RELEASE)
        if self.phase in (Phase.TAKE_OFF, Phase.RELEASE):
            await self.begin(Phase.LAND)
        elif self.phase is Phase.LAND:
            await Wait(lambda: self.progress.done)
        await self.begin(Phase.DISARM)

    def close(self) -> None:
        """Ask no script any more."""
        self._turns.close()

    # -- one decision --------------------------------------------------------------------------------------------------

    def answer(self, t: float, now: float, observation: Observation) -> Sample:
        """The decision for what is known of `now` (s of the vehicles' clock); `observation` is of the members."""
        self._heard = observation
        self.progress.tick(now)
        self._protection.look(self, observation)
        phase, progress = self.phase, self.progress
        if phase is not None and not progress.done and ACTIONS[phase].over(self, self.here):
            progress.done = True
        self._ask_script()
        if (phase := self.phase) is not None and not progress.done and progress.lasted_s > self.limit_s(phase):
            self._timed_out(phase)
        if self.finished:
            for k, fate in self.membership.fates():
                self.tell("fate", f"vehicle {k + 1}", f"vehicle {k + 1}: {fate}")
        return self._fly(t, self.here)

    def _ask_script(self) -> None:
        """Ask the script for what it wants next, as long as what it waited for has come."""
        while not self.finished and self._turns.ready:
            try:
                over = self._turns.ask()
            except MissionError as error:
                if self._aborted and not self._turns.replaced:
                    self.failure, self.finished = self.failure or str(error), True
                self.abort(str(error))
            else:
                self.finished = self.finished or over

    def _enter(self, phase: Phase, to: list[float] | None) -> None:
        entry = Entry(self.phase, self.led, to)
        self.progress.enter(phase)
        self.tell("phase", "all", str(phase))
        ACTIONS[phase].enter(self, entry)

    def _fly(self, t: float, i: Observation) -> Sample:
        loaded = self.hanging
        reference = self.reference if loaded and self.phase in LOADED else self._at_rest(i)
        measured = Measurement(t, i.state, restrained=not (loaded and self.released))
        if loaded:
            return self.control.fly_load(measured, reference)
        return self.control.fly_vehicles(measured, reference, i, self.goals(), self.now)

    def _timed_out(self, phase: Phase) -> None:
        text = f"phase {phase} took more than {self.limit_s(phase):.3g} s"
        if phase is Phase.PREFLIGHT:
            text += ": " + "; ".join(preflight_faults(self.here, self.geometry, self.plan, self.fleet))
        if not self._aborted and phase not in (Phase.SET_DOWN, Phase.RELEASE, Phase.LAND, Phase.DISARM):
            self.abort(text)
            return
        stuck = phase is Phase.DISARM or (phase is Phase.LAND and self.progress.overdue)
        if phase is Phase.LAND and stuck:
            text += " again; vehicles are left to their own failsafe, as they may be in the air"
        self.failure = self.failure or text
        self.tell("abort", "all", text)
        self.progress.overdue = True
        self.progress.restart()
        self.progress.done = phase is not Phase.LAND  # towards the ground, but not by a fall
        self.finished = self.finished or stuck

    # -- what phases and protection do ---------------------------------------------------------------------------------

    def tell(self, kind: str, subject: str, text: str) -> None:
        """An event."""
        self.events.append((kind, subject, text))

    def hang(self, before: Array, after: Array) -> None:
        """What hangs on the vehicles, (members,) N, goes from one to the other."""
        self.control.singles.hang(before, after, self.now)
        self.progress.taking = False

    def move_to(self, x: Array, speed: float) -> None:
        """Every vehicle on a straight way from where it was to be to `x`, (members, 3) m."""
        self.control.singles.straight_to(x, self.limits_at(speed))
        self.progress.clock.time = 0.0

    def limits_at(self, speed: float) -> Limits:
        """Of a way at `speed` (m/s); an aborted mission hurries."""
        speed *= HURRY if self._aborted else 1.0
        return Limits(speed, max(0.3, speed), 3.0, 0.5)

    def limit_s(self, phase: Phase) -> float:
        """What a phase may take: what the scenario says; else as long as its way takes twice, and some."""
        if (stated := self.plan.limits_s.get(phase)) is not None:
            return stated
        way_s = 0.0
        if phase in LOADED and not self.by_itself:
            way_s = self.control.track.duration
        elif phase in FLYING:
            way_s = self.control.singles.duration
        return max(RULES[phase].limit_s, 2.0 * way_s + SOME_S)

    def keep(self, rest: list[int]) -> None:
        """Only some members are left: where they stood among those before."""
        self._heard = self.here.of(rest, self.design)
        self.control.keep(rest, self.design, self.here.x)

    def shares(self) -> Array:
        """(members,) N: what hung on each vehicle by the last command."""
        if self.control.last is None or self.by_itself:
            return self.control.singles.hung(self.now)
        return -self.geometry.pulled(self.control.last)[:, 2]

    def goals(self) -> Goals:
        """Where each vehicle is to be, while it flies by itself."""
        action = None if self.phase is None else ACTIONS[self.phase]
        power, spun = (0.0, 0.0) if action is None else (action.power(self), action.spin_up_s)
        clock = self.progress.clock
        return self.control.singles.goals(self.here.x, self.now, clock.time - spun, clock.rate, power)

    # -- how things are ------------------------------------------------------------------------------------------------

    @property
    def phase(self) -> Phase | None:
        """The one that is under way, or over; None before the first."""
        return self.progress.phase

    @property
    def phase_done(self) -> bool:
        """Whether it is over."""
        return self.progress.done

    @property
    def now(self) -> float:
        """s of the vehicles' clock."""
        return self.progress.now

    @property
    def members(self) -> list[int]:
        """Who is not lost, from 0."""
        return self.membership.left

    @property
    def lost(self) -> dict[int, str]:
        """Why, by the vehicle."""
        return self.membership.lost

    @property
    def design(self) -> Design:
        """For those that are not lost."""
        return self.membership.design

    @property
    def filters(self) -> dict[frozenset[int], Filter]:
        """By the vehicles that are lost."""
        return self.membership.filters

    @property
    def geometry(self) -> CableGeometry:
        """The cables of those that are not lost."""
        return self.membership.geometry

    @property
    def hanging(self) -> bool:
        """Whether the load hangs from vehicles that carry it together."""
        before = self.plan.airborne and self.phase in (None, Phase.PREFLIGHT, Phase.ARM)
        return (before or self.phase in LOADED) and not self.by_itself

    @property
    def released(self) -> bool:
        """Whether anything moves yet."""
        return self.fleet.released_at is not None

    @property
    def load_m(self) -> tuple[float, float, float] | None:
        """Where the load was last; None before it was seen."""
        if self._heard is None:
            return None
        x, y, z = self._heard.state.x0.tolist()
        return x, y, z

    @property
    def here(self) -> Observation:
        """What is known of this instant."""
        assert self._heard is not None
        return self._heard

    def tensions(self, i: Observation) -> Array:
        """(members,) N, at the load."""
        return tensions(self, i)

    @property
    def reference(self) -> Reference:
        """Where the load is to be."""
        return self.control.reference(self.progress.clock)

    @property
    def led(self) -> list[float]:
        """Where the reference has come to: x, y, z (m), yaw (rad)."""
        r = at(self.control.track, self.progress.clock.time)
        return [*r.x0.tolist(), float(r.yaw[0])]

    def _at_rest(self, i: Observation) -> Reference:
        return at(still([*i.state.x0.tolist(), yaw_of(i.state, self.plan.hangs)]), 0.0)

    def _below(self) -> list[float]:
        r = self.reference
        ahead = r.x0 + 0.5 * r.v0  # a load that moves is let run out
        return [*ahead[:2].tolist(), float(r.x0[2]), float(r.yaw[0])]
