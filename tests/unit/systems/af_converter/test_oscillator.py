"""Master oscillator over temperature: against whole pulses counted between two clocks whose phases are integrated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bench.model.errors import FitError
from bench.systems.af_converter.estimators.oscillator import (
    FIT,
    GENERATOR,
    SENSOR,
    OscillatorFit,
    OscillatorWindows,
    fit_oscillator,
)

FG_Hz, GATE_s, REFERENCE_degC = 1e7, 100.0, 20.0
TRUTH_ppm = (1.5, 0.013, 0.0, 4.7e-5)  # about 20 degC
GENERATOR_ppm = 3.0 / np.sqrt(3.0)


def temperatures() -> np.ndarray:
    """900 windows of the bias ramp: hold, up, hold, down, hold."""
    corners_h, degC = [0, 2, 12, 13, 23, 25], [-10.0, -10, 50, 50, -10, -10]
    return np.interp((np.arange(900) + 0.5) * GATE_s / 3600.0, corners_h, degC)


def counted(rng, generator_ppm: float = 0.0, noise_degC: float = 0.0, flicker_ppm: float = 0.0) -> OscillatorWindows:
    """The unit opens its gate for 1e9 pulses of its own clock; generator pulses are whole, none is counted twice."""
    unit = temperatures()
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


def errors(fit: OscillatorFit) -> np.ndarray:
    return fit.coefficients_ppm - np.array(TRUTH_ppm)


@pytest.mark.validates(
    "AF paper 4.1: master oscillator over temperature",
    against="whole generator pulses counted between two clocks whose phases are integrated",
)
def test_residual_and_interval(record_property: Callable[[str, object], None]) -> None:
    """Resolution 1e-9: the fit is good to a few 1e-4 ppm, the generator decides the interval."""
    fit = fit_oscillator(counted(np.random.default_rng(1)), FG_Hz)
    parts = fit.components_ppm(20.0)
    print(f"residual {fit.rms_ppm:.2e} ppm, fit {parts[FIT]:.1e}, generator {parts[GENERATOR]:.3f} ppm")
    record_property(
        "obtained", f"residual {fit.rms_ppm:.1e} ppm, at 20 degC {fit.value_ppm(20.0) - TRUTH_ppm[0]:.0e} ppm off"
    )
    assert fit.rms_ppm < 0.02
    assert fit.rms_ppm == pytest.approx(1e-3 / np.sqrt(6.0), rel=0.1)
    assert parts[GENERATOR] == pytest.approx(GENERATOR_ppm)
    assert parts[FIT] < 1e-3 * parts[GENERATOR]
    assert fit.value_ppm(20.0) == pytest.approx(TRUTH_ppm[0], abs=5 * parts[FIT])
    assert fit.std_ppm(20.0) == pytest.approx(GENERATOR_ppm, rel=1e-6)
    assert fit.coefficient_std_ppm(0) == pytest.approx(GENERATOR_ppm, rel=1e-6)
    assert fit.coefficient_std_ppm(1) < 1e-4
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
    print("covered %", covered, "reduced chi-square", np.mean([fit.reduced_chi2 for fit in fits]))
    record_property("obtained", f"{noise_degC} degC, {flicker_ppm} ppm: {covered.min():.1f} to {covered.max():.1f} %")
    assert (covered >= 91.0).all()  # 200 fits: sd 1.5 %


def test_the_generator_moves_the_constant_alone() -> None:
    right = fit_oscillator(counted(np.random.default_rng(2)), FG_Hz)
    high = fit_oscillator(counted(np.random.default_rng(2), generator_ppm=2.5), FG_Hz)
    shift = high.coefficients_ppm - right.coefficients_ppm
    assert shift[0] == pytest.approx(-2.5, abs=1e-3)
    assert np.abs(shift[1:]).max() < 5 * right.coefficient_std_ppm(1)
    assert abs(errors(high)[0]) < 1.96 * high.coefficient_std_ppm(0)
    stated = fit_oscillator(counted(np.random.default_rng(2)), FG_Hz, generator_std=1e-7)
    assert stated.std_ppm(20.0) == pytest.approx(0.1, rel=1e-3)


def test_an_offset_of_the_sensor_is_within_its_component() -> None:
    """By hand, c_k (T - d) = ...: d moves c1 by 2 c2 d and c2 by 3 c3 d."""
    windows = counted(np.random.default_rng(3))
    fit = fit_oscillator(replace(windows, unit_degC=windows.unit_degC + 0.5), FG_Hz, sensor_std_degC=0.5)
    for order in range(3):
        part = fit.coefficient_components_ppm(order)[SENSOR]
        assert abs(errors(fit)[order]) == pytest.approx(part, rel=0.1, abs=1e-4), order
        expected = (order + 1) * abs(fit.coefficients_ppm[order + 1]) * 0.5
        assert part == pytest.approx(expected, rel=1e-12), order
    missed = fit.value_ppm(50.0) - np.polynomial.polynomial.polyval(30.0, TRUTH_ppm)
    assert abs(missed) == pytest.approx(fit.components_ppm(50.0)[SENSOR], rel=0.1)


def test_too_low_a_degree_shows() -> None:
    windows = counted(np.random.default_rng(4))
    cubic, straight = (fit_oscillator(windows, FG_Hz, order=order) for order in (3, 1))
    print(f"next order: cubic {cubic.next_order_sigma:.1f}, straight line {straight.next_order_sigma:.1f}; "
          f"autocorrelation {straight.autocorrelation:.2f}")  # fmt: skip
    assert cubic.next_order_sigma < 4.0
    assert fit_oscillator(windows, FG_Hz, order=2).next_order_sigma > 10.0
    assert straight.autocorrelation > 0.9, "what a straight line leaves hangs together"
    assert straight.rms_ppm > 0.1


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
    with pytest.raises(FitError, match="do not determine a polynomial of degree 3") as caught:
        fit_oscillator(windows, FG_Hz)
    assert caught.value.code == "B-FIT-026"


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
        found.append((errors(fit)[0], fit.components_ppm(REFERENCE_degC)[FIT]))
    error, stated = np.array(found).T
    assert 1 / 1.6 < np.std(error) / np.sqrt(np.mean(stated**2)) < 1.6
