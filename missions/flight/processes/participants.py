"""Whoever takes part in a flight beside the control loop: its link, log, simulator, autopilots and viewer."""

import contextlib
import gc
import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from bridge.fleet.fleet import TRACKER
from bridge.wire.frames import Signer
from bridge.wire.link import Address, Endpoint, Link
from bridge.wire.memory import MemoryNetwork
from bridge.wire.ports import TRACKER_PORTS, vehicle_ports
from missions.flight.options import Options, Progress
from missions.flight.processes.in_process import InProcessLog, InProcessSimulator
from missions.flight.processes.launch import Autopilots, Launch, start_lines
from missions.flight.processes.live_viewer import Show
from missions.flight.processes.simulate import Serving, Simulator, pin, settings
from missions.flight.recording.log_process import LogProcess
from missions.scenario.flights import Flight
from sitl.settings import HOST

SWITCH_S = 0.0005  # the writer thread gives the interpreter back to the control loop this often


class Participants:
    """What is started for a flight, and stopped after it, whatever happens."""

    def __init__(self, flight: Flight, options: Options) -> None:
        """Raises LinkError where a port is taken, ScenarioError where the backend cannot fly the scenario."""
        self.external = options.backend != "builtin"
        self.asks = self.external or bool(options.connect)  # vehicles may have clocks of their own
        self.lockstep = math.isinf(options.speed) and not self.asks
        self.simulator: Simulator | InProcessSimulator | None = None
        self._show: Show | None = None
        self._autopilots: Autopilots | None = None
        key = options.signing_key
        epoch_s = flight.scenario.epoch_s if self.lockstep else None
        signer = Signer(key, options.accept_unsigned_telemetry, epoch_s) if key is not None else None
        network = MemoryNetwork() if options.in_process else None
        self.link = Link(endpoints(len(flight.system.m), options), signer, network)
        self.link.reliable = self.lockstep and network is None
        try:
            self.log = LogProcess() if network is None else InProcessLog()
        except BaseException:
            self.link.close()
            raise
        try:
            if not options.connect:
                self._simulate(flight, options, network)
        except BaseException:
            self.close()
            raise

    def _simulate(self, flight: Flight, options: Options, network: MemoryNetwork | None) -> None:
        serving = Serving(
            lockstep=self.lockstep, await_controller=True, speed=options.speed, backend=options.backend,
            port_offset=options.port_offset, signing_key=options.signing_key,
            accept_unsigned_telemetry=options.accept_unsigned_telemetry, stall_s=options.stall_timeout_s,
        )  # fmt: skip
        if isinstance(self.log, LogProcess):
            self.simulator = Simulator(settings(flight, serving), self.log.truth_end)
        elif network is not None:
            self.simulator = InProcessSimulator(settings(flight, serving), self.log.truth_end, network)
            self.link.go_on = self.simulator.go_on

    def show(self, log: Path) -> None:
        """Show the log in the viewer that is open as it is written."""
        self._show = Show(log)

    def start_autopilots(self, starts: list[Launch], folder: Path, launch: bool, progress: Progress) -> None:
        """Start them, or tell the user how."""
        if launch:
            self._autopilots = Autopilots(starts, folder)
            return
        progress.say("start the autopilots:")
        for line in start_lines(starts, folder):
            progress.say(f"  {line}")

    def share_processors(self) -> None:
        """Let processes beside this one have their turns; in lockstep with them it stays on a processor, as they do."""
        if isinstance(self.simulator, Simulator):
            sys.setswitchinterval(SWITCH_S)
            if self.lockstep:
                pin(-2)

    def autopilot_ended(self) -> str | None:
        """Which autopilot of ours has ended by itself."""
        return None if self._autopilots is None else self._autopilots.ended()

    def alive(self) -> bool:
        """Whether there is still anybody to be flown."""
        return self.simulator is None or self.simulator.failure is None

    def stop_simulator(self) -> int:
        """End the simulator; how many frames were still on their way."""
        if self.simulator is None:
            return 0
        self.simulator.stop()
        left = 0
        while after := self.link.poll(0.0):
            left += len(after)
        return left

    def close(self) -> None:
        """Stop and close everything."""
        if self.simulator is not None:
            self.simulator.stop()
        self.log.close()
        if self._show is not None:
            self._show.close()
        if self._autopilots is not None:
            self._autopilots.stop()
        self.link.close()


@contextlib.contextmanager
def interpreter_restored() -> Iterator[None]:
    """What a control loop changes of Python and of its processors is as before afterwards."""
    processors = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    switch, thresholds = sys.getswitchinterval(), gc.get_threshold()
    try:
        yield
    finally:
        sys.setswitchinterval(switch)
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, processors)
        gc.set_threshold(*thresholds)
        gc.unfreeze()


def endpoints(n: int, options: Options) -> list[Endpoint]:
    """Where the controller listens: what is connected to, or where n vehicles and their tracker send."""
    if options.connect:
        return list(options.connect)
    ports = [*(vehicle_ports(i)[0] for i in range(n)), TRACKER_PORTS[0]]
    return [Endpoint((HOST, port + options.port_offset), None) for port in ports]


def places(n: int, port_offset: int) -> dict[int, tuple[int, Address]]:
    """On which of our ports, and from where, our own vehicles and their tracker speak."""
    ports = [*(vehicle_ports(i)[1] for i in range(n)), TRACKER_PORTS[1]]
    systems = [*range(1, n + 1), TRACKER]
    return {who: (k, (HOST, port + port_offset)) for k, (who, port) in enumerate(zip(systems, ports, strict=True))}
