"""Commands for before a flight: check, margins, preflight. Heavy imports stand inside."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from missions.cli.exits import FAILED, fail, untested, usage
from missions.cli.options import (
    ArmOption,
    BackendOption,
    ConnectOption,
    FirmwareOption,
    JsonOption,
    LaunchOption,
    PortOffset,
    ScenarioArgument,
    backend,
    endpoints,
    load,
    refuse,
)


def check(
    scenario: ScenarioArgument = "paper-case-1",
    quick: Annotated[
        bool, typer.Option(help="Leave out the search for what settles in simulated flights, and most samples.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Say what can be said of a scenario before it flies: modes, margins, the stability certificate, what settles."""
    from rich.console import Console

    from missions.analysis.check import check as examine
    from missions.analysis.check_page import show, summary
    from missions.analysis.drills import in_the_air
    from missions.flight.terminal import telling
    from missions.scenario.flights import ScenarioError

    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False, quiet=as_json)
    try:
        flight = load(scenario, None, None)
        refuse(flight, as_json)
        s = flight.scenario
        for note in flight.notes:
            print(f"cablequad: {s.name}: {note}", file=sys.stderr)
        with telling(s.name) as tell:
            result = examine(in_the_air(flight), quick, tell)
    except ScenarioError as error:
        usage(str(error))
    if as_json:
        print(json.dumps(result))
    else:
        if result["cannot_fly"]:
            console.print(f"[bold]cannot fly:[/bold] {'; '.join(result['cannot_fly'])}")
        console.print(f"[bold]{s.name}: {summary(result)}[/bold]")
        console.print(f"law = {s.control.law}: {s.description}")
        show(result, console)
    if result["cannot_fly"]:
        fail(f"{s.name}: cannot fly: {'; '.join(result['cannot_fly'])}")


def margins(
    scenario: ScenarioArgument = "paper-case-1",
    out: Annotated[Path, typer.Option(help="Folder for the figure.")] = Path("runs"),
    as_json: JsonOption = False,
) -> None:
    """How much delay, loss and wrong modelling the loop stands: predicted, and measured in simulated flights."""
    from missions.analysis.drills import in_the_air
    from missions.analysis.margins import measure, plot
    from missions.flight.terminal import margins_table, telling
    from missions.scenario.flights import ScenarioError

    try:
        flight = load(scenario, None, None)
        refuse(flight, as_json)
        out.mkdir(parents=True, exist_ok=True)
        with telling(flight.scenario.name) as tell:
            tell("simulated flights towards its margins")
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
    port_offset: Annotated[int, typer.Option(hidden=True, help="Flights here need no ports.")] = 0,
) -> None:
    """Go or no-go: design, margins, the flight itself and eight drills with and without protection, on one page.

    Exit code 0 for go, 1 for no-go, 3 where the computer could not carry a flight out.
    """
    from rich.console import Console

    from missions.analysis import preflight as page
    from missions.flight.run import Options
    from missions.flight.terminal import telling
    from missions.scenario.flights import ScenarioError

    del port_offset
    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False, quiet=as_json)
    try:
        flight = load(scenario, None, None)
        refuse(flight, as_json)
        out.mkdir(parents=True, exist_ok=True)
        name = flight.scenario.name
        with telling(name) as tell:
            for note in flight.notes:
                tell(note)
            lines = list(page.preflight(flight, Options(out=out, in_process=True), tell))
    except ScenarioError as error:
        usage(str(error))
    except page.NotTested as error:
        untested(f"{name}: {error}")
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


def identify(
    scenario: ScenarioArgument = "ground-to-ground",
    out: Annotated[Path, typer.Option(help="Folder for the log and the scenario with what was found.")] = Path("runs"),
    as_json: JsonOption = False,
    port_offset: PortOffset = 0,
    firmware: FirmwareOption = None,
    backend_name: BackendOption = "builtin",
    launch: LaunchOption = None,
    connect: ConnectOption = None,
    arm: ArmOption = False,
) -> None:
    """Tilt the vehicles a little while they hover on slack cables; find attitude response, delay and hover thrust.

    Writes the scenario with what was found, which is then flown with a law designed for it. Exit code 1 if a vehicle
    did not answer.
    """
    import math
    from importlib import resources

    from rich.console import Console
    from rich.table import Table

    from bridge.wire.link import LinkError
    from logs.reading.reader import LogError
    from missions.analysis.drills import changed
    from missions.analysis.identify import identified, with_responses
    from missions.flight.run import Options, run
    from missions.flight.terminal import progress
    from missions.scenario.flights import ScenarioError

    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False, quiet=as_json)
    who = backend(backend_name, firmware, launch)
    try:
        asked = load(scenario, None, None, firmware, backend=who, connected=bool(connect))
        refuse(asked, as_json)
        if asked.scenario.mission is None or asked.scenario.mission.start != "ground":
            usage(
                f"scenario {asked.scenario.name}: vehicles take off from the ground to be identified; add [ground] "
                "and [mission], as ground-to-ground has"
            )
        unjudged = dict.fromkeys(type(asked.scenario.acceptance).model_fields)
        flight = changed(asked, {"acceptance": asked.scenario.acceptance.model_copy(update=unjudged)})
        script = (resources.files("missions") / "scripts" / "tilt_steps.py").read_text(encoding="utf-8")
        ends = endpoints(connect, arm)
        speed = math.inf if who == "builtin" and not ends else 1.0
        alone = who == "builtin" and not ends
        options = Options(ends, out, speed, port_offset, True, backend=who, launch=launch, in_process=alone)
        with progress() as told:
            summary, _ = run(flight._replace(script=script), options, told)
        if not summary.passed or summary.log is None:
            fail(f"{asked.scenario.name}: {summary.reason}")
        found = identified(Path(summary.log), flight)
    except (ScenarioError, LinkError) as error:
        usage(str(error))
    except LogError as error:
        fail(str(error))
    target = out / f"{asked.scenario.name}-identified.json"
    target.write_text(json.dumps(with_responses(asked, found), indent=1), encoding="utf-8")
    if as_json:
        print(json.dumps({"vehicles": [r._asdict() for r in found], "scenario": str(target), "log": summary.log}))
        return
    title = f"{asked.scenario.name}: how the vehicles answer (in brackets: as configured)"
    table = Table(title=title, title_justify="left")
    delay_ms = asked.scenario.control.delay_ticks * asked.control_us / 1000
    for column in ("vehicle", "bandwidth", "damping", "delay", "misfit", "hover thrust", "N made per N asked"):
        table.add_column(column, justify="right")
    for i, r in enumerate(found):
        table.add_row(
            str(i + 1), f"{r.bandwidth_rad_s:.1f} rad/s ({asked.airframe.bandwidth[i]:g})",
            f"{r.damping:.2f} ({asked.airframe.damping[i]:g})", f"{1e3 * r.delay_s:.0f} ms ({delay_ms:g})",
            f"{r.misfit_deg:.2f} deg", f"{100 * r.hover_share:.1f} %", f"{r.thrust_scale:.3f}",
        )  # fmt: skip
    console.print(table)
    console.print(f"log:      {summary.log}\nscenario: {target}  (cablequad fly {target})", soft_wrap=True)
