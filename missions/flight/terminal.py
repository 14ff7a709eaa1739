"""What a flight shows on a terminal: progress while it goes, a table at its end."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TaskID, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table

from bridge.loop.deciders import PART
from logs.views.results import rows
from missions.flight.run import Progress
from missions.flight.summary import Summary

SOON_S = 2.0  # nothing is said of how long something takes before
LINE_S = 10.0  # wall clock, between lines that say how far something is


class _Bar(Progress):
    """A progress bar on the terminal's error stream, with what is being done before it moves."""

    def __init__(self, bar: Bar) -> None:
        self._bar = bar
        self._task: TaskID | None = None
        self._doing: TaskID | None = None
        self._shown = -1.0

    def doing(self, text: str) -> None:
        if self._doing is None:
            self._doing = self._bar.add_task(text, total=None)
        self._bar.update(self._doing, description=text)

    def say(self, text: str) -> None:
        self._bar.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def flown(self, t: float, duration: float, error_m: float, factor: float) -> None:
        if t - self._shown < duration / 100 and t < duration:
            return
        self._shown = t
        if self._doing is not None:
            self._bar.remove_task(self._doing)
            self._doing = None
        if self._task is None:
            self._task = self._bar.add_task("flying", total=duration)
        text = f"t = {t:5.2f} s   error {100 * error_m:7.2f} cm   {factor:4.1f} x real time"
        self._bar.update(self._task, completed=t, description=text)


class _Lines(Progress):
    """Plain lines on the error stream, for pipes and files: what is said, and how far the flight is now and then."""

    def __init__(self) -> None:
        self._next = 0.0
        self._doing: str | None = None
        self._since = 0.0

    def say(self, text: str) -> None:
        _line(text)

    def doing(self, text: str) -> None:
        if text != self._doing:
            _line(text)
            self._doing, self._since = text, time.monotonic()

    def again(self) -> None:
        """Say once more what is still being done."""
        doing = self._doing
        if doing is not None and time.monotonic() - self._since >= LINE_S:
            _line(f"{doing} ({time.monotonic() - self._since:.0f} s)")

    def flown(self, t: float, duration: float, error_m: float, factor: float) -> None:
        now = time.monotonic()
        self._doing = None
        if self._next == 0.0:
            self._next = now + LINE_S
        if now >= self._next:
            self._next = now + LINE_S
            _line(f"flying: t = {t:.1f} of {duration:g} s, error {100 * error_m:.2f} cm, {factor:.1f} x real time")


def _line(text: str) -> None:
    """A line for whoever reads the error stream, at once; an indented one is to be copied, and stands as it is."""
    print(text if text.startswith("  ") else f"cablequad: {text}", file=sys.stderr, flush=True)


@contextmanager
def progress() -> Iterator[Progress]:
    """What a flight says on the error stream: a live bar on a terminal, plain lines in a pipe."""
    if sys.stderr.isatty():
        console = Console(stderr=True)
        with Bar(TextColumn("{task.description}"), BarColumn(bar_width=30), console=console) as bar:
            yield _Bar(bar)
    else:
        lines, ended = _Lines(), threading.Event()

        def again() -> None:
            while not ended.wait(LINE_S):
                lines.again()

        thread = threading.Thread(target=again, name="progress", daemon=True)
        thread.start()
        try:
            yield lines
        finally:
            ended.set()


@contextmanager
def telling(name: str) -> Iterator[Callable[[str], None]]:
    """A function that says what is being done: beside a spinner on a terminal, as lines in a pipe.

    What takes long is said again now and then with the time that it has taken.
    """
    doing = _Doing(name)
    console = Console(stderr=True)
    spinner = console.status(name) if sys.stderr.isatty() else None
    ended = threading.Event()

    def tell(text: str) -> None:
        doing.now(text)
        if spinner is not None:
            spinner.update(doing.text())
        else:
            _line(doing.text())

    def again() -> None:
        while not ended.wait(LINE_S if spinner is None else 1.0):
            if spinner is not None:
                spinner.update(doing.text(True))
            elif doing.what and doing.took_s >= SOON_S:
                _line(doing.text(True))

    thread = threading.Thread(target=again, name="progress", daemon=True)
    thread.start()
    try:
        with spinner if spinner is not None else nullcontext():
            yield tell
    finally:
        ended.set()
        thread.join()


