"""Predicted and achieved uncertainties side by side, and what a run will come to, against what variances add up to."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bench.analysis import NOTED, ORDINARY, agreements, by_foreseen_name, expected_at_end

SEED, DRAWS = 20, 20_000


def entry(U: float | None, *, grown: dict[str, float] | None = None, **conditions: Any) -> dict[str, Any]:
    common = {"common": {"standards": {"gain": 3.0}, "campaign": grown}} if grown is not None else {}
    return {"quantity": "dsf_n", "conditions": conditions, "expanded_uncertainty": U,
            "std_uncertainty": None if U is None else U / 2.0, **common}  # fmt: skip


def test_what_a_run_measures_of_the_conditions_names_no_estimate() -> None:
    planned = entry(1.0, channel=1, temperature_degC=50.0, unit_temperature_degC=50.0, hours=38.0)
    measured = entry(1.0, channel=1, temperature_degC=50.0, unit_temperature_degC=49.61, hours=38.002)
    others = [entry(1.0, channel=2, temperature_degC=50.0), {**planned, "quantity": "dsf_p"}]
    assert list(by_foreseen_name([planned])) == list(by_foreseen_name([measured]))
    assert len(by_foreseen_name([planned, *others])) == 3


def test_repeats_of_a_channel_are_held_against_their_own_predictions() -> None:
    before = [entry(1.0, channel=7, hours=8.0), entry(2.0, channel=7, hours=22.0)]
    after = [entry(3.0, channel=7, hours=7.99), entry(2.0, channel=7, hours=22.1)]
    assert [pair.ratio for pair in agreements(before, after)] == [3.0, 1.0]


def test_the_ratio_and_the_error_that_has_grown() -> None:
    before = [entry(2.0, grown={"drift": 0.5}, channel=channel) for channel in (1, 2, 3)]
    sensor = entry(2.0 * math.sqrt(1.0 + 0.9**2), grown={"drift": 0.5, "sensor": -0.9}, channel=1)
    many = entry(4.0, grown={"drift": 0.5, "sensor": 1.0}, channel=2)  # the variance grew by 3, the sensor brings 1
    found = agreements(before, [entry(2.0, grown={"drift": 0.5}, channel=3), many, sensor])
    assert [pair.ratio for pair in found] == pytest.approx([math.sqrt(1.81), 2.0, 1.0])
    assert [pair.grown for pair in found] == ["sensor", "", ""]
    assert [pair.is_noted for pair in found] == [True, True, False]


def test_what_is_not_known_on_both_sides_is_left_out() -> None:
    before = [entry(2.0, channel=1), entry(2.0, channel=2), entry(0.0, channel=3), entry(2.0, channel=4)]
    after = [entry(None, channel=1), entry(1.0, channel=3), entry(1.0, channel=4), entry(1.0, channel=5)]
    (pair,) = agreements(before, after)
    assert pair.predicted["conditions"] == {"channel": 4}
    assert pair.is_noted, "less than the least is as odd as more"
    assert agreements([entry(1.0)], [entry(1.0 + 0.99 * NOTED)])[0].is_noted is False


def noted_share(dof: int, factor: float) -> float:
    """Return how many of uncertainties by the scatter of ``dof`` + 1 readings are noted, their noise ``factor`` times
    the predicted one.
    """
    print(f"seed {SEED}")
    readings = np.random.default_rng(SEED).normal(0.0, factor, (DRAWS, dof + 1))
    achieved = [entry(float(U)) | {"dof": float(dof)} for U in readings.std(axis=1, ddof=1)]
    return float(np.mean([agreements([entry(1.0)], [after])[0].is_noted for after in achieved]))


@pytest.mark.parametrize("dof", [2, 5, 20])
def test_scatter_of_few_degrees_of_freedom_is_no_note(dof: int) -> None:
    share = noted_share(dof, 1.0)
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], DRAWS, 1.0 - ORDINARY) / DRAWS
    assert low <= share <= high, "the interval is that of the stated probability, not a wider one"


@pytest.mark.parametrize(("dof", "factor"), [(5, 4.0), (20, 2.0), (200, 1.5), (200, 0.7)])
def test_a_discrepancy_beyond_scatter_is_a_note(dof: int, factor: float) -> None:
    assert noted_share(dof, factor) > 0.9


@pytest.mark.parametrize("dof", [5.0, 30.0, 1e5, math.inf])
def test_the_bounds_are_those_of_chi_square_and_never_nearer_than_ten_per_cent(dof: float) -> None:
    both = [(1.0 - ORDINARY) / 2.0, (1.0 + ORDINARY) / 2.0]
    low, high = np.sqrt(stats.chi2.ppf(both, dof) / dof) if dof < 1e5 else (1.0 - NOTED, 1.0 + NOTED)
    stated = {} if math.isinf(dof) else {"dof": dof}
    for ratio, noted in ((low - 1e-6, True), (low + 1e-6, False), (high - 1e-6, False), (high + 1e-6, True)):
        assert agreements([entry(1.0)], [entry(ratio) | stated])[0].is_noted is noted


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_noise_that_is_not_the_declared_one_stays_so(factor: float) -> None:
    """The mean of 4 records of 16: so far s / 2, at the end s / 4."""
    s = 8.0
    assert expected_at_end(factor * s / 2, s / 2, s / 4) == pytest.approx(factor * s / 4)


def test_what_the_unit_brought_stays_where_only_a_drift_comes_on_top() -> None:
    random, unit, drift = 3.0, 4.0, 12.0
    at_end = expected_at_end(math.hypot(random, unit), random, math.hypot(random, drift))
    assert at_end == pytest.approx(13.0)  # 3, 4, 12: their squares add up to that of 13


def test_nothing_more_comes_and_it_is_what_it_is() -> None:
    for so_far in (0.9, 1.0, 7.0):
        assert expected_at_end(so_far, 1.0, 1.0) == pytest.approx(so_far)
