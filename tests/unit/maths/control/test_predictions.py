"""Charts: predictions, the common mode of units and run lengths against mixed models, tables and counted points."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from bench.maths.control.common_mode import certificate_steps, common_mode, population
from bench.maths.control.limits import KINDS, Limits, chart, false_rate, limits_for
from bench.maths.control.predictions import (
    Readings,
    Scatter,
    change_until,
    first_phase,
    level_and_drift,
    odd_one_of_first_phase,
    predictions,
    step_until,
)
from bench.maths.control.run_lengths import (
    CUSUM_REFERENCE,
    EWMA_WEIGHT,
    Scores,
    cusum_run_length,
    ewma_run_length,
    ewma_std,
    normal_scores,
)
from bench.maths.drift import NO_STANDARD
from bench.model.errors import FitError

SEED = 23


def dense(readings: Readings, variance: float) -> np.ndarray:
    same = np.equal.outer(readings.standard, readings.standard) & (readings.standard != NO_STANDARD)
    return variance * np.eye(readings.t.size) + np.outer(readings.shared, readings.shared) * same


def expected_by_hand(readings: Readings, variance: float, place: int) -> tuple[float, float]:
    """Conditional distribution of one reading given those before it, level and drift with all but flat priors."""
    design = np.column_stack([np.ones_like(readings.t), readings.t - readings.t[0]])
    covariance = dense(readings, variance) + 1e8 * design @ design.T
    before = covariance[:place, :place]
    gain = np.linalg.solve(before, covariance[:place, place])
    left = covariance[place, place] - gain @ covariance[:place, place]
    return float(gain @ readings.value[:place]), math.sqrt(left)


def test_predictions_are_conditional_normal_distributions() -> None:
    readings = history(np.random.default_rng(SEED), 20, 5)
    scatter = first_phase(readings, FIRST)
    found = predictions(readings, scatter)
    assert np.isnan(found.expected[:2]).all()  # two unknowns
    for place in (3, 10, 14, 19):
        expected, std = expected_by_hand(readings, scatter.variance, place)
        assert found.expected[place] == pytest.approx(expected, abs=1e-3)
        assert found.std[place] == pytest.approx(std, rel=1e-4)


def test_the_first_phase_is_chi_square_of_its_own_scatter() -> None:
    readings = history(np.random.default_rng(SEED), FIRST, 4)
    scatter = first_phase(readings, FIRST)
    weight = np.linalg.inv(dense(readings, scatter.variance))
    design = level_and_drift(readings)
    left = readings.value - design @ np.linalg.solve(design.T @ weight @ design, design.T @ weight @ readings.value)
    assert left @ weight @ left == pytest.approx(FIRST - 2, rel=1e-6)
    assert scatter.count == FIRST


def test_a_later_calibration_changes_nothing_before_it() -> None:
    readings = history(np.random.default_rng(SEED), 24, 5)
    scatter = first_phase(readings, FIRST)
    whole, part = predictions(readings, scatter), predictions(readings.of(slice(17)), scatter)
    np.testing.assert_allclose(whole.score[:17], part.score, rtol=1e-9)
    assert first_phase(readings.of(slice(17)), FIRST) == scatter


def test_an_adjustment_begins_a_level_and_keeps_the_drift() -> None:
    readings = history(np.random.default_rng(SEED), 24, 30)
    level = (np.arange(24) >= 16).astype(np.int64)
    moved = Readings(
        readings.t, readings.value + 500.0 * level, readings.std, readings.shared, readings.standard, level
    )
    scatter = first_phase(moved, FIRST)
    found = predictions(moved, scatter)
    assert np.isnan(found.score[16])  # nothing is known of the new level
    assert np.isfinite(found.score[17:]).all()
    assert np.nanmax(np.abs(found.score)) < 4.0
    assert chart(found.score[FIRST:], limits_for(200.0, 1, scatter.dof)).signals == ()


@pytest.mark.parametrize("size", [8.0, -20.0])
def test_a_step_is_found_with_its_date_and_size(size: float) -> None:
    rng, right, inside, trials = np.random.default_rng(SEED), 0, 0, 40
    for _ in range(trials):
        readings = history(rng, 26, 40, size, 20)
        scatter = first_phase(readings, FIRST)
        signals = chart(predictions(readings, scatter).score[FIRST:], limits_for(60.0, 1, scatter.dof)).signals
        assert signals
        change = change_until(readings, scatter, 25)
        right += change.earliest <= 20 <= change.latest
        inside += abs(change.size - size * OWN) <= change.expanded
    print(f"seed {SEED}, step {size}: date within its range {right}, size within its interval {inside} of {trials}")
    assert right >= 36
    assert inside >= 34


def test_units_with_the_same_certificates_are_predicted_together() -> None:
    """Eight units by turns, known scatter: scores are standard normal and the next one knows nothing of the last."""
    rng, scores = np.random.default_rng(SEED), []
    for _ in range(30):
        errors, parts = rng.normal(0.0, SHARED, 5), []
        for _ in range(8):
            t = np.sort(rng.uniform(0.0, 5.0, 10))
            label = np.floor(t).astype(np.int64)
            value = rng.normal(0.0, 300.0) + rng.normal(0.0, 10.0) * t + errors[label] + rng.normal(0.0, OWN, 10)
            parts.append((t, value, label))
        t, value, label = (np.concatenate(column) for column in zip(*parts, strict=True))
        order, shared, level = np.argsort(t), np.full(80, SHARED), np.zeros(80, dtype=np.int64)
        together = Readings(t, value, shared, shared, label, level, np.repeat(np.arange(8), 10)).of(order)
        score = predictions(together, Scatter(OWN**2, 1e-9, np.inf, 0, np.inf)).score
        scores.append(score[np.isfinite(score)])
    assert all(score.size == 80 - 2 * 8 for score in scores)  # a level and a drift each
    print(f"seed {SEED}: standard deviation {np.concatenate(scores).std():.3f}")
    assert np.concatenate(scores).std() == pytest.approx(1.0, abs=4.0 / (2 * 1920) ** 0.5)
    assert abs(np.mean([np.mean(score[1:] * score[:-1]) for score in scores])) < 4.0 / 1890**0.5


def test_an_odd_calibration_of_the_first_phase_by_leaving_it_out() -> None:
    """Its residual against the line of the others, over its standard deviation by their scatter, by Student's t."""
    readings = history(np.random.default_rng(SEED), FIRST, FIRST)
    value = readings.value.copy()
    value[7] += 6.0 * OWN
    alone = Readings(readings.t, value, readings.std, 0.0 * value, np.full(FIRST, NO_STANDARD), readings.level)
    worst, probability = odd_one_of_first_phase(alone, first_phase(alone, FIRST))
    others = np.arange(FIRST) != 7
    design = np.column_stack([np.ones(FIRST), readings.t])
    fitted, squares, *_ = np.linalg.lstsq(design[others], value[others])
    leverage = design[7] @ np.linalg.inv(design[others].T @ design[others]) @ design[7]
    by_hand = (value[7] - design[7] @ fitted) / math.sqrt(squares[0] / (FIRST - 3) * (1.0 + leverage))
    assert worst == 7
    assert probability == pytest.approx(2.0 * FIRST * stats.t.sf(abs(by_hand), FIRST - 3), rel=1e-4)


