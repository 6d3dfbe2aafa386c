"""Drift from as left to the next as found, never across an adjustment, whatever campaigns saw it."""

from __future__ import annotations

import math
from pathlib import Path

import charts_sample
import numpy as np
import pytest
from charts_sample import Documents
from store_database import new_history

from bench.maths.drift import NO_STANDARD, fit_drift_line
from bench.store import Filters, compare_pair, compare_unit, state_calibration

SEED = 23


def history(url: str, states: dict[int, str], other: dict[int, str] | None = None) -> Documents:
    """Twelve calibrations each quarter, adjusted by 500 ppm before the seventh."""
    days = 91.0 * np.arange(12)
    steps = np.where(np.arange(12) >= 6, 500.0, 0.0)
    ordered = charts_sample.written(url, charts_sample.unit("A1", days, SEED, np.zeros(4), steps))
    if other is not None:
        second = charts_sample.unit("A1", days + 1.0, SEED + 1, np.zeros(4), steps)
        for document, _ in second:
            document["campaign"] = "another"
        charts_sample.written(url, second)
        for place, state in other.items():
            state_calibration(url, second[place][0]["session"], state, "gain", "A. Meyer")
    for place, state in states.items():
        state_calibration(url, ordered[place][0]["session"], state, "gain", "A. Meyer")
    return ordered


@pytest.mark.parametrize("states", [{5: "as_found", 6: "as_left"}, {5: "as_found"}, {6: "as_left"}])
def test_no_drift_and_no_agreement_across_an_adjustment(tmp_path: Path, states: dict[int, str]) -> None:
    url = new_history("sqlite", tmp_path)
    ordered = history(url, states)
    comparison = compare_unit(url, Filters(None, None, "dsf_n"))
    assert comparison.series.level.tolist() == [0] * 6 + [1] * 6
    (parameter,) = comparison.parameters
    assert parameter.line is not None
    assert abs(parameter.line.rate) < 60.0  # 500 ppm within 91 days would be 2,000 a year
    assert np.isnan(parameter.en[[0, 6]]).all()
    assert np.nanmax(np.abs(parameter.en)) < 2.0
    assert parameter.line.mean == pytest.approx(parameter.value[6:].mean(), abs=25.0)
    pair = compare_pair(url, ordered[5][0]["session"], ordered[6][0]["session"])
    assert any("adjusted between them" in note for note in pair["notes"])


def test_two_campaigns_see_one_adjustment(tmp_path: Path) -> None:
    url = new_history("sqlite", tmp_path)
    history(url, {5: "as_found", 6: "as_left"}, {5: "as_found", 6: "as_left"})
    level = compare_unit(url, Filters()).series.level
    assert level.tolist() == [0] * 12 + [1] * 12
    again = new_history("sqlite", tmp_path / "again")
    history(again, {4: "as_left", 8: "as_left"}, {4: "as_left"})
    assert compare_unit(again, Filters()).series.level.tolist() == [0] * 8 + [1] * 8 + [2] * 8


def test_a_unit_adjusted_between_any_two_has_no_drift(tmp_path: Path) -> None:
    url = new_history("sqlite", tmp_path)
    history(url, dict.fromkeys(range(12), "as_left"))
    comparison = compare_unit(url, Filters(None, None, "bias"))
    assert comparison.parameters[0].line is None
    assert comparison.parameters[0].as_json(comparison.series)["change"] is None


def test_the_rate_of_two_levels_is_that_of_the_pooled_slopes() -> None:
    """Parallel lines, Draper and Smith, Applied Regression Analysis: slope = sum of Sxy / sum of Sxx within groups."""
    rng = np.random.default_rng(SEED)
    t, level = np.arange(10.0), (np.arange(10) >= 4).astype(np.int64)
    value = 3.0 * t + 100.0 * level + rng.normal(0.0, 0.1, 10)
    line = fit_drift_line(t, value, np.full(10, 0.1), np.zeros(10), np.full(10, NO_STANDARD), level)
    parts = [(t[level == label] - t[level == label].mean(), value[level == label]) for label in (0, 1)]
    squares = sum(float(at @ at) for at, _ in parts)
    assert line.rate == pytest.approx(sum(float(at @ y) for at, y in parts) / squares, rel=1e-9)
    factor = math.hypot(0.1, line.between_std)
    assert line.rate_std == pytest.approx(factor / math.sqrt(squares), rel=1e-6)
    assert line.dof == 7


def test_intervals_across_an_adjustment_hold_the_rate() -> None:
    """500 histories of 12 calibrations, adjusted once by an unknown amount, with twice the stated scatter."""
    rng, inside = np.random.default_rng(SEED), 0
    t, level, std = np.arange(12.0), (np.arange(12) >= 5).astype(np.int64), np.ones(12)
    for _ in range(500):
        value = 12.0 * t + rng.normal(0.0, 300.0) * level + rng.normal(0.0, 2.0, 12)
        line = fit_drift_line(t, value, std, np.zeros(12), np.full(12, NO_STANDARD), level)
        inside += abs(line.rate - 12.0) <= line.rate_expanded
    print(f"seed {SEED}: {inside} of 500")
    assert 458 <= inside <= 488
