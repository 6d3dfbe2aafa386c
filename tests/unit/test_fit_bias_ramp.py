"""The analysis bias_ramp on simulated records: estimates against the truth, what is missing, what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bias_simulation import MASTER_ppm, Ramp, Row, campaign, draw, ramp, rows

from bench.campaigns import bias_ramp
from bench.campaigns.analysis import Analysis
from bench.campaigns.coefficients import coefficients_of, validate_coefficients
from bench.campaigns.material import Material, Trace
from bench.campaigns.results import build_results
from bench.model.errors import FitError
from bench.model.quality import Quality

Entry = dict[str, Any]


def units(seed: int) -> dict[int, Ramp]:
    """Two gyro channels (the second without hysteresis) and an accelerometer; scale factors are not nominal."""
    rng = np.random.default_rng([99, seed])
    return {
        1: ramp(seed, unit=draw(rng, "gyro", dsf=True)),
        2: ramp(seed + 1, unit=draw(rng, "gyro", dsf=True, hysteresis=False)),
        7: ramp(seed + 2, unit=draw(rng, "accelerometer", dsf=True)),
    }


def material(ramps: dict[int, Ramp], found: list[Row] | None = None) -> Material:
    world = next(iter(ramps.values()))
    trace = Trace(world.trace_t_s, world.air_degC, world.sensor_degC)
    return Material(found if found is not None else rows(ramps), campaign(ramps), {}, trace)


@pytest.fixture(scope="module")
def ramps() -> dict[int, Ramp]:
    return units(40)


@pytest.fixture(scope="module")
def analysis(ramps: dict[int, Ramp]) -> Analysis:
    return bias_ramp.analyse(material(ramps))


def of(analysis: Analysis, quantity: str, **conditions: Any) -> list[Entry]:
    wanted = conditions.items()
    return [one for one in analysis.estimates if one["quantity"] == quantity and wanted <= one["conditions"].items()]


def one_of(analysis: Analysis, quantity: str, **conditions: Any) -> Entry:
    (found,) = of(analysis, quantity, **conditions)
    return found


def score(entry: Entry, truth: float) -> float:
    return abs(entry["value"] - truth) / entry["std_uncertainty"]


def test_bias_and_its_coefficients(analysis: Analysis, ramps: dict[int, Ramp]) -> None:
    for number, one in ramps.items():
        curve = [one.truth(order) for order in range(4)]
        for at in (-10.0, 5.0, 20.0, 35.0, 50.0):
            entry = one_of(analysis, "bias", channel=number, temperature_degC=at)
            truth = float(np.polynomial.polynomial.polyval(at - 20.0, np.array(curve) * (1 + one.unit.dsf)))
            assert score(entry, truth) < 4, (number, at)
            assert abs(entry["value"] - truth) < 4e-9
            assert entry["unit"] == "A"
        for order in (1, 2, 3):
            entry = one_of(analysis, f"bias_tc{order}", channel=number, reference_temperature_degC=20.0)
            assert score(entry, one.unit.polynomial[order]) < 4, (number, order)


def test_hysteresis_and_lag(analysis: Analysis, ramps: dict[int, Ramp]) -> None:
    for number, one in ramps.items():
        width = one_of(analysis, "hysteresis_width", channel=number, reference_temperature_degC=20.0)
        assert score(width, one.unit.width_A) < 4
        at = one_of(analysis, "hysteresis_width", channel=number, temperature_degC=35.0)
        assert at["value"] == pytest.approx(width["value"], rel=1e-6)
        assert score(one_of(analysis, "thermal_lag", channel=number), 25.0) < 4
        assert not of(analysis, "hysteresis_width", channel=number, temperature_degC=-10.0)  # closes there by itself
    for number in (1, 7):
        assert score(one_of(analysis, "play_half_width", channel=number), ramps[number].unit.half_width_degC) < 4
    assert not of(analysis, "play_half_width", channel=2)
    assert any("Channel 2: no play half-width" in note for note in analysis.notes)
    assert not analysis.missing


def test_residual_is_judged_against_the_stability(analysis: Analysis, ramps: dict[int, Ramp]) -> None:
    entry = one_of(analysis, "bias_residual", channel=1)
    assert entry["limit"] == 2.4e-8
    assert entry["verdict"] == "pass"
    assert abs(entry["value"]) == pytest.approx(abs(ramps[1].unit.width_A) / 2, abs=2.5e-9)  # half the loop is left


def test_master_oscillator(analysis: Analysis) -> None:
    for at in (-10.0, 20.0, 50.0):
        entry = one_of(analysis, "master_clock_error", temperature_degC=at)
        truth = float(np.polynomial.polynomial.polyval(at - 20.0, MASTER_ppm))
        assert abs(entry["value"] - truth) < 0.02
        assert entry["std_uncertainty"] == pytest.approx(3.0 / np.sqrt(3.0), rel=0.01)
    assert score(one_of(analysis, "master_clock_error_tc3"), MASTER_ppm[3]) < 4
    assert one_of(analysis, "master_clock_error_tc2")["unit"] == "ppm/degC2"


def test_noise_of_the_bias(analysis: Analysis) -> None:
    for number in (1, 2, 7):
        white = one_of(analysis, "white_noise", channel=number)
        assert white["value"] == pytest.approx(2e-9 / np.sqrt(2), rel=0.25)
        assert white["unit"] == "A*s^0.5"
        for walk in of(analysis, "random_walk", channel=number):
            assert walk["value"] == pytest.approx(3e-10, rel=0.5)


def test_lag_is_shown_beside_the_joint_fit(analysis: Analysis, ramps: dict[int, Ramp]) -> None:
    """Against the chamber's air separate cubics add 2 x rate x lag x slope, here of 25 min at 0.1 degC/min."""
    table = next(one for one in analysis.tables if "separate polynomials" in one["title"])
    for number, one in ramps.items():
        (row,) = [row for row in table["rows"] if row[0] == number and row[1] == 20.0]
        joint, against_air, against_sensor = float(row[2]), float(row[4]), float(row[5])
        excess = 2 * 0.1 * 25.0 * one.unit.polynomial[1] * 1e9
        assert against_air - joint == pytest.approx(excess, abs=4.0), number
        assert abs(against_sensor - joint) < 3.0
    assert any("instead of" in note for note in analysis.notes)
    assert any("are masked there" in note for note in analysis.notes)


