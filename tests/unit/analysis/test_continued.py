"""A recording through a motion in two parts is one record again, and only where nothing lies between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from imu_material import Rig

from bench.analysis import joined
from bench.model.quality import Quality
from bench.record import RecordRow
from bench.systems.gnc.rows import sampled_rows


def parts(gap: int = 0) -> list[RecordRow]:
    """One second before a turn and two behind it; ``gap``: samples between them."""
    rig = Rig(610)
    rig.rest(1.0, (0.0, 0.0, 0.0), item="rotation")
    rig.counter += gap - 1000  # records of this rig lie 1,000 samples apart
    rig.rest(2.0, (0.0, 0.0, 30.0), item="rotation", continues=1)
    first, second = rig.rows
    return [
        replace(first, lost=2, bad=1, duplicate=4, suspect=3, quality=Quality.GOOD),
        replace(second, lost=5, bad=7, duplicate=6, suspect=9, quality=Quality.LOST),
    ]


def test_two_parts_are_one() -> None:
    first, second = parts()
    (one,) = joined([first, second])
    assert (one.window.number, one.window.first_counter, one.window.frames) == (1, 0, 600)
    assert (one.window.t_start_ns, one.window.t_end_ns) == (first.window.t_start_ns, second.window.t_end_ns)
    assert one.window.conditions == first.window.conditions
    assert (one.frames, one.lost, one.bad, one.duplicate, one.suspect) == (600, 7, 8, 10, 12)
    assert one.quality == Quality.LOST
    assert np.array_equal(one.samples.counter, np.arange(600))
    assert np.array_equal(one.samples.columns["gyro"][200:], second.samples.columns["gyro"])  # type: ignore[union-attr]
    assert np.array_equal(one.samples.t_ns[:200], first.samples.t_ns)  # type: ignore[union-attr]


def test_parts_with_samples_between_them_stay_apart_and_the_second_is_not_used() -> None:
    found = joined(parts(gap=1))
    assert len(found) == 2
    rig = Rig(610)
    rig.rows = list(found)
    used, empty = sampled_rows(rig.material("imu_calibration"), ("rotation",))
    assert [one.number for one in used] == [1]
    assert empty == ["record 2 (rotation): it does not follow the record that it continues"]


def test_what_merely_follows_is_a_record_of_its_own() -> None:
    first, second = parts()
    conditions = {name: value for name, value in second.window.conditions.items() if name != "continues"}
    alone = replace(second, window=replace(second.window, conditions=conditions))
    assert len(joined([first, alone])) == 2
