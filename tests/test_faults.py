"""Links that fail: what the channel does to frames, by the numbers it was given."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.wire.link_faults import Channel, Faults, generator

TICK = 4000


def sent_through(
    faults: Faults, frames: int = 5000, seed: int = 1, size: int = 50
) -> tuple[Channel[int], list[tuple[int, int]]]:
    """One frame a tick; what came out, as (frame, tick it came at)."""
    channel: Channel[int] = Channel(faults, generator(seed, 1, up=True))
    out = []
    for k in range(frames):
        channel.put(k, size, k * TICK)
        out += [(frame, k) for frame in channel.take(k * TICK)]
    return channel, out


@given(
    st.floats(0, 0.9), st.floats(0, 0.9), st.floats(0, 0.5), st.floats(0, 0.5), st.integers(0, 30_000),
    st.floats(0, 50_000), st.integers(0, 2**31),
)  # fmt: skip
def test_every_frame_is_accounted_for(
    loss: float, burst: float, duplicate: float, reorder: float, jitter: int, rate: float, seed: int
) -> None:
    """offered + duplicated = passed + lost + waiting, whatever fails."""
    faults = Faults(1000, jitter, loss, burst, 5.0, duplicate, reorder, rate)
    channel, out = sent_through(faults, 300, seed)
    t = channel.tally
    assert t.offered == 300
    assert t.offered + t.duplicated == t.passed + t.lost + t.waiting
    assert len(out) == t.passed


def test_a_line_of_next_to_no_bytes_a_second_carries_nothing() -> None:
    channel, out = sent_through(Faults(rate_bytes_s=2e-313), 300, 0)
    assert out == []
    assert channel.tally.waiting + channel.tally.lost == 300


def test_without_faults_everything_passes_at_once_in_its_order() -> None:
    _, out = sent_through(Faults())
    assert out == [(k, k) for k in range(5000)]
    assert Faults().none
    assert not Faults(loss=0.1).none


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_loss_takes_its_share(share: float) -> None:
    channel, _ = sent_through(Faults(loss=share))
    assert channel.tally.lost / 5000 == pytest.approx(share, abs=3 * (share * (1 - share) / 5000) ** 0.5)


def test_bursts_have_their_share_and_their_length() -> None:
    channel, out = sent_through(Faults(burst_loss=0.2, burst_frames=8.0), 100_000)
    assert channel.tally.lost / 100_000 == pytest.approx(0.2, abs=0.02)
    gaps = np.diff([frame for frame, _ in out]) - 1
    assert gaps[gaps > 0].mean() == pytest.approx(8.0, rel=0.1)


def test_delay_and_jitter_stay_between_their_bounds() -> None:
    _, out = sent_through(Faults(delay_us=8000, jitter_us=10_000))
    ticks = np.array([at - frame for frame, at in out])
    assert ticks.min() == 3  # 8 ms and some, on a clock of 4
    assert ticks.max() == 5
    assert any(a > b for (a, _), (b, _) in pairwise(out))  # independent, so they overtake


def test_reordered_frames_are_overtaken_by_what_comes_after() -> None:
    _, out = sent_through(Faults(reorder=0.1))
    late = sum(at - frame == 5 for frame, at in out)
    assert late / 5000 == pytest.approx(0.1, abs=0.02)


def test_duplicates_come_twice() -> None:
    channel, out = sent_through(Faults(duplicate=0.25))
    assert channel.tally.duplicated / 5000 == pytest.approx(0.25, abs=0.02)
    assert len(out) == 5000 + channel.tally.duplicated


def test_a_narrow_line_passes_its_rate_and_loses_what_its_queue_does_not_hold() -> None:
    channel, out = sent_through(Faults(rate_bytes_s=6250.0))  # half of 50 bytes at 250 Hz
    assert len(out) / 5000 == pytest.approx(0.5, abs=0.03)
    delays = [at - frame for frame, at in out]
    assert max(delays) * TICK <= 520_000
    assert channel.tally.lost > 2000


def test_a_cut_counts_from_the_release() -> None:
    channel: Channel[int] = Channel(Faults(cuts_us=((100_000, 200_000),)), generator(1, 1, up=True))
    passed = []
    for k in range(200):
        if k == 50:
            channel.released_us = k * TICK
        channel.put(k, 50, k * TICK)
        passed += channel.take(k * TICK)
    assert [k for k in range(200) if k not in passed] == list(range(75, 100))


def test_a_seed_fails_the_same_way_and_each_direction_by_itself() -> None:
    faults = Faults(loss=0.3, jitter_us=9000)
    assert sent_through(faults)[1] == sent_through(faults)[1]
    assert sent_through(faults)[1] != sent_through(faults, seed=2)[1]
    a, b = generator(1, 2, up=True).random(5), generator(1, 2, up=False).random(5)
    assert not np.allclose(a, b)
