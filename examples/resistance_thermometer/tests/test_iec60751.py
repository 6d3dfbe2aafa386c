"""The relation of IEC 60751 against its published table, its inverse, its classes, and the older form of it."""

from __future__ import annotations

import numpy as np
import pytest
from block import standards

from resistance_thermometer.system.estimators.iec60751 import (
    CLASSES,
    ratio,
    slope_per_degC,
    temperature_degC,
)
from resistance_thermometer.system.setup import setup_of
from resistance_thermometer.world.probe import Element
from resistance_thermometer.world.world import REFERENCE

PUBLISHED_OHM = {
    -200.0: 18.5201, -100.0: 60.2558, 0.0: 100.0000, 100.0: 138.5055, 200.0: 175.8560, 400.0: 247.0920, 850.0: 390.4811,
}  # fmt: skip
TABLE_OHM = {
    -190.0: 22.83, -150.0: 39.72, -100.0: 60.26, -80.0: 68.33, -50.0: 80.31, -40.0: 84.27, -30.0: 88.22, -20.0: 92.16,
    -10.0: 96.09, 0.0: 100.00, 1.0: 100.39, 2.0: 100.78, 100.0: 138.51,
}  # fmt: skip
PUBLISHED_TOLERANCES_DEGC = {
    "A": {-100.0: 0.35, 0.0: 0.15, 100.0: 0.35, 200.0: 0.55},
    "B": {-100.0: 0.8, 0.0: 0.3, 100.0: 0.8, 200.0: 1.3},
}


@pytest.mark.parametrize(("table", "half_a_digit"), [(PUBLISHED_OHM, 5.1e-5), (TABLE_OHM, 5.1e-3)])
def test_the_published_table(table: dict[float, float], half_a_digit: float) -> None:
    t_degC, ohm = np.array(list(table)), np.array(list(table.values()))
    assert np.abs(100.0 * ratio(t_degC) - ohm).max() < half_a_digit
    back_degC = temperature_degC(ohm / 100.0)
    assert back_degC == pytest.approx(t_degC, abs=half_a_digit / 0.29)


def test_the_inverse_holds_in_the_whole_range_and_nowhere_else() -> None:
    t_degC = np.linspace(-200.0, 850.0, 2101)
    assert temperature_degC(ratio(t_degC)) == pytest.approx(t_degC, abs=1e-9)
    assert np.isnan(temperature_degC([0.1, 4.0])).all()


def test_the_slope_is_the_derivative() -> None:
    t_degC = np.array([-199.0, -80.0, -1.0, 1.0, 80.0, 800.0])
    step = 1e-3
    difference = (ratio(t_degC + step) - ratio(t_degC - step)) / (2.0 * step)
    assert slope_per_degC(t_degC) == pytest.approx(difference, rel=1e-7)


@pytest.mark.parametrize("name", CLASSES)
def test_the_published_tolerances(name: str) -> None:
    for t_degC, tolerance_degC in PUBLISHED_TOLERANCES_DEGC[name].items():
        assert CLASSES[name].degC(t_degC) == pytest.approx(tolerance_degC, abs=1e-12)


def test_the_simulated_element_has_the_older_form_of_the_same_curve() -> None:
    t_degC = np.linspace(-200.0, 400.0, 61)
    ohm = [Element(100.0).ohm(float(t)) for t in t_degC]
    assert ohm == pytest.approx((100.0 * ratio(t_degC)).tolist(), abs=1e-9)


def test_the_register_states_the_certificate_of_the_simulated_reference() -> None:
    setup = setup_of({"thermometers": [THERMOMETER]}, standards())
    t_degC = np.linspace(-50.0, 120.0, 18)
    of_ratio = np.array([REFERENCE.ohm(float(t)) for t in t_degC]) / setup.reference_r0_ohm
    assert temperature_degC(of_ratio, setup.reference_curve) == pytest.approx(t_degC, abs=1e-4)


THERMOMETER = {"serial": "P", "channel": 101, "tolerance_class": "A", "nominal_ohm": 100.0, "self_heating_degC": 0.0}
