"""Average run lengths against published tables, closed forms and counted points; limits against Student's t."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from control_simulation import KINDS, run_length_of_family, run_lengths_of_histories, signals_begun_again
from scipy import stats

from bench.maths.control.limits import false_rate, limits_for
from bench.maths.control.run_lengths import (
    Scores,
    cusum_run_length,
    ewma_run_length,
    normal_scores,
)

SEED = 23
SHIFTS = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
# Lucas and Saccucci, Technometrics 32 (1990) 1, table 3: by (weight, limit). The first two as the manual of the R
# package spc 0.7.2 quotes them, the others as in Montgomery, 6th edition, table 9.11.
EWMA = {
    (0.50, 3.071): (500, 88.8, 17.5, 6.53, 3.63, 2.50, 1.93, 1.34),
    (0.03, 2.437): (500, 29.3, 12.6, 8.07, 5.99, 4.80, 4.03, 3.11),
    (0.40, 3.054): (500, 71.2, 14.3, 5.9, 3.5, 2.5, 2.0, 1.4),
    (0.25, 2.998): (500, 48.2, 11.1, 5.5, 3.6, 2.7, 2.3, 1.7),
    (0.20, 2.962): (500, 41.8, 10.5, 5.5, 3.7, 2.9, 2.4, 1.9),
    (0.10, 2.814): (500, 31.3, 10.3, 6.1, 4.4, 3.4, 2.9, 2.2),
    (0.05, 2.615): (500, 28.8, 11.4, 7.1, 5.2, 4.2, 3.5, 2.7),
}
# Crowder, Technometrics 29 (1987) 401, table 1, as quoted there: limit 2, by weight.
CROWDER = {
    0.50: (26.45, 11.89, 4.91, 2.80, 1.94, 1.51, 1.26, 1.05),
    0.05: (127.53, 18.97, 8.38, 5.41, 4.04, 3.26, 2.76, 2.15),
}
# Montgomery, Introduction to Statistical Quality Control, 6th edition, table 9.3: reference value 1/2, by interval; 4
# also in Lucas and Crosier, Technometrics 24 (1982) 199, table 1, as quoted there.
CUSUM = {
    4.0: (168, 26.6, 8.38, 4.75, 3.34, 2.62, 2.19, 1.71),
    5.0: (465, 38.0, 10.4, 5.75, 4.01, 3.11, 2.57, 2.01),
}


def shewhart_run_length(limit: float, scores: Scores | None = None) -> float:
    """Return the average run length of single scores beyond -limit or +limit.

    Args:    limit: in standard deviations.   scores: their distribution, standard normal without it.
    Returns: points until the first signal, on average.
    Source:  Montgomery, Introduction to Statistical Quality Control, section 5.3 (geometric distribution).
    """
    low, high = (scores or Scores()).below(np.array([-limit, limit]))
    return float(1.0 / max(low + 1.0 - high, 1e-300))


def beside(table: tuple[float, ...], chart: Callable[[Scores], float]) -> float:
    """The largest relative difference of run lengths, less what the table is rounded by."""
    found = [chart(Scores(shift)) for shift in SHIFTS]
    rounded = [
        0.5 if value >= 100 else 0.05 if value >= 10 or value * 10 == round(value * 10) else 0.005 for value in table
    ]
    return max(
        max(abs(length - value) - half, 0.0) / value for length, value, half in zip(found, table, rounded, strict=True)
    )


@pytest.mark.validates(
    "run lengths of EWMA charts", against="Lucas and Saccucci 1990 (seven charts), Crowder 1987 (two charts)"
)
def test_ewma_of_the_published_table(record_property: Callable[[str, object], None]) -> None:
    charts = EWMA | {(weight, 2.0): table for weight, table in CROWDER.items()}
    worst = max(
        beside(table, lambda law, key=key: ewma_run_length(key[1], law, key[0])) for key, table in charts.items()
    )
    record_property("obtained", f"within {100 * worst:.1f} %, limit 0.2 %")
    assert worst < 0.002


@pytest.mark.validates(
    "run lengths of CUSUM charts", against="Montgomery, table 9.3; Lucas and Crosier 1982 (two charts)"
)
def test_cusum_of_the_published_table(record_property: Callable[[str, object], None]) -> None:
    worst = max(beside(table, lambda law, limit=limit: cusum_run_length(limit, law)) for limit, table in CUSUM.items())
    record_property("obtained", f"within {100 * worst:.1f} %, limit 0.5 %")
    assert worst < 0.005


def test_shewhart_of_the_textbook() -> None:
    """Montgomery, section 5.3 and figure 6.13: 370.4 in control, 43.9, 6.30 and 2.00 for 1, 2 and 3 sigma."""
    assert shewhart_run_length(3.0) == pytest.approx(370.4, abs=0.05)
    found = [shewhart_run_length(3.0, Scores(shift)) for shift in (1.0, 2.0, 3.0)]
    assert found == pytest.approx([43.89, 6.30, 2.00], abs=0.005)


def test_scores_are_normal_where_quotients_follow_student() -> None:
    at = np.array([-9.0, -1.3, 0.0, 0.4, 5.0])
    score = normal_scores(at, np.full(5, 8.0))
    np.testing.assert_allclose(stats.norm.cdf(score), stats.t.cdf(at, 8), rtol=1e-9)
    np.testing.assert_allclose(normal_scores(at, np.full(5, math.inf))[1:4], at[1:4], rtol=1e-12)
    np.testing.assert_allclose(Scores(0.0, 1.3, 8.0).below(score), stats.norm.cdf(1.3 * at), atol=1e-5)


@pytest.mark.parametrize("dof", [4.0, 10.0, 40.0])
def test_the_average_over_first_phases_is_students_distribution(dof: float) -> None:
    """Of a single score it is known: beyond the limit it is, by Student's t, as rare as the limit says."""
    for limit in (2.5, 3.0, 4.3):
        assert false_rate(shewhart_run_length, limit, dof, 1e-5) == pytest.approx(2.0 * stats.norm.sf(limit), rel=0.01)


