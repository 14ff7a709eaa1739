"""Commands for before a flight: check, margins, preflight. Heavy imports stand inside."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from missions.exits import FAILED, usage
from missions.options import JsonOption, PortOffset, ScenarioArgument, load


def check(
    scenario: ScenarioArgument = "paper-case-1",
    quick: Annotated[bool, typer.Option(help="Leave out what needs many simulated flights.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Say what can be said of a scenario before it flies: modes, margins, the stability certificate, what settles."""
    from rich.console import Console

    from missions.check import check as examine
    from missions.check import show
    from missions.drills import in_the_air
    from missions.scenario import ScenarioError

    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False, quiet=as_json)
    try:
        flight = load(scenario, None, None)
        s = flight.scenario
        console.print(f"[bold]{s.name}[/bold], law = {s.control.law}: {s.description}")
        result = examine(in_the_air(flight), quick)
    except ScenarioError as error:
        usage(str(error))
    if as_json:
        print(json.dumps(result))
    else:
        show(result, console)


def margins(
    scenario: ScenarioArgument = "paper-case-1",
    out: Annotated[Path, typer.Option(help="Folder for the figure.")] = Path("runs"),
    as_json: JsonOption = False,
) -> None:
    """How much delay, loss and wrong modelling the loop stands: predicted, and measured in simulated flights."""
    from missions.drills import in_the_air
    from missions.margins import measure, plot
    from missions.report import margins_table, working
    from missions.scenario import ScenarioError

    try:
        flight = load(scenario, None, None)
        out.mkdir(parents=True, exist_ok=True)
        with working(f"{flight.scenario.name}: flying towards its margins", quiet=as_json):
            result = measure(in_the_air(flight))
    except ScenarioError as error:
        usage(str(error))
    except OSError as error:
        usage(f"--out {out}: {error.strerror}; choose another folder")
    result["figure"] = str(out / f"{flight.scenario.name}-margins.png")
    plot(result, Path(result["figure"]))
    if as_json:
        print(json.dumps(result))
    else:
        margins_table(result)


def preflight(
    scenario: ScenarioArgument = "ground-to-ground",
    out: Annotated[Path, typer.Option(help="Folder for the page and the logs.")] = Path("runs"),
    as_json: JsonOption = False,
    port_offset: PortOffset = 0,
) -> None:
    """Go or no-go: design, margins, the flight itself and eight drills with and without protection, on one page.

    Exit code 0 for go, 1 for no-go.
    """
    from rich.console import Console

    from missions import preflight as page
    from missions.run import Options
    from missions.scenario import ScenarioError

    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False, quiet=as_json)
    progress = Console(stderr=True, quiet=as_json or not sys.stderr.isatty())
    try:
        flight = load(scenario, None, None)
        out.mkdir(parents=True, exist_ok=True)
        name = flight.scenario.name
        with progress.status(name) as status:
            lines = list(
                page.preflight(
                    flight, Options(out=out, port_offset=port_offset), lambda text: status.update(f"{name}: {text}")
                )
            )
    except ScenarioError as error:
        usage(str(error))
    except OSError as error:
        usage(f"--out {out}: {error.strerror}; choose another folder")
    target = out / f"{name}-preflight.html"
    target.write_text(page.page(name, flight.scenario.description, lines), encoding="utf-8")
    go = page.verdict(lines)
    if as_json:
        print(
            json.dumps({"scenario": name, "go": go, "page": str(target), "lines": [line._asdict() for line in lines]})
        )
    else:
        page.show(name, lines, console)
        console.print(f"page:   {target}", soft_wrap=True)
    if not go:
        raise typer.Exit(FAILED)
