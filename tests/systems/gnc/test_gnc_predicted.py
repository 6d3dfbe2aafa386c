"""Holds what is predicted of GNC campaigns against the spread of their estimates about the truth of the simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest
from gnc_campaigns import (
    Key,
    Module,
    bias_truth,
    calibration_truth,
    campaign,
    left_by,
    magnetometer_truth,
    material_of,
    plan_of,
    records_of,
)
from spread_study import Study

from bench.analysis import Analysis, Material
from bench.plan import Plan
from bench.session.predicted import predicted
from bench.systems.gnc import bias, magnetometer
from bench.systems.gnc.calibration import analysis as calibration

SHORT = {"position": "60 s", "check_position": "20 s"}


def study(
    plan: Plan,
    analyse: Callable[[Material], Analysis],
    truth: Callable[[Module, Analysis], Mapping[Key, float]],
    first_seed: int,
    units: int,
) -> Study:
    """Units of seeds that follow each other."""
    found = Study(predicted(plan))
    records = records_of(plan)
    for seed in range(first_seed, first_seed + units):
        module = campaign(records, seed, plan.campaign["rate_Hz"])
        analysis = analyse(material_of(plan, module))
        found.add(analysis.estimates, truth(module, analysis))
    print(f"seeds {first_seed} to {first_seed + units - 1}")
    print(*found.lines(), sep="\n")
    print(f"median of {len(found.scores)} quantities {found.median():.3f}; outside of 99.9 %: {found.outside()}")
    return found


def calibration_study(sequence: str, first_seed: int, units: int) -> Study:
    return study(
        plan_of(sequence, **SHORT),
        calibration.analyse,
        lambda module, analysis: calibration_truth(module) | left_by(module, analysis.estimates),
        first_seed,
        units,
    )


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
    found = calibration_study(sequence, 5000, 2)
    assert found.prediction.missing == []
    assert len(found.scores) == len(found.prediction.estimates) == 60
    assert found.outside() == {}


@pytest.mark.sweep
@pytest.mark.parametrize("sequence", ["gnc_imu_calibration", "gnc_imu_calibration_vertical"])
def test_calibrations_scatter_as_predicted(sequence: str) -> None:
    found = calibration_study(sequence, 5000, 1000)
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
