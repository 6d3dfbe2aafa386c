"""The analysis bias_ramp on simulated records: estimates against the truth, what is missing, what is refused."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bias_simulation import MASTER_ppm, Ramp, campaign, draw, ramp, rows
from one_estimate import every as of
from one_estimate import one as entry_of
from one_estimate import score

from bench.analysis import Analysis, Material, Trace, build_results, with_uncertainty
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.record import RecordRow
from bench.systems.af_converter.bias_ramp import analysis as bias_ramp
from bench.systems.af_converter.coefficients import coefficients_of


def material(ramps: dict[int, Ramp], found: list[RecordRow] | None = None) -> Material:
    world = next(iter(ramps.values()))
    trace = Trace(world.trace_t_s, world.air_degC, world.sensor_degC)
    return Material(found if found is not None else rows(ramps), campaign(ramps), {}, trace)


@pytest.fixture(scope="module")
def ramps() -> dict[int, Ramp]:
    """Two gyro channels (the second without hysteresis) and an accelerometer; scale factors are not nominal."""
    rng = np.random.default_rng([99, 40])
    return {
        1: ramp(40, unit=draw(rng, "gyro", dsf=True)),
        2: ramp(41, unit=draw(rng, "gyro", dsf=True, hysteresis=False)),
        7: ramp(42, unit=draw(rng, "accelerometer", dsf=True)),
    }


@pytest.fixture(scope="module")
def analysis(ramps: dict[int, Ramp]) -> Analysis:
    return bias_ramp.analyse(material(ramps))


def assert_bias_and_width(analysis: Analysis, one: Ramp) -> None:
    """Both are within four standard uncertainties of the truth at 20 degC."""
    assert abs(score(entry_of(analysis, "bias", temperature_degC=20.0), one.truth(0))) < 4
    width = entry_of(analysis, "hysteresis_width", reference_temperature_degC=20.0)
    assert abs(score(width, one.unit.width_A)) < 4


def test_bias_and_its_coefficients(analysis: Analysis, ramps: dict[int, Ramp]) -> None:
    for number, one in ramps.items():
        curve = [one.truth(order) for order in range(4)]
        for at in (-10.0, 5.0, 20.0, 35.0, 50.0):
            entry = entry_of(analysis, "bias", channel=number, temperature_degC=at)
            truth = float(np.polynomial.polynomial.polyval(at - 20.0, np.array(curve) * (1 + one.unit.dsf)))
            assert abs(score(entry, truth)) < 4, (number, at)
            assert abs(entry.value - truth) < 4e-9
            assert entry.unit == "A"
        for order in (1, 2, 3):
            entry = entry_of(analysis, f"bias_tc{order}", channel=number, reference_temperature_degC=20.0)
            assert abs(score(entry, one.unit.polynomial[order])) < 4, (number, order)


def test_hysteresis_and_lag(analysis: Analysis, ramps: dict[int, Ramp]) -> None:
    for number, one in ramps.items():
        width = entry_of(analysis, "hysteresis_width", channel=number, reference_temperature_degC=20.0)
        assert abs(score(width, one.unit.width_A)) < 4
        at = entry_of(analysis, "hysteresis_width", channel=number, temperature_degC=35.0)
        assert at.value == pytest.approx(width.value, rel=1e-6)
        assert abs(score(entry_of(analysis, "thermal_lag", channel=number), 25.0)) < 4
        assert not of(analysis, "hysteresis_width", channel=number, temperature_degC=-10.0)  # closes there by itself
    for number in (1, 7):
        assert abs(score(entry_of(analysis, "play_half_width", channel=number), ramps[number].unit.half_width_degC)) < 4
    assert not of(analysis, "play_half_width", channel=2)
    assert any("Channel 2: no play half-width" in note for note in analysis.notes)
    assert not analysis.missing
    left = entry_of(analysis, "bias_residual", channel=1)
    assert (left.limit, left.verdict) == (2.4e-8, "pass")
    assert abs(left.value) == pytest.approx(abs(ramps[1].unit.width_A) / 2, abs=2.5e-9)  # half the loop is left


def test_master_oscillator(analysis: Analysis) -> None:
    for at in (-10.0, 20.0, 50.0):
        entry = entry_of(analysis, "master_clock_error", temperature_degC=at)
        truth = float(np.polynomial.polynomial.polyval(at - 20.0, MASTER_ppm))
        assert abs(entry.value - truth) < 0.02
        assert entry.std_uncertainty == pytest.approx(3.0 / np.sqrt(3.0), rel=0.01)
    assert abs(score(entry_of(analysis, "master_clock_error_tc3"), MASTER_ppm[3])) < 4
    assert entry_of(analysis, "master_clock_error_tc2").unit == "ppm/degC2"


def test_noise_of_the_bias(analysis: Analysis) -> None:
    for number in (1, 2, 7):
        white = entry_of(analysis, "white_noise", channel=number)
        assert white.value == pytest.approx(2e-9 / np.sqrt(2), rel=0.25)
        assert white.unit == "A*s^0.5"
        for walk in of(analysis, "random_walk", channel=number):
            assert walk.value == pytest.approx(3e-10, rel=0.5)


@pytest.mark.validates(
    "separate polynomials of the branches against the air are off by the lag",
    against="closed form: 2 x rate x lag x slope of the bias",
)
def test_lag_is_shown_beside_the_joint_fit(
    record_property: Callable[[str, object], None], analysis: Analysis, ramps: dict[int, Ramp]
) -> None:
    """Against the chamber's air separate cubics add 2 x rate x lag x slope, here of 25 min at 0.1 degC/min."""
    table = next(one for one in analysis.tables if "separate polynomials" in one.title)
    for number, one in ramps.items():
        (row,) = [row for row in table.rows if row[0] == number and float(row[1]) == 20.0]
        joint, against_air, against_sensor = float(row[2]), float(row[4]), float(row[5])
        excess = 2 * 0.1 * 25.0 * one.unit.polynomial[1] * 1e9
        record_property("obtained", f"channel {number}: {against_air - joint:.1f} of {excess:.1f} nA")
        assert against_air - joint == pytest.approx(excess, abs=4.0), number
        assert abs(against_sensor - joint) < 3.0
    assert any("instead of" in note for note in analysis.notes)
    assert any("are masked there" in note for note in analysis.notes)