def test_a_step_in_independent_errors_is_their_weighted_mean() -> None:
    error, std = np.array([0.1, np.nan, 5.0, 7.0]), np.array([1.0, np.nan, 1.0, 2.0])
    change = step_until(error, std, 3, np.inf)
    assert (change.since, change.size) == (2, pytest.approx((5.0 + 7.0 / 4.0) / 1.25))
    assert change.std == pytest.approx(1.25**-0.5)


def test_what_shows_no_scatter_is_refused() -> None:
    readings = history(np.random.default_rng(SEED), 4, 4)
    with pytest.raises(FitError, match="B-FIT-001"):
        first_phase(readings, 2)
    with pytest.raises(FitError, match="B-FIT-002"):
        first_phase(Readings(readings.t, readings.value, 0.0 * readings.t, *list(vars(readings).values())[3:]), 4)
    still = Readings(readings.t, 0.0 * readings.t, *list(vars(readings).values())[2:])
    assert first_phase(still, 4).variance > 0.0
    assert isinstance(first_phase(still, 4), Scatter)


CERTIFICATES, STATED, UNIT_OWN = 6, 10.0, 2.0


def units(rng: np.random.Generator, wrong: float = 0.0, count: int = 8) -> list[Readings]:
    """Units with drifts of their own over six years, a certificate each year; that of the fifth may be wrong."""
    errors = rng.normal(0.0, STATED, CERTIFICATES)
    errors[4] += wrong
    found = []
    for _ in range(count):
        t = np.sort(rng.uniform(0.0, CERTIFICATES, 9))
        label = np.floor(t).astype(np.int64)
        value = rng.normal(0.0, 300.0) + rng.normal(0.0, 20.0) * t + errors[label] + rng.normal(0.0, UNIT_OWN, 9)
        shared = np.full(9, STATED)
        found.append(Readings(t, value, shared, shared, label, np.zeros(9, dtype=np.int64)))
    return found


