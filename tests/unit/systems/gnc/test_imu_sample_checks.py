"""Samples of a record against what the frame promises, not against what they are themselves."""

from __future__ import annotations

import pytest
from imu_material import IMU, POSES, RATE_Hz, Rig

from bench.systems.gnc.rows import SampledRow
from bench.systems.gnc.sample_checks import check_notes, checked


def rows() -> list[SampledRow]:
    rig = Rig(4)
    rig.rest(10.0, POSES["+z"], item="bias")
    (row,) = rig.rows
    assert row.samples is not None
    return [SampledRow(1, row.window.conditions, row.samples, 0)]


@pytest.mark.parametrize(("due_Hz", "found"), [(RATE_Hz, False), (2 * RATE_Hz, True), (RATE_Hz / 2, True)])
def test_a_unit_that_samples_at_another_rate_is_named(due_Hz: float, found: bool) -> None:
    notes = check_notes(checked(rows(), ("gyro", "accelerometer"), {"imu": IMU, "rate_Hz": due_Hz}))
    assert bool(notes) is found, notes