def test_parts_of_the_uncertainty(analysis: Analysis, ramps: dict[int, Ramp]) -> None:
    """400 ppm of the bias, and 0.05 degC times its slope, by hand; table and residual hold them, too."""
    table = next(one for one in analysis.tables if one.title.startswith("Components of the bias"))
    for number, one in ramps.items():
        parts = {row[1]: float(row[2]) for row in table.rows if row[0] == number}
        assert parts["scale factor taken as nominal"] == pytest.approx(4e5 * abs(one.truth(0)), rel=0.01)
        expected_nA = 1e9 * 0.05 * abs(one.unit.polynomial[1])
        assert parts["temperature sensor of the unit"] == pytest.approx(expected_nA, rel=0.1)
        left = entry_of(analysis, "bias_residual", channel=number)
        white_A = 2e-9 / np.sqrt(2.0 * 3600.0)  # over an hour
        assert left.std_uncertainty == pytest.approx(white_A, rel=0.05)


def test_budgets_give_the_stated_uncertainty_and_the_sensor_joins_the_channels(
    analysis: Analysis, ramps: dict[int, Ramp]
) -> None:
    """U of the budget is that of results.json; correlation by hand: product of the sensor's parts over both u."""
    budgets = [one for one in analysis.tables if one.title.startswith("Uncertainty budget of the bias at 20")]
    assert len(budgets) == len({one.conditions.get("kind", "gyro") for one in analysis.estimates})
    for table in budgets:
        number = int(table.title.split("channel ")[1].split(" ")[0])
        stated = entry_of(analysis, "bias", channel=number, temperature_degC=20.0)
        assert with_uncertainty(stated.value * 1e9, stated.expanded_uncertainty * 1e9) in table.caption
    matrix = next(one for one in analysis.tables if one.title.startswith("Correlation of the bias"))
    names = matrix.headers[1:]
    sensor_nA = {str(n): 1e9 * 0.05 * one.unit.polynomial[1] for n, one in ramps.items()}
    u_nA = {
        name: 1e9 * entry_of(analysis, "bias", channel=int(name), temperature_degC=20.0).std_uncertainty
        for name in names
    }
    expected = sensor_nA[names[0]] * sensor_nA[names[1]] / (u_nA[names[0]] * u_nA[names[1]])
    assert float(matrix.rows[0][2].replace("−", "-")) == pytest.approx(expected, abs=0.02)


