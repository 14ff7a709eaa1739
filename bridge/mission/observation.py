"""What a mission knows of one instant: the state as it is put together, and what vehicles say of themselves."""

from typing import NamedTuple

from bridge.mission.members.fleet_subset import state_of
from cablequad.control.design import Design
from cablequad.model.state import State
from cablequad.types import Array


class Observation(NamedTuple):
    """Of those that are not lost."""

    state: State
    tension: Array  # (n,) N, of the links at the load; NaN where nobody tells
    age_s: float  # of the newest measurement that the oldest part of the state rests on
    x: Array  # (n, 3) m, W: where vehicles say they are, carried on at the speed they say; NaN before the first word
    v: Array  # (n, 3) m/s, W
    x_age_s: Array  # (n,) s, how old that word is

    def of(self, rest: list[int], design: Design) -> "Observation":
        """What is known of some of them, for whom `design` is."""
        return Observation(
            state_of(self.state, rest, design), self.tension[rest], self.age_s, self.x[rest], self.v[rest],
            self.x_age_s[rest],
        )  # fmt: skip
