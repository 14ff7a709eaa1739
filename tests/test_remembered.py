"""A design is made once in a process, and no flight can spoil it for the next."""

import numpy as np
import pytest

from cablequad.control.law import LAWS
from cablequad.model.system import System
from missions.scenario import laws, remembered
from missions.scenario.loading import load
from missions.scenario.remembered import remembered as once


def test_equal_arguments_are_computed_once_and_everybody_has_a_copy() -> None:
    computed: list[System] = []

    @once
    def masses(_: object, system: System, times: float) -> np.ndarray:
        computed.append(system)
        return times * system.m

    a = masses(None, System.paper(1), 2.0)
    a[:] = 0.0
    assert masses(None, System.paper(1), 2.0).tolist() == (2.0 * System.paper(1).m).tolist()
    assert len(computed) == 1
    masses(None, System.paper(1), 3.0)
    masses(None, System.paper(2), 2.0)
    heavier = System.paper(1)
    heavier.m[2] = np.nextafter(heavier.m[2], 2.0)  # the last bit counts
    masses(None, heavier, 2.0)
    assert len(computed) == 4


def test_errors_are_not_kept_and_old_values_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remembered, "KEPT", 2)
    computed: list[int] = []

    @once
    def inverse(_: object, value: int) -> float:
        computed.append(value)
        return 1 / value

    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            inverse(None, 0)
    for value in (1, 2, 1, 3, 1, 2):
        inverse(None, value)
    assert computed == [0, 0, 1, 2, 3, 2]


def test_another_law_of_the_same_name_designs_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = load("paper-case-1")
    ours = laws.design(flight)
    monkeypatch.setitem(LAWS, "sampled", LAWS["paper"])
    assert laws.design(flight).K_x.tolist() != ours.K_x.tolist()
    monkeypatch.undo()
    assert laws.design(flight).K_x.tolist() == ours.K_x.tolist()


def test_a_design_is_the_same_bit_by_bit_when_it_is_taken_again() -> None:
    flight = load("paper-case-1")
    first, again = laws.design(flight), laws.design(flight)
    fresh = laws.law_of(flight).design(flight.system, laws.designed_for(flight, flight.airframe))
    for name in ("K_x", "K_xdot", "K_phi", "K_pending", "K_integral", "u_star"):
        one, other, made = (np.asarray(getattr(d, name)) for d in (first, again, fresh))
        assert one.tobytes() == other.tobytes() == made.tobytes(), name
        assert one is not other
