"""The plan's own clock: it stops while somebody wants it to, and runs down and up again smoothly."""

PAUSE_S = 2.0  # from running to standing: who is out of touch holds its last command, the others must not pull at it


class PlanClock:
    """Time in a phase of a mission, s."""

    def __init__(self, period_s: float) -> None:
        self.time = 0.0  # s since the phase began, less what it stood
        self.rate = 1.0
        self._period = period_s
        self._stopped_by: set[str] = set()

    @property
    def stopped(self) -> bool:
        """Whether anybody wants it to stand."""
        return bool(self._stopped_by)

    def stop(self, who: str) -> bool:
        """Stand as long as `who` wants; whether it ran before."""
        ran = not self._stopped_by
        self._stopped_by.add(who)
        return ran

    def go(self, who: str) -> bool:
        """`who` does not want it to stand any more; whether it runs again by that."""
        if who not in self._stopped_by:
            return False
        self._stopped_by.discard(who)
        return not self._stopped_by

    def run(self) -> None:
        """Nobody stops it."""
        self._stopped_by.clear()

    def tick(self) -> float:
        """A period passes; how much of it (s) the clock did not run."""
        before = self.rate
        self.time += before * self._period
        goal, step = 0.0 if self.stopped else 1.0, self._period / PAUSE_S
        self.rate = min(max(goal, before - step), before + step)
        return (1.0 - before) * self._period