def test_estimators_are_named(analysis: Analysis) -> None:
    assert any(note.startswith("Windows by estimator") and "reciprocal" in note for note in analysis.notes)


def test_documents_are_valid(analysis: Analysis, ramps: dict[int, Ramp]) -> None:
    provenance = {
        "simulated": True, "plan_sha256": "0", "frame_sha256": "0", "session_sha256": "0", "software": "test",
    }  # fmt: skip
    results = build_results("s", analysis, {}, provenance)
    document = coefficients_of(analysis, results, campaign(ramps))
    validate_coefficients(document, "s")
    bias = next(one for one in document["parameters"] if one["parameter"] == "bias" and one["channel"] == 1)
    entry = one_of(analysis, "bias", channel=1, temperature_degC=35.0)
    assert np.polynomial.polynomial.polyval(15.0, bias["coefficients"]) == pytest.approx(entry["value"], rel=1e-12)
    assert {one["parameter"] for one in document["parameters"]} == {"bias", "master_clock"}
    groups = {one.get("group") for one in analysis.figures}
    assert {"bias over temperature", "residuals of the joint fit", "hysteresis width"} <= groups
    assert all(len(one["x"]) == len(one.get("y", one.get("low"))) for f in analysis.figures for one in f["series"])
    assert analysis.components[-1]["component"] == "combined"


def test_temperatures_are_those_of_the_sensor(ramps: dict[int, Ramp]) -> None:
    """A sensor that reads 2 degC too high moves the curve along, not its values at the same true temperature."""
    plain = {1: ramps[1]}
    shifted = {1: replace(ramps[1], sensor_degC=ramps[1].sensor_degC + 2.0)}
    apart = bias_ramp.analyse(material(shifted)).compensation[0]["coefficients"]
    base = bias_ramp.analyse(material(plain)).compensation[0]["coefficients"]
    at = np.linspace(-10, 40, 6)
    moved = np.polynomial.polynomial.polyval(at + 2.0, apart)
    np.testing.assert_allclose(moved, np.polynomial.polynomial.polyval(at, base), atol=5e-11)


