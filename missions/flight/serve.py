"""`cablequad sitl`: the vehicles alone, until they are told to stop."""

import signal
import sys
import threading
from pathlib import Path
from types import FrameType

from rich.console import Console
from rich.table import Table

from bridge.wire.ports import vehicle_ports
from missions.flight.processes.launch import Autopilots, launches, start_lines
from missions.flight.processes.simulate import Serving, kinds, server_of, settings
from missions.flight.terminal import telling
from missions.scenario.flights import Flight
from sitl.addresses import places, tracker_endpoints
from sitl.external.ardupilot import ARDUPILOT_PORT
from sitl.external.px4 import PX4_PORT
from sitl.settings import Event, Report, ServerOutput

FOLDER = Path("autopilots")  # where they work


def serve(flight: Flight, serving: Serving, launch: Path | None = None) -> None:
    """Serve until SIGINT or SIGTERM; autopilots of their own are started where `launch` says, else their commands told.

    Raises ScenarioError for autopilots that cannot be started, AutopilotError where one is missing, LinkError for
    an address that is taken, ValueError for a parameter that a vehicle does not have, PhysicsError
    if motion diverges.
    """
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 120)
    stopped = threading.Event()

    def stop(_: int, __: FrameType | None) -> None:
        stopped.set()

    def sink(message: ServerOutput) -> None:
        if isinstance(message, Event):
            console.print(f"t = {message.boot_us * 1e-6:8.2f} s  {message.kind}: {message.text}")

    for note in flight.notes:
        console.print(note)
    with telling(flight.scenario.name) as tell:
        tell("getting ready")
        server = server_of(settings(flight, serving), sink)
    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    console.print(_addresses(flight, serving) if serving.backend == "builtin" else _seats(flight, serving))
    console.print(
        "lockstep with a controller 250/191 that answers every state; real time for everyone else"
        if serving.lockstep
        else f"{serving.speed:g} x real time"
    )
    autopilots: Autopilots | None = None
    try:
        if serving.backend != "builtin":
            autopilots = _start(console, flight, serving, launch)
        report = server.run(stopped.is_set)
    finally:
        server.close()
        if autopilots is not None:
            autopilots.stop()
    _tell_report(console, report)


def _start(console: Console, flight: Flight, serving: Serving, launch: Path | None) -> Autopilots | None:
    """Start the autopilots where `launch` says, or tell how each is started."""
    starts = launches(flight, serving.backend, launch, serving.port_offset, serving.host, serving.speed)
    if launch is not None:
        autopilots = Autopilots(starts, FOLDER)
        console.print(f"{len(starts)} autopilots started, in {FOLDER}")
        return autopilots
    console.print("start the autopilots:")
    for line in start_lines(starts, FOLDER):
        console.print(f"  {line}", soft_wrap=True)
    return None


def _tell_report(console: Console, report: Report) -> None:
    """How time was kept, and what was made nothing of."""
    if refused := ", ".join(f"{count} {why}" for why, count in report.refused.items() if count):
        console.print(f"frames left out: {refused}")
    if failed := ", ".join(f"{count} {name}" for name, count in report.mishandled.items()):
        console.print(f"frames that could not be handled: {failed}")
    late = sorted(report.lateness_s)
    if late:
        p50, p99 = late[len(late) // 2], late[min(len(late) - 1, len(late) * 99 // 100)]
        console.print(
            f"stopped after {report.ticks} ticks; {report.missed_deadlines} deadlines missed, "
            f"ticks late by {p50 * 1e6:.0f} us (p50), {p99 * 1e6:.0f} us (p99), {late[-1] * 1e6:.0f} us (max)"
        )
    else:
        console.print(f"stopped after {report.ticks} ticks")


def _addresses(flight: Flight, serving: Serving) -> Table:
    offset, host = serving.port_offset, serving.host
    n = len(flight.firmware)
    what = "vehicles on the ground, no load" if serving.untethered else "vehicles and a payload tracker"
    table = Table(title=f"{flight.scenario.name}: {n} {what}", title_justify="left")
    for column in ("system", "component", "firmware", "link", "sends to", "listens on"):
        table.add_column(column)
    for place in places(flight.firmware, offset, host):
        who = "all" if place.vehicle is None else str(place.vehicle + 1)
        firmware = "" if place.vehicle is None else flight.firmware[place.vehicle]
        kind = "tcp" if place.endpoint.stream else "udp"
        to = _url(place.endpoint.peer) if place.endpoint.peer else "whoever speaks"
        table.add_row(who, "1", firmware, f"{place.kind.name.lower()}, {kind}", to, _url(place.endpoint.bind))
    if not serving.untethered:
        for end in tracker_endpoints(offset, host):
            table.add_row("200 (payload)", "191", "", "tracker, udp", _url(end.peer), _url(end.bind))
    return table


def _seats(flight: Flight, serving: Serving) -> Table:
    offset, host = serving.port_offset, serving.host
    table = Table(title=f"{flight.scenario.name}: physics for {len(flight.firmware)} autopilots", title_justify="left")
    for column in ("system", "autopilot", "physics here", "MAVLink to"):
        table.add_column(column)
    for i, kind in enumerate(kinds(flight, serving.backend)):
        here = (
            f"udp {host}:{ARDUPILOT_PORT + offset + 10 * i}"
            if kind == "arducopter"
            else f"tcp {host}:{PX4_PORT + offset + i}"
        )
        table.add_row(str(i + 1), kind, here, f"udp {host}:{vehicle_ports(i)[0] + offset}")
    end = tracker_endpoints(offset, host)[0]
    table.add_row("200", "payload tracker", f"udp {_url(end.bind)}", f"udp {_url(end.peer)}")
    return table


def _url(address: tuple[str, int] | None) -> str:
    return "-" if address is None else f"{address[0]}:{address[1]}"
