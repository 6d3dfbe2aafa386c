"""Holds what is predicted of GNC campaigns against the spread of their estimates about the truth of the simulator."""

from __future__ import annotations

import pytest
from gnc_campaigns import bias_truth, magnetometer_truth, plan_of
from gnc_study import calibration_study, study
from spread_study import Study

from bench.systems.gnc import bias, magnetometer

SHORT = {"position": "60 s", "check_position": "20 s"}


def bias_study(first_seed: int, units: int) -> Study:
    return study(plan_of("gnc_bias", 50.0), bias.analyse, lambda module, _: bias_truth(module), first_seed, units)


def magnetometer_study(first_seed: int, units: int) -> Study:
    return study(
        plan_of("gnc_magnetometer", 50.0),
        magnetometer.analyse,
        lambda module, _: magnetometer_truth(module),
        first_seed,
        units,
    )


@pytest.mark.parametrize("sequence", ["gnc_imu_calibration", "gnc_imu_calibration_vertical"])
def test_a_few_calibrations_scatter_as_predicted(sequence: str) -> None:
    found = calibration_study(plan_of(sequence, **SHORT), 5000, 2)
    assert found.prediction.missing == []
    assert len(found.scores) == len(found.prediction.estimates) == 60
    assert found.outside() == {}


@pytest.mark.sweep
@pytest.mark.parametrize("sequence", ["gnc_imu_calibration", "gnc_imu_calibration_vertical"])
def test_calibrations_scatter_as_predicted(sequence: str) -> None:
    found = calibration_study(plan_of(sequence, **SHORT), 5000, 1000)
    assert found.outside() == {}
    assert 0.97 < found.median() < 1.03


def test_a_few_biases_scatter_as_predicted() -> None:
    found = bias_study(6000, 1)
    assert found.prediction.missing == []
    assert len(found.scores) == len(found.prediction.estimates) == 17
    assert found.outside() == {}


@pytest.mark.sweep
def test_biases_scatter_as_predicted() -> None:
    found = bias_study(6000, 500)
    assert found.outside() == {}
    assert 0.97 < found.median() < 1.03


def test_a_few_magnetometers_scatter_as_predicted() -> None:
    found = magnetometer_study(7000, 2)
    assert len(found.scores) == len(found.prediction.estimates) == 19
    assert found.outside() == {}


@pytest.mark.sweep
def test_magnetometers_scatter_as_predicted() -> None:
    found = magnetometer_study(7000, 500)
    assert found.outside() == {}
    assert 0.97 < found.median() < 1.03
