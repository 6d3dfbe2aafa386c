"""Ramps and holds of programmes made here, with known corners, plain, noisy, in steps, or behind a lag."""

from __future__ import annotations

import numpy as np
import pytest
from import_sample import HOLD_s, RAMP_s, lagging, programme

from bench.systems.af_converter.estimators.segments import branches, find_segments

KINDS = ["hold", "up", "hold", "down", "hold"]
CORNERS_s = np.cumsum([0.0, HOLD_s, RAMP_s, HOLD_s, RAMP_s, HOLD_s])
T_s = np.arange(0.0, CORNERS_s[-1], 20.0)


def test_a_plain_programme_is_found_to_the_second() -> None:
    found = find_segments(T_s, programme(T_s), 600.0)
    assert [one.kind for one in found] == KINDS
    np.testing.assert_allclose([one.start_s for one in found], CORNERS_s[:-1], atol=1.0)
    np.testing.assert_allclose([one.rate_degC_h for one in found], [0.0, 3.0, 0.0, -3.0, 0.0], atol=1e-6)
    np.testing.assert_allclose([one.end_degC for one in found], [20.0, 35.0, 35.0, 20.0, 20.0], atol=1e-3)
    assert [one.length_h for one in found] == pytest.approx([2.0, 5.0, 2.0, 5.0, 2.0], rel=1e-3, abs=0.01)


def test_noise_and_coarse_steps_cost_little() -> None:
    rng = np.random.default_rng(3)
    for shown in (programme(T_s) + rng.normal(0.0, 0.03, T_s.size), np.floor(programme(T_s) / 0.05) * 0.05):
        found = find_segments(T_s, shown, 600.0)
        assert [one.kind for one in found] == KINDS
        np.testing.assert_allclose([one.start_s for one in found[1:]], CORNERS_s[1:-1], atol=90.0)


def test_a_sensor_behind_a_lag_turns_later_by_the_lag() -> None:
    found = find_segments(T_s, lagging(T_s, 300.0), 600.0)
    assert [one.kind for one in found] == KINDS
    np.testing.assert_allclose([one.start_s for one in found[1:]], CORNERS_s[1:-1] + 300.0, atol=200.0)


def test_a_triangle_has_no_hold_and_a_short_overshoot_no_piece_of_its_own() -> None:
    triangle = np.interp(T_s, [0.0, T_s[-1] / 2, T_s[-1]], [10.0, 30.0, 10.0])
    assert [one.kind for one in find_segments(T_s, triangle, 600.0)] == ["up", "down"]
    bump = np.where((T_s > CORNERS_s[2]) & (T_s < CORNERS_s[2] + 600.0), 0.5, 0.0)
    assert [one.kind for one in find_segments(T_s, programme(T_s) + bump, 600.0)] == KINDS


def test_a_record_that_stands_still_is_one_hold() -> None:
    rng = np.random.default_rng(4)
    found = find_segments(T_s, 23.0 + rng.normal(0.0, 0.01, T_s.size))
    assert [(one.kind, one.start_s, one.end_s) for one in found] == [("hold", 0.0, T_s[-1])]


def test_gaps_do_not_matter() -> None:
    kept = (T_s < 9000.0) | (T_s > 14000.0)
    found = find_segments(T_s[kept], programme(T_s[kept]), 600.0)
    assert [one.kind for one in found] == KINDS
    np.testing.assert_allclose([one.start_s for one in found], CORNERS_s[:-1], atol=60.0)


def test_the_direction_at_any_time() -> None:
    found = find_segments(T_s, programme(T_s), 600.0)
    asked = np.array([HOLD_s / 2, HOLD_s + RAMP_s / 2, 1.5 * HOLD_s + RAMP_s, 2 * HOLD_s + 1.5 * RAMP_s, T_s[-1]])
    assert branches(asked, found).tolist() == [0, 1, 0, -1, 0]