class _Doing:
    """What is being done, and since when."""

    def __init__(self, name: str) -> None:
        self._name, self.what, self._since = name, "", time.monotonic()

    def now(self, what: str) -> None:
        self.what, self._since = what, time.monotonic()

    @property
    def took_s(self) -> float:
        """Seconds so far."""
        return time.monotonic() - self._since

    def text(self, how_long: bool = False) -> str:
        took = self.took_s
        return f"{self._name}: {self.what}" + (f" ({took:.0f} s)" if how_long and took >= SOON_S else "")


def table(s: Summary) -> None:
    """The summary as a table, one line a figure, with what was asked beside it."""
    failed = "FLOWN IN PART" if s.reason.startswith(PART) else "FAILED"
    verdict = "passed" if s.passed else failed if s.tested else "NOT TESTED"
    out = Table(title=f"{s.scenario}: {verdict}", title_justify="left", show_header=False)
    out.add_column(style="bold")
    out.add_column(justify="right")
    out.add_column()
    out.add_row("reason", "", s.reason)
    for row in rows(s._asdict()):
        out.add_row(*row)
    if s.predicted_ticks:
        out.add_row("states partly predicted", str(s.predicted_ticks), "")
    if s.thrust_scale:
        known = [k for k in s.thrust_scale if k is not None]
        made = ", ".join("-" if k is None else f"{k['scale']:.4f}" for k in s.thrust_scale)
        made += f" +- {max(k['error'] for k in known):.0e}" if known else " (not known)"
        out.add_row("thrust made / asked", made, "")
    if s.jitter_us is not None:
        jitter = f"{s.jitter_us['p50']:.0f}, {s.jitter_us['p99']:.0f}, {s.jitter_us['max']:.0f} us"
        out.add_row("tick jitter p50, p99, max", jitter, "")
    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    console.print(out)
    for name, path in (("log", s.log), ("replay", s.replay)):
        console.print(f"{name + ':':8}{path or '-'}", soft_wrap=True)


def margins_table(result: dict[str, Any]) -> None:
    """What `cablequad margins` found."""
    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    table = Table(title=f"{result['scenario']}: margins, one thing wrong at a time", title_justify="left")
    for name in ("what", "predicted", "set by", "measured", ""):
        table.add_column(name, justify="right" if name in ("predicted", "measured") else "left")
    for row in result["margins"]:
        cells = [margin_text(row, row[key], result["period_ms"]) for key in ("predicted", "measured")]
        more = "all that was tried" if row["tried_all"] else f"{len(row['flights'])} flights"
        table.add_row(row["name"], cells[0], row["bound"], cells[1], more)
    console.print(table)
    console.print(
        f"measured: {result['flown_s']:.0f} s of the nonlinear model from {100 * result['kick_m'][0]:.0f} cm beside "
        "the target on every axis; whole ticks are lost, the setpoints before hold"
    )
    console.print(f"figure: {result['figure']}")


def margin_text(row: dict[str, Any], value: float, period_ms: float) -> str:
    """A margin with its unit."""
    match row["unit"]:
        case "ticks":
            return f"{value:.0f} ticks, {value * period_ms:.0f} ms"
        case "share":
            return f"{100 * value:.0f} %"
        case _:
            return f"x {value:.2f}"


def info_table(result: dict[str, Any]) -> None:
    """What `cablequad log info` found."""
    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    run, ended = result["run"], result["result"]
    whole = "damaged" if result["damage"] else "whole" if result["complete"] else "cut short"
    console.print(
        f"{result['log']}: {whole}, {result['bytes'] / 1e6:.1f} MB, {result['duration_s']:.2f} s, of which "
        f"{result['flown_s']:.2f} s flown, {result['messages']} messages"
    )
    console.print("  ".join(f"{key}: {value}" for key, value in run.items()), soft_wrap=True)
    for damage in result["damage"]:
        console.print(f"[bold]{damage}[/bold]", soft_wrap=True)
    if result["messages_lost"]:
        console.print(f"[bold]{result['messages_lost']} messages are lost in all[/bold]")
    if ended is None:
        console.print("[bold]no result: the run did not end in order[/bold]")
    else:
        verdict = "passed" if ended.get("passed") == "true" else "failed"
        console.print(f"result: {verdict}, {ended.get('reason', '').strip(chr(34))}")
    table = Table()
    for name in ("topic", "schema", "messages", "Hz", "kB", "gaps"):
        table.add_column(name, justify="left" if name in ("topic", "schema") else "right")
    for name, t in result["topics"].items():
        cells = (f"{t['messages']}", f"{t['rate_hz']:g}", f"{t['bytes'] / 1e3:.1f}", f"{t['gaps'] or ''}")
        table.add_row(name, t["schema"], *cells)
    console.print(table)
    console.print(f"attached: {', '.join(result['attachments'])}")
