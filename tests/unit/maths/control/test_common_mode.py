"""The common mode of units against a mixed model solved whole, and wrong certificates among units that drift."""

from __future__ import annotations

import numpy as np
import pytest

from bench.maths.control.common_mode import certificate_steps, common_mode, population
from bench.maths.control.predictions import Readings
from bench.maths.drift import NO_STANDARD

SEED, CERTIFICATES, STATED, OWN = 23, 6, 10.0, 2.0


def units(rng: np.random.Generator, wrong: float = 0.0, count: int = 8) -> list[Readings]:
    """Units with drifts of their own over six years, a certificate each year; that of the fifth may be wrong."""
    errors = rng.normal(0.0, STATED, CERTIFICATES)
    errors[4] += wrong
    found = []
    for _ in range(count):
        t = np.sort(rng.uniform(0.0, CERTIFICATES, 9))
        label = np.floor(t).astype(np.int64)
        value = rng.normal(0.0, 300.0) + rng.normal(0.0, 20.0) * t + errors[label] + rng.normal(0.0, OWN, 9)
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
    assert np.mean(found) == pytest.approx(OWN**2, rel=0.1)


def test_scores_are_standard_normal_while_certificates_hold_what_they_state() -> None:
    stated = np.full(CERTIFICATES, STATED)
    scores = np.array([certificate_steps(units(np.random.default_rng(seed)), stated, 5.0).score for seed in range(100)])
    assert np.isnan(scores[:, 0]).all()
    known = scores[:, 3:]  # before that some histories leave too little
    print(f"means {known.mean(axis=0)}, standard deviations {known.std(axis=0)}")
    assert np.abs(known.mean(axis=0)).max() < 4.0 / 100**0.5
    assert np.abs(known.std(axis=0) - 1.0).max() < 0.25


def test_one_wrong_certificate_is_found_and_the_next_one_is_not_blamed() -> None:
    stated = np.full(CERTIFICATES, STATED)
    beyond = np.zeros(CERTIFICATES)
    for seed in range(40):
        steps = certificate_steps(units(np.random.default_rng(seed), 60.0), stated, 3.5)
        beyond += np.abs(np.nan_to_num(steps.score)) > 3.5
    print(f"of 40 histories beyond 3.5: {beyond}")
    assert beyond[4] >= 34
    assert beyond[[0, 1, 2, 3, 5]].sum() <= 1


def test_units_without_a_standard_have_a_scatter_all_the_same() -> None:
    alone = [
        Readings(*list(vars(unit).values())[:4], np.full(9, NO_STANDARD), unit.level)
        for unit in units(np.random.default_rng(SEED))
    ]
    known = population(alone, 0)
    assert known.freedom == 8 * 7
    assert known.variance > OWN**2


def test_a_certificate_that_no_unit_met_beside_another_is_not_judged() -> None:
    """Units that come back to the same bench each time, in its first year: anything may be."""
    rng = np.random.default_rng(SEED)
    t, shared = np.linspace(0.1, 0.9, 9), np.full(9, STATED)
    everyone = [
        Readings(t, rng.normal(300.0, OWN, 9), shared, shared, np.full(9, number % 2), np.zeros(9, dtype=np.int64))
        for number in range(8)
    ]
    steps = certificate_steps(everyone, np.full(2, STATED), 3.5)
    assert np.isnan([steps.moved, steps.std, steps.expected_std, steps.score]).all()
