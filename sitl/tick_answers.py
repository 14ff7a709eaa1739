"""Whom the vehicles' clock waits for in lockstep: the controller's answers to what was told at a tick."""


class TickAnswers:
    """Which vehicles' setpoints a tick waits for, and which have come."""

    def __init__(self, n: int, lockstep: bool, await_controller: bool, untethered: bool) -> None:
        """`await_controller`: from the first tick on, not only once a controller has answered.

        `untethered`: without a load nobody answers a tick as a whole.
        """
        waits = lockstep and await_controller
        self.controller_ports = list(range(n))  # on which the controller speaks to each vehicle
        self.missed = 0
        self._lockstep, self._untethered = lockstep, untethered
        self._engaged = [waits] * n
        self._answered_ms = [-1] * n
        self._expected = [False] * n  # of the coming tick: whose state goes to the controller
        self._awaited = [False] * n  # of this one
        self._awaits_controller = waits and not untethered
        self._seen_us = -1

    @property
    def engaged(self) -> bool:
        """Whether any answer is waited for."""
        return any(self._engaged)

    def begin(self) -> None:
        """What was expected of the coming tick is now awaited."""
        self._awaited = list(self._expected)

    def expect(self, i: int, ports: list[int]) -> None:
        """The state of vehicle i goes out on these ports at the coming tick."""
        self._expected[i] = self.controller_ports[i] in ports

    def take(self, i: int, port: int, boot_ms: int, now_us: int) -> None:
        """A setpoint for vehicle i that answers the state of `boot_ms`."""
        self._answered_ms[i] = boot_ms
        self.controller_ports[i] = port
        if self._lockstep and boot_ms * 1000 == now_us:
            self._engaged[i] = True
            self._awaits_controller = not self._untethered

    def dealt_with(self, now_us: int) -> None:
        """The controller has seen this tick and has nothing more to say to it."""
        self._seen_us = now_us

    def missing(self, now_us: int) -> list[int] | None:
        """Vehicles without an answer; empty where only the controller as a whole is awaited, None where nobody is."""
        now_ms = now_us // 1000
        vehicles = range(len(self._engaged))
        missing = [i for i in vehicles if self._engaged[i] and self._awaited[i] and self._answered_ms[i] != now_ms]
        quiet = self._awaits_controller and not any(self._awaited)  # nobody told the controller its state
        answered = any(self._answered_ms[i] == now_ms for i in vehicles)
        if self._seen_us == now_us or not (missing or (quiet and not answered)):
            return None
        return missing

    def give_up(self, missing: list[int]) -> None:
        """These are waited for no more until they answer again."""
        self.missed += len(missing)
        for i in missing:
            self._engaged[i] = False
        self._awaits_controller = False
