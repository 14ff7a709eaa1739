"""Write the README's figures from benchmarks/results, and the text for package indexes: `python -m docs.readme`.

What stands between `<!-- NAME -->` and `<!-- end -->` is written; a test compares it with the results.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
BLOCK = re.compile(r"(<!-- (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def _read(name: str) -> Any:
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def flights() -> str:
    """What the quoted flights showed, beside what was asked of them."""
    of = {(f["scenario"], f["firmware"]): f for f in _read("flights")["flights"]}
    one, two = of["paper-case-1", "px4"], of["paper-case-2", "px4"]
    ground = [of["ground-to-ground", firmware] for firmware in ("px4", "arducopter")]
    down = " / ".join(f"{100 * f['set_down_error_m']:.1f}" for f in ground)
    touch = " / ".join(f"{f['touch_down_m_s']:.2f}" for f in ground)
    hours = " / ".join(f"{f['per_core_hour']:.0f}" for f in (one, ground[0]))
    rows = (
        ("Case 1 after 10 s: distance, speed", "2 cm, 2 cm/s",
         f"{100 * one['final_error_m']:.2f} cm, {100 * one['final_speed_m_s']:.2f} cm/s"),
        ("link error e_q, largest Psi_i", "0.1, 0.01", f"{one['final_e_q']:.4f}, {one['max_psi']:.0e}"),
        ("Case 2 at 250 Hz: largest error 8-10 s, e_q at 10 s, largest Psi_i", "2 cm, 0.3, 1",
         f"{100 * two['error_8_10_m']:.2f} cm, {two['e_q_10']:.2f}, {two['max_psi']:.2f}"),
        ("ground to ground at 50 Hz, noisy fleet in wind, PX4 / ArduCopter: set down from its mark, touch-down",
         "10 cm, 0.3 m/s", f"{down} cm, {touch} m/s"),
        ("flights an hour of one core, in one process, everything recorded: Case 1 / ground to ground", "", hours),
        ("Case 1 without a wire and a log", "", f"{_read('flights')['without_wire']['per_core_hour']:.0f} an hour"),
    )  # fmt: skip
    return _table(rows)


def cost() -> str:
    """What a tick, the record and a step cost."""
    wire, record, model = _read("wire"), _read("record"), _read("model")
    factors, (every, often) = wire["real_time_factors"], record["recorded"]
    ticks = [4000.0 / max(factors) / us for us in wire["pymavlink_tick_us"]]
    rows = (
        ("lockstep over sockets, four vehicles at 250 Hz, everything recorded (`benchmarks.wire`)", "8 x real time",
         f"{max(factors):.1f} x, the best of three"),
        ("a tick of it, beside what pymavlink alone takes to pack and read its messages", "",
         f"{min(ticks):.1f} to {max(ticks):.1f} x"),
        ("recording in real time (`benchmarks.record`): share of a core, MB a minute; truth at 1 kHz", "5 %, 40; 12 %",
         f"{every['core_percent']:.1f} %, {every['MB_per_minute']:.0f}; {often['core_percent']:.1f} %"),
        ("a minute's log read and converted to a replay; truth at 1 kHz", "0.5 s, 2 s",
         f"{_seconds(every)} s, {_seconds(often)} s"),
        ("energy over 60 s of free fall, 1 ms steps (`benchmarks.model`)", "",
         f"off by {model['drift']['change_J']:.0e} J"),
    )  # fmt: skip
    return _table(rows)


def steps() -> str:
    """Our step beside MuJoCo's."""
    out = ["| vehicles, links a cable | evaluation | step | MuJoCo's RK4 step | |\n|---|---|---|---|---|\n"]
    for row in _read("model")["sizes"]:
        theirs = row["mujoco_step_us"]
        shown = "- | -" if theirs is None else f"{theirs:.0f} | {theirs / row['step_us']:.0f} x"
        out.append(f"| {row['n']}, {row['links']} | {row['evaluation_us']:.2f} | {row['step_us']:.1f} | {shown} |\n")
    return "".join(out)


def _seconds(row: dict[str, float]) -> str:
    return f"{row['read_s_per_minute'] + row['convert_s_per_minute']:.2f}"


def _table(rows: tuple[tuple[str, str, str], ...]) -> str:
    return "| | asked | measured |\n|---|---|---|\n" + "".join(f"| {' | '.join(row)} |\n" for row in rows)


TABLES: dict[str, Callable[[], str]] = {"flights": flights, "cost": cost, "steps": steps}


def page() -> str:
    """The README with its figures as the results have them."""

    def block(match: re.Match[str]) -> str:
        return f"{match[1]}{TABLES[match[2]]()}{match[3]}"

    return BLOCK.sub(block, (ROOT / "README.md").read_text(encoding="utf-8"))


def index_page() -> str:
    """The README without what only a repository has: pictures, and links to its files."""
    text = re.sub(r"!\[[^]]*\]\((?!https?:)[^)]*\)\n*", "", page())
    text = re.sub(r"<!-- \w+ -->\n", "", text)
    return re.sub(r"\[([^]]*)\]\((?!https?:)[^)]*\)", r"\1", text)


if __name__ == "__main__":
    (ROOT / "README.md").write_text(page(), encoding="utf-8")
    (ROOT / "docs" / "index-page.md").write_text(index_page(), encoding="utf-8")
