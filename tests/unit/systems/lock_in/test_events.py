"""Blocks of a time tagger to edges: bytes by hand, gaps, dropped edges, and what is no such record."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rlg_rig import as_row, block_bytes

from bench.model.errors import FitError
from bench.systems.lock_in.records import record_events

CLOCK_HZ, PER_BLOCK = 100_000_000, 1_000_000


def row(blocks: int = 4, *, dropped: Any = None, counter: Any = None, clock: Any = None, **change: Any) -> Any:
    """Blocks of four events each: beat up, pick-off up, beat down, beat up; ticks 10, 20, 30, 40 of the block."""
    events = np.empty(blocks, object)
    for k in range(blocks):
        events[k] = block_bytes([10, 20, 30, 40], [1, 1, 0, 1], [1, 0, 0, 1], [0, 1, 0, 0])
    columns: dict[str, Any] = {
        "tick": np.arange(5, 5 + blocks, dtype=np.uint64) * np.uint64(PER_BLOCK),
        "clock": np.full(blocks, CLOCK_HZ, np.uint32) if clock is None else np.array(clock, np.uint32),
        "dropped": np.zeros(blocks, np.uint32) if dropped is None else np.array(dropped, np.uint32),
        "edges": np.full(blocks, 4, np.uint16),
        "events": events,
    }
    numbers = np.arange(7, 7 + blocks) if counter is None else np.array(counter)
    return as_row(columns | change, numbers, 3, {"path_length_m": 0.28, "clock_Hz": CLOCK_HZ})


def test_events_by_hand() -> None:
    """The golden block of the frame: 0x2693 = 9875: level 1, cosine 1, channel 0, 1234 ticks; 0xb170; 0x7a11fd."""
    golden = bytes.fromhex("93260000 70b10000 fd117a00")
    one = np.empty(1, object)
    one[0] = golden
    found = record_events(row(1, edges=np.array([3], np.uint16), events=one))
    (stretch,) = found.stretches
    assert stretch.begin_tick == 5 * PER_BLOCK
    assert stretch.ticks.tolist() == [1234, 5678]
    assert stretch.rising.tolist() == [True, False]
    assert stretch.cosine.tolist() == [True, False]
    assert stretch.pickoff_ticks.tolist() == [999999]
    assert stretch.pickoff_rising.tolist() == [True]
    assert found.clock_Hz == CLOCK_HZ


def test_ticks_run_through_the_blocks() -> None:
    (stretch,) = record_events(row(3)).stretches
    assert stretch.ticks.tolist() == [k * PER_BLOCK + at for k in range(3) for at in (10, 30, 40)]
    assert stretch.pickoff_ticks.tolist() == [k * PER_BLOCK + 20 for k in range(3)]
    assert stretch.rising.tolist() == [True, False, True] * 3
    assert stretch.ticks.dtype == np.int64


def test_a_missing_block_ends_a_stretch() -> None:
    tick = np.array([5, 6, 9, 10], np.uint64) * np.uint64(PER_BLOCK)
    found = record_events(row(counter=[7, 8, 11, 12], tick=tick))
    assert [one.ticks.size for one in found.stretches] == [6, 6]
    assert [one.begin_tick // PER_BLOCK for one in found.stretches] == [5, 9]
    assert found.lost_blocks == 2


def test_a_block_in_which_edges_were_dropped_is_left_out() -> None:
    found = record_events(row(5, dropped=[0, 0, 40, 40, 40]))
    assert [one.begin_tick // PER_BLOCK for one in found.stretches] == [5, 8]
    assert [one.ticks.size for one in found.stretches] == [6, 6]
    assert (found.lost_edges, found.torn) == (40, 1)


def test_a_first_block_behind_losses_is_not_trusted() -> None:
    found = record_events(row(3, dropped=[40, 40, 40]))
    assert [one.begin_tick // PER_BLOCK for one in found.stretches] == [6]
    assert found.lost_edges == 0


def test_a_laser_that_went_dark_is_not_bridged() -> None:
    """Blocks come all the same, with consecutive numbers: only that there is no edge in them tells it."""
    plain = row(6)
    events = plain.samples.columns["events"].copy()
    for k in (0, 2, 3):
        events[k] = b""
    found = record_events(row(6, events=events, edges=np.array([0, 4, 0, 0, 4, 4], np.uint16)))
    assert [one.begin_tick // PER_BLOCK for one in found.stretches] == [6, 9]
    assert [one.ticks.size for one in found.stretches] == [3, 6]
    assert (found.dark, found.torn, found.lost_blocks) == (3, 0, 0)


def test_a_record_in_the_dark_has_no_stretch() -> None:
    events = np.empty(2, object)
    events[:] = [b"", b""]
    found = record_events(row(2, events=events, edges=np.zeros(2, np.uint16)))
    assert (found.stretches, found.dark) == ((), 2)


def test_a_tagger_that_was_started_again_begins_a_stretch() -> None:
    found = record_events(row(4, tick=np.array([5, 6, 0, 1], np.uint64) * np.uint64(PER_BLOCK)))
    assert [one.begin_tick // PER_BLOCK for one in found.stretches] == [5, 0]


def test_losses_before_a_restart_are_not_taken_off_again() -> None:
    """The tagger's own count begins at 0 again."""
    found = record_events(row(5, dropped=[0, 40, 0, 0, 3]))
    assert found.lost_edges == 43


def test_a_block_with_too_few_bytes_is_left_out() -> None:
    found = record_events(row(3, edges=np.array([4, 5, 4], np.uint16)))
    assert [one.begin_tick // PER_BLOCK for one in found.stretches] == [5, 7]
    assert found.torn == 1


@pytest.mark.parametrize(
    ("wrong", "code"),
    [
        (lambda: replace(row(), samples=None), "B-RLG-001"),
        (lambda: row(0), "B-RLG-001"),
        (lambda: as_row({"gyro": np.zeros(4, np.int16)}, np.arange(4), 3, {}), "B-RLG-002"),
        (lambda: row(clock=[CLOCK_HZ, CLOCK_HZ, 20_000_000, 20_000_000]), "B-RLG-003"),
    ],
)
def test_what_is_no_record_of_edges_is_refused(wrong: Any, code: str) -> None:
    with pytest.raises(FitError) as raised:
        record_events(wrong())
    assert raised.value.code == code
    assert "record 3" in str(raised.value)
