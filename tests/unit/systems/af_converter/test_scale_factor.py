"""The fit of one channel at one temperature, by independent methods; the master oscillator over temperature."""

import dataclasses
from collections.abc import Callable
from dataclasses import replace

import fit_simulation as sim
import numpy as np
import pytest
import scipy.optimize
from one_estimate import every, score

from bench.model.errors import FitError
from bench.systems.af_converter.estimators.oscillator import (
    FIT,
    GENERATOR,
    SENSOR,
    OscillatorFit,
    OscillatorWindows,
    fit_oscillator,
)
from bench.systems.af_converter.estimators.readings import Converter, RangeSpecification, Readings
from bench.systems.af_converter.estimators.scale_factor import ScaleFactor, fit_scale_factor
from bench.systems.af_converter.groups import group_rows

STANDARD = {full: RangeSpecification(20e-6, floor) for full, floor in sim.FLOOR_A.items()}
IDEAL = sim.Switches(gain=False, calibrator_errors=False, noise=False, quantised=False, lag=False)
CONVERTER = {kind: Converter(sim.KIND[kind]["k0_C"], sim.F_AF0_Hz, **sim.NOISE) for kind in sim.KIND}


def one_group(seed: int, switches: sim.Switches, kind: str = "gyro") -> tuple[Readings, np.ndarray]:
    """Closed rows of one channel at 20 degC, and the true scale-factor errors there."""
    campaign = sim.simulate(seed, switches, {1: kind}, temperatures=(20.0,))
    closed = group_rows(campaign.rows, sim.MASTER_Hz)[0].closed
    return closed, campaign.units[1].dsf(float(closed.unit_temperature_degC.mean()))


def fit(rows: Readings, kind: str = "gyro", method: str = "gls") -> ScaleFactor:
    return fit_scale_factor(rows, CONVERTER[kind], STANDARD, method)


@pytest.mark.parametrize("kind", ["gyro", "accelerometer"])
@pytest.mark.parametrize("method", ["gls", "paper", "ols"])
def test_ideal_rows_are_recovered_exactly_by_every_method(kind: str, method: str) -> None:
    rows, truth = one_group(3, IDEAL, kind)
    np.testing.assert_allclose(fit(rows, kind, method).dsf_ppm, truth, atol=1e-6)


def closed_form_ppm(rows: Readings, level_A: float) -> np.ndarray:
    """Equations (6) and (9) of one level, solved as two equations in K_N and K_P; an independent second method."""
    ratio = sim.F_AF0_Hz * rows.gate_s / rows.af_count
    c_n, c_p = rows.n_count / rows.gate_s * ratio, rows.p_count / rows.gate_s * ratio
    matrix = []
    for sign in (1, -1):
        at = np.flatnonzero((rows.polarity == sign) & (rows.level_A == level_A))[0]
        zero = np.flatnonzero((rows.polarity == sign) & (rows.level_A == 0))[0]
        matrix.append([c_n[at] - c_n[zero], -(c_p[at] - c_p[zero])])
    k = np.linalg.solve(np.array(matrix), [level_A, -level_A])
    return np.asarray(1e6 * (k / sim.KIND["gyro"]["k0_C"] - 1))


@pytest.mark.validates(
    "AF paper (4) to (9), (7) corrected: joint model of one group",
    against="each level's two equations solved for K_N and K_P on their own",
)
@pytest.mark.parametrize("level_A", sim.KIND["gyro"]["levels_A"])
def test_the_papers_differences_solved_level_by_level_agree(
    record_property: Callable[[str, object], None], level_A: float
) -> None:
    rows, _ = one_group(5, IDEAL)
    closed = closed_form_ppm(rows, level_A)
    record_property("obtained", f"{level_A:g} A: {np.max(np.abs(closed - fit(rows).dsf_ppm)):.1e} ppm")
    np.testing.assert_allclose(closed, fit(rows).dsf_ppm, atol=1e-5)


