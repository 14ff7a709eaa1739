"""A mission from the ground to the ground: phases, who does what in them, and what is done when something goes wrong.

No socket and no clock in here: `answer` makes one decision per measured state. While cables are slack every vehicle
flies by itself (`single`); from lifting to setting down the load is flown (`pilot`). What comes next is up to a script,
which asks for phases and waits for them.
"""

import math
from collections.abc import Callable, Coroutine, Generator, Mapping, Sequence
from typing import Any

import numpy as np

from bridge.fleet.fleet import Fleet
from bridge.mission.cable_geometry import CableGeometry, yaw_of
from bridge.mission.fault_detection import FaultDetector, Loss
from bridge.mission.fleet_subset import bare, blind, static_shares
from bridge.mission.guards import GuardInputs, GuardMonitor, guard_values, outside_fence, separation
from bridge.mission.observation import Observation
from bridge.mission.per_vehicle import SHARE_S, SingleVehicles, clear_of
from bridge.mission.phases import FLYING, LOADED, RULES, Phase
from bridge.mission.plan import MissionPlan
from bridge.mission.plan_clock import PlanClock
from bridge.mission.preflight_checks import preflight_faults
from bridge.wire.dialect import mavlink
from cablequad.control.control_step import Measurement, Sample, control_step, first_memory
from cablequad.control.design import Design
from cablequad.control.estimator import Filter
from cablequad.control.single_vehicle import Goals
from cablequad.control.trajectory import Limits, Reference, Trajectory, at, joined, leg, sink, still
from cablequad.model import lie
from cablequad.types import Array

ACCEPTED, TEMPORARILY_REJECTED, UNSUPPORTED = 0, 1, 3  # MAV_RESULT
SPIN_UP_S = 2.0
CLEAR_M = 0.35  # straight up first, and down last
NEAR_M, SLOW_M_S = 0.12, 0.15  # at rest where it should be
STILL_S = 0.5
STRAIGHT = 0.97  # of a cable's length
SLACK = frozenset({Phase.TAKE_OFF, Phase.TENSION, Phase.RELEASE}) - LOADED  # nobody carries yet, or any more
BELOW_M = 0.15  # how far below the ground the load is led when it is set down
SLOWLY_M = 0.12  # above the ground, from where it is set down slowly
STANDS_M_S, PUSHED_M = 0.05, 0.05
EMERGENCY_M_S = 0.4
HURRY = 1.6  # how much faster everything goes that brings an aborted mission down


Until = Callable[[], bool]
Script = Callable[["Mission"], Coroutine[Any, Any, None]]


class Wait:
    """What a script awaits."""

    def __init__(self, until: Until) -> None:
        self._until = until

    def __await__(self) -> Generator[Until, None, None]:
        yield self._until


class MissionError(Exception):
    """Something that a script may not ask for now."""


