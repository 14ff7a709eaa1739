"""The `cablequad` command. Heavy imports stand inside the commands, so that help is quick."""

import io
import json
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from logs.reading.extras import missing
from missions.cli.before_flight import check, identify, margins, preflight
from missions.cli.exits import FAILED, INTERRUPTED, UNTESTED, USAGE, fail, untested, usage
from missions.cli.interrupts import interruptible, say_interrupted
from missions.cli.log_commands import log_app, report
from missions.cli.options import (
    ArmOption,
    BackendOption,
    ConnectOption,
    FirmwareOption,
    FreePortOffset,
    JsonOption,
    KeyOption,
    LaunchOption,
    PortOffset,
    ScenarioArgument,
    SpeedOption,
    UnsignedOption,
    backend,
    endpoints,
    load,
    refuse,
)
from missions.cli.replay_command import replay
from missions.cli.streams import unbroken

if TYPE_CHECKING:
    from missions.flight.summary import Summary
    from missions.scenario.flights import Flight

app = typer.Typer(
    name="cablequad",
    help="Simulate and fly several quadrotors under one load on flexible cables, over MAVLink.",
    no_args_is_help=True,
    rich_markup_mode="markdown",  # rich markup would take [plan] for a style, and leave it out
    pretty_exceptions_enable=False,
)
scenarios_app = typer.Typer(
    help="List the shipped scenarios, or show one as a starting point.", rich_markup_mode="markdown"
)
app.add_typer(scenarios_app, name="scenarios")
app.add_typer(log_app, name="log")


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"cablequad {version('cablequad')}")
        raise typer.Exit


