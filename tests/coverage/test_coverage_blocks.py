"""Intervals of generated campaigns hold the truth as often as they say; 2,000 of each kind are ``run.py``."""

from dataclasses import replace

import pytest
from coverage_blocks import Covered, all_campaigns, done_block, summed, told

ROW = Covered("scale_factor", "bias_tc2", 0, 999, "0123abc", 1000, 950, 0, 20.0)


def test_what_is_off_is_told() -> None:
    assert ROW.as_stated
    assert not replace(ROW, inside=889).as_stated
    assert not replace(ROW, inside=994).as_stated
    assert "NOT as stated" in told(replace(ROW, inside=889))


def test_blocks_are_summed_by_quantity() -> None:
    other = replace(ROW, first=1000, last=1999, sound=998, inside=940, unsound=2)
    (sum_of_both,) = summed([ROW, other])
    assert (sum_of_both.sound, sum_of_both.inside, sum_of_both.unsound) == (1998, 1890, 2)
    assert sum_of_both.seeds == range(2000)


@pytest.mark.parametrize("count", [12, pytest.param(60, marks=pytest.mark.sweep)])
@pytest.mark.parametrize("module", list(all_campaigns()))
def test_intervals_hold_the_truth_as_often_as_they_say(module: str, count: int) -> None:
    """Of 12 campaigns fewer than 8 inside would be seen, of 60 fewer than 50."""
    rows = done_block(module, range(count), "now")
    print("\n".join(told(row) for row in rows))
    assert [told(row) for row in rows if not row.as_stated] == []
    assert sum(row.unsound for row in rows) == 0