def test_temperatures_are_those_that_the_sensor_reads(ramps: dict[int, Ramp]) -> None:
    """A sensor that reads 2 degC too high moves the curve along, not its values at the same true temperature.

    What is valid is what it read, with 5 degC too much up to 55 degC; without it temperatures are those of the fit.
    """
    (base, _), (apart, _) = (
        bias_ramp.analyse(material({1: replace(ramps[1], sensor_degC=ramps[1].sensor_degC + more)})).compensation
        for more in (0.0, 2.0)
    )
    at = np.linspace(-10, 40, 6)
    moved = np.polynomial.polynomial.polyval(at + 2.0, apart["coefficients"])
    np.testing.assert_allclose(moved, np.polynomial.polynomial.polyval(at, base["coefficients"]), atol=5e-11)
    plain = rows({1: ramps[1]})
    found = [replace(row, context={key: value + 5.0 for key, value in row.context.items()}) for row in plain]
    for entry in bias_ramp.analyse(material({1: ramps[1]}, found)).compensation:
        assert entry["valid_degC"] == pytest.approx([-5.0, 54.8], abs=0.3)
    without = bias_ramp.analyse(material({1: ramps[1]}, [replace(row, context={}) for row in plain]))
    assert any("gave no reading; temperatures of the results are the lagged ones" in line for line in without.missing)
    assert not without.compensation


def test_documents_are_valid(analysis: Analysis, ramps: dict[int, Ramp]) -> None:
    provenance = {
        "simulated": True, "plan_sha256": "0", "frame_sha256": "0", "session_sha256": "0", "software": "test",
    }  # fmt: skip
    results = build_results("s", analysis, {}, provenance)
    document = coefficients_of(analysis, results, campaign(ramps))
    bias = next(one for one in document["parameters"] if one["parameter"] == "bias" and one["channel"] == 1)
    entry = entry_of(analysis, "bias", channel=1, temperature_degC=35.0)
    assert np.polynomial.polynomial.polyval(15.0, bias["coefficients"]) == pytest.approx(entry.value, rel=1e-12)
    assert {one["parameter"] for one in document["parameters"]} == {"bias", "master_clock"}
    groups = {one.group for one in analysis.figures}
    assert {"bias over temperature", "residuals of the joint fit", "hysteresis width"} <= groups
    assert all(len(one.x) == len(one.y or one.low or []) for f in analysis.figures for one in f.series)
    assert analysis.components[-1]["component"] == "combined"


@pytest.mark.parametrize(
    ("method", "timed", "said"),
    [("joint", False, "gated 900."), ("joint_unit_sensor", True, "Channel 1: no thermal lag")],
)
def test_without_timing_or_by_the_sensor_of_the_unit(
    ramps: dict[int, Ramp], method: str, timed: bool, said: str
) -> None:
    one = {1: ramps[1]}
    found = bias_ramp.analyse(material(one, rows(one, timed=timed)), method)
    assert found.method == method
    assert any(said in note for note in found.notes)
    assert_bias_and_width(found, one[1])
    assert bool(of(found, "thermal_lag")) == (method == "joint")


def test_flagged_windows_are_left_out_and_lost_frames_cost_the_resolution_of_theirs(ramps: dict[int, Ramp]) -> None:
    one = {1: ramps[1]}
    found = rows(one)
    for place in (100, 101, 500):
        found[place] = replace(found[place], quality=int(Quality.SUSPECT))
    sums = found[400].sums | {"master_count": np.int64(999_500_000)}
    found[400] = replace(found[400], sums=sums, timing={}, frames=9995, lost=5)
    result = bias_ramp.analyse(material(one, found))
    entry = entry_of(result, "bias", temperature_degC=20.0)
    assert (entry.n, entry.dropped) == (897, 3)
    assert any("reciprocal 896, gated 1." in note for note in result.notes)
    assert_bias_and_width(result, one[1])


def test_half_a_ramp_has_a_bias_but_no_hysteresis(ramps: dict[int, Ramp]) -> None:
    one = {1: ramps[1]}
    result = bias_ramp.analyse(material(one, rows(one)[:432]))
    assert any(line.startswith("branch down: no usable record; hysteresis width") for line in result.missing)
    assert not of(result, "hysteresis_width") + of(result, "play_half_width") + of(result, "thermal_lag")
    half, whole = (entry_of(x, "bias_tc1", channel=1) for x in (result, bias_ramp.analyse(material(one))))
    assert half.std_uncertainty > 1.2 * whole.std_uncertainty
    assert abs(score(half, one[1].unit.polynomial[1])) < 4


@pytest.mark.parametrize("stuck_from", [0, 432])
def test_a_stuck_sensor_costs_the_compensation_but_not_the_campaign(ramps: dict[int, Ramp], stuck_from: int) -> None:
    one = {1: ramps[1]}
    found = rows(one)
    stuck = found[stuck_from].context
    result = bias_ramp.analyse(
        material(one, found[:stuck_from] + [replace(x, context=stuck) for x in found[stuck_from:]])
    )
    assert abs(score(entry_of(result, "bias", temperature_degC=20.0), one[1].truth(0) * (1 + one[1].unit.dsf))) < 4
    assert abs(score(entry_of(result, "hysteresis_width", temperature_degC=20.0), one[1].unit.width_A)) < 4
    assert not result.compensation
    assert not of(result, "master_clock_error")
    (said,) = [line for line in result.missing if line.startswith("compensation of the bias, channel 1")]
    assert "does not follow the unit" in said
    assert any(line.startswith("master oscillator") for line in result.missing)


