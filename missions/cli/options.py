"""What several commands have in common: their options, and how a scenario is loaded."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from missions.cli.exits import fail, usage

if TYPE_CHECKING:
    from bridge.wire.ports import Endpoint
    from missions.flight.processes.simulate import Backend
    from missions.scenario.flights import Flight

FreePortOffset = Annotated[
    int | None,
    typer.Option(
        help="Added to every UDP port; flights 200 apart share none, up to 3600. Where it is not given, a simulated "
        "flight takes the first that is free.",
        min=0,
        max=40000,
    ),
]
ScenarioArgument = Annotated[
    str, typer.Argument(help="A shipped scenario's name, the path of a TOML file, or of a script (.py).")
]
PortOffset = Annotated[
    int,
    typer.Option(
        help="Added to every UDP port, so that several can run at once: 200 apart, up to 3600.", min=0, max=40000
    ),
]
SpeedOption = Annotated[
    str, typer.Option(help="max: lockstep, as fast as the machine allows; X: X times real time, without waiting.")
]
FirmwareOption = Annotated[
    str | None,
    typer.Option(
        help="px4 or arducopter, for every vehicle, instead of what the scenario says; auto: whatever they are, by "
        "their heartbeats (with --backend or --connect)."
    ),
]
BackendOption = Annotated[
    str,
    typer.Option(
        "--backend",
        help="Who flies: builtin (our vehicles), ardupilot or px4 (our physics behind real autopilots), mixed (each "
        "vehicle's firmware in the scenario).",
    ),
]
LaunchOption = Annotated[
    Path | None,
    typer.Option(
        help="Start the autopilots too: the arducopter binary, PX4's build folder, or with mixed a folder with both. "
        "Without it their command lines are printed."
    ),
]
ConnectOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Fly what is there, start no simulator: udpin:HOST:PORT or udpout:HOST:PORT, one per vehicle and one for "
        "the payload tracker."
    ),
]
ArmOption = Annotated[
    bool,
    typer.Option("--arm", help="Yes: arm vehicles that are connected from beyond this machine; nobody is near them."),
]
KeyOption = Annotated[
    Path | None, typer.Option(help="Sign with the key in this file, and obey nothing that is not signed with it.")
]
UnsignedOption = Annotated[
    bool, typer.Option("--accept-unsigned-telemetry", help="With a key: take unsigned messages that ask for nothing.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, nothing else.")]


def load(
    scenario: str,
    duration: float | None,
    seed: int | None,
    firmware: str | None = None,
    script: Path | None = None,
    backend: "Backend" = "builtin",
    connected: bool = False,
) -> "Flight":
    """A scenario with what the command line says instead, as `backend` flies it or what is `connected`.

    Raises ScenarioError; an unknown firmware ends as usage.
    """
    from missions.scenario.loading import load as read
    from missions.scenario.tables import Firmware

    if firmware not in (None, "auto", *get_args(Firmware)):
        usage(f"--firmware: {firmware!r} given; write {', '.join(get_args(Firmware))} or auto")
    external = backend != "builtin"
    flight = read(scenario, duration, seed, None if firmware == "auto" else firmware, script, external or connected)
    compiled()
    if not external:
        return flight
    from missions.flight.processes.simulate import kinds
    from missions.scenario.autopilots import behind

    return behind(flight, kinds(flight, backend))


def compiled() -> None:
    """Before the first command that needs it: all that is compiled."""
    from cablequad._jit import all_kept

    if not all_kept():
        from missions.flight.compiled import ensure

        ensure()


def backend(name: str, firmware: str | None, launch: Path | None) -> "Backend":
    """The backend that is asked for; ends as usage where there is no such thing, or it contradicts the rest."""
    from missions.flight.processes.simulate import BACKENDS, KINDS

    if name not in BACKENDS:
        usage(f"--backend: {name!r} given; write {', '.join(BACKENDS[:-1])} or {BACKENDS[-1]}")
    if name == "builtin" and launch is not None:
        usage("--launch starts autopilots; say which with --backend ardupilot, px4 or mixed")
    if name in KINDS and firmware not in (None, "auto", KINDS[name]):
        usage(f"--firmware {firmware} contradicts --backend {name}; leave it out, or write auto")
    return name


def refuse(flight: "Flight", as_json: bool) -> None:
    """End as a failure, with one line, where a flight cannot be flown as it is described."""
    import json

    from missions.scenario.feasibility import obstacles

    found = obstacles(flight)
    if not found:
        return
    reason = f"cannot fly: {'; '.join(found)}"
    if as_json:
        print(json.dumps({"scenario": flight.scenario.name, "passed": False, "reason": reason, "cannot_fly": found}))
    fail(f"{flight.scenario.name}: {reason}")


def endpoints(urls: list[str] | None, arm: bool) -> "tuple[Endpoint, ...]":
    """Where `--connect` finds vehicles and tracker; from beyond this machine only with an explicit yes to arm them.

    Raises LinkError where an address cannot be read.
    """
    from bridge.wire.ports import Endpoint

    out = tuple(Endpoint.parse(url) for url in urls or ())
    for url, end in zip(urls or (), out, strict=True):
        if not arm and not end.local:
            usage(f"--connect {url}: vehicles from beyond this machine are armed by this command; say yes with --arm")
    return out
