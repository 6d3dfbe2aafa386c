"""The joint fit of bias, hysteresis and thermal lag against simulated ramps and a second method."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from bias_simulation import K0_C, Ramp, WALK_A_rth, WHITE_A_rtHz, covariance, draw, follow, heat, ramp, slack
from scipy.optimize import least_squares

from bench.systems.af_converter.estimators.gates import Drive, series_covariance, usable_drive
from bench.systems.af_converter.estimators.hysteresis.fit import (
    HALF_WIDTH,
    HysteresisFit,
    branch_curves,
    crossed_over,
    fit_hysteresis,
    width_at,
)
from bench.systems.af_converter.estimators.hysteresis.model import (
    WIDTH,
    Gates,
    HysteresisModel,
    ModelShape,
    mean_of_walk,
)
from bench.systems.af_converter.estimators.hysteresis.search import Bounds

WIDTH_AT = 4


def fit_ramp(
    one: Ramp,
    *,
    drive: Drive | None = None,
    lag_s: tuple[float, float] = (120.0, 5400.0),
    shape: ModelShape | None = None,
    level: bool = True,
) -> HysteresisFit:
    """Joint fit of gated readings."""
    noise: Any = series_covariance(
        "gated",
        (one.start_s + one.end_s) / 2.0,
        one.end_s - one.start_s,
        K0_C[one.unit.kind],
        WHITE_A_rtHz,
        WALK_A_rth,
    )
    return fit_hysteresis(
        one.bias_A,
        Gates(one.start_s, one.end_s),
        drive or usable_drive(one.trace_t_s, one.air_degC),
        noise.whiten,
        shape=shape,
        bounds=Bounds(lag_s=lag_s),
        level=mean_of_walk(one.start_s, one.end_s, WALK_A_rth) if level else None,
    )


def truths(one: Ramp) -> np.ndarray:
    """True b0 to b3, width, lag and half-width, (7,)."""
    return np.array([*map(one.truth, range(4)), one.unit.width_A, one.unit.lag_s, one.unit.half_width_degC])


def scores(one: Ramp, fit: HysteresisFit) -> np.ndarray:
    """Errors over stated standard uncertainties, (7,)."""
    return (fit.parameters - truths(one)) / np.sqrt(np.diag(fit.covariance))


@cache
def fitted(seed: int, kind: str = "gyro") -> tuple[Ramp, HysteresisFit]:
    """Return a ramp and its fit, for several tests."""
    one = ramp(seed, kind)
    return one, fit_ramp(one)


@pytest.mark.validates(
    "joint fit: hysteresis width, mean error over 20 ramps",
    against="the truth of ramps made from charge and heat flow",
)
@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(K0_C))
def test_truth_over_twenty_seeds(record_property: Callable[[str, object], None], kind: str) -> None:
    """Bias within 4 nA, slope within 0.1 nA/degC, width, half-width and lag within 5 stated standard deviations."""
    width_errors = []
    for seed in range(20):
        one, fit = fitted(seed, kind)
        curve = np.array([one.truth(order) for order in range(4)])
        for at in (-10.0, 5.0, 20.0, 35.0, 50.0):
            error = np.polynomial.polynomial.polyval(at - 20.0, fit.parameters[:4] - curve)
            assert abs(error) < 4e-9, f"seed {seed}: {error * 1e9:.2f} nA at {at} degC"
        assert abs(fit.value("b1") - curve[1]) < 1e-10, f"seed {seed}"
        assert np.abs(scores(one, fit)[4:]).max() < 5.0, f"seed {seed}"
        assert fit.half_width_determined
        assert fit.lag_determined
        width_errors.append(fit.value(WIDTH) - one.unit.width_A)
    record_property("obtained", f"{kind}: {np.mean(width_errors) * 1e9:.2f} nA, limit 1")
    assert abs(np.mean(width_errors)) < 1e-9


@pytest.mark.validates(
    "joint fit: 95 % intervals of b0 to b3, width, lag, half-width",
    against="the truth of 40 simulated ramps, in the sweep of 500",
)
@pytest.mark.slow
def test_intervals_cover_the_truth(record_property: Callable[[str, object], None]) -> None:
    """40 fits: 95 % intervals cover 95 % within 3.2 standard deviations of a count; scores have the spread 1.

    An uncertainty off by the factor 1.6 is seen in 95 of 100 cases; test_coverage_over_500_fits sees one of 1.1.
    """
    found = np.array([scores(*fitted(seed)) for seed in range(40)])
    covered = np.mean(np.abs(found) < 1.96, axis=0)
    record_property("obtained", ", ".join(f"{100 * share:.0f}" for share in covered) + " %, at least 84")
    assert np.all(covered > 0.84)
    assert np.all((found.std(axis=0) > 0.7) & (found.std(axis=0) < 1.35))


@pytest.mark.validates(
    "joint fit: no hysteresis where there is none, though the unit lags",
    against="10 simulated ramps without hysteresis",
)
@pytest.mark.slow
def test_no_hysteresis_is_found_where_there_is_none(record_property: Callable[[str, object], None]) -> None:
    """The chamber lags all the same; the lag is still determined, the half-width is not."""
    found = []
    for seed in range(10):
        unit = draw(np.random.default_rng(seed), "gyro", hysteresis=False)
        one = ramp(seed, unit=unit)
        fit = fit_ramp(one)
        assert not fit.half_width_determined
        assert fit.lag_determined
        assert fit.std(HALF_WIDTH) > 1.0  # an average over all of them
        found.append(scores(one, fit)[:6])
    found_z = np.array(found)
    record_property(
        "obtained",
        f"95 % interval of the width holds 0 in {np.sum(np.abs(found_z[:, WIDTH_AT]) < 1.96)} of {len(found)}",
    )
    assert np.mean(np.abs(found_z[:, WIDTH_AT]) < 1.96) > 0.8
    assert np.abs(found_z).max() < 5.0


@pytest.mark.validates(
    "joint fit of bias, hysteresis and thermal lag",
    against="scipy.optimize.least_squares on all seven parameters with a model of its own",
)
def test_second_method_finds_the_same_minimum(record_property: Callable[[str, object], None]) -> None:
    """scipy.optimize.least_squares on all seven parameters, with its own model, from a start far away."""
    one = ramp(5)
    fit = fit_ramp(one, level=False)
    factor = np.linalg.inv(np.linalg.cholesky(covariance("gyro")))
    world = heat()
    air_degC = np.interp(world.t_s, one.trace_t_s, one.air_degC)  # as recorded, joined by straight lines
    places = world.windows[:-1, None] + np.arange(50)

    def model(p: np.ndarray) -> np.ndarray:
        unit = follow(air_degC, p[5] * 100.0)
        x = (unit[places] + unit[places + 1]).mean(axis=1) / 2.0
        behind = slack(unit, p[6]) - unit
        shape = (behind[places] + behind[places + 1]).mean(axis=1) / (4.0 * p[6])
        return np.polynomial.polynomial.polyval((x - 20.0) / 10.0, p[:4]) + p[4] * shape

    def white(p: np.ndarray) -> np.ndarray:
        return factor @ (one.bias_A - 1e-9 * model(p))

    start, bounds = [400.0, 10.0, 0.0, 0.0, 5.0, 10.0, 4.0], ([-999.0] * 5 + [1.0, 0.2], [999.0] * 5 + [60.0, 10.0])
    end = least_squares(white, start, bounds=bounds, x_scale=[1, 1, 1, 1, 1, 1, 0.1], diff_step=1e-4)
    scale = np.array([1e-9, 1e-10, 1e-11, 1e-12, 1e-9, 100.0, 1.0])
    np.testing.assert_allclose(fit.chi2, 2 * end.cost, rtol=1e-4)
    apart = np.abs(fit.parameters - end.x * scale) / np.sqrt(np.diag(fit.covariance))
    record_property("obtained", f"worst parameter {apart.max():.3f} of its standard uncertainty, limit 0.05")
    assert apart.max() < 0.05
    other = np.sqrt(np.diag(np.linalg.inv(end.jac.T @ end.jac))) * scale
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), other, rtol=0.1)


def test_without_noise_the_truth_comes_out() -> None:
    one = ramp(7, noise=False, quantised=False)
    fit = fit_ramp(one)
    for name, truth, tolerance in zip(
        fit.names, truths(one), (1e-11, 1e-12, 1e-14, 1e-15, 2e-11, 2, 0.01), strict=True
    ):
        assert abs(fit.value(name) - truth) < tolerance, name


def test_extra_columns_take_a_drift_out() -> None:
    one = ramp(9)
    hours = (one.start_s - one.start_s[0]) / 3600.0
    drifting = replace(one, bias_A=one.bias_A + 2e-9 * hours - 5e-11 * hours**2)
    columns = np.column_stack((hours, hours**2))
    shape = ModelShape(extra_columns=columns, extra_names=("per hour", "per hour2"))
    fit = fit_ramp(drifting, shape=shape)
    assert fit.names[5:7] == ("per hour", "per hour2")
    assert abs(fit.value("per hour") - 2e-9) < 4 * fit.std("per hour")
    assert abs(fit.value("per hour2") + 5e-11) < 4 * fit.std("per hour2")
    assert abs(fit.value(WIDTH) - one.unit.width_A) < 4 * fit.std(WIDTH)


def test_width_closes_at_the_ends_and_holds_the_covariance() -> None:
    """Its uncertainty between them is that of widths and half-widths drawn from their covariance."""
    one = ramp(10)
    fit = fit_ramp(one)
    low, high = fit.loop_degC
    twice = 2 * fit.value(HALF_WIDTH)
    assert width_at(fit, low) == (0.0, 0.0)
    assert width_at(fit, 20.0) == (fit.value(WIDTH), fit.std(WIDTH))
    value, std = width_at(fit, low + twice / 4)
    assert value == pytest.approx(fit.value(WIDTH) / 4)
    places, scale = [fit.names.index(WIDTH), fit.names.index(HALF_WIDTH)], np.array([1e9, 1.0])
    covariance = fit.covariance[np.ix_(places, places)] * np.outer(scale, scale)
    drawn = np.random.default_rng(0).multivariate_normal(fit.parameters[places] * scale, covariance, 200_000)
    assert std == pytest.approx(1e-9 * np.std(drawn[:, 0] * twice / 4 / (2 * drawn[:, 1])), rel=1e-3)
    assert width_at(fit, high - twice / 2)[0] == pytest.approx(fit.value(WIDTH) / 2)
    loop = np.concatenate((np.linspace(high, low, 4000), np.linspace(low, high, 4000), np.linspace(high, low, 4000)))
    literal = slack(loop, twice / 2)
    at = np.linspace(low, high, 25)
    rising, falling = branch_curves(fit, at)
    expected = np.interp(at, loop[:4000][::-1], literal[8000:][::-1]) - np.interp(
        at, loop[4000:8000], literal[4000:8000]
    )
    np.testing.assert_allclose(falling - rising, fit.value(WIDTH) / twice * expected, atol=2e-11)


def test_windows_after_a_reversal_are_marked() -> None:
    one = ramp(11)
    fit = fit_ramp(one)
    crossing = ~crossed_over(fit)
    minutes = 2 * one.unit.half_width_degC / 0.1  # at 0.1 degC/min, and what the lag adds at each turn
    assert crossing[72:432].sum() * 100 / 60 == pytest.approx(minutes + 25, abs=8)
    assert not crossing[200:432].any()


def test_start_of_the_play_matters_only_without_preparation() -> None:
    one = ramp(12)
    ends = [fit_ramp(one, shape=ModelShape(play_start=start)).parameters for start in (1.0, -1.0)]
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-4)
    after = one.trace_t_s >= one.start_s[0]
    drive = Drive(one.trace_t_s[after], one.air_degC[after])
    models = [HysteresisModel(Gates(one.start_s, one.end_s), drive, ModelShape(play_start=s)) for s in (1.0, -1.0)]
    first, second = (model.shape_column(1500.0, 2.5) for model in models)
    assert first[0] == pytest.approx(0.5, abs=0.01)
    assert second[0] == pytest.approx(-0.5, abs=0.01)
    np.testing.assert_allclose(first[300:], second[300:], atol=1e-9)


@pytest.mark.sweep
@pytest.mark.parametrize(("kind", "hysteresis"), [("gyro", True), ("accelerometer", True), ("gyro", False)])
def test_coverage_over_500_fits(kind: str, hysteresis: bool) -> None:
    """95 % intervals cover 95 +- 3 %; without hysteresis the half-width has none, and the others 95 +- 4 %."""
    found = []
    for seed in range(500):
        unit = draw(np.random.default_rng([7, seed]), kind, hysteresis=hysteresis)
        one = ramp(1000 + seed, unit=unit)
        found.append(scores(one, fit_ramp(one)))
    covered = np.mean(np.abs(np.array(found)) < 1.96, axis=0)[: 7 if hysteresis else 6]
    print(f"{kind}, hysteresis {hysteresis}: covered {covered}")
    assert np.all(np.abs(covered - 0.95) <= (0.03 if hysteresis else 0.04))
