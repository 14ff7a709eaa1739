"""Messages -> State at one instant: what belongs to one time stamp is put together, what is missing is predicted.

Link directions, rates and the payload come from the tracker (ODOMETRY, CABLE_STATE), attitudes and rates from the
vehicles (ATTITUDE_QUATERNION). A vehicle's own LOCAL_POSITION_NED is redundant with those and is kept as a check: it
says whether the vehicle hangs where its cable says it does.

Each instant's estimate is the one before, carried on by the model under the setpoints that were under way, with
everything that was measured of it put in its place. What comes late is put where it belongs, and the model leads from
there to now. Where everything is in time the estimate is what was measured, and no model is asked.

With a filter (measurements with noise, or cables that nobody measures) the same chain of instants is corrected by what
was measured of each instead of being replaced by it. What `sensing` leaves out is not looked at, also where it is sent.
"""

import math
from typing import NamedTuple

import numpy as np

from bridge.loop.tick_barrier import REBOOT_MS
from bridge.wire.values import CableShape, PayloadState, VehicleAttitude, VehiclePosition
from cablequad.control.estimator import (
    Belief,
    Filter,
    Measured,
    Sensing,
    corrected,
    first_belief,
    nothing_measured,
    predicted,
)
from cablequad.model import lie
from cablequad.model.attitude import Airframe, Setpoint, flown
from cablequad.model.state import State, measured, positions
from cablequad.model.system import System
from cablequad.types import Array

KEPT = 64  # instants, for each attitude in a period, that late measurements may still belong to


class LoopModel(NamedTuple):
    """What the observer knows of the loop it stands in; times are milliseconds of the vehicles' clock."""

    system: System
    airframe: Airframe
    period_ms: int
    delay_ms: int  # from the state that a setpoint answers to when it acts
    step_s: float  # of the model
    filter: Filter | None = None  # for measurements with noise or without some; None: all is measured exactly
    sensing: Sensing = "full"
    attitude_rate: int = 1  # how often a vehicle tells its attitude in a period


class Instant(NamedTuple):
    """What is known of one time stamp."""

    boot_ms: int
    state: State
    tension: Array  # (n,) N, of the links at the payload
    position_gap: Array  # (n,) m between a vehicle's own position and where its cable puts it; NaN where not said
    age_ms: int  # of the newest measurement that the oldest part rests on; 0 where all is measured


class _Parts:
    """What has come in of one time stamp."""

    def __init__(self, hanging: Array, many: int) -> None:
        """`hanging` (n, L, 6): what stands where there is no link, or none was told."""
        self.attitudes: dict[int, VehicleAttitude] = {}
        self.positions: dict[int, VehiclePosition] = {}
        self.payload: PayloadState | None = None
        self.links = hanging.copy()
        self.frames = np.empty((len(hanging), 7))
        self.tension = np.zeros(len(hanging))
        self.cable_links = [0] * len(hanging)
        self.links_missing = many


class _LastReports:
    """What each vehicle and the tracker said last, whenever that was."""

    def __init__(self, n: int) -> None:
        self.at_ms = [-1] * n  # when each vehicle told its position
        self.x, self.v = np.full((n, 3), np.nan), np.zeros((n, 3))
        self.R: dict[int, VehicleAttitude] = {}
        self.load: PayloadState | None = None
        self.cable_ms = [-1] * n


