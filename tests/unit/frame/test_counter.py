"""Counters without wrap: losses, repeats, long gaps by receive time, restarts, single odd values."""

from __future__ import annotations

import numpy as np
import pytest

from bench.frame.counter import CounterUnwrapper, Unwrapped

WRAP = 65536
SECOND = 1_000_000_000


def feed(
    unwrapper: CounterUnwrapper, raw: list[int] | np.ndarray, stamps: list[int] | np.ndarray | None = None
) -> Unwrapped:
    values = np.asarray(raw, np.int64) % WRAP
    return unwrapper.feed(values, None if stamps is None else np.asarray(stamps, np.int64))


def test_a_plain_stream_over_several_wraps_in_uneven_batches() -> None:
    unwrapper = CounterUnwrapper(WRAP, None)
    true = np.arange(65000, 65000 + 200_000)
    at = 0
    for size in (1, 99_999, 3, 30_000, 69_997):
        result = feed(unwrapper, true[at : at + size])
        assert result.counter.tolist() == true[at : at + size].tolist()
        assert (result.lost, result.duplicate, result.suspect.any()) == (0, 0, False)
        at += size
    assert at == len(true)


def test_lost_frames_inside_and_between_batches() -> None:
    unwrapper = CounterUnwrapper(WRAP, None)
    first = feed(unwrapper, [65534, 65535, 65538, 65539])
    assert first.counter.tolist() == [65534, 65535, 65538, 65539]
    assert first.lost == 2
    second = feed(unwrapper, [65545])
    assert second.counter.tolist() == [65545]
    assert second.lost == 5


def test_repeated_frames_carry_the_counter_they_repeat() -> None:
    unwrapper = CounterUnwrapper(WRAP, None)
    result = feed(unwrapper, [9, 10, 11, 9, 10, 11, 12, 12, 15])
    assert result.counter.tolist() == [9, 10, 11, 9, 10, 11, 12, 12, 15]
    assert (result.duplicate, result.lost) == (4, 2)


def test_repeats_that_go_on_in_the_next_batch() -> None:
    unwrapper = CounterUnwrapper(WRAP, None)
    feed(unwrapper, [9, 10, 11])
    assert feed(unwrapper, [9]).duplicate == 1
    result = feed(unwrapper, [10, 11, 12])
    assert (result.duplicate, result.lost) == (2, 0)


def test_a_repeat_across_batches_and_the_wrap() -> None:
    unwrapper = CounterUnwrapper(WRAP, None)
    feed(unwrapper, [65535, 65536])
    result = feed(unwrapper, [65535, 65536, 65537])
    assert result.counter.tolist() == [65535, 65536, 65537]
    assert (result.duplicate, result.lost) == (2, 0)


@pytest.mark.parametrize("gap", [1, 2, 500, 65535, 65536, 65537, 200_000, 1_000_000])
def test_gaps_longer_than_a_wrap_by_receive_time(gap: int) -> None:
    """100 Hz in 1 s reads; the time of the gap is off by up to a read."""
    for error in (-SECOND // 2, 0, SECOND // 2):
        unwrapper = CounterUnwrapper(WRAP, 100.0)
        feed(unwrapper, np.arange(1, 101), np.full(100, SECOND))
        raw = 100 + gap + np.arange(100)
        t_ns = SECOND + (gap + 99) * SECOND // 100 + error
        result = feed(unwrapper, raw, np.full(100, t_ns))
        assert result.counter.tolist() == raw.tolist()
        assert result.lost == gap - 1


def test_a_narrow_fast_counter_is_followed_by_time() -> None:
    """u8 at 1 kHz, read once a second: a thousand frames per read are four wraps."""
    unwrapper = CounterUnwrapper(256, 1000.0)
    at = 0
    for second in range(1, 20):
        size = 1000 if second != 7 else 990  # ten frames lost somewhere in the read
        true = np.concatenate((np.arange(at, at + 500), np.arange(at + 1500 - size, at + 1000)))
        result = unwrapper.feed(true % 256, np.full(size, second * SECOND))
        assert result.counter.tolist() == true.tolist(), second
        at += 1000


def test_one_odd_counter_is_suspect_and_changes_nothing() -> None:
    unwrapper = CounterUnwrapper(WRAP, None)
    result = feed(unwrapper, [100, 101, 40_000, 102, 103])
    assert result.suspect.tolist() == [False, False, True, False, False]
    assert result.counter.tolist() == [100, 101, 101, 102, 103]
    assert (result.lost, result.duplicate) == (0, 0)


def test_an_odd_counter_at_the_end_of_a_batch() -> None:
    unwrapper = CounterUnwrapper(WRAP, None)
    assert feed(unwrapper, [100, 101, 40_000]).suspect.tolist() == [False, False, True]
    result = feed(unwrapper, [103, 104])
    assert result.counter.tolist() == [103, 104]
    assert result.lost == 1


def test_a_restart_of_the_unit_goes_on_as_the_time_predicts() -> None:
    """Counter 5000, 10 s without frames, then from 0 again: 1000 frames are missing, the counter goes on upwards."""
    unwrapper = CounterUnwrapper(WRAP, 100.0)
    feed(unwrapper, np.arange(4901, 5001), np.full(100, SECOND))
    result = feed(unwrapper, np.arange(100), np.full(100, 12 * SECOND))
    assert result.suspect.tolist() == [True] + [False] * 99
    assert (np.diff(result.counter[1:]) == 1).all()
    assert abs(int(result.counter[1]) - (5000 + 1002)) <= 2
    assert result.lost == result.counter[1] - 5001


def test_an_empty_batch() -> None:
    result = feed(CounterUnwrapper(WRAP, 100.0), [], [])
    assert (len(result.counter), result.lost, result.duplicate) == (0, 0, 0)


@pytest.mark.parametrize("seed", range(40))
def test_random_losses_repeats_and_batches(seed: int) -> None:
    """Against the known truth: the counters themselves, and losses and repeats counted with sets."""
    generator = np.random.default_rng(seed)
    true = np.flatnonzero(generator.random(3000) > 0.2) + generator.integers(0, 65536)
    again = generator.random(len(true)) < 0.05
    true = np.repeat(true, 1 + again)
    unwrapper = CounterUnwrapper(WRAP, 100.0)
    cuts = np.unique(generator.integers(0, len(true), 20))
    lost = duplicate = 0
    for part in np.split(true, cuts):
        stamps = np.full(len(part), (int(part[-1]) if len(part) else 0) * SECOND // 100)
        result = unwrapper.feed(part % WRAP, stamps)
        assert result.counter.tolist() == part.tolist()
        lost, duplicate = lost + result.lost, duplicate + result.duplicate
    unique = set(true.tolist())
    assert lost == int(true[-1] - true[0]) + 1 - len(unique)
    assert duplicate == len(true) - len(unique)