@pytest.mark.validates(
    "AF paper (10) and (11), signs corrected",
    against="the equations stacked as printed in the decision record and solved by numpy.linalg.lstsq",
)
def test_ols_is_equation_10_stacked(record_property: Callable[[str, object], None]) -> None:
    rows, _ = one_group(6, sim.Switches())
    ratio = sim.F_AF0_Hz * rows.gate_s / rows.af_count
    c = np.column_stack([rows.n_count, -rows.p_count]) * (ratio / rows.gate_s)[:, None]
    stacked, current = [], []
    for at in np.flatnonzero(rows.level_A > 0):
        zero = np.flatnonzero((rows.polarity == rows.polarity[at]) & (rows.level_A == 0))[0]
        stacked.append(c[at] - c[zero])
        current.append(rows.polarity[at] * rows.level_A[at])
    for method, weight in (("ols", np.ones(12)), ("paper", 1 / np.abs(current))):
        k, *_ = np.linalg.lstsq(np.array(stacked) * weight[:, None], np.array(current) * weight)
        expected = 1e6 * (k / sim.KIND["gyro"]["k0_C"] - 1)
        found = fit(rows, method=method).dsf_ppm
        record_property("obtained", f"{method}: {np.max(np.abs(found - expected)):.1e} ppm, limit 1e-6")
        np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.validates(
    "generalised least squares of one group, value and covariance",
    against="every offset and linearity error as an unknown with a prior, minimised by scipy.optimize",
)
def test_gls_agrees_with_a_numerical_search_over_every_unknown(record_property: Callable[[str, object], None]) -> None:
    """Second method: offsets and linearity errors as unknowns with priors, minimised by scipy.optimize."""
    rows, _ = one_group(8, sim.Switches())
    quiet = dataclasses.replace(CONVERTER["gyro"], walk_A_rth=0.0)
    result = fit_scale_factor(rows, quiet, STANDARD)
    ratio = sim.F_AF0_Hz * rows.gate_s / rows.af_count
    n_A, p_A = (quiet.k0_C * count * ratio / rows.gate_s for count in (rows.n_count, rows.p_count))
    relative_clock = 1 / (np.sqrt(6) * rows.af_count)
    quantum_A = quiet.k0_C / rows.gate_s
    variance = quantum_A**2 / 6 + 2e-9**2 / 200 + ((n_A - p_A) * relative_clock / ratio) ** 2
    ranges, levels = sorted(set(rows.range_A)), sorted(set(rows.level_A) - {0.0})
    prior_A = np.array([STANDARD[one].floor_A / 2 for one in ranges])
    linear_A = np.array([STANDARD[sim.smallest_range(one)].floor_A / 2 for one in levels])

    def misfit(x: np.ndarray) -> np.ndarray:
        dsf_n, dsf_p, plus_nA, minus_nA = x[:4]
        b, e = x[4 : 4 + len(ranges)], x[4 + len(ranges) :]
        counted = n_A * (1 + 1e-6 * dsf_n) - p_A * (1 + 1e-6 * dsf_p)
        offset = np.where(rows.polarity > 0, plus_nA, minus_nA) * 1e-9
        b_row = np.array([b[ranges.index(one)] * prior_A[ranges.index(one)] for one in rows.range_A])
        e_row = np.array([e[levels.index(one)] * linear_A[levels.index(one)] if one else 0.0 for one in rows.level_A])
        expected = rows.polarity * (rows.level_A + b_row + e_row) + offset
        return np.concatenate([(counted - expected) / np.sqrt(variance), b, e])

    start = np.zeros(4 + len(ranges) + len(levels))
    slopes = np.column_stack([misfit(unit) - misfit(start) for unit in 1e3 * np.eye(start.size)]) / 1e3
    found = scipy.optimize.least_squares(
        misfit, start, jac=lambda _x: slopes, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    record_property("obtained", f"{np.max(np.abs(found.x[:2] - result.dsf_ppm)):.1e} ppm, limit 1e-4")
    np.testing.assert_allclose(found.x[:2], result.dsf_ppm, atol=1e-4)
    assert 2 * found.cost == pytest.approx(result.chi2, rel=1e-6)
    spread = np.linalg.inv(found.jac.T @ found.jac)[:2, :2]
    np.testing.assert_allclose(spread, result.covariance_ppm2, rtol=1e-5)


def test_gain_is_ten_ppm_on_both_and_cancels_in_the_asymmetry() -> None:
    rows, _ = one_group(2, sim.Switches())
    gain_ppm = fit(rows).gains_ppm["gain"]
    np.testing.assert_allclose(gain_ppm, 10.0, atol=0.02)
    assert abs(gain_ppm[0] - gain_ppm[1]) < 0.02


def test_corrections_of_the_certificate_are_applied() -> None:
    rows, truth = one_group(4, IDEAL)
    wrong = {full: dataclasses.replace(one, gain=-50e-6, offset_A=0.0) for full, one in STANDARD.items()}
    np.testing.assert_allclose(fit_scale_factor(rows, CONVERTER["gyro"], wrong).dsf_ppm, truth - 50.0, atol=0.1)
    shifted = dataclasses.replace(rows, n_count=rows.n_count * 1.0)
    delivered = {full: dataclasses.replace(one, offset_A=2e-9) for full, one in STANDARD.items()}
    moved = fit_scale_factor(shifted, CONVERTER["gyro"], delivered)
    np.testing.assert_allclose(moved.dsf_ppm, truth, atol=1e-4)  # the same offset everywhere is a zero offset


def test_rows_that_are_not_finite_are_dropped_and_counted() -> None:
    rows, truth = one_group(9, IDEAL)
    count = rows.n_count.copy()
    count[6] = np.nan
    result = fit(dataclasses.replace(rows, n_count=count))
    assert (result.n, result.dropped) == (13, 1)
    assert np.isnan(result.residual_A[6])
    np.testing.assert_allclose(result.dsf_ppm, truth, atol=1e-6)


def test_what_does_not_determine_both_charges_is_refused() -> None:
    """One polarity, also with the zero of the other one; too few rows; a zero for the methods that begin from it."""
    rows, _ = one_group(1, sim.Switches())
    zero = (rows.polarity < 0) & (rows.level_A == 0)
    for kept, method, code, said in (
        (rows.polarity == 1, "gls", "B-FIT-005", "K_P is not determined"),
        (rows.polarity == -1, "gls", "B-FIT-005", "K_N is not determined"),
        ((rows.polarity > 0) | (rows.level_A == 0), "gls", "B-FIT-005", "K_P is not determined"),
        (rows.level_A == 1e-3, "gls", "B-FIT-001", None),
        (~zero, "paper", "B-FIT-006", "the -0 row"),
        (rows.level_A >= 0, "wls", "B-FIT-004", "wls"),
    ):
        with pytest.raises(FitError, match=said) as caught:
            fit(rows.take(kept), method=method)
        assert caught.value.code == code
    assert fit(rows.take(~zero)).n == 13
    with pytest.raises(FitError) as caught:
        fit_scale_factor(rows, CONVERTER["gyro"], {2.2e-4: STANDARD[2.2e-4]})
    assert caught.value.code == "B-FIT-003"


GAIN_OFF_LIMIT_ppm = 8.0


def worst_ppm(rows: Readings, truth: np.ndarray, method: str = "gls") -> float:
    return float(np.max(np.abs(fit(rows, method=method).dsf_ppm - truth)))


@pytest.mark.validates(
    "misprint of AF paper (7): the positive zero is not taken for the negative one",
    against="counts made from the physics, no noise, offset 6 nA",
)
def test_positive_zero_used_as_negative_zero(record_property: Callable[[str, object], None]) -> None:
    """Equation (7) as printed would be off by more than 40 ppm."""
    rows, truth = one_group(7, dataclasses.replace(IDEAL, offset_A=6e-9, zero_in_every_range=True))
    record_property("obtained", f"{worst_ppm(rows, truth, 'paper'):.1e} ppm off")
    assert worst_ppm(rows, truth, "paper") < 0.01
    assert worst_ppm(rows, truth) < 0.01


@pytest.mark.validates(
    "AF paper (1): clock ratio r applied to every count",
    against="counts made with both clocks off by 50 ppm",
)
@pytest.mark.parametrize("clock", ["af_error", "master_error"])
@pytest.mark.parametrize("error", [50e-6, -50e-6])
def test_clock_ratio_left_out(clock: str, error: float) -> None:
    """Acceptance: 50 ppm of clock error changes DSF by less than 0.1 ppm; without r by about 50 ppm."""
    exact, truth = one_group(12, IDEAL)
    off, _ = one_group(12, dataclasses.replace(IDEAL, **{clock: error + getattr(IDEAL, clock)}))
    assert np.max(np.abs(fit(off).dsf_ppm - fit(exact).dsf_ppm)) < 0.1
    assert worst_ppm(off, truth) < GAIN_OFF_LIMIT_ppm


def test_clock_error_has_no_mean_effect_on_quantised_counts() -> None:
    """Other clocks cut the pulses elsewhere, which scatters each gyro result by 0.45 ppm, but the mean stays."""
    gated = dataclasses.replace(IDEAL, quantised=True)
    faster = dataclasses.replace(gated, af_error=70e-6, master_error=-48.5e-6)
    pairs = [(one_group(seed, faster), one_group(seed + 5000, gated)) for seed in range(300)]
    errors = [[fit(rows).dsf_ppm - truth for rows, truth in pair] for pair in pairs]
    changes = np.array([now - then for now, then in errors])
    assert abs(changes.mean()) < 0.1
    assert changes.std() == pytest.approx(0.45, abs=0.05)


def test_biases_are_true() -> None:
    campaign = sim.simulate(13, sim.Switches(), {1: "gyro", 2: "accelerometer"})
    biases = every(sim.analysed(campaign), "bias")
    assert len(biases) == 10
    assert max(abs(score(one, campaign.truth(one))) for one in biases) < 4.0


FG_Hz, GATE_s, REFERENCE_degC = 1e7, 100.0, 20.0
TRUTH_ppm = (1.5, 0.013, 0.0, 4.7e-5)  # about 20 degC
GENERATOR_ppm = 3.0 / np.sqrt(3.0)


def counted(rng, generator_ppm: float = 0.0, noise_degC: float = 0.0, flicker_ppm: float = 0.0) -> OscillatorWindows:
    """The unit opens its gate for 1e9 pulses of its own clock; generator pulses are whole, none is counted twice."""
    corners_h, degC = [0, 2, 12, 13, 23, 25], [-10.0, -10, 50, 50, -10, -10]  # hold, up, hold, down, hold
    unit = np.interp((np.arange(900) + 0.5) * GATE_s / 3600.0, corners_h, degC)
    error = np.polynomial.polynomial.polyval(unit - REFERENCE_degC, TRUTH_ppm) * 1e-6
    error = error + flicker_ppm * 1e-6 * rng.standard_normal(unit.size)
    seconds = GATE_s / (1.0 + error)  # true length of a gate of 1e9 master pulses
    # pulses beyond 1e9 a window, so that nothing is lost to rounding
    beyond = seconds * FG_Hz * (1.0 + generator_ppm * 1e-6) - FG_Hz * GATE_s
    edges = np.floor(np.concatenate(([0.0], np.cumsum(beyond))) + rng.uniform())
    return OscillatorWindows(
        times_s=(np.arange(unit.size) + 0.5) * GATE_s,
        gate_s=np.full(unit.size, GATE_s),
        fg_count=np.diff(edges) + FG_Hz * GATE_s,
        unit_degC=unit + noise_degC * rng.standard_normal(unit.size),
        contiguous=np.arange(unit.size) > 0,
    )


AT_20, LINEAR = np.eye(4)[:2]  # weights of the coefficients: value at the reference, slope there


def errors(fit: OscillatorFit) -> np.ndarray:
    return fit.coefficients_ppm - np.array(TRUTH_ppm)


@pytest.mark.validates(
    "AF paper 4.1: master oscillator over temperature",
    against="whole generator pulses counted between two clocks whose phases are integrated",
)
def test_residual_and_interval(record_property: Callable[[str, object], None]) -> None:
    """Resolution 1e-9: the fit is good to a few 1e-4 ppm, the generator decides the interval."""
    fit = fit_oscillator(counted(np.random.default_rng(1)), FG_Hz)
    parts = fit.components_ppm(AT_20)
    record_property("obtained", f"residual {fit.rms_ppm:.1e} ppm, at 20 degC {errors(fit)[0]:.0e} ppm off")
    assert fit.rms_ppm < 0.02
    assert fit.rms_ppm == pytest.approx(1e-3 / np.sqrt(6.0), rel=0.1)
    assert parts[GENERATOR] == pytest.approx(GENERATOR_ppm)
    assert parts[FIT] < 1e-3 * parts[GENERATOR]
    assert abs(errors(fit)[0]) <= 5 * parts[FIT]
    assert fit.std_ppm(AT_20) == pytest.approx(GENERATOR_ppm, rel=1e-6)
    assert fit.std_ppm(LINEAR) < 1e-4
    assert (fit.n_used, fit.n_dropped, fit.span_degC) == (900, 0, (-10.0, 50.0))


@pytest.mark.validates(
    "95 % intervals of the oscillator's coefficients",
    against="the truth of 200 simulated ramps, without and with noise of the sensor and of the oscillator",
)
@pytest.mark.parametrize(
    ("noise_degC", "flicker_ppm"), [(0.0, 0.0), (0.02, 0.0), (0.0, 2e-3)], ids=["counts alone", "sensor", "oscillator"]
)
def test_intervals_of_the_coefficients_cover(
    record_property: Callable[[str, object], None], noise_degC: float, flicker_ppm: float
) -> None:
    rng = np.random.default_rng(300)
    fits = [fit_oscillator(counted(rng, 0.0, noise_degC, flicker_ppm), FG_Hz) for _ in range(200)]
    scaled = np.array([errors(fit) / np.sqrt(np.diag(fit.covariance_ppm2)) for fit in fits])
    covered = 100.0 * np.mean(np.abs(scaled) < 1.96, axis=0)
    record_property("obtained", f"{noise_degC} degC, {flicker_ppm} ppm: {covered.min():.1f} to {covered.max():.1f} %")
    assert (covered >= 91.0).all()  # 200 fits: sd 1.5 %


def test_the_generator_moves_the_constant_alone() -> None:
    right = fit_oscillator(counted(np.random.default_rng(2)), FG_Hz)
    high = fit_oscillator(counted(np.random.default_rng(2), generator_ppm=2.5), FG_Hz)
    shift = high.coefficients_ppm - right.coefficients_ppm
    assert shift[0] == pytest.approx(-2.5, abs=1e-3)
    assert np.abs(shift[1:]).max() < 5 * right.std_ppm(LINEAR)
    assert abs(errors(high)[0]) < 1.96 * high.std_ppm(AT_20)
    stated = fit_oscillator(counted(np.random.default_rng(2)), FG_Hz, generator_std=1e-7)
    assert stated.std_ppm(AT_20) == pytest.approx(0.1, rel=1e-3)


def test_an_offset_of_the_sensor_is_within_its_component() -> None:
    """By hand, c_k (T - d) = ...: d moves c1 by 2 c2 d and c2 by 3 c3 d."""
    windows = counted(np.random.default_rng(3))
    fit = fit_oscillator(replace(windows, unit_degC=windows.unit_degC + 0.5), FG_Hz, sensor_std_degC=0.5)
    for order in range(3):
        part = fit.components_ppm(np.eye(4)[order])[SENSOR]
        assert abs(errors(fit)[order]) == pytest.approx(part, rel=0.1, abs=1e-4), order
        expected = (order + 1) * abs(fit.coefficients_ppm[order + 1]) * 0.5
        assert part == pytest.approx(expected, rel=1e-12), order
    weights = 30.0 ** np.arange(4)
    assert abs(weights @ errors(fit)) == pytest.approx(fit.components_ppm(weights)[SENSOR], rel=0.1)


def test_too_low_a_degree_shows() -> None:
    windows = counted(np.random.default_rng(4))
    cubic, straight = (fit_oscillator(windows, FG_Hz, order=order) for order in (3, 1))
    assert straight.rms_ppm > max(0.1, 10.0 * cubic.rms_ppm)


def test_windows_without_generator_or_temperature_are_dropped() -> None:
    windows = counted(np.random.default_rng(5))
    windows.fg_count[100:120] = 0
    windows.unit_degC[300] = np.nan
    windows.gate_s[301] = 0.0
    fit = fit_oscillator(windows, FG_Hz)
    assert (fit.n_used, fit.n_dropped) == (878, 22)
    assert np.isnan(fit.residual_ppm[[100, 300, 301]]).all()
    assert fit.rms_ppm < 0.001
    windows.contiguous[[120, 302]] = False
    stated = fit_oscillator(windows, FG_Hz)
    assert np.array_equal(stated.covariance_ppm2, fit.covariance_ppm2), "a window after a gap shares no cut"


@pytest.mark.parametrize("mistake", ["generator off", "one temperature"])
def test_a_degree_the_windows_do_not_determine_is_refused(mistake: str) -> None:
    windows = counted(np.random.default_rng(6))
    if mistake == "generator off":
        windows.fg_count[3:] = 0
    else:
        windows.unit_degC[:] = 20.0 + 0.01 * np.sin(windows.times_s)
    with pytest.raises(FitError, match=r"B-FIT-026: .*do not determine a polynomial of degree 3"):
        fit_oscillator(windows, FG_Hz)


def test_residuals_that_hang_together_widen_the_interval() -> None:
    """A flicker of one hour: the interval of the constant holds its scatter over 40 seeds within a factor of 1.6."""
    found = []
    for seed in range(40):
        rng = np.random.default_rng([12, seed])
        windows = counted(rng)
        slow = np.zeros(windows.unit_degC.size)
        for k in range(1, slow.size):
            slow[k] = 0.97 * slow[k - 1] + 0.05e-6 * rng.standard_normal()
        fit = fit_oscillator(replace(windows, fg_count=windows.fg_count * (1.0 - slow)), FG_Hz)
        found.append((errors(fit)[0], fit.components_ppm(AT_20)[FIT]))
    error, stated = np.array(found).T
    assert 1 / 1.6 < np.std(error) / np.sqrt(np.mean(stated**2)) < 1.6
