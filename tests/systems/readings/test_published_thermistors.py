"""Steinhart-Hart coefficients from published tables of thermistors, against the coefficients published with them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from bench.maths.arrays import Floats
from bench.systems.readings.estimators.polynomial import Curve, Points, fit_polynomial, function_of

# Campbell Scientific, 109SS temperature probe, instruction manual, table C-1: BetaTHERM 10K3MCD1, ohm.
BETATHERM_DEGC = np.arange(-40.0, 1.0, 5.0)
BETATHERM_OHM = np.array(
    [336103.2, 242430.2, 176804.8, 130307.6, 97006.9, 72911.1, 55303.9, 42316.7, 32650.9],
)  # fmt: skip
BETATHERM = [1.129241e-3, 2.341077e-4, 8.775468e-8]  # 1/T = A + B ln R + C (ln R)^3

# Geokon, 8002-4-1 instruction manual, table 16: U.S. Sensor 103JL1A, ohm; with A to D of 1, ln R, (ln R)^3, (ln R)^5.
US_SENSOR_DEGC = np.arange(-30.0, 101.0, 10.0)
US_SENSOR_OHM = np.array(
    [176974, 97081, 55329, 32650, 19901, 12493, 8057, 5326, 3602, 2488, 1752, 1255, 915.5, 678.6],
)  # fmt: skip
US_SENSOR = [1.12766979300187e-3, 2.34444184128213e-4, 8.47692130592308e-8, 1.17512193579615e-11]


def _exact(mean: Floats, std: float) -> Points:
    every = np.ones_like(mean)
    return Points(mean, std * every, np.nan * every, 0.0 * mean, 0.0 * mean, every)


def fitted(ohm: Floats, degC: Floats, powers: tuple[int, ...]) -> Curve:
    of_x, of_y = function_of("log", "ohm"), function_of("reciprocal", "degC")
    return fit_polynomial(of_x.points(_exact(ohm, 1e-9)), of_y.points(_exact(degC, 1e-3)), powers)


def degC_at(curve: Curve, ohm: Floats) -> Floats:
    return function_of("reciprocal", "degC").back(curve.at(np.log(ohm)))


@pytest.mark.validates("Steinhart-Hart coefficients of a thermistor", against="BetaTHERM's table and coefficients")
def test_betatherm(record_property: Callable[[str, object], None]) -> None:
    """The maker's coefficients are for more than this table, and 2.4 mK off at its cold end."""
    curve = fitted(BETATHERM_OHM, BETATHERM_DEGC, (0, 1, 3))
    off = np.max(np.abs(curve.coefficients / BETATHERM - 1.0))
    published_degC = 1.0 / (np.log(BETATHERM_OHM)[:, None] ** [0, 1, 3] @ BETATHERM) - 273.15
    apart = np.max(np.abs(degC_at(curve, BETATHERM_OHM) - published_degC))
    record_property("obtained", f"coefficients within {1e2 * off:.2f} %, curves within {1e3 * apart:.1f} mK")
    assert off < 1e-3
    assert apart < 3e-3
    assert degC_at(curve, BETATHERM_OHM) == pytest.approx(BETATHERM_DEGC, abs=1e-5)


@pytest.mark.validates("four powers of the logarithm of a thermistor", against="U.S. Sensor's table and coefficients")
def test_us_sensor(record_property: Callable[[str, object], None]) -> None:
    """The digits of the published table alone leave up to 30 mK."""
    curve = fitted(US_SENSOR_OHM, US_SENSOR_DEGC, (0, 1, 3, 5))
    between = np.sqrt(US_SENSOR_OHM[:-1] * US_SENSOR_OHM[1:])
    published_degC = 1.0 / (np.log(between)[:, None] ** [0, 1, 3, 5] @ US_SENSOR) - 273.15
    off = np.max(np.abs(degC_at(curve, between) - published_degC))
    record_property("obtained", f"{1e3 * off:.1f} mK off between the points")
    assert off < 0.03
    assert degC_at(curve, US_SENSOR_OHM) == pytest.approx(US_SENSOR_DEGC, abs=0.03)


def test_what_a_power_less_leaves_is_seen() -> None:
    """Two powers, the equation with B alone, are off by some tenths of a degree over this range."""
    curve = fitted(US_SENSOR_OHM, US_SENSOR_DEGC, (0, 1))
    assert 0.3 < np.max(np.abs(degC_at(curve, US_SENSOR_OHM) - US_SENSOR_DEGC)) < 3.0
    assert curve.rival > 1.0


def test_errors_go_through_the_functions() -> None:
    """Drawn errors of resistance and temperature scatter the value that is read back as its uncertainty says."""
    rng = np.random.default_rng(5)
    of_x, of_y = function_of("log", "ohm"), function_of("reciprocal", "degC")
    every = np.ones_like(US_SENSOR_DEGC)
    read, stated = [], []
    for _ in range(300):
        ohm = US_SENSOR_OHM * (1.0 + rng.normal(0.0, 1e-3, every.size))
        degC = US_SENSOR_DEGC + rng.normal(0.0, 0.05, every.size)
        x = Points(ohm, 1e-3 * US_SENSOR_OHM, np.nan * every, 0.0 * every, 0.0 * every, every)
        y = Points(degC, 0.05 * every, np.nan * every, 0.0 * every, 0.0 * every, every)
        curve = fit_polynomial(of_x.points(x), of_y.points(y), (0, 1, 3))
        at = np.log([10_000.0])
        read.append(float(of_y.back(curve.at(at))[0]))
        stated.append(float(np.abs(of_y.back_slope(curve.at(at))) @ curve.std_at(at)))
    assert np.mean(read) == pytest.approx(25.0, abs=0.02)
    assert np.std(read) == pytest.approx(np.median(stated), rel=0.2)