def test_the_common_mode_without_holes_is_the_mean_and_holes_do_not_move_it() -> None:
    rng = np.random.default_rng(SEED)
    effect, table = rng.normal(0.0, 5.0, 7), np.array([100.0, -40.0, 3.0])[None, :]
    whole = effect[:, None] + table
    np.testing.assert_allclose(common_mode(whole), whole.mean(axis=1))
    whole[2, 0] = whole[5, 1] = np.nan
    np.testing.assert_allclose(common_mode(whole), effect + table.mean(), atol=1e-6)


def test_certificates_by_the_whole_mixed_model() -> None:
    """Every unit and certificate in one covariance matrix, levels and drifts with all but flat priors."""
    everyone = units(np.random.default_rng(SEED))
    newest = 3
    rows = [unit.standard <= newest for unit in everyone]
    t = np.concatenate([unit.t[row] for unit, row in zip(everyone, rows, strict=True)])
    value = np.concatenate([unit.value[row] for unit, row in zip(everyone, rows, strict=True)])
    label = np.concatenate([unit.standard[row] for unit, row in zip(everyone, rows, strict=True)])
    owner = np.repeat(np.arange(len(everyone)), [int(row.sum()) for row in rows])
    known = [unit.of(row) for unit, row in zip(everyone, rows, strict=True)]
    variance = population(known, newest + 1).variance
    same_unit = np.equal.outer(owner, owner)
    covariance = variance * np.eye(t.size) + 1e7 * same_unit * (1.0 + np.outer(t, t))
    covariance += STATED**2 * (np.equal.outer(label, label) & (label < newest)[:, None])
    share = (label == newest).astype(float)
    weighted = np.linalg.solve(covariance, np.column_stack([share, value]))
    std = (share @ weighted[:, 0]) ** -0.5
    found = certificate_steps(everyone, np.full(CERTIFICATES, STATED), 100.0)
    assert found.std[newest] == pytest.approx(std, rel=1e-4)
    assert found.moved[newest] == pytest.approx(share @ weighted[:, 1] * std**2, abs=2e-3)
    assert found.expected_std[newest] == pytest.approx(np.hypot(std, STATED), rel=1e-4)


def test_the_scatter_of_units_does_not_hold_the_error_of_a_certificate() -> None:
    good, bad = (population(units(np.random.default_rng(SEED), wrong), CERTIFICATES) for wrong in (0.0, 1e4))
    assert bad.variance == pytest.approx(good.variance, rel=1e-6)
    assert good.freedom == 8 * 9 - 8 * 2 - (
        CERTIFICATES - 1
    )  # what all certificates have in common is a level of the units
    found = [population(units(np.random.default_rng(seed)), CERTIFICATES).variance for seed in range(20)]
    assert np.mean(found) == pytest.approx(UNIT_OWN**2, rel=0.1)


