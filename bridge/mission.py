"""A mission from the ground to the ground: phases, who does what in them, and what is done when something goes wrong.

No socket and no clock in here: `answer` makes one decision per measured state. While cables are slack every vehicle
flies by itself (`single`); from lifting to setting down the load is flown (`pilot`). What comes next is up to a script,
which asks for phases and waits for them.
"""

import math
from collections.abc import Callable, Coroutine, Generator, Mapping, Sequence
from typing import Any

import numpy as np

from bridge.crew import state_of, static_shares
from bridge.fleet import Fleet
from bridge.guards import Reading, Watch, readings, separation
from bridge.mission_plan import MissionPlan
from bridge.observe import Instant
from bridge.phases import FLYING, LOADED, RULES, Phase
from bridge.wire.dialect import mavlink
from cablequad.design import Design
from cablequad.estimate import Filter
from cablequad.pilot import Measurement, Sample, first_memory, tick
from cablequad.single import Goals, fly_each, integrated
from cablequad.state import Error, State
from cablequad.system import System
from cablequad.trajectory import Limits, Reference, Trajectory, at, joined, leg, still
from cablequad.types import Array

ACCEPTED, TEMPORARILY_REJECTED, UNSUPPORTED = 0, 1, 3  # MAV_RESULT
SPIN_UP_S = 2.0
CLEAR_M = 0.35  # straight up first, and down last
NEAR_M, SLOW_M_S = 0.12, 0.15  # at rest where it should be
STILL_S = 0.5
SHARE_S = 1.5  # for a cable's share of the load to be taken or given
STRAIGHT = 0.97  # of a cable's length
BELOW_M = 0.15  # how far below the ground the load is led when it is set down
SLOWLY_M = 0.12  # above the ground, from where it is set down slowly
STANDS_M_S, PUSHED_M = 0.05, 0.05
PAUSE_S = 1.0
NO_FOLLOW_RAD, NO_FOLLOW_S = 0.7, 0.2
SAGGED, CUT, CUT_M, GONE_S = 0.8, 1.06, 0.1, 0.08  # of a cable's length
FRESH_S = 0.15  # old is a vehicle's word of where it is
CARRIES = 0.02  # of a vehicle's weight: the least that a cable must bear for a fleet that goes on
EMERGENCY_M_S = 0.4
HURRY = 1.6  # how much faster everything goes that brings an aborted mission down
OFF = "its cable is off"


Until = Callable[[], bool]
Script = Callable[["Mission"], Coroutine[Any, Any, None]]


