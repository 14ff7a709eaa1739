"""The figures that a run is judged by, as the terminal and the report's page show them: one table."""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Figure(NamedTuple):
    """One figure of a run's result."""

    key: str  # in the result
    label: str
    form: str  # with its unit
    criterion: str = ""  # in the scenario's [acceptance]; the key where nothing is said
    of_mission: bool = False  # of missions alone
    of_plan: bool = False  # of a plan that ends at a target alone: where a mission ends the load stands


class Row(NamedTuple):
    """One line to show."""

    label: str
    value: str
    asked: str  # the limit, and whether it holds; nothing where none was asked


FIGURES = (
    Figure("final_position_error_m", "final position error", "{:.4f} m", "position_error_m"),
    Figure("rms_tracking_error_m", "rms tracking error", "{:.4f} m"),
    Figure("mean_position_error_m", "mean error, last 10 s", "{:.4f} m", of_plan=True),
    Figure("link_direction_error_deg", "link directions estimated to", "{:.2f} deg"),
    Figure("payload_attitude_error_deg", "load's attitude estimated to", "{:.2f} deg"),
    Figure("final_speed_m_s", "final speed", "{:.4f} m/s", "speed_m_s", of_plan=True),
    Figure("settling_time_s", "settled within 5 cm at", "{:.2f} s", of_plan=True),
    Figure("final_e_q", "final e_q, sum over all links", "{:.4f}", "e_q", of_plan=True),
    Figure("final_link_error_rms_deg", "final error of a link, rms", "{:.3f} deg", "link_error_deg", of_plan=True),
    Figure("final_psi", "final Psi_i, largest", "{:.3g}", "psi"),
    Figure("max_psi", "largest Psi_i", "{:.3g}"),
    Figure("max_thrust_N", "largest thrust", "{:.2f} N"),
    Figure("min_tension_N", "smallest tension", "{:.2f} N"),
    Figure("max_tension_N", "largest tension", "{:.2f} N", of_mission=True),
    Figure("min_separation_m", "smallest separation", "{:.2f} m", of_mission=True),
    Figure("touch_down_m_s", "touch-down", "{:.3f} m/s", of_mission=True),
    Figure("set_down_error_m", "set down from its mark", "{:.3f} m", of_mission=True),
    Figure("vehicles_crashed", "vehicles crashed", "{:d}", of_mission=True),
    Figure("state_age_ms", "age of a state's oldest part", "{:.1f} ms"),
    Figure("messages_sent", "messages sent", "{:d}"),
    Figure("messages_lost", "messages lost", "{:d}"),
    Figure("messages_late", "messages late", "{:d}"),
    Figure("real_time_factor", "real-time factor", "{:.2f}"),
    Figure("missed_deadlines", "missed deadlines", "{:d}"),
)
ALWAYS = 0.01  # deg: directions that are estimated better than this are measured
LED_ON = "its reference goes on into the ground"


def rows(result: Mapping[str, Any]) -> list[Row]:
    """Every figure that the run has, with what was asked beside it."""
    asked = {c["name"]: c for c in result.get("criteria") or []}
    mission = result.get("max_tension_N") is not None
    out = []
    for figure in FIGURES:
        value = result.get(figure.key)
        measured = figure.key.endswith("error_deg") and (value or 0.0) <= ALWAYS
        whole = figure.key == "state_age_ms" and value == 0.0  # every state was measured as a whole
        limit = _limit(asked.get(figure.criterion or figure.key))
        elsewhere = (figure.of_mission and not mission) or (figure.of_plan and mission and not limit)
        if value is None or measured or whole or elsewhere:
            continue
        label = figure.label
        if mission and figure.key == "final_position_error_m":
            label, limit = "last error to its reference", limit or LED_ON
        out.append(Row(label, figure.form.format(value), limit))
    return out


def _limit(criterion: Mapping[str, Any] | None) -> str:
    if criterion is None:
        return ""
    sign = ">=" if criterion["name"].startswith("min_") else "<="
    return f"{sign} {criterion['limit']:g} {'ok' if criterion['holds'] else 'MISSED'}"