class StateAssembler:
    """Collects values by time stamp; `estimate` is the state at one of them."""

    def __init__(self, loop: LoopModel) -> None:
        self._loop = loop
        self._links_of: list[int] = loop.system.n_links.tolist()
        apart = 1 if loop.attitude_rate == 1 else self._n  # each at a time of its own
        self._kept = KEPT * loop.attitude_rate * apart
        self._hanging = np.tile((0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (*loop.system.length.shape, 1))
        self._parts: dict[int, _Parts] = {}
        self._known: dict[int, tuple[Belief, int]] = {}  # estimates and the stamp that their oldest part rests on
        self._no_force = np.zeros((self._n + 1, 3))
        self._commands: dict[int, tuple[Array, Array]] = {}  # R_c and f by the state they answered
        self._newest_ms = -1
        self._oldest_new = -1  # the earliest stamp of which something new is known; -1: none
        self._tension = np.zeros(self._n)
        self._moving = False
        self._slack = False
        self._begun = False
        self._last = _LastReports(self._n)

    @property
    def _n(self) -> int:
        return len(self._links_of)

    def inherit(self, before: "StateAssembler", rest: list[int]) -> None:
        """Know what `before` was told last by those of its vehicles (from 0) that are left: the silent say no more."""
        self._last.load = before._last.load
        for own, i in enumerate(rest):
            self._last.at_ms[own] = before._last.at_ms[i]
            self._last.x[own], self._last.v[own] = before._last.x[i], before._last.v[i]
            if i in before._last.R:
                self._last.R[own] = before._last.R[i]

    def feed(self, source: int, value: object) -> None:
        """Take one value from the vehicle with system id `source`, or from the tracker."""
        n = len(self._links_of)
        match value:
            case VehicleAttitude() if 1 <= source <= n:
                parts = self._of(value.boot_ms)
                parts.attitudes[source - 1] = self._last.R[source - 1] = value
                parts.frames[source - 1] = value.frame
            case VehiclePosition() if 1 <= source <= n:
                self._of(value.boot_ms).positions[source - 1] = value
                if (
                    value.boot_ms > self._last.at_ms[source - 1]
                    or value.boot_ms < self._last.at_ms[source - 1] - REBOOT_MS
                ):
                    self._last.at_ms[source - 1] = value.boot_ms
                    self._last.x[source - 1], self._last.v[source - 1] = value.x, value.v
            case PayloadState() if source > n and self._loop.sensing != "vehicles":
                self._of(value.boot_us // 1000).payload = self._last.load = value
            case CableShape() if source > n and self._loop.sensing == "full":
                self._cable(value)
            case _:
                pass

    def commanded(self, boot_ms: int, R_c: Array, f: Array) -> None:
        """Remember the setpoints that answer the state of `boot_ms`."""
        self._commands[boot_ms] = (R_c, f)
        self._forget(self._commands)

    def released(self) -> None:
        """From now on things move; before, what is not measured is as it was."""
        self._moving = True

    def slack(self, is_slack: bool) -> None:
        """Cables may hang slack, which no model of taut ones knows: nothing is carried on, all is as it is measured."""
        self._slack, self._moving = is_slack, not is_slack

    def estimate(self, boot_ms: int) -> Instant | None:
        """The state at `boot_ms`; None until everything has been measured together once."""
        parts = self._parts.get(boot_ms)
        state = None if parts is None or self._loop.filter is not None else self._measured(parts)
        if state is not None:
            age = 0
            self._known[boot_ms] = (Belief(state, self._no_force), boot_ms)
        elif not self._begun and not self._begin():
            return None
        else:
            belief, rests_on = self._carried(boot_ms)
            state, age = belief.state, boot_ms - (min(self._last.at_ms) if self._slack else rests_on)
        self._begun = True
        self._oldest_new = -1
        self._forget(self._known)
        gap = np.full(self._n, np.nan)
        if parts is not None:
            if parts.links_missing == 0:
                self._tension = parts.tension
            elif self._loop.sensing != "full":
                self._tension = np.full(self._n, np.nan)
            if parts.positions:
                hung = positions(self._loop.system, state)
                for i, said in parts.positions.items():
                    gap[i] = math.dist(said.x.tolist(), hung[i, 0].tolist())
        return Instant(boot_ms, state, self._tension, gap, age)

    def incomplete(self) -> str:
        """Whose word is missing most in the instants that are remembered, in words."""
        parts, of = list(self._parts.values()), len(self._parts)
        if not parts:
            return "no measurement has come"
        said = {"the payload tracker (ODOMETRY)": sum(p.payload is not None for p in parts)}
        if self._loop.sensing == "full":
            for i, links in enumerate(self._links_of):
                stamped = sum(p.cable_links[i] >= links for p in parts)
                said[f"the payload tracker (CABLE_STATE of cable {i + 1})"] = stamped
        elif self._loop.sensing == "vehicles":
            said = {
                f"vehicle {i + 1} (LOCAL_POSITION_NED)": sum(i in p.positions for p in parts) for i in range(self._n)
            }
        said |= {f"vehicle {i + 1} (ATTITUDE_QUATERNION)": sum(i in p.attitudes for p in parts) for i in range(self._n)}
        who = min(said, key=lambda name: said[name])
        return f"{who} spoke of {said[who]} of the last {of} instants"

    def reported(self, boot_ms: int) -> tuple[Array, Array, Array]:
        """x (n, 3) m where vehicles said they are, carried on by v (n, 3) m/s to `boot_ms`, and its age (n,) s."""
        since = np.maximum(boot_ms - np.array(self._last.at_ms), 0) * 1e-3
        return self._last.x + since[:, None] * self._last.v, self._last.v.copy(), since

    def known(self, boot_ms: int) -> tuple[State, Array] | None:
        """The state and the tensions (n,) N of an instant whose cables were measured."""
        parts, known = self._parts.get(boot_ms), self._known.get(boot_ms)
        if parts is None or known is None or parts.links_missing > 0:
            return None
        return known[0].state, parts.tension

    def acting(self, boot_ms: int) -> tuple[Array, Array] | None:
        """R_c and f that act from `boot_ms` on, if they arrived."""
        due = boot_ms - self._loop.delay_ms
        newest_first = reversed(self._commands.items())
        return next((command for stamp, command in newest_first if stamp <= due), None)

    # -- inside --------------------------------------------------------------------------------------------------------

    def _of(self, boot_ms: int) -> _Parts:
        parts = self._parts.get(boot_ms)
        if parts is None:
            if boot_ms < self._newest_ms - REBOOT_MS:  # the clock went back: everything starts anew
                for store in (self._parts, self._known, self._commands):
                    store.clear()
                self._begun = False
                self._last.cable_ms = [-1] * self._n
                self._newest_ms = boot_ms
            self._newest_ms = max(self._newest_ms, boot_ms)
            parts = self._parts[boot_ms] = _Parts(self._hanging, sum(self._links_of))
            self._forget(self._parts)
        if self._oldest_new < 0 or boot_ms < self._oldest_new:
            self._oldest_new = boot_ms
        return parts

    def _forget(self, store: dict) -> None:
        while len(store) > self._kept:
            del store[next(iter(store))]  # the first that came

    def _cable(self, c: CableShape) -> None:
        i, k, first = c.cable - 1, len(c.links), c.first_link
        if not 0 <= i < self._n or c.n_links != self._links_of[i] or first + k > self._hanging.shape[1]:
            return
        parts = self._of(c.boot_us // 1000)
        if parts.cable_links[i] >= self._links_of[i]:
            return  # a copy
        parts.links[i, first : first + k] = c.links
        parts.cable_links[i] += k
        parts.links_missing -= k
        parts.tension[i] = c.tension_N
        if parts.cable_links[i] >= self._links_of[i]:
            self._last.cable_ms[i] = max(self._last.cable_ms[i], c.boot_us // 1000)

    def _begin(self) -> bool:
        """Whether some instant is known whole, from which the model can lead on."""
        filter = self._loop.filter
        for stamp in sorted(self._parts, reverse=True):
            if filter is not None:
                belief = self._lying(filter, self._parts[stamp])
            else:
                state = self._measured(self._parts[stamp])
                belief = None if state is None else Belief(state, self._no_force)
            if belief is not None:
                self._known[stamp] = (belief, stamp)
                return True
        return self._begin_apart()

    def _begin_apart(self) -> bool:
        """Begin with vehicles that keep their own time: what is held is at the tracker's stamp as they told it last."""
        if self._loop.filter is not None:
            return self._begin_among_vehicles(self._loop.filter)
        if len(self._last.R) < self._n:
            return False
        for stamp in sorted(self._parts, reverse=True):
            parts = self._parts[stamp]
            beside = any(
                stamped.boot_ms % self._loop.period_ms != stamp % self._loop.period_ms
                for stamped in self._last.R.values()
            )
            state = self._measured(parts, self._last.R) if beside else None
            if state is not None:
                self._known[stamp] = (Belief(state, self._no_force), min(stamp, self._oldest_reported()))
                return True
        return False

    def _begin_among_vehicles(self, filter: Filter) -> bool:
        """Begin with vehicles alone whose streams have phases of their own: nothing is ever said of one instant by all.

        Before they fly they stand or are held: each is where it reported last.
        """
        apart = len({ms % self._loop.period_ms for ms in self._last.at_ms}) > 1
        if self._loop.sensing != "vehicles" or not apart or min(self._last.at_ms) < 0:
            return False
        if len(self._last.R) < self._n or not self._parts:
            return False
        measured = nothing_measured(self._loop.system)
        for i in range(self._n):
            measured.x[i], measured.v[i] = self._last.x[i], self._last.v[i]
            measured.R[i], measured.Omega[i] = self._last.R[i].R, self._last.R[i].Omega
        belief = first_belief(filter, measured)
        if belief is None:
            return False
        self._known[max(self._parts)] = (belief, min(self._last.at_ms))
        return True

    def _oldest_reported(self) -> int:
        """The stamp (ms) that the source which was silent for longest spoke of last; -1 before all have spoken."""
        stamps = [stamped.boot_ms for stamped in self._last.R.values()]
        if len(stamps) < self._n:
            return -1
        if self._loop.sensing == "full":
            stamps += [
                -1 if self._last.load is None else self._last.load.boot_us // 1000,
                *self._last.cable_ms,
            ]
        return min(stamps)

    def _lying(self, filter: Filter, parts: _Parts) -> Belief | None:
        """Everything where it is measured, cables straight; None without what that takes.

        Where cables are slack little moves: what this stamp does not tell is as it was told last.
        """
        measured = self._measurements(parts)
        load = self._last.load
        if self._slack and load is None:
            return None
        if load is not None:
            if parts.payload is None:
                measured = measured._replace(x0=load.x0, v0=load.v0, R0=load.R0, Omega0=load.Omega0)
            for i in range(self._n):
                if i not in parts.positions:
                    measured.x[i], measured.v[i] = self._last.x[i], self._last.v[i]
                if i not in parts.attitudes and i in self._last.R:
                    measured.R[i], measured.Omega[i] = self._last.R[i].R, self._last.R[i].Omega
        return first_belief(filter, measured)

    def _measurements(self, parts: _Parts) -> Measured:
        """What was measured, for the filter."""
        measured = nothing_measured(self._loop.system)
        load = parts.payload
        if load is not None:
            measured = measured._replace(x0=load.x0, v0=load.v0, R0=load.R0, Omega0=load.Omega0)
        for i, said in parts.positions.items():
            measured.x[i], measured.v[i] = said.x, said.v
        self._put_measured(parts, measured)
        return measured

    def _put_measured(self, parts: _Parts, into: State | Measured) -> None:
        """Attitudes of vehicles and whole cables, in their place."""
        for i, vehicle in parts.attitudes.items():
            into.R[i], into.Omega[i] = vehicle.R, vehicle.Omega
        for i, links in enumerate(parts.cable_links):
            q = parts.links[i : i + 1, :, :3].copy()
            if links == self._links_of[i] and lie.normalize(q):
                into.q[i], into.omega[i] = q[0], parts.links[i, :, 3:]

    def _measured(self, parts: _Parts, attitudes: dict[int, VehicleAttitude] | None = None) -> State | None:
        """The state where everything was measured, or everything but `attitudes`."""
        load, attitudes = parts.payload, parts.attitudes if attitudes is None else attitudes
        if load is None or len(attitudes) < self._n or parts.links_missing > 0:
            return None
        frames = (
            parts.frames if attitudes is parts.attitudes else np.array([attitudes[i].frame for i in range(self._n)])
        )
        whole, *rest = measured(parts.links, frames)
        return State(load.x0, load.v0, load.R0, load.Omega0, *rest) if whole else None

    def _carried(self, boot_ms: int) -> tuple[Belief, int]:
        """From the last estimate that nothing new concerns, step by step to `boot_ms`."""
        first = min(boot_ms, self._oldest_new) if self._oldest_new >= 0 else boot_ms
        base = max((stamp for stamp in self._known if stamp < first), default=min(self._known))
        belief, rests_on = self._known[base]
        at = base
        stamped = sorted(stamp for stamp in self._parts if base < stamp <= boot_ms)  # sources keep their own time
        while at < boot_ms:
            following = min(
                at + self._loop.period_ms, boot_ms, next((stamp for stamp in stamped if stamp > at), boot_ms)
            )
            belief = self._predicted(belief, at, following)
            at = following
            parts = self._parts.get(at)
            if parts is not None and self._loop.filter is not None:
                belief = self._filtered(self._loop.filter, belief, parts)
                rests_on = at if len(parts.attitudes) == self._n else max(rests_on, min(at, self._oldest_reported()))
            elif parts is not None:
                whole = self._measured(parts)
                if whole is not None:
                    belief, rests_on = Belief(whole, self._no_force), at
                else:
                    belief = Belief(self._corrected(belief.state, parts), self._no_force)
                    rests_on = max(rests_on, min(at, self._oldest_reported()))
            self._known[at] = (belief, rests_on)
        return belief, rests_on

    def _filtered(self, filter: Filter, belief: Belief, parts: _Parts) -> Belief:
        if self._slack:
            return self._lying(filter, parts) or belief
        after = corrected(filter, belief, self._measurements(parts))
        if not math.isfinite(float(after.state.omega.sum()) + float(after.state.v0.sum()) + float(after.force.sum())):
            return self._lying(filter, parts) or self._known[min(self._known)][0]  # what moves is not what is modelled
        if self._moving:
            return after
        s = after.state  # what is held does not move
        still = s._replace(v0=0.0 * s.v0, Omega0=0.0 * s.Omega0, omega=0.0 * s.omega)
        return Belief(still, self._no_force)

    def _predicted(self, belief: Belief, start_ms: int, end_ms: int) -> Belief:
        command = self.acting(start_ms)
        if not self._moving or command is None:
            return belief
        setpoint = Setpoint.attitude(*command)
        steps = max(1, round((end_ms - start_ms) * 1e-3 / self._loop.step_s))
        h = (end_ms - start_ms) * 1e-3 / steps
        if self._loop.filter is not None:
            return predicted(self._loop.filter, belief, setpoint, h, steps)
        state = flown(self._loop.system, self._loop.airframe, setpoint, belief.state, h, steps)
        return Belief(state, self._no_force)

    def _corrected(self, state: State, parts: _Parts) -> State:
        """`state` with what was measured in its place."""
        state = state.copy()
        if parts.payload is not None:
            p = parts.payload
            state = state._replace(x0=p.x0, v0=p.v0, R0=p.R0, Omega0=p.Omega0)
        self._put_measured(parts, state)
        return state
