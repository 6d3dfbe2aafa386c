"""Holds what is predicted of GNC campaigns against the spread of their estimates about the truth of the simulator."""

from __future__ import annotations

from dataclasses import replace

import pytest
from gnc_answers import roll_truth, unit_test_study, with_rolls
from gnc_campaigns import Module, bias_truth, magnetometer_truth, plan_of
from gnc_study import calibration_study, study
from spread_study import Key, Study

from bench.analysis import Analysis
from bench.session.planned import planned_of
from bench.systems.gnc import bias, magnetometer
from bench.systems.gnc.predicted import of_unit_test

SHORT = {"position": "60 s", "check_position": "20 s"}


def bias_study(first_seed: int, units: int) -> Study:
    return study(plan_of("gnc_bias", 50.0), bias.analyse, lambda module, _: bias_truth(module), first_seed, units)


def magnetometer_study(first_seed: int, units: int) -> Study:
    plan = plan_of("gnc_magnetometer", 50.0)

    def truth(module: Module, analysis: Analysis) -> dict[Key, float]:
        return magnetometer_truth(module) | roll_truth(plan, module, analysis)

    return study(plan, magnetometer.analyse, truth, first_seed, units, with_rolls)


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
    assert found.prediction.missing == []
    assert len(found.scores) == len(found.prediction.estimates) == 51
    assert found.outside() == {}


@pytest.mark.sweep
def test_magnetometers_scatter_as_predicted() -> None:
    found = magnetometer_study(7000, 500)
    assert found.outside() == {}
    assert 0.97 < found.median() < 1.03


def test_a_few_unit_tests_scatter_as_predicted() -> None:
    found = unit_test_study(plan_of("gnc_unit_test", units="GNC-01"), 8000, 40)
    assert found.prediction.missing == []
    assert len(found.scores) == len(found.prediction.estimates) == 10
    assert found.outside() == {}


def test_a_request_of_another_form_is_named() -> None:
    planned = planned_of(plan_of("gnc_unit_test", units="GNC-01"))
    cut = [replace(one, sent=one.sent[:-1]) if one.name == "timer" else one for one in planned.exchanges]
    found = of_unit_test(replace(planned, exchanges=cut))
    assert {entry["quantity"] for entry in found.estimates} == {"imu_rate", "imu_acceleration"}
    (sentence,) = found.missing
    assert sentence.startswith("timer: not predicted, as a request of ")


@pytest.mark.sweep
def test_unit_tests_scatter_as_predicted() -> None:
    found = unit_test_study(plan_of("gnc_unit_test", units="GNC-01"), 8000, 500)
    assert found.outside() == {}
    assert 0.97 < found.median() < 1.03