class Mission:
    """The state of one mission."""

    def __init__(
        self,
        plan: MissionPlan,
        fleet: Fleet,
        designs: Mapping[frozenset[int], Design],
        filters: Mapping[frozenset[int], Filter],
        period_s: float,
        script: Script,
    ) -> None:
        """`designs` and `filters` by the vehicles that are lost; those of nobody lost are always among them.

        No filters: everything is measured exactly. Who is lost without a design for it is flown without one.
        """
        self.plan, self.fleet = plan, fleet
        self._designs, self.filters = designs, dict(filters)
        self.design = designs[frozenset()]
        n = len(self.design.system.m)
        self.members = list(range(n))
        self.lost, self._fates = dict[int, str](), dict[int, str]()  # why, and what became of those that are lost
        self.phase: Phase | None = None
        self.phase_done = False
        self.now = 0.0
        self.failure: str | None = None
        self.finished = False
        self.by_itself = False  # the load is set down with every vehicle by itself
        self.events: list[tuple[str, str, str]] = []
        self.largest_tension_N = 0.0
        self.smallest_separation_m = math.inf
        self.touch_down_m_s: float | None = None
        self.mark: tuple[float, float] | None = None  # m: where the load was to be set down last
        self._clock = PlanClock(period_s)
        self._entered = 0.0  # s, when the phase began, later by as long as the plan's clock stood
        self._still_since: float | None = None
        self._touched_at: float | None = None
        self._tilt, self._tilted_until = np.eye(3), 0.0  # of every vehicle, beyond what it is commanded
        self._taking = False
        self._aborted = False
        self._script: Coroutine[Any, Any, None] = script(self)
        self._until: Until | None = None
        self._running: Coroutine[Any, Any, None] | None = None  # the script that is being asked
        self._monitor = GuardMonitor(plan.guards)
        self._faults = FaultDetector()
        self._singles = SingleVehicles(n, period_s)
        self._memory = first_memory(self.design)
        self._R_before = np.tile(np.eye(3), (n, 1, 1))
        self._track: Trajectory = still([0.0, 0.0, 0.0, 0.0])
        self._heard: Observation | None = None
        self._last: Sample | None = None
        self._as_planned = True
        self._geometry = CableGeometry.of(self.design)

    # -- what scripts ask ----------------------------------------------------------------------------------------------

    def begin(self, phase: Phase, to: list[float] | None = None) -> Wait:
        """Start a phase; await what comes back for its end. Raises MissionError where it may not follow."""
        if self.phase not in RULES[phase].after and not self._aborted:
            here = "the start" if self.phase is None else f"phase {self.phase}"
            allowed = ", ".join(sorted("the start" if p is None else str(p) for p in RULES[phase].after))
            raise MissionError(f"{phase} may not follow {here}; it may follow {allowed}")
        if self.phase is not None and not self.phase_done and not self._aborted:
            raise MissionError(f"{phase} may not begin while phase {self.phase} is under way; await that first")
        if to is not None and not self._aborted:
            self._reachable(phase, to)
        self._enter(phase, to)
        return Wait(lambda: self.phase_done)

    def _reachable(self, phase: Phase, to: list[float]) -> None:
        """Raise MissionError where the load cannot be brought to x, y, z (m), yaw (rad), before anything moves."""
        where = "({:g}, {:g}, {:g}) m".format(*to[:3])
        if to[2] > self.plan.rest_z:
            raise MissionError(
                f"{phase} to {where}: below the ground; the load stands at z = {self.plan.rest_z:.2f} m, and up is "
                "negative"
            )
        hung = self.here.state._replace(x0=np.array(to[:3]), R0=lie.exp(np.array([0.0, 0.0, to[3]])) @ self.plan.hangs)
        outside = outside_fence(self.plan.fence, [np.array(to[:3]), *self._geometry.above(hung, 1.0)])
        if outside > 0.0:
            raise MissionError(
                f"{phase} to {where}: the load or a vehicle above it would be {outside:.1f} m outside the fence"
            )
        seconds, limit = leg(self.led, to, self.plan.limits).duration, self.plan.limits_s[phase]
        if seconds > limit:
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
        if self.phase is not Phase.TAKE_OFF or not self.phase_done:
            raise MissionError("tilt: only while all hover on slack cables, after take off")
        self._tilt, self._tilted_until = lie.exp(np.array(turn)), self.now + seconds
        return self.wait(seconds)

    def pause(self, who: str = "operator") -> None:
        """Stop the load where it is on its way, for as long as `who` wants."""
        if self._clock.stop(who):
            self._tell("pause", who, f"the plan's clock stops in phase {self.phase}")

    def resume(self, who: str = "operator") -> None:
        """Go on, unless somebody else wants it to stand."""
        if self._clock.go(who):
            self._tell("resume", who, f"the plan's clock goes on in phase {self.phase}")

    def abort(self, why: str) -> None:
        """Give up what was planned and come to the ground from here, in order."""
        if self._aborted or self.finished:
            return
        self._aborted = True
        self._clock.run()
        self.failure = self.failure or why
        self._tell("abort", "all", why)
        before, self._script, self._until = self._script, self._come_down(), None
        if before is not self._running:  # a script that gives up by itself ends by itself
            before.close()

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
            self._track = still([*self.here.state.x0.tolist(), yaw_of(self.here.state, self.plan.hangs)])
            await self.begin(Phase.SET_DOWN)
            await self.begin(Phase.RELEASE)
        elif self.phase in LOADED:
            if self.phase is not Phase.SET_DOWN:
                await self.begin(Phase.SET_DOWN, self._below())
            else:
                await Wait(lambda: self.phase_done)
            await self.begin(Phase.RELEASE)
        elif self.phase is Phase.TENSION:
            await self.begin(Phase.RELEASE)
        if self.phase in (Phase.TAKE_OFF, Phase.RELEASE):
            await self.begin(Phase.LAND)
        await self.begin(Phase.DISARM)

    def close(self) -> None:
        """Ask no script any more."""
        self._script.close()

    # -- one decision --------------------------------------------------------------------------------------------------

    def answer(self, t: float, now: float, observation: Observation) -> Sample:
        """The decision for what is known of `now` (s of the vehicles' clock); `observation` is of the members."""
        self.now, self._heard = now, observation
        self._entered += self._clock.tick()
        self._look_out(observation)
        if self.phase is not None and not self.phase_done and self._over(self.here):
            self.phase_done = True
        self._run_script()
        if self.phase is not None and not self.phase_done and now - self._entered > self.plan.limits_s[self.phase]:
            self._timed_out()
        if self.finished and self._fates:
            self._tell_fates()
        sample = self._fly(t, self.here)
        self._last = sample
        return sample

    def _run_script(self) -> None:
        """Ask the script for what it wants next, as long as what it waited for has come."""
        while not self.finished and (self._until is None or self._until()):
            script = self._running = self._script
            try:
                until = script.send(None)
            except StopIteration:
                self.finished = self.finished or script is self._script
            except MissionError as error:
                if self._aborted and script is self._script:
                    self.failure, self.finished = self.failure or str(error), True
                self.abort(str(error))
            else:
                if script is self._script:
                    self._until = until
                else:
                    script.close()  # it gave up, and something else goes on
            finally:
                self._running = None

    def _enter(self, phase: Phase, to: list[float] | None) -> None:
        before, self.phase = self.phase, phase
        led = self.led
        self.phase_done, self._entered, self._clock.time, self._still_since = False, self.now, 0.0, None
        self._tell("phase", "all", str(phase))
        instant = self.here
        match phase:
            case Phase.ARM:
                self.fleet.may_arm = True
            case Phase.TAKE_OFF:
                x = instant.x
                up = [[*p[:2], p[2] - CLEAR_M, 0.0] for p in x.tolist()]
                slack = self._geometry.above(self.here.state, self.plan.slack)
                limits = self._slow(self.plan.take_off_speed)
                self._singles.go(
                    [
                        joined([leg([*a, 0.0], b, limits), leg(b, [*c, 0.0], limits)])
                        for a, b, c in zip(x.tolist(), up, slack.tolist(), strict=True)
                    ]
                )
                self._hang(self._geometry.chains(0.5), self._geometry.chains(0.5))
                self._singles.forget()
            case Phase.TENSION:
                self._move_to(self._geometry.above(self.here.state, 1.0), self.plan.lift_speed)
                self._hang(self._geometry.chains(0.5), self._geometry.chains(0.5))
            case Phase.LIFT:
                self._memory = first_memory(self.design)
                start = [*instant.state.x0.tolist(), yaw_of(instant.state, self.plan.hangs)]
                lift = 0.0 if self.plan.airborne else self.plan.lift_m
                self._track = leg(start, [*start[:2], start[2] - lift, start[3]], self._slow(self.plan.lift_speed))
            case Phase.CARRY:
                start = led
                end = to if to is not None else [*self.plan.target[:2], start[2], self.plan.target[3]]
                self._track = self.plan.route(start, end) if to is None else leg(start, to, self.plan.limits)
            case Phase.SET_DOWN:
                self._touched_at = None
                start = led
                near = [*start[:2], min(start[2], self.plan.rest_z - SLOWLY_M), start[3]]
                if to is not None:
                    near = [*to[:2], near[2], to[3]]
                self.mark = near[0], near[1]
                low = [*near[:2], self.plan.rest_z + BELOW_M, near[3]]
                slowly = self._slow(self.plan.set_down_speed)
                self._track = joined([leg(start, near, self._slow(self.plan.lift_speed)), leg(near, low, slowly)])
            case Phase.RELEASE:
                share = self._shares() if before in LOADED else self._singles.hung(self.now)
                if before in LOADED:
                    self._singles.aim = instant.x.copy()
                self._move_to(self._singles.aim, 1.0)
                self._hang(np.maximum(share, 0.0), self._geometry.chains(0.5))
                self._singles.forget()
            case Phase.LAND:
                self._touched_at = None
                R0, x0 = self.here.state.R0, self.here.state.x0
                wrecks = [p for k in self.lost if (p := self.fleet.place(k)) is not None]
                spots = clear_of(wrecks, x0 + self.plan.stands[self.members] @ R0.T, x0)
                spots[:, 2] = self.plan.rest_z + self.plan.stands[self.members][:, 2]
                limits, down = self._slow(self.plan.take_off_speed), self._slow(self.plan.set_down_speed)
                ways = []
                for a, b in zip(self._singles.aim.tolist(), spots.tolist(), strict=True):
                    over, low = [*b[:2], b[2] - CLEAR_M, 0.0], [*b[:2], b[2] + BELOW_M, 0.0]
                    ways.append(joined([leg([*a, 0.0], over, limits), leg(over, low, down)]))
                self._singles.go(ways)
            case Phase.DISARM:
                self.fleet.disarm(self.now)
            case _:
                pass

    def _over(self, i: Observation) -> bool:
        """Whether the phase's end has come."""
        match self.phase:
            case Phase.PREFLIGHT:
                return not preflight_faults(i, self._geometry, self.plan, self.fleet)
            case Phase.ARM:
                return self.fleet.flying
            case Phase.TAKE_OFF:
                ready = self._clock.time >= SPIN_UP_S + self._singles.duration
                return ready and self._rest(
                    float(np.linalg.norm(i.x - self._geometry.above(self.here.state, self.plan.slack), axis=1).max()),
                    i.v,
                )
            case Phase.TENSION:
                reached = self._clock.time >= self._singles.duration
                far = np.linalg.norm(i.x - self._geometry.ends(self.here.state), axis=1)
                straight = bool((far > STRAIGHT * self._geometry.length).all())
                if reached and straight and not self._taking:
                    self._hang(
                        self._singles.hung(self.now),
                        self._geometry.chains(1.0) + self.plan.pretension * self._geometry.bears,
                    )
                    self._taking = True
                return self._taking and straight and self._singles.handed_over(self.now)
            case Phase.LIFT | Phase.CARRY:
                end = self.led
                off = math.dist(i.state.x0.tolist(), end[:3])
                return self._clock.time >= self._track.duration and self._rest(off, i.state.v0[None])
            case Phase.SET_DOWN:
                return self._stands(i)
            case Phase.RELEASE:
                if self.now - self._entered < SHARE_S:
                    return False
                if not self._taking:
                    self._taking = True
                    self._move_to(self._geometry.above(self.here.state, self.plan.slack), self.plan.lift_speed)
                reached = self._clock.time >= self._singles.duration
                return reached and self._rest(float(np.linalg.norm(i.x - self._goals().x, axis=1).max()), i.v)
            case Phase.LAND:
                if self._touched_at is None and self._on_feet(i):
                    self._touched_at = self.now
                return self.fleet.all_landed
            case Phase.DISARM:
                return self.fleet.at_rest
            case _:
                return False

    @property
    def hanging(self) -> bool:
        """Whether the load hangs from vehicles that carry it together."""
        before = self.plan.airborne and self.phase in (None, Phase.PREFLIGHT, Phase.ARM)
        return (before or self.phase in LOADED) and not self.by_itself

    @property
    def _on_plan(self) -> bool:
        """Whether the load is to be where the reference is; when it is set down it is led into the ground."""
        return self.phase in (Phase.LIFT, Phase.CARRY)

    @property
    def released(self) -> bool:
        """Whether anything moves yet."""
        return self.fleet.released_at is not None

    # -- control -------------------------------------------------------------------------------------------------------

    def _fly(self, t: float, i: Observation) -> Sample:
        loaded = self.hanging
        flown = loaded and self.released
        reference = self._reference() if loaded and self.phase in LOADED else self._at_rest(i)
        memory = self._memory
        after, sample = control_step(memory, Measurement(t, i.state, restrained=not flown), reference, self.design)
        if loaded:
            if not math.isfinite(float(sample.A.sum()) + float(sample.f.sum()) + float(sample.R_c.sum())):
                sample = self._as_before(sample)
                after = first_memory(self.design)
            self._memory = after
            self._R_before = sample.R_c
        else:
            alone = self._singles.fly(self.design, i.x, i.v, i.state.R, self._goals(), self._R_before)
            self._R_before = alone.R_c
            tilted = self.now < self._tilted_until - 1e-9
            sample = sample._replace(
                A=alone.A, R_c=alone.R_c @ self._tilt if tilted else alone.R_c, f=alone.f, Psi=alone.Psi
            )
        return sample

    def _as_before(self, sample: Sample) -> Sample:
        """A decision that came to nothing finite, of a motion that no model knows, is not sent: the last stands.

        In the log it is that one; what it was decided from is NaN there.
        """
        if self._as_planned:
            self._as_planned = False
            self._tell("guard", "decision", "it came to nothing finite: the last one stands")
        before = self._last
        n = len(self.members)
        fresh = first_memory(self.design)
        if before is None:
            hover = self.design.system.m * self.design.system.g
            A = np.column_stack([np.zeros((n, 2)), -hover])
            blank = sample._replace(A=A, R_c=np.tile(np.eye(3), (n, 1, 1)), f=hover, Psi=np.zeros(n))
        else:
            blank = sample._replace(A=before.A, R_c=before.R_c, f=before.f, Psi=before.Psi)
        return blank._replace(memory=fresh)

    def _reference(self) -> Reference:
        r, k = at(self._track, self._clock.time), self._clock.rate
        if k == 1.0:
            return r
        turn = np.array([r.yaw[0], k * r.yaw[1], k * k * r.yaw[2]])
        return Reference(r.x0, k * r.v0, k**2 * r.a0, k**3 * r.j0, k**4 * r.s0, turn)

    def _at_rest(self, i: Observation) -> Reference:
        return at(still([*i.state.x0.tolist(), yaw_of(i.state, self.plan.hangs)]), 0.0)

    def _goals(self) -> Goals:
        """Where each vehicle is to be, while it flies by itself."""
        power, spun = 1.0, 0.0
        match self.phase:
            case None | Phase.PREFLIGHT | Phase.ARM | Phase.DISARM:
                power = 0.0
            case Phase.TAKE_OFF:
                spun = SPIN_UP_S
                power = 1.0 if self._clock.time >= SPIN_UP_S else 0.1 + 0.8 * self._clock.time / SPIN_UP_S
            case Phase.LAND if self._touched_at is not None:
                power = max(0.0, 0.6 - (self.now - self._touched_at))
            case _:
                pass
        return self._singles.goals(self.here.x, self.now, self._clock.time - spun, self._clock.rate, power)

    def _hang(self, before: Array, after: Array) -> None:
        self._singles.hang(before, after, self.now)
        self._taking = False

    def _move_to(self, x: Array, speed: float) -> None:
        """Every vehicle on a straight way from where it was to be to `x`."""
        self._singles.straight_to(x, self._slow(speed))
        self._clock.time = 0.0

    def _slow(self, speed: float) -> Limits:
        speed *= HURRY if self._aborted else 1.0
        return Limits(speed, max(0.3, speed), 3.0, 0.5)

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

    # -- where things are ----------------------------------------------------------------------------------------------

    def _shares(self) -> Array:
        """(n,) N: what hung on each vehicle by the last command."""
        if self._last is None or self.by_itself:
            return self._singles.hung(self.now)
        return -self._geometry.pulled(self._last)[:, 2]

    @property
    def led(self) -> list[float]:
        """Where the reference has come to."""
        r = at(self._track, self._clock.time)
        return [*r.x0.tolist(), float(r.yaw[0])]

    def _below(self) -> list[float]:
        r = self._reference()
        ahead = r.x0 + 0.5 * r.v0  # a load that moves is let run out
        return [*ahead[:2].tolist(), float(r.x0[2]), float(r.yaw[0])]

    def _rest(self, off_m: float, v: Array) -> bool:
        """Whether everything has been near and slow for a while."""
        if off_m > NEAR_M or float(np.linalg.norm(v, axis=-1).max()) > SLOW_M_S:
            self._still_since = None
            return False
        self._still_since = self.now if self._still_since is None else self._still_since
        return self.now - self._still_since >= STILL_S

    def _stands(self, i: Observation) -> bool:
        """Whether the load has come to stand: led further down than it goes."""
        low = abs(float(i.state.x0[2]) - self.plan.rest_z) < NEAR_M
        if low and self.touch_down_m_s is None and float(i.state.x0[2]) > self.plan.rest_z - 0.02:
            self.touch_down_m_s = abs(float(i.state.v0[2]))
        slow = float(np.linalg.norm(i.state.v0)) < STANDS_M_S
        pushed = self.by_itself or self.led[2] - float(i.state.x0[2]) > PUSHED_M
        if not (low and slow and pushed):
            self._still_since = None
            return False
        self._still_since = self.now if self._still_since is None else self._still_since
        return self.now - self._still_since >= 0.2

    def _on_feet(self, i: Observation) -> bool:
        goals = self._goals()
        pushed = goals.x[:, 2] - i.x[:, 2] > PUSHED_M
        slow = np.linalg.norm(i.v, axis=1) < SLOW_M_S
        return bool((pushed & slow).all())

    # -- what goes wrong -----------------------------------------------------------------------------------------------

    def tensions(self, i: Observation) -> Array:
        """(members,) N: at the load as the tracker tells, or what vehicles give beyond their weight."""
        if self._last is None or np.isfinite(i.tension).all():
            return i.tension
        return np.asarray(np.linalg.norm(self._geometry.pulled(self._last), axis=1))

    def _look_out(self, i: Observation) -> None:
        if self.phase not in FLYING:
            return
        tension = self.tensions(i)
        if self.phase in LOADED:
            self.largest_tension_N = max(self.largest_tension_N, float(np.nanmax(tension)))
        self.smallest_separation_m = min(self.smallest_separation_m, separation(i.x))
        reserve = 1.0 if self._last is None else float((1.0 - self._last.f / self.design.airframe.max_thrust).min())
        batteries = [self.fleet.batteries[k] for k in self.members]
        off = math.dist(i.state.x0.tolist(), self._reference().x0.tolist()) if self._on_plan else 0.0
        reading = GuardInputs(
            i.x, i.state.R, i.state.x0, i.state.R0, tension, reserve, i.age_s, off, min(batteries),
            self.plan.fence,
        )  # fmt: skip
        broken, healed = self._monitor.look(self.now, guard_values(reading))
        for b in broken:
            action = b.guard.action if self.plan.protect else "warn"
            self._tell("guard", b.guard.name, f"{b.value:.3g}, limit {b.guard.limit:g}: {action}")
            if action == "pause":
                self.pause(b.guard.name)
            elif action == "set-down":
                self.abort(f"guard {b.guard.name}: {b.value:.3g}, limit {b.guard.limit:g}; set down here")
        for guard in healed:
            self._tell("guard", guard.name, "holds again")
            self.resume(guard.name)
        if self.plan.protect and self.phase in SLACK:
            gone = [(k, self.fleet.departed[k]) for k in self.members if k in self.fleet.departed]
            for k, (at, why) in gone:
                if self.now >= at:
                    self._lose(Loss(self.members.index(k), why, off=False, sound=True))
        if self.plan.protect and self.phase in LOADED:
            R_c = None if self._last is None else self._last.R_c
            loss = self._faults.look(
                self.now, self.members, i, self._geometry.ends(self.here.state), self._geometry.length, R_c,
                not self.by_itself, self.fleet.departed, self.fleet.astray,
            )  # fmt: skip
            if loss is not None:
                self._lose(loss)

    def _lose(self, loss: Loss) -> None:
        """Go on without a vehicle where the rest can, else set down in order."""
        k = self.members[loss.member]
        self.lost[k] = loss.why
        self._tell("lost", f"vehicle {k + 1}", loss.why)
        end = "it was told to land" if loss.sound else "its motors were told to stop"
        self._fates[k] = f"lost in phase {self.phase}: {loss.why}; {end}"
        self.fleet.lose(k, self.plan.hooks, stop=not loss.sound)
        rest = [j for j in range(len(self.members)) if j != loss.member]
        if not rest:
            self.failure, self.finished = f"vehicle {k + 1}: {loss.why}; nobody is left", True
            return
        whole, gone = self._designs[frozenset()], frozenset(self.lost)
        self.members.remove(k)
        planned = self._designs.get(gone)
        self.design = planned if planned is not None else bare(whole, self.members)
        if planned is None and self.filters:
            self.filters[gone] = blind(self.design)
        self._geometry = CableGeometry.of(self.design)
        self._heard = self.here.of(rest, self.design)
        self._singles.keep(self.here.x)
        self._R_before = self._R_before[rest].copy()
        self._memory, self._last = first_memory(self.design), None
        if self.phase in SLACK:
            none = np.zeros(len(rest))
            self._hang(none, none)
            self.phase_done = True
            self.abort(f"vehicle {k + 1}: {loss.why}; the others land")
            return
        off = self.plan.hooks or loss.off
        if off and not self.by_itself and self._geometry.can_carry():
            self._tell("crew", "all", f"{len(rest)} vehicles carry the load on")
            return
        self._tell("crew", "all", f"{len(rest)} vehicles cannot carry the load on; they set it down")
        self.by_itself = True
        depth = max(0.0, self.plan.rest_z + BELOW_M - float(self.here.state.x0[2]))
        self._singles.go([sink([*x, 0.0], depth, EMERGENCY_M_S) for x in self.here.x.tolist()])
        self._clock.time = 0.0
        hung = static_shares(self.design.system, self.here.state.R0)
        self._hang(hung, hung)
        self.abort(f"vehicle {k + 1}: {loss.why}; the load is set down here")
        if self.phase is Phase.SET_DOWN:
            self._entered, self.phase_done = self.now, False

    def _tell_fates(self) -> None:
        """One line for each vehicle of a mission that lost some."""
        for k in range(len(self._designs[frozenset()].system.m)):
            text = self._fates.get(k, "flew to the end; it stands on the ground, disarmed")
            self._tell("fate", f"vehicle {k + 1}", f"vehicle {k + 1}: {text}")
        self._fates = {}

    def _timed_out(self) -> None:
        text = f"phase {self.phase} took more than {self.plan.limits_s[self.phase]:g} s"  # type: ignore[index]
        if self.phase is Phase.PREFLIGHT:
            text += ": " + "; ".join(preflight_faults(self.here, self._geometry, self.plan, self.fleet))
        if self._aborted or self.phase in (Phase.SET_DOWN, Phase.RELEASE, Phase.LAND, Phase.DISARM):
            self.failure = self.failure or text
            self._tell("abort", "all", text)
            self.phase_done = True  # go on towards the ground all the same
            self._entered = self.now
            if self.phase is Phase.DISARM:
                self.finished = True
            return
        self.abort(text)

    def _tell(self, kind: str, subject: str, text: str) -> None:
        self.events.append((kind, subject, text))