@app.callback()
def cablequad(
    version: Annotated[
        bool, typer.Option("--version", help="Say which version this is.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Simulate and fly several quadrotors under one load on flexible cables, over MAVLink."""
    del version


@app.command()
def fly(
    scenario: ScenarioArgument = "paper-case-1",
    connect: ConnectOption = None,
    script: Annotated[
        Path | None,
        typer.Option(help="A Python file whose mission(course) says where the load goes, instead of [plan]."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the log and the replay.")] = Path("runs"),
    speed: Annotated[
        str | None,
        typer.Option(
            help="max: lockstep, as fast as the machine allows (the default); X: X times real time, without waiting "
            "(1 is the default with autopilots of their own)."
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds to fly, instead of the scenario's.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the scenario's.", min=0)] = None,
    replay: Annotated[bool, typer.Option(help="Write the replay (.rrd) beside the log.")] = True,
    live: Annotated[
        bool,
        typer.Option("--live", help="Show the flight in the Rerun viewer that is open on this machine (start: rerun)."),
    ] = False,
    as_json: JsonOption = False,
    port_offset: FreePortOffset = None,
    firmware: FirmwareOption = None,
    arm: ArmOption = False,
    configure: Annotated[
        bool,
        typer.Option(help="Set the parameters that a vehicle needs to be flown (with --connect it is only asked)."),
    ] = False,
    signing_key: KeyOption = None,
    accept_unsigned: UnsignedOption = False,
    backend_name: BackendOption = "builtin",
    launch: LaunchOption = None,
    in_process: Annotated[
        bool,
        typer.Option(
            "--in-process",
            help="Vehicles, controller and log in one process, joined in memory: the same log, sooner.",
        ),
    ] = False,
    stall_timeout: Annotated[
        float, typer.Option(help="Seconds of wall clock that a simulator in lockstep may stand still.", min=1.0)
    ] = 600.0,
) -> None:
    """Fly a scenario over MAVLink: start the vehicles (or connect to what is there), fly the plan, record, report.

    Exit code 0 if the scenario's acceptance criteria hold, 1 if not, 2 for usage, 3 if the computer could not carry it
    out, 130 after Ctrl-C.
    """
    from bridge.wire.link import LinkError
    from bridge.wire.signing_keys import KeyFileError, read_key
    from missions.flight.run import Options, run
    from missions.flight.terminal import progress
    from missions.scenario.flights import ScenarioError

    who = backend(backend_name, firmware, launch)
    pace = _speed(speed or ("max" if who == "builtin" else "1"))
    if in_process and (connect or who != "builtin" or live or not math.isinf(pace)):
        usage("--in-process flies built-in vehicles at full speed; leave out --connect, --backend, --live, --speed")
    if connect and who != "builtin":
        usage("--backend starts our physics; with --connect it runs already")
    if live:
        from logs.views.live import VIEWER, reachable

        if not reachable():
            usage("--live: no viewer listens on {}:{}; start one with: rerun".format(*VIEWER))
    if connect and speed not in (None, "max"):
        usage("--speed sets the pace of our own simulator; with --connect the vehicles set it")
    if duration is not None and not (math.isfinite(duration) and duration > 0):
        usage(f"--duration: {duration} given; seconds above 0 are needed")
    try:
        flight = load(scenario, duration, seed, firmware, script, backend=who, connected=bool(connect))
        refuse(flight, as_json)
        key = None if signing_key is None else read_key(signing_key)
        ends = endpoints(connect, arm)
        options = Options(
            ends,
            out,
            pace,
            _offset(flight, port_offset, who == "builtin" and not ends and not in_process),
            configure or not ends,
            key,
            accept_unsigned,
            live,
            who,
            launch,
            in_process,
            stall_timeout,
        )
        with progress() as told:
            summary, interrupted = run(flight, options, told)
    except (ScenarioError, LinkError, KeyFileError) as error:
        usage(str(error))
    if replay and summary.log is not None and summary.flown_s > 0.0:
        summary = _write_replay(summary)
    if as_json:
        print(json.dumps(summary._asdict()))
    elif summary.log is not None and summary.flown_s > 0.0:
        _report(summary)
    if interrupted:
        raise typer.Exit(INTERRUPTED)
    if not summary.passed:
        kept = "" if summary.flown_s > 0.0 or summary.log is None else f" (log: {summary.log})"
        untold = not summary.tested and not summary.reason.startswith("not tested")
        print(f"cablequad: {summary.scenario}: {'not tested: ' * untold}{summary.reason}{kept}", file=sys.stderr)
        raise typer.Exit(FAILED if summary.tested else UNTESTED)


@app.command()
def sitl(
    scenario: ScenarioArgument = "paper-case-1",
    speed: SpeedOption = "1",
    host: Annotated[str, typer.Option(help="Address to bind and to send to.")] = "127.0.0.1",
    port_offset: PortOffset = 0,
    firmware: FirmwareOption = None,
    with_load: Annotated[
        bool, typer.Option("--load/--no-load", help="The load and its cables; --no-load: vehicles on the ground alone.")
    ] = True,
    signing_key: KeyOption = None,
    accept_unsigned: UnsignedOption = False,
    faults: Annotated[
        bool,
        typer.Option(
            "--faults", help="Let [faults] act on what the vehicles send as well, for clients other than fly."
        ),
    ] = False,
    backend_name: BackendOption = "builtin",
    launch: LaunchOption = None,
) -> None:
    """Serve the scenario's vehicles and payload tracker until Ctrl-C."""
    from bridge.wire.link import LinkError
    from bridge.wire.signing_keys import KeyFileError, read_key
    from missions.flight.processes.simulate import Serving
    from missions.flight.serve import serve
    from missions.scenario.flights import ScenarioError
    from sitl.external.seats import AutopilotError
    from sitl.plant import PhysicsError

    who = backend(backend_name, firmware, launch)
    if who != "builtin" and (not with_load or faults):
        usage("--no-load and --faults are for our own vehicles; leave them out with --backend")
    pace = _speed(speed)
    if faults and math.isinf(pace):
        usage("--faults loses what the vehicles send, on which --speed max would wait for ever; give a --speed")
    try:
        flight = load(scenario, None, None, firmware)
        key = None if signing_key is None else read_key(signing_key)
        serving = Serving(
            lockstep=math.isinf(pace) and who == "builtin", speed=pace, port_offset=port_offset, host=host,
            untethered=not with_load,
            signing_key=key, accept_unsigned_telemetry=accept_unsigned, faults_at_sender=faults, backend=who,
        )  # fmt: skip
        serve(flight, serving, launch)
    except (ScenarioError, KeyFileError) as error:
        usage(str(error))
    except LinkError as error:
        untested(str(error))
    except (PhysicsError, AutopilotError) as error:
        fail(str(error))


@app.command()
def tell(
    word: Annotated[str, typer.Argument(help="pause, resume or abort (set down here, land, disarm).")],
    host: Annotated[str, typer.Option(help="Where the controller listens.")] = "127.0.0.1",
    port_offset: PortOffset = 0,
    signing_key: KeyOption = None,
) -> None:
    """Tell a mission that is being flown to pause, to go on, or to come down."""
    from bridge.wire.link import LinkError
    from bridge.wire.signing_keys import KeyFileError, read_key
    from missions.flight import operator as operator

    if word not in operator.WORDS:
        usage(f"{word!r} given; tell pause, resume or abort")
    try:
        key = None if signing_key is None else read_key(signing_key)
        refused = operator.tell(word, host, port_offset, key)
    except (LinkError, KeyFileError) as error:
        usage(str(error))
    if refused:
        fail(f"{word}: {refused}")
    print(f"{word}: obeyed")


@app.command("warm-up")
def warm_up() -> None:
    """Compile the model, the controller and the log's writer once, on all cores; the first command does so as well."""
    from missions.flight.compiled import compile_all
    from missions.flight.terminal import telling

    begun = time.monotonic()
    with telling("warm-up") as tell:
        whole = compile_all(tell)
    if not whole:
        fail("warm-up: a process that compiles ended early; is there memory and room on the disk? Try it again")
    print(f"compiled in {time.monotonic() - begun:.0f} s")


@app.command("signing-key")
def signing_key(file: Annotated[Path, typer.Argument(help="The new file; only you may read it.")]) -> None:
    """Make a key for MAVLink 2 signing."""
    from bridge.wire.signing_keys import KeyFileError, write_key

    try:
        write_key(file)
    except KeyFileError as error:
        usage(str(error))
    print(file)


for command in (replay, check, margins, preflight, identify, report):
    app.command()(command)


@scenarios_app.callback(invoke_without_command=True)
def scenarios(context: typer.Context) -> None:
    """List the shipped scenarios."""
    if context.invoked_subcommand is None:
        from missions.scenario.loading import names, parse, text

        for name in names():
            typer.echo(f"{name:24} {parse(text(name), name).description}")


@scenarios_app.command("show")
def show(name: ScenarioArgument) -> None:
    """Print a scenario's file."""
    from missions.scenario.flights import ScenarioError
    from missions.scenario.loading import text

    try:
        typer.echo(text(name), nl=False)
    except ScenarioError as error:
        usage(str(error))


def main() -> None:
    """Entry point of the `cablequad` command."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a path may have letters that a terminal has not
            stream.reconfigure(errors="backslashreplace")
    with interruptible() as interrupted:
        unbroken()
        try:
            app()
        except KeyboardInterrupt:
            pass
        except Exception as error:
            if not interrupted:  # else a library that it met has made an error of its own of it
                said = missing(error) if isinstance(error, ImportError) else None
                if said is None:
                    raise
                print(f"cablequad: {said}", file=sys.stderr)
                sys.exit(USAGE)
    say_interrupted()
    sys.exit(INTERRUPTED)


def _offset(flight: "Flight", asked: int | None, simulated: bool) -> int:
    """Of the ports: what is asked for, or the first that is free for a flight that is simulated."""
    if asked is not None or not simulated:
        return asked or 0
    from missions.flight.processes.free_ports import free_offset

    found = free_offset(flight)
    if found:
        print(f"cablequad: ports are in use; --port-offset {found} is taken", file=sys.stderr)
    return found


def _speed(text: str) -> float:
    if text == "max":
        return math.inf
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        usage(f"--speed: {text!r} given; write max or a factor above 0, such as 1")
    return value


def _report(summary: "Summary") -> None:
    from missions.flight.terminal import table

    table(summary)


def _write_replay(summary: "Summary") -> "Summary":
    from logs.reading.reader import LogError, read
    from logs.views import replay as replays

    log = Path(summary.log or "")
    target = log.with_name(log.name.removesuffix(".part")).with_suffix(".rrd")
    try:
        replays.save(read(log), target)
    except (LogError, OSError) as error:
        print(f"cablequad: no replay: {error}", file=sys.stderr)
        return summary
    return summary._replace(replay=str(target))


if __name__ == "__main__":
    main()