def test_unit_sensor_as_drive(ramps: dict[int, Ramp]) -> None:
    found = bias_ramp.analyse(material({1: ramps[1]}), "joint_unit_sensor")
    assert found.method == "joint_unit_sensor"
    assert score(one_of(found, "hysteresis_width", reference_temperature_degC=20.0), ramps[1].unit.width_A) < 4
    assert not of(found, "thermal_lag")
    assert any("Channel 1: no thermal lag" in note for note in found.notes)


def test_without_timing_the_gated_count_serves(ramps: dict[int, Ramp]) -> None:
    one = {1: ramps[1]}
    found = bias_ramp.analyse(material(one, rows(one, timed=False)))
    assert any("gated 900." in note for note in found.notes)
    assert score(one_of(found, "bias", temperature_degC=20.0), one[1].truth(0)) < 4


def test_flagged_windows_are_left_out_and_counted(ramps: dict[int, Ramp]) -> None:
    one = {1: ramps[1]}
    found = rows(one)
    for place in (100, 101, 500):
        found[place] = replace(found[place], quality=int(Quality.SUSPECT))
    result = bias_ramp.analyse(material(one, found))
    entry = one_of(result, "bias", temperature_degC=20.0)
    assert (entry["n"], entry["dropped"]) == (897, 3)
    assert any("3 windows left out" in note for note in result.notes)
    assert score(entry, one[1].truth(0)) < 4


def test_lost_frames_cost_the_resolution_of_their_window(ramps: dict[int, Ramp]) -> None:
    one = {1: ramps[1]}
    found = rows(one)
    sums = found[400].sums | {"master_count": np.int64(999_500_000)}
    found[400] = replace(found[400], sums=sums, timing={}, frames=9995, lost=5)
    result = bias_ramp.analyse(material(one, found))
    assert any("reciprocal 899, gated 1." in note for note in result.notes)
    assert score(one_of(result, "bias", temperature_degC=20.0), one[1].truth(0)) < 4
    assert score(one_of(result, "hysteresis_width", reference_temperature_degC=20.0), one[1].unit.width_A) < 4


def test_half_a_ramp_says_what_is_missing(ramps: dict[int, Ramp]) -> None:
    one = {1: ramps[1]}
    result = bias_ramp.analyse(material(one, rows(one)[:432]))
    assert "branch down: no usable record" in result.missing
    width = one_of(result, "hysteresis_width", reference_temperature_degC=20.0)
    whole = bias_ramp.analyse(material(one)).estimates
    assert width["std_uncertainty"] > next(x for x in whole if x["quantity"] == "hysteresis_width")["std_uncertainty"]
    assert score(width, one[1].unit.width_A) < 4


def test_missing_channel_and_generator(ramps: dict[int, Ramp]) -> None:
    two = {1: ramps[1], 12: ramps[1]}
    found = [replace(row, sums=row.sums | {"fg_count": np.int64(0)}) for row in rows({1: ramps[1]})]
    result = bias_ramp.analyse(replace(material(two, found)))
    assert any(line.startswith("channel 12: no record") for line in result.missing)
    assert any(line.startswith("master oscillator") for line in result.missing)
    assert not of(result, "master_clock_error")


def test_refusals(ramps: dict[int, Ramp]) -> None:
    one = {1: ramps[1]}
    usual = material(one)
    for change, method, code in (
        (replace(usual, rows=[]), "joint", "B-FIT-022"),
        (replace(usual, rows=usual.rows[:20]), "joint", "B-FIT-023"),
        (replace(usual, trace=Trace()), "joint", "B-FIT-020"),
        (usual, "naive", "B-FIT-004"),
    ):
        with pytest.raises(FitError) as caught:
            bias_ramp.analyse(change, method)
        assert caught.value.code == code
