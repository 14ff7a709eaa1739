"""What a flight amounted to, and whether its own criteria hold."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bridge.loop.fly import Outcome
from bridge.loop.tick_timing import TickStatistics
from cablequad.control.control_step import Sample
from missions.scenario.metrics import Followed, Following, Grounded
from missions.scenario.tables import AcceptanceTable


class Track:
    """Figures that accumulate while flying; only what happens between release and end counts."""

    def __init__(self, target: tuple[float, ...], ends_there: bool, n_links: Sequence[int]) -> None:
        """See Following; `n_links` of each cable."""
        self.last: Sample | None = None
        self._links = np.arange(max(n_links)) < np.array(n_links)[:, None]
        self.following = Following(target, ends_there)
        self.max_psi = 0.0
        self.max_thrust_N = 0.0
        self.min_tension_N = np.inf

    def decided(self, sample: Sample) -> None:
        """Take one decision of the flight."""
        self.last = sample
        self.max_psi = max(self.max_psi, *sample.Psi.tolist())
        self.max_thrust_N = max(self.max_thrust_N, *sample.f.tolist())
        s, wanted = sample.state, sample.reference.x0
        self.following.take(sample.t, s.x0.tolist(), s.v0.tolist(), wanted.tolist())

    def link_error_deg(self) -> float | None:
        """Root mean square over all links of the angle between |q_ij| and its reference, of the last decision."""
        if self.last is None:
            return None
        off = np.linalg.norm((self.last.state.q - self.last.q_d)[self._links], axis=1)
        return float(np.degrees(np.sqrt(np.mean(off**2))))

    def tension(self, smallest_N: float) -> None:
        """Take the smallest tension of one instant."""
        self.min_tension_N = min(self.min_tension_N, smallest_N)


OF_THE_END = frozenset(
    {"position_error_m", "speed_m_s", "e_q", "link_error_deg", "psi", "settling_time_s", "mean_position_error_m"}
)  # criteria that a flight can only meet at its end


class Criterion(NamedTuple):
    """One line of [acceptance]."""

    name: str
    limit: float
    measured: float | None
    holds: bool


class Summary(NamedTuple):
    """What `cablequad fly` reports."""

    scenario: str
    passed: bool
    reason: str
    final_position_error_m: float | None
    final_speed_m_s: float | None
    settling_time_s: float | None
    max_psi: float | None
    max_thrust_N: float | None
    min_tension_N: float | None
    messages_sent: int
    messages_lost: int
    messages_late: int
    real_time_factor: float | None
    log: str | None
    replay: str | None
    final_e_q: float | None = None
    final_link_error_rms_deg: float | None = None  # of one link, where final_e_q is a sum over them
    final_psi: float | None = None
    flown_s: float = 0.0
    missed_deadlines: int = 0
    jitter_us: dict[str, float] | None = None
    criteria: list[dict[str, Any]] | None = None
    predicted_ticks: int = 0  # answered with a state that was not all measured
    wire: dict[str, int] | None = None  # frames counted on both sides, and what became of them
    thrust_scale: list[dict[str, float] | None] | None = None  # of each vehicle: newtons made per newton asked
    state_age_ms: float | None = None  # mean, of the oldest measurement that decisions rested on
    rms_tracking_error_m: float | None = None
    largest_tracking_error_m: float | None = None
    mean_position_error_m: float | None = None  # over the last 10 s
    link_direction_error_deg: float | None = None  # rms of the estimate that was flown by
    payload_attitude_error_deg: float | None = None
    set_down_error_m: float | None = None  # of a mission: level distance of the load that stands from its target
    touch_down_m_s: float | None = None
    max_tension_N: float | None = None
    min_separation_m: float | None = None  # between vehicles
    vehicles_crashed: int | None = None
    tested: bool = True  # False: the computer could not carry the flight out, which says nothing of it


def criteria(limits: AcceptanceTable, s: Summary) -> list[Criterion]:
    """Every criterion that the scenario asks for, with what was measured."""
    upper = {
        "position_error_m": s.final_position_error_m,
        "speed_m_s": s.final_speed_m_s,
        "e_q": s.final_e_q,
        "link_error_deg": s.final_link_error_rms_deg,
        "psi": s.final_psi,
        "max_psi": s.max_psi,
        "max_thrust_N": s.max_thrust_N,
        "settling_time_s": s.settling_time_s,
        "rms_tracking_error_m": s.rms_tracking_error_m,
        "mean_position_error_m": s.mean_position_error_m,
        "link_direction_error_deg": s.link_direction_error_deg,
        "set_down_error_m": s.set_down_error_m,
        "touch_down_m_s": s.touch_down_m_s,
        "max_tension_N": s.max_tension_N,
    }
    out = []
    for name, measured in upper.items():
        limit = getattr(limits, name)
        if limit is not None:
            out.append(Criterion(name, limit, measured, measured is not None and measured <= limit))
    for name, low in (("min_tension_N", s.min_tension_N), ("min_separation_m", s.min_separation_m)):
        limit = getattr(limits, name)
        if limit is not None:
            out.append(Criterion(name, limit, low, low is not None and low >= limit))
    return out


class Asked(NamedTuple):
    """What a flight is judged by."""

    scenario: str
    limits: AcceptanceTable
    scripted: bool = False  # what such a mission never did is not asked of it
    cut_short: bool = False  # asked to end early: what is of the end is not asked of it
    broken: int = 0  # vehicles that the scenario breaks, and that may come down as they like


class Known(NamedTuple):
    """What is known of a flight that ended."""

    track: Track
    outcome: Outcome
    timing: TickStatistics
    sent: int = 0
    lost: int = 0
    missed_deadlines: int = 0
    n: int = 0  # vehicles
    true: Followed | None = None  # how the load really moved, where a simulator told it
    grounded: Grounded | None = None
    mark: tuple[float, float] | None = None  # where a mission set the load down last


def summarize(asked: Asked, k: Known) -> Summary:
    """The summary of a flight; a criterion that does not hold is named in the reason."""
    s = _figures(asked.scenario, k)
    found = [c for c in criteria(asked.limits, s) if not (asked.scripted and c.measured is None)]
    found = [c for c in found if not (asked.cut_short and c.name in OF_THE_END)]
    failed = [c for c in found if not c.holds]
    reason = k.outcome.reason
    if k.outcome.completed and failed:
        reason = "; ".join(
            f"{c.name} is {'not reached' if c.measured is None else f'{c.measured:.4g}'}, asked {c.limit:g}"
            for c in failed
        )
    crashed = max(0, (s.vehicles_crashed or 0) - asked.broken)
    if k.outcome.completed and crashed:
        told = f"{crashed} vehicle{'s' if crashed > 1 else ''} crashed"
        reason = f"{reason}; {told}" if failed else told
    return s._replace(
        passed=k.outcome.completed and not failed and not crashed, tested=not k.outcome.untested, reason=reason,
        criteria=[c._asdict() for c in found],
    )  # fmt: skip


def _figures(scenario: str, k: Known) -> Summary:
    """What was measured."""
    track, timing, grounded, last = k.track, k.timing, k.grounded, k.track.last
    moved = k.true or track.following.followed()
    s = Summary(
        scenario=scenario,
        passed=False,
        reason=k.outcome.reason,
        final_position_error_m=None, final_speed_m_s=None, settling_time_s=None,
        max_psi=None if last is None else track.max_psi,
        max_thrust_N=None if last is None else track.max_thrust_N,
        min_tension_N=float(track.min_tension_N) if np.isfinite(track.min_tension_N) else None,
        messages_sent=k.sent,
        messages_lost=k.lost,
        messages_late=timing.missed_ticks * k.n,
        real_time_factor=last.t / timing.flight_s if last is not None and timing.flight_s > 0 else None,
        log=None, replay=None,
        final_e_q=None if last is None else last.e_q,
        final_link_error_rms_deg=track.link_error_deg(),
        final_psi=None if last is None else float(last.Psi.max()),
        flown_s=0.0 if last is None else last.t,
        missed_deadlines=k.missed_deadlines,
        jitter_us=_jitter(timing.intervals_s) if len(timing.intervals_s) > 2 else None,
        predicted_ticks=timing.predicted_ticks,
        thrust_scale=[
            {"scale": round(t.scale, 5), "error": round(t.error, 5)} if t.pairs > 2 else None
            for t in timing.thrust_scales
        ],
        state_age_ms=timing.mean_age_ms,
    )  # fmt: skip
    if moved is not None:
        s = s._replace(
            final_position_error_m=moved.final_m,
            final_speed_m_s=moved.final_speed_m_s,
            settling_time_s=moved.settled_s,
            rms_tracking_error_m=moved.rms_m,
            largest_tracking_error_m=moved.largest_m,
            mean_position_error_m=moved.mean_last_m,
            link_direction_error_deg=moved.link_rms_deg,
            payload_attitude_error_deg=moved.attitude_rms_deg,
        )
    if grounded is not None:
        s = s._replace(
            set_down_error_m=None if k.mark is None else math.dist(grounded.load_m[:2], k.mark),
            touch_down_m_s=grounded.touch_down_m_s,
            max_tension_N=grounded.largest_tension_N,
            vehicles_crashed=grounded.vehicles_crashed,
            min_separation_m=grounded.smallest_separation_m,
        )
    return s


def _jitter(intervals_s: Sequence[float]) -> dict[str, float]:
    """How far the times between answered states lie from their median, in us."""
    values = np.array(intervals_s)
    off = np.abs(values - np.median(values)) * 1e6
    return {
        "p50": round(float(np.percentile(off, 50)), 1),
        "p99": round(float(np.percentile(off, 99)), 1),
        "max": round(float(off.max()), 1),
    }