class Waiting:
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
        """`designs` and `filters` by the vehicles that are lost; that of nobody lost is always among them."""
        self.plan, self.fleet = plan, fleet
        self._designs, self.filters, self._period = designs, filters, period_s
        self.design = designs[frozenset()]
        n = len(self.design.system.m)
        self.members = list(range(n))
        self.lost: dict[int, str] = {}
        self.phase: Phase | None = None
        self.phase_done = False
        self.now = 0.0
        self.failure: str | None = None
        self.finished = False
        self.paused = False
        self.changed_crew = False
        self.events: list[tuple[str, str, str]] = []
        self.largest_tension_N = 0.0
        self.smallest_separation_m = math.inf
        self.touch_down_m_s: float | None = None
        self.mark: tuple[float, float] | None = None  # m: where the load was to be set down last
        self._rate = 1.0  # of the plan's clock
        self._tau = 0.0  # s, the plan's clock in this phase
        self._entered = 0.0
        self._still_since: float | None = None
        self._script: Coroutine[Any, Any, None] = script(self)
        self._until: Until | None = None
        self._watch = Watch(plan.guards)
        self._memory = first_memory(self.design)
        self._lasting = np.zeros((n, 3))
        self._R_before = np.tile(np.eye(3), (n, 1, 1))
        self._aim = np.zeros((n, 3))
        self._taking = False
        self._from, self._from_load = np.zeros((n, 3)), 0.0
        self._track: Trajectory = still([0.0, 0.0, 0.0, 0.0])
        self._paths: list[Trajectory] = []
        self._hung0 = self._hung1 = np.zeros(n)
        self._hung_from = 0.0
        self._touched_at: float | None = None
        self.by_itself = False  # set down with every vehicle by itself
        self._aborted = False
        self._sunk: dict[int, float] = {}
        self._heard: Instant | None = None
        self._last: Sample | None = None
        self._descent = 0.0
        self.loaded_length = self._lengths()

    # -- what scripts ask ----------------------------------------------------------------------------------------------

    def begin(self, phase: Phase, to: list[float] | None = None) -> Waiting:
        """Start a phase; await what comes back for its end. Raises MissionError where it may not follow."""
        if self.phase not in RULES[phase].after and not self._aborted:
            here = "the start" if self.phase is None else f"phase {self.phase}"
            allowed = ", ".join(sorted("the start" if p is None else str(p) for p in RULES[phase].after))
            raise MissionError(f"{phase} may not follow {here}; it may follow {allowed}")
        self._enter(phase, to)
        return Waiting(lambda: self.phase_done)

    def wait(self, seconds: float) -> Waiting:
        """For a while, on the vehicles' clock."""
        end = self.now + seconds
        return Waiting(lambda: self.now >= end - 1e-9)

    def pause(self) -> None:
        """Stop the load where it is on its way."""
        if not self.paused:
            self.paused = True
            self._tell("pause", "all", f"the plan's clock stops in phase {self.phase}")

    def resume(self) -> None:
        """Go on."""
        if self.paused:
            self.paused = False
            self._tell("resume", "all", f"the plan's clock goes on in phase {self.phase}")

    def abort(self, why: str) -> None:
        """Give up what was planned and come to the ground from here, in order."""
        if self._aborted or self.phase is None:
            return
        self._aborted, self.paused = True, False
        self.failure = self.failure or why
        self._tell("abort", "all", why)
        self._script.close()
        self._script = self._come_down()
        self._until = None

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
        if self.phase in LOADED:
            if self.phase is not Phase.SET_DOWN:
                await self.begin(Phase.SET_DOWN, self._below())
            else:
                await Waiting(lambda: self.phase_done)
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

    def answer(self, t: float, now: float, instant: Instant) -> Sample:
        """The decision for what is known of `now` (s of the vehicles' clock); `instant` is of the members."""
        self.now, self._heard = now, instant
        self._tau += self._rate * self._period
        goal = 0.0 if self.paused else 1.0
        step = self._period / PAUSE_S
        self._rate = min(max(goal, self._rate - step), self._rate + step)
        self._look_out(instant)
        if self.phase is not None and not self.phase_done and self._over(instant):
            self.phase_done = True
        self._run_script()
        if self.phase is not None and not self.phase_done and now - self._entered > self.plan.limits_s[self.phase]:
            self._timed_out()
        sample = self._fly(t, self.here)
        self._last = sample
        return sample

    def _run_script(self) -> None:
        try:
            while self._until is None or self._until():
                self._until = self._script.send(None)
        except StopIteration:
            if not self.finished:
                self.finished = True
        except MissionError as error:
            self.failure = self.failure or str(error)
            self.abort(str(error))

    def _enter(self, phase: Phase, to: list[float] | None) -> None:
        before, self.phase = self.phase, phase
        led = self.led
        self.phase_done, self._entered, self._tau, self._still_since = False, self.now, 0.0, None
        self._tell("phase", "all", str(phase))
        instant = self.here
        match phase:
            case Phase.ARM:
                self.fleet.may_arm = True
            case Phase.TAKE_OFF:
                x = instant.x
                up = [[*p[:2], p[2] - CLEAR_M, 0.0] for p in x.tolist()]
                slack = self._above(self.plan.slack)
                limits = self._slow(self.plan.take_off_speed)
                self._paths = [
                    joined([leg([*a, 0.0], b, limits), leg(b, [*c, 0.0], limits)])
                    for a, b, c in zip(x.tolist(), up, slack.tolist(), strict=True)
                ]
                self._hang(self._chain_weight(0.5), self._chain_weight(0.5))
                self._lasting[:] = 0.0
            case Phase.TENSION:
                self._move_to(self._above(1.0), self.plan.lift_speed)
                self._hang(self._chain_weight(0.5), self._chain_weight(0.5))
            case Phase.LIFT:
                self._memory = first_memory(self.design)
                start = self._pose()
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
                share = self._shares() if before in LOADED else self._hung()
                if before in LOADED:
                    self._aim = instant.x.copy()
                self._move_to(self._aim, 1.0)
                self._hang(np.maximum(share, 0.0), self._chain_weight(0.5))
                self._lasting[:] = 0.0
            case Phase.LAND:
                self._touched_at = None
                R0, x0 = self.here.state.R0, self.here.state.x0
                spots = x0 + self.plan.stands[self.members] @ R0.T
                spots[:, 2] = self.plan.rest_z + self.plan.stands[self.members][:, 2]
                limits, down = self._slow(self.plan.take_off_speed), self._slow(self.plan.set_down_speed)
                self._paths = []
                for a, b in zip(self._aim.tolist(), spots.tolist(), strict=True):
                    over = [*b[:2], b[2] - CLEAR_M, 0.0]
                    self._paths.append(
                        joined([leg([*a, 0.0], over, limits), leg(over, [*b[:2], b[2] + BELOW_M, 0.0], down)])
                    )
            case Phase.DISARM:
                self.fleet.disarm(self.now)
            case _:
                pass

    def _over(self, i: Instant) -> bool:
        """Whether the phase's end has come."""
        match self.phase:
            case Phase.PREFLIGHT:
                return not self.missing(i)
            case Phase.ARM:
                return self.fleet.flying
            case Phase.TAKE_OFF:
                ready = self._tau >= SPIN_UP_S + max(p.duration for p in self._paths)
                return ready and self._rest(
                    float(np.linalg.norm(i.x - self._above(self.plan.slack), axis=1).max()), i.v
                )
            case Phase.TENSION:
                reached = self._tau >= max(p.duration for p in self._paths)
                far = np.linalg.norm(i.x - self._ends(), axis=1)
                straight = bool((far > STRAIGHT * self.loaded_length).all())
                if reached and straight and not self._taking:
                    self._hang(self._hung(), self._chain_weight(1.0) + self.plan.pretension * self._load_shares())
                    self._taking = True
                return self._taking and straight and self.now - self._hung_from >= SHARE_S
            case Phase.LIFT | Phase.CARRY:
                end = self.led
                off = math.dist(i.state.x0.tolist(), end[:3])
                return self._tau >= self._track.duration and self._rest(off, i.state.v0[None])
            case Phase.SET_DOWN:
                return self._stands(i)
            case Phase.RELEASE:
                if self.now - self._entered < SHARE_S:
                    return False
                if not self._taking:
                    self._taking = True
                    self._move_to(self._above(self.plan.slack), self.plan.lift_speed)
                reached = self._tau >= self._paths[0].duration
                return reached and self._rest(float(np.linalg.norm(i.x - self._goals().x, axis=1).max()), i.v)
            case Phase.LAND:
                if self._touched_at is None and self._on_feet(i):
                    self._touched_at = self.now
                return self.fleet.all_landed
            case Phase.DISARM:
                return self.fleet.at_rest
            case _:
                return False

    def missing(self, i: Instant) -> list[str]:
        """What a preflight check still finds wrong, one line each."""
        out = [f"vehicle {k + 1} tells no position" for k in np.flatnonzero(~np.isfinite(i.x[:, 0])).tolist()]
        if out:
            return out
        far = np.linalg.norm(i.x - self._ends(), axis=1)
        out += [
            f"vehicle {k + 1} is {far[k]:.2f} m from its end of the cable, which is {self.loaded_length[k]:.2f} m long"
            for k in np.flatnonzero(far > self.loaded_length + NEAR_M).tolist()
        ]
        if not self.plan.airborne and abs(float(i.state.x0[2]) - self.plan.rest_z) > NEAR_M:
            out.append(f"the load is at z = {i.state.x0[2]:.2f} m, not on the ground ({self.plan.rest_z:.2f} m)")
        out += [
            f"vehicle {k + 1} has {100 * level:.0f} % of its battery, {100 * self.plan.battery:.0f} % is needed"
            for k, level in enumerate(self.fleet.batteries)
            if level < self.plan.battery
        ]
        out += self.fleet.not_ready()
        return out

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

    def _fly(self, t: float, i: Instant) -> Sample:
        loaded = self.hanging
        flown = loaded and self.released
        reference = self._reference() if loaded and self.phase in LOADED else self._at_rest(i)
        memory = self._memory
        after, sample = tick(memory, Measurement(t, i.state, held=not flown), reference, self.design)
        if loaded:
            if not math.isfinite(float(sample.A.sum()) + float(sample.f.sum()) + float(sample.R_c.sum())):
                sample = self._as_before(sample)  # what moves is not what is modelled
                after = first_memory(self.design)
            self._memory = after
            self._R_before = sample.R_c
        else:
            goals = self._goals()
            self._aim = goals.x
            self._lasting = integrated(self._lasting, i.x, goals, self._period)
            each = fly_each(self.design, i.x, i.v, i.state.R, self._lasting, goals, self._R_before)
            self._R_before = each.R_c
            sample = sample._replace(A=each.A, R_c=each.R_c, f=each.f, Psi=each.Psi)
        return sample

    def _as_before(self, sample: Sample) -> Sample:
        """A decision that came to nothing finite is not sent; the last one stands."""
        before = self._last
        n = len(self.members)
        fresh = first_memory(self.design)
        if before is None:
            hover = self.design.system.m * self.design.system.g
            A = np.column_stack([np.zeros((n, 2)), -hover])
            blank = sample._replace(A=A, R_c=np.tile(np.eye(3), (n, 1, 1)), f=hover, Psi=np.zeros(n))
        else:
            blank = sample._replace(A=before.A, R_c=before.R_c, f=before.f, Psi=before.Psi)
        error = Error(np.nan_to_num(sample.error.x), np.nan_to_num(sample.error.x_dot))
        return blank._replace(memory=fresh, error=error, e_q=0.0, e_omega=0.0, Psi_0=0.0)

    def _reference(self) -> Reference:
        r, k = at(self._track, self._tau), self._rate
        if k == 1.0:
            return r
        turn = np.array([r.yaw[0], k * r.yaw[1], k * k * r.yaw[2]])
        return Reference(r.x0, k * r.v0, k**2 * r.a0, k**3 * r.j0, k**4 * r.s0, turn)

    def _at_rest(self, i: Instant) -> Reference:
        return at(still([*i.state.x0.tolist(), self._yaw(i.state)]), 0.0)

    def _goals(self) -> Goals:
        """Where each vehicle is to be, while it flies by itself."""
        n = len(self.members)
        x, v, a = self.here.x.copy(), np.zeros((n, 3)), np.zeros((n, 3))
        power = np.ones(n)
        match self.phase:
            case None | Phase.PREFLIGHT | Phase.ARM | Phase.DISARM:
                power[:] = 0.0
            case Phase.TAKE_OFF if self._tau < SPIN_UP_S:
                power[:] = 0.1 + 0.8 * self._tau / SPIN_UP_S
            case Phase.LAND if self._touched_at is not None:
                power[:] = max(0.0, 0.6 - (self.now - self._touched_at))
            case Phase.SET_DOWN if self.by_itself:
                ramp = min(1.0, (self.now - self._descent) / 1.0)
                for k in range(n):
                    x[k] = self._from[k]
                drop = EMERGENCY_M_S * (self.now - self._descent) * 0.5 * (1.0 + ramp)
                x[:, 2] += min(drop, max(0.0, self.plan.rest_z + BELOW_M - self._from_load))
                v[:, 2] = EMERGENCY_M_S if drop < self.plan.rest_z + BELOW_M - self._from_load else 0.0
            case _:
                spun = SPIN_UP_S if self.phase is Phase.TAKE_OFF else 0.0
                for k, path in enumerate(self._paths):
                    r = at(path, self._tau - spun)
                    x[k], v[k], a[k] = r.x0, r.v0, r.a0
        return Goals(x, v, a, self._hung(), power)

    def _hang(self, before: Array, after: Array) -> None:
        """What hangs on the vehicles goes from one to the other."""
        self._hung0, self._hung1, self._hung_from, self._taking = before, after, self.now, False

    def _hung(self) -> Array:
        share = min(1.0, max(0.0, (self.now - self._hung_from) / SHARE_S))
        return self._hung0 + share * (self._hung1 - self._hung0)

    def _move_to(self, x: Array, speed: float) -> None:
        """Every vehicle on a straight way from where it was to be to `x`."""
        limits = self._slow(speed)
        self._paths = [leg([*a, 0.0], [*b, 0.0], limits) for a, b in zip(self._aim.tolist(), x.tolist(), strict=True)]
        self._tau = 0.0

    def _slow(self, speed: float) -> Limits:
        speed *= HURRY if self._aborted else 1.0
        return Limits(speed, max(0.3, speed), 3.0, 0.5)

    @property
    def here(self) -> Instant:
        """What is known of this instant."""
        assert self._heard is not None
        return self._heard

    # -- where things are ----------------------------------------------------------------------------------------------

    def _lengths(self) -> Array:
        s = self.design.system
        used = np.arange(s.length.shape[1])[None, :] < s.n_links[:, None]
        return np.asarray(np.where(used, s.length, 0.0).sum(axis=1))

    def _ends(self) -> Array:
        """(n, 3) m: where the cables are tied to the load."""
        s = self.here.state
        return s.x0 + self.design.system.rho @ s.R0.T

    def _above(self, share: float) -> Array:
        out = self._ends()
        out[:, 2] -= share * self.loaded_length
        return out

    def _chain_weight(self, share: float) -> Array:
        s: System = self.design.system
        return share * (s.M_iT - s.m) * s.g

    def _load_shares(self) -> Array:
        """(n,) N: what each bears of the load where it hangs at rest."""
        return -self.design.u_star[:, 2] - self.design.system.M_iT * self.design.system.g

    def _shares(self) -> Array:
        """(n,) N: what hung on each vehicle by the last command."""
        if self._last is None or self.by_itself:
            return self._hung()
        return -self._last.A[:, 2] - self.design.system.m * self.design.system.g

    def _yaw(self, s: State) -> float:
        turned = s.R0 @ self.plan.hangs.T
        return math.atan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])

    def _pose(self) -> list[float]:
        s = self.here.state
        return [*s.x0.tolist(), self._yaw(s)]

    @property
    def led(self) -> list[float]:
        """Where the reference has come to."""
        r = at(self._track, self._tau)
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

    def _stands(self, i: Instant) -> bool:
        """Whether the load has come to stand: led further down than it goes."""
        down = self._from_load + BELOW_M if self.by_itself else self.led[2]
        low = abs(float(i.state.x0[2]) - self.plan.rest_z) < NEAR_M
        if low and self.touch_down_m_s is None and float(i.state.x0[2]) > self.plan.rest_z - 0.02:
            self.touch_down_m_s = abs(float(i.state.v0[2]))
        slow = float(np.linalg.norm(i.state.v0)) < STANDS_M_S
        pushed = self.by_itself or down - float(i.state.x0[2]) > PUSHED_M
        if not (low and slow and pushed):
            self._still_since = None
            return False
        self._still_since = self.now if self._still_since is None else self._still_since
        return self.now - self._still_since >= 0.2

    def _on_feet(self, i: Instant) -> bool:
        goals = self._goals()
        pushed = goals.x[:, 2] - i.x[:, 2] > PUSHED_M
        slow = np.linalg.norm(i.v, axis=1) < SLOW_M_S
        return bool((pushed & slow).all())

    # -- what goes wrong -----------------------------------------------------------------------------------------------

    def tensions(self, i: Instant) -> Array:
        """(members,) N: at the load as the tracker tells, or what vehicles give beyond their weight."""
        if self._last is None or np.isfinite(i.tension).all():
            return i.tension
        weight = np.outer(self.design.system.m, [0.0, 0.0, self.design.system.g])
        return np.asarray(np.linalg.norm(self._last.A + weight, axis=1))

    def _look_out(self, i: Instant) -> None:
        if self.phase not in FLYING:
            return
        tension = self.tensions(i)
        if self.phase in LOADED:
            self.largest_tension_N = max(self.largest_tension_N, float(np.nanmax(tension)))
        self.smallest_separation_m = min(self.smallest_separation_m, separation(i.x))
        reserve = 1.0 if self._last is None else float((1.0 - self._last.f / self.design.airframe.max_thrust).min())
        batteries = [self.fleet.batteries[k] for k in self.members]
        off = math.dist(i.state.x0.tolist(), self._reference().x0.tolist()) if self._on_plan else 0.0
        reading = Reading(
            i.x, i.state.R, i.state.x0, i.state.R0, tension, reserve, i.age_ms * 1e-3, off, min(batteries),
            self.plan.fence,
        )  # fmt: skip
        broken, healed = self._watch.look(self.now, readings(reading))
        for b in broken:
            action = b.guard.action if self.plan.protect else "warn"
            self._tell("guard", b.guard.name, f"{b.value:.3g}, limit {b.guard.limit:g}: {action}")
            if action == "pause":
                self.pause()
            elif action == "set-down":
                self.abort(f"guard {b.guard.name}: {b.value:.3g}, limit {b.guard.limit:g}; set down here")
        for guard in healed:
            self._tell("guard", guard.name, "holds again")
            if guard.action == "pause" and self.plan.protect:
                self.resume()
        if self.plan.protect and self.phase in LOADED:
            self._look_for_losses(i)

    def _look_for_losses(self, i: Instant) -> None:
        far = np.linalg.norm(i.x - self._ends(), axis=1)
        for own, k in enumerate(list(self.members)):
            act_at, why = self.fleet.departed.get(k, (self.now, ""))
            wait = 0.0
            why = why if self.now >= act_at else ""
            trusted = k not in self.fleet.astray and i.x_age_s[own] < FRESH_S
            if not why and trusted and far[own] > CUT * self.loaded_length[own] + CUT_M:
                why, wait = f"it is {far[own]:.2f} m from the load: {OFF}", GONE_S
            elif not why and trusted and far[own] < SAGGED * self.loaded_length[own] and not self.by_itself:
                why, wait = "it is where its cable cannot hold the load", GONE_S
            elif not why and self._last is not None:
                cosine = float(self._last.R_c[own, :, 2] @ i.state.R[own, :, 2])
                if math.acos(min(1.0, max(-1.0, cosine))) > NO_FOLLOW_RAD:
                    why, wait = "it does not follow its attitude", NO_FOLLOW_S
            if not why:
                self._sunk.pop(k, None)
                continue
            if self.now - self._sunk.setdefault(k, self.now) >= wait:
                self._lose(k, why)
                return

    def _lose(self, k: int, why: str) -> None:
        """Go on without vehicle k (from 0) where the rest can, else set down in order."""
        self.lost[k] = why
        self._tell("lost", f"vehicle {k + 1}", why)
        self.fleet.lose(k, self.plan.hooks, stop=k not in self.fleet.departed and OFF not in why)
        own = self.members.index(k)
        rest = [j for j in range(len(self.members)) if j != own]
        if not rest:
            self.failure = f"vehicle {k + 1}: {why}; nobody is left"
            return
        x = self.here.x[rest]
        self.members.remove(k)
        self.changed_crew = True
        self._aim = x.copy()
        self._R_before, self._lasting = self._R_before[rest].copy(), np.zeros((len(rest), 3))
        load_z = float(self.here.state.x0[2])
        design = self._designs.get(frozenset(self.lost))
        off = self.plan.hooks or OFF in why
        self.design = design if design is not None else self.design
        carries = design is not None and off and self._can_carry(design)
        if design is None:
            self.failure = f"vehicle {k + 1}: {why}; no plan for {len(rest)} vehicles"
            return
        self.loaded_length = self._lengths()
        self._last = None
        self._heard = self.here._replace(
            x=x,
            v=self.here.v[rest],
            x_age_s=self.here.x_age_s[rest],
            tension=self.here.tension[rest],
            state=state_of(self.here.state, rest, design),
        )
        self._memory = first_memory(design)
        if carries and not self.by_itself:
            self._tell("crew", "all", f"{len(rest)} vehicles carry the load on")
            return
        self._tell("crew", "all", f"{len(rest)} vehicles cannot carry the load on; they set it down")
        self.by_itself = True
        self._from, self._from_load, self._descent = x.copy(), load_z, self.now
        hung = static_shares(design.system, self.here.state.R0)
        self._hang(hung, hung)
        self.abort(f"vehicle {k + 1}: {why}; the load is set down here")
        if self.phase is Phase.SET_DOWN:
            self._entered, self.phase_done = self.now, False

    def _can_carry(self, design: Design) -> bool:
        s = design.system
        bears = -design.u_star[:, 2] - s.M_iT * s.g
        strong = bool((-design.u_star[:, 2] < 0.8 * design.airframe.max_thrust).all())
        return strong and bool((bears > CARRIES * s.m * s.g).all())

    def _timed_out(self) -> None:
        text = f"phase {self.phase} took more than {self.plan.limits_s[self.phase]:g} s"  # type: ignore[index]
        if self.phase is Phase.PREFLIGHT:
            text += ": " + "; ".join(self.missing(self.here))
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
