"""The fit of one thermometer: exact data, a second method, what the data tell of the cold coefficient."""

from __future__ import annotations

import numpy as np
import pytest
from bench.model.errors import FitError
from block import with_noise
from scipy.optimize import least_squares

from resistance_thermometer.system.estimators.callendar import fit_callendar
from resistance_thermometer.system.estimators.iec60751 import IEC_60751, Curve, ratio

OWN = Curve(a=3.9101e-3, b=-5.79e-7, c=-4.3e-12)
CHAMBER_DEGC = np.array([-40.0, -20.0, 0.0, 20.0, 40.0, 60.0, 80.0, 100.0])
CRYOSTAT_DEGC = np.array([-190.0, -140.0, -80.0, -40.0, 0.0, 50.0, 100.0, 200.0])
STD_OHM = 0.002


def covariance(t_degC: np.ndarray) -> np.ndarray:
    """Noise, and one error that all readings share."""
    return STD_OHM**2 * np.eye(t_degC.size) + 0.005**2 * np.outer(ratio(t_degC), ratio(t_degC))


def test_exact_readings_give_the_coefficients_back() -> None:
    fit = fit_callendar(CRYOSTAT_DEGC, 100.02 * ratio(CRYOSTAT_DEGC, OWN), covariance(CRYOSTAT_DEGC))
    assert fit.values == pytest.approx([100.02, OWN.a, OWN.b, OWN.c], rel=1e-9)
    assert (fit.chi2, fit.dof) == (pytest.approx(0.0, abs=1e-12), 4)


def test_a_second_method_finds_the_same() -> None:
    """Nonlinear least squares in R0, a, b, c, whitened, by scipy."""
    ohm = with_noise(100.02 * ratio(CRYOSTAT_DEGC, OWN), 1, STD_OHM)
    matrix = covariance(CRYOSTAT_DEGC)
    fit = fit_callendar(CRYOSTAT_DEGC, ohm, matrix)
    white = np.linalg.inv(np.linalg.cholesky(matrix))
    scale = np.array([100.0, 1e-3, 1e-7, 1e-12])

    def left(p: np.ndarray) -> np.ndarray:
        r0, a, b, c = p * scale
        return white @ (ohm - r0 * ratio(CRYOSTAT_DEGC, Curve(a, b, c)))

    found = least_squares(left, fit.values / scale * 1.001, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert fit.values == pytest.approx(found.x * scale, rel=1e-6)
    std = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac))) * scale
    assert fit.std == pytest.approx(std, rel=1e-3)
    assert fit.chi2 == pytest.approx(float(found.fun @ found.fun), rel=1e-6)


def test_the_cold_coefficient_is_held_where_the_chamber_cannot_tell_it() -> None:
    ohm = with_noise(100.02 * ratio(CHAMBER_DEGC, Curve(OWN.a, OWN.b)), 2, STD_OHM)
    fit = fit_callendar(CHAMBER_DEGC, ohm, covariance(CHAMBER_DEGC))
    assert fit.values.size == 3
    assert abs(IEC_60751.c) < fit.cold_std_per_degC4 < 100.0 * abs(IEC_60751.c)
    assert np.all(np.abs(fit.values - [100.02, OWN.a, OWN.b]) < 4.0 * fit.std)


def test_without_a_cold_point_nothing_is_said_of_the_cold_coefficient() -> None:
    warm = CHAMBER_DEGC[2:]
    fit = fit_callendar(warm, 100.0 * ratio(warm), covariance(warm))
    assert fit.values.size == 3
    assert np.isinf(fit.cold_std_per_degC4)


def test_intervals_hold() -> None:
    """Of 400 thermometers about 95 % of R0, a and b lie inside their intervals, and chi-square is what it should be."""
    inside, chi2 = np.zeros(3), 0.0
    truth = np.array([100.02, OWN.a, OWN.b])
    rng = np.random.default_rng(3)
    for _ in range(400):
        readings = 100.02 * ratio(CHAMBER_DEGC, Curve(OWN.a, OWN.b))
        readings = readings + rng.normal(0.0, STD_OHM, 8) + 0.005 * rng.normal() * ratio(CHAMBER_DEGC)
        fit = fit_callendar(CHAMBER_DEGC, readings, covariance(CHAMBER_DEGC))
        inside += np.abs(fit.values - truth) < 1.96 * fit.std
        chi2 += fit.chi2 / fit.dof
    assert np.all(np.abs(inside / 400.0 - 0.95) < 0.04)
    assert chi2 / 400.0 == pytest.approx(1.0, abs=0.12)


def test_too_few_temperatures_are_refused_rt_fit_001() -> None:
    few = CHAMBER_DEGC[:3]
    with pytest.raises(FitError, match="3 temperatures do not test three coefficients") as caught:
        fit_callendar(few, 100.0 * ratio(few), covariance(few))
    assert caught.value.code == "RT-FIT-001"


def test_points_at_one_temperature_determine_nothing() -> None:
    same = np.array([20.0, 20.0, 20.0, 20.0])
    with pytest.raises(FitError) as caught:
        fit_callendar(same, 100.0 * ratio(same), covariance(same))
    assert caught.value.code == "B-FIT-001"