def test_a_certificate_that_no_unit_met_beside_another_is_not_judged() -> None:
    """Units that come back to the same bench each time, in its first year: anything may be."""
    rng = np.random.default_rng(SEED)
    t, shared = np.linspace(0.1, 0.9, 9), np.full(9, STATED)
    everyone = [
        Readings(t, rng.normal(300.0, UNIT_OWN, 9), shared, shared, np.full(9, number % 2), np.zeros(9, dtype=np.int64))
        for number in range(8)
    ]
    steps = certificate_steps(everyone, np.full(2, STATED), 3.5)
    assert np.isnan([steps.moved, steps.std, steps.expected_std, steps.score]).all()


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
CUSUM = {4.0: (168, 26.6, 8.38, 4.75, 3.34, 2.62, 2.19, 1.71), 5.0: (465, 38.0, 10.4, 5.75, 4.01, 3.11, 2.57, 2.01)}


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
    for length_of, limit in (
        (shewhart_run_length, limits.shewhart),
        (ewma_run_length, limits.ewma),
        (cusum_run_length, limits.cusum),
    ):
        assert 1.0 / false_rate(length_of, limit, dof, 1.0 / 600.0) == pytest.approx(600.0, rel=0.01)
    wider = limits_for(50.0, 4, dof - 2.0) if math.isfinite(dof) else limits_for(60.0, 4)
    assert wider.ewma > limits.ewma
    assert wider.cusum > limits.cusum


def test_false_signals_are_counted() -> None:
    """20,000 points in control on three charts of 100 points each: within 3 standard deviations of a count."""
    scores = np.random.default_rng(SEED).normal(size=(1000, 20))
    counts = signals_begun_again(scores, limits_for(100.0 / 3.0, 1))
    for kind in KINDS:
        assert abs(counts[kind] - 200) < 3.0 * 200**0.5
    # Drift, certificates and first phase of 12: no more false signals than declared; 3,000 points of 60 units.
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


OWN, SHARED, DRIFT, FIRST = 2.0, 10.0, 12.0, 12


def history(rng: np.random.Generator, count: int, per_certificate: int, step: float = 0.0, at: int = 0) -> Readings:
    """A unit that drifts, calibrated each quarter, with certificates that are off by what they state."""
    t, label = np.arange(count) / 4.0, (np.arange(count) // per_certificate).astype(np.int64)
    value = 300.0 + DRIFT * t + rng.normal(0.0, SHARED, label[-1] + 1)[label] + rng.normal(0.0, OWN, count)
    value[at:] += step * OWN
    std = np.full(count, math.hypot(OWN, SHARED))
    return Readings(t, value, std, np.full(count, SHARED), label, np.zeros(count, dtype=np.int64))


def signals_begun_again(scores: np.ndarray, limits: Limits) -> dict[str, int]:
    """Signals of each chart of scores (n,) or (n, series), each chart beginning again behind its own signals."""
    zero = np.zeros(scores.shape[1:])
    ewma, up, down = zero, zero, zero
    counts = dict.fromkeys(KINDS, 0)
    for row in scores:
        row = np.nan_to_num(row)
        ewma = (1.0 - EWMA_WEIGHT) * ewma + EWMA_WEIGHT * row
        up, down = np.maximum(0.0, up + row - CUSUM_REFERENCE), np.maximum(0.0, down - row - CUSUM_REFERENCE)
        beyond = {
            "shewhart": np.abs(row) > limits.shewhart,
            "ewma": np.abs(ewma) > limits.ewma * ewma_std(),
            "cusum": np.maximum(up, down) > limits.cusum,
        }
        for kind, hit in beyond.items():
            counts[kind] += int(np.sum(hit))
        ewma = np.where(beyond["ewma"], 0.0, ewma)
        up, down = (np.where(beyond["cusum"], 0.0, side) for side in (up, down))
    return counts


def run_lengths_of_histories(
    seed: int, histories: int, points: int, declared: float, per_certificate: int
) -> dict[str, float]:
    """Points for each false signal of a chart that is declared for ``declared`` points, by whole histories."""
    rng, counts = np.random.default_rng(seed), dict.fromkeys(KINDS, 0)
    for _ in range(histories):
        readings = history(rng, FIRST + points, per_certificate)
        scatter = first_phase(readings, FIRST)
        scores = predictions(readings, scatter).score[FIRST:]
        for kind, count in signals_begun_again(scores, limits_for(declared / len(KINDS), 1, scatter.dof)).items():
            counts[kind] += count
    return {kind: histories * points / max(count, 1) for kind, count in counts.items()}
