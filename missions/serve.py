"""`cablequad sitl`: the vehicles alone, until they are told to stop."""

import math
import signal
import threading
from types import FrameType

from rich.console import Console
from rich.table import Table

from missions.scenario import Flight
from missions.simulate import settings
from sitl.plant import Truth
from sitl.server import Event, Server, endpoints


def serve(flight: Flight, speed: float, host: str, port_offset: int) -> None:
    """Serve until SIGINT or SIGTERM. Raises LinkError for an address that is taken, PhysicsError if motion diverges."""
    console = Console(highlight=False)
    stopped = threading.Event()

    def stop(_: int, __: FrameType | None) -> None:
        stopped.set()

    def sink(message: Truth | Event) -> None:
        if isinstance(message, Event):
            console.print(f"t = {message.boot_us * 1e-6:8.2f} s  {message.kind}: {message.text}")

    for note in flight.notes:
        console.print(note)
    lockstep = math.isinf(speed)
    server = Server(
        settings(flight, lockstep=lockstep, await_controller=False, speed=speed, port_offset=port_offset, host=host),
        sink,
    )
    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    console.print(_addresses(flight, host, port_offset))
    console.print(
        "lockstep with a controller 250/191 that answers every state; real time for everyone else"
        if lockstep
        else f"{speed:g} x real time"
    )
    try:
        report = server.run(stopped.is_set)
    finally:
        server.close()
    late = sorted(report.lateness_s)
    if late:
        p50, p99 = late[len(late) // 2], late[min(len(late) - 1, len(late) * 99 // 100)]
        console.print(
            f"stopped after {report.ticks} ticks; {report.missed_deadlines} deadlines missed, "
            f"ticks late by {p50 * 1e6:.0f} us (p50), {p99 * 1e6:.0f} us (p99), {late[-1] * 1e6:.0f} us (max)"
        )
    else:
        console.print(f"stopped after {report.ticks} ticks")


def _addresses(flight: Flight, host: str, offset: int) -> Table:
    n = len(flight.system.m)
    ends = endpoints(n, offset, host)
    table = Table(title=f"{flight.scenario.name}: {n} vehicles and a payload tracker", title_justify="left")
    for column in ("system", "component", "sends to", "listens on"):
        table.add_column(column)
    for i in range(n):
        table.add_row(str(i + 1), "1", _url(ends[i].peer), _url(ends[i].bind))
    table.add_row("200 (payload)", "191", _url(ends[2 * n + 1].peer), _url(ends[2 * n + 1].bind))
    table.add_row("all", "", f"{_url(ends[n].peer)} (ground station)", _url(ends[n].bind) + " ...")
    table.add_row("all", "", "whoever speaks", _url(ends[2 * n].bind))
    return table


def _url(address: tuple[str, int] | None) -> str:
    return "-" if address is None else f"{address[0]}:{address[1]}"
