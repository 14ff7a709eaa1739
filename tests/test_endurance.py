"""The short form of what `.ci/run --full` does at length: hostile frames, and a long flight over a lossy link."""

from pathlib import Path
from typing import Any

import pytest
from fuzz import a_server, fuzz, hear, in_flight, state
from soak import soak
from strangers import strangers

from bridge.wire.frames import frame
from bridge.wire.messages import encode
from bridge.wire.signing_keys import write_key
from bridge.wire.values import Command, ParamSet

pytestmark = pytest.mark.alone


def test_twenty_thousand_hostile_frames_change_nothing_that_they_may_not(offset: int) -> None:
    figures = fuzz(20_000, 7, offset)
    assert figures["frames"] >= 20_000
    assert figures["refused"] > 0
    assert figures["bad"] > 0
    assert figures["memory_growth_MB"] < 20  # measured: 2 MB over a million


def test_the_harness_sees_what_a_valid_frame_changes(offset: int) -> None:
    """A harness that looks at nothing would pass everything."""
    import socket

    import numpy as np

    class Fixed:
        rng = np.random.default_rng(1)

    server = a_server(offset, None)
    in_flight(server)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    to = [server.link.ports[0].endpoint.bind]
    mode = (1.0, 4.0, 6.0, 0.0, 0.0, 0.0, 0.0)
    values: list[Any] = [Command(1, 1, 176, mode), ParamSet(1, 1, "MIS_TAKEOFF_ALT", 7.0, 9)]
    for value in values:
        before = state(server)
        hear(server, sender, to, [frame(encode(value), 0, 255, 190)], Fixed())  # type: ignore[arg-type]
        assert state(server) != before
    server.close()


def test_a_minute_under_five_percent_loss_loses_nothing_else(offset: int) -> None:
    """Every frame is accounted for on both sides, the clocks agree to the end, the flight arrives."""
    figures = soak(0.5, 0.05, offset)
    assert figures["down_lost"] > 1000
    assert figures["predicted_ticks"] > 1000
    assert figures["final_position_error_m"] < 0.01


def test_a_flight_among_strangers_who_send_every_kind_of_message_decides_the_same(offset: int) -> None:
    """Every message of the dialect and of others', from every kind of sender, to every port; bit for bit the same."""
    figures = strangers(0.25, offset)
    assert figures["kinds"] > 350
    assert figures["decisions_compared"] > 3000


def test_a_signed_mission_of_arducopters_among_strangers_without_a_key_decides_the_same(
    offset: int, tmp_path: Path
) -> None:
    key = tmp_path / "key"
    write_key(key)
    figures = strangers(0.0, offset, 2, "ground-to-ground", "--firmware", "arducopter", "--signing-key", str(key))
    assert figures["kinds"] > 350
    assert figures["decisions_compared"] > 2500