@pytest.mark.parametrize("dof", [6.0, 18.0, math.inf])
def test_limits_give_each_chart_its_part_of_the_run_length(dof: float) -> None:
    limits = limits_for(50.0, 4, dof)
    assert limits.run_length == 600.0
    for chart, limit in (
        (shewhart_run_length, limits.shewhart),
        (ewma_run_length, limits.ewma),
        (cusum_run_length, limits.cusum),
    ):
        assert 1.0 / false_rate(chart, limit, dof, 1.0 / 600.0) == pytest.approx(600.0, rel=0.01)
    wider = limits_for(50.0, 4, dof - 2.0) if math.isfinite(dof) else limits_for(60.0, 4)
    assert wider.ewma > limits.ewma
    assert wider.cusum > limits.cusum


def test_known_scatter_counted() -> None:
    """20,000 points in control on three charts of 100 points each: within 3 standard deviations of a count."""
    scores = np.random.default_rng(SEED).normal(size=(1000, 20))
    counts = signals_begun_again(scores, limits_for(100.0 / 3.0, 1))
    for kind in KINDS:
        assert abs(counts[kind] - 200) < 3.0 * 200**0.5


def test_whole_histories_counted() -> None:
    """Drift, certificates and first phase of 12: no more false signals than declared; 3,000 points of 60 units."""
    found = run_lengths_of_histories(SEED, 60, 50, 50.0, 6)
    print(f"seed {SEED}: {found}")
    for length in found.values():
        assert 35.0 < length < 130.0


@pytest.mark.sweep
@pytest.mark.parametrize("per_certificate", [6, 10**6])
def test_a_hundred_thousand_points_in_control(per_certificate: int) -> None:
    """Certificates of 6 calibrations each, or a single one: 1,000 units, first phase of 12, 100 points behind it."""
    found = run_lengths_of_histories(1, 1000, 100, 200.0, per_certificate)
    print(f"seed 1: points for each false signal, declared 200: {found}")
    for length in found.values():
        assert length > 0.85 * 200.0  # 500 signals, most of them of the units whose first phase was too quiet


@pytest.mark.sweep
@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_all_charts_of_a_unit_together(correlation: float) -> None:
    found = run_length_of_family(3, 300, 100, 50.0, 10, 10, correlation)
    print(f"30 charts with correlation {correlation}: {found:.0f} points, declared 50")
    assert found > 50.0