def unit_with(**changes: Any) -> dict[int, Ramp]:
    unit = draw(np.random.default_rng(5), "gyro")
    return {1: ramp(3, unit=replace(unit, **changes))}


@pytest.mark.parametrize("half_width_degC", [0.1, 0.25])
def test_a_loop_that_opens_at_once(half_width_degC: float) -> None:
    one = unit_with(half_width_degC=half_width_degC)
    result = bias_ramp.analyse(material(one))
    assert abs(score(entry_of(result, "play_half_width"), half_width_degC)) < 4
    assert abs(score(entry_of(result, "thermal_lag"), 25.0)) < 4
    assert abs(score(entry_of(result, "hysteresis_width", temperature_degC=20.0), one[1].unit.width_A)) < 4


@pytest.mark.parametrize(
    ("changes", "said"),
    [({"lag_s": 7200.0}, "thermal lag of 90 min"), ({"half_width_degC": 12.0}, "half-width of 9.00")],
)
def test_a_lag_or_a_loop_beyond_the_search_is_refused(changes: dict[str, float], said: str) -> None:
    """Held at the limit of the search they would put the width and the slope of the bias off by 8 to 20 sigma."""
    with pytest.raises(FitError, match=said) as caught:
        bias_ramp.analyse(material(unit_with(**changes)))
    assert caught.value.code == "B-FIT-001"


@pytest.mark.parametrize(
    ("reference_degC", "step_degC", "at_degC"),
    [
        (25.0, 15.0, [-5.0, 10.0, 25.0, 40.0]),
        (-40.0, 15.0, [-10.0, 5.0, 20.0, 35.0, 50.0]),
        (90.0, 1000.0, [20.0]),  # no step within the ramp: its middle
    ],
)
def test_estimates_stand_at_the_reference_and_in_steps_from_it(
    ramps: dict[int, Ramp], monkeypatch: pytest.MonkeyPatch, reference_degC: float, step_degC: float,
    at_degC: list[float],
) -> None:  # fmt: skip
    monkeypatch.setattr("bench.systems.af_converter.bias_ramp.estimates.STEP_degC", step_degC)
    usual = material({1: ramps[1]})
    campaign_there = {**usual.campaign, "reference_temperature_degC": reference_degC}
    result = bias_ramp.analyse(replace(usual, campaign=campaign_there))
    assert [one.conditions["temperature_degC"] for one in of(result, "bias")] == at_degC
    for one in of(result, "bias"):
        x = one.conditions["temperature_degC"] - 20.0
        truth = sum(ramps[1].truth(k) * (1 + ramps[1].unit.dsf) * x**k for k in range(4))
        assert abs(score(one, float(truth))) < 4
    (paste,) = [one for one in result.compensation if one["parameter"] == "bias"]
    assert paste["reference_temperature_degC"] == reference_degC
    assert entry_of(result, "bias_tc1").value == paste["coefficients"][1]


def test_the_stated_uncertainty_of_the_generator_counts_without_a_calibrator(ramps: dict[int, Ramp]) -> None:
    stated = {"function_generator": {"uncertainty": [{"relative": 2e-5}], "traceability_relative": 1.5e-5}}
    result = bias_ramp.analyse(replace(material({1: ramps[1]}), standards=stated))
    entry = entry_of(result, "master_clock_error", temperature_degC=20.0)
    assert entry.std_uncertainty == pytest.approx(12.5, rel=1e-3)  # ppm: 10 and 7.5


def test_what_is_missing_and_what_is_refused(ramps: dict[int, Ramp]) -> None:
    one = {1: ramps[1]}
    usual = material(one)
    found = [replace(row, sums=row.sums | {"fg_count": np.int64(0)}) for row in usual.rows]
    result = bias_ramp.analyse(material({**one, 12: ramps[1]}, found))
    assert {line.split(":")[0] for line in result.missing} >= {"channel 12", "master oscillator"}
    assert not of(result, "master_clock_error")
    for change, method, code in (
        (replace(usual, rows=[]), "joint", "B-FIT-022"),
        (replace(usual, rows=usual.rows[:20]), "joint", "B-FIT-023"),
        (replace(usual, trace=Trace()), "joint", "B-FIT-020"),
    ):
        with pytest.raises(FitError) as caught:
            bias_ramp.analyse(change, method)
        assert caught.value.code == code
