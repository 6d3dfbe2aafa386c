"""The analysis of a temperature ramp on logs made here: segments, a step, a lag, a drift; refusals; what it shows."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from bias_simulation import slack
from imported_logs import RAMP, HOLD_s, LAG_s, RAMP_s, programme, ramp_rows
from imported_logs import lagging as lagging_by
from scipy import stats
from scipy.signal import lfilter
from spoken import english_left

from bench.analysis import Analysis, Material, build_results
from bench.model.errors import FitError
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model
from bench.systems.af_converter.estimators.drift_ramp import (
    block_means,
    drift_columns,
    fit_drift,
    fit_noise,
    fit_ramp_hysteresis,
    whitening,
)
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG
from bench.systems.af_converter.estimators.hysteresis.model import Gates, HysteresisModel, ModelShape
from bench.systems.af_converter.estimators.segments import branches, find_segments
from bench.systems.af_converter.temperature_ramp.analysis import analyse
from bench.systems.af_converter.temperature_ramp.fits import ramp_columns, ramp_drive

NAMES = {"set": "set_point", "s1": "sensor_1", "s2": "sensor_2", "ref": "standard", "dmm": "meter"}
CAMPAIGN = parse_yaml(RAMP, "m.yaml", mapping_model()).model.campaign()
KINDS = ["hold", "up", "hold", "down", "hold"]
CORNERS_s = np.cumsum([0.0, HOLD_s, RAMP_s, HOLD_s, RAMP_s, HOLD_s])
T_s = np.arange(0.0, CORNERS_s[-1], 20.0)


def material(rows: Mapping[str, np.ndarray], campaign: Mapping[str, Any] = CAMPAIGN) -> Material:
    series = {NAMES.get(name, name): values.copy() for name, values in rows.items()}
    return Material(rows=(), campaign=campaign, standards={}, series=series)


def without(*roles: str) -> dict[str, Any]:
    return {**CAMPAIGN, "columns": [one for one in CAMPAIGN["columns"] if one["role"] not in roles]}


def value(analysis: Analysis, quantity: str) -> tuple[float, float]:
    (one,) = [entry for entry in analysis.estimates if entry.quantity == quantity]
    return one.value, one.expanded_uncertainty


@pytest.fixture(scope="module")
def lagging() -> Analysis:
    rows = ramp_rows(5, lag_s=LAG_s)
    given = material(rows)
    given.series["standard"][0] = np.nan
    given.series["meter"][:3] = np.nan
    return analyse(given)


def test_the_drift_model_equals_lstsq_on_the_same_means() -> None:
    """The temperature is the mean of the sensors."""
    rows = ramp_rows(1, step_ppm=-2.0)
    rows["s1"] = rows["s1"] + 0.4
    columns = ramp_columns(material(rows))
    np.testing.assert_allclose(columns.temperature_degC, rows["set"] + 0.2, atol=1e-9)
    blocks = block_means(columns.t_s, 300)
    temperature, readings = blocks.mean(columns.temperature_degC), blocks.mean(columns.readings["meter"])
    branch = blocks.mean(columns.branch / 2.0)
    fit = fit_drift(blocks, temperature, readings, branch, 25.0)
    hours = blocks.hours()
    design = np.column_stack([(temperature - 25.0) ** k for k in range(4)] + [branch, hours, hours**2])
    np.testing.assert_allclose(fit.parameters, np.linalg.lstsq(design, readings, rcond=None)[0], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(fit.operator @ readings, fit.parameters, rtol=1e-9, atol=1e-10)
    np.testing.assert_array_equal(drift_columns(blocks), design[:, 5:])
    t_s = np.concatenate((np.arange(0.0, 1000.0, 10.0), np.arange(5000.0, 6000.0, 10.0)))
    with_gap = block_means(t_s, 60)
    assert (with_gap.count.sum(), with_gap.count.min() > 0) == (t_s.size, True), "every row once, no empty block"
    assert with_gap.mean(t_s) == pytest.approx(with_gap.middle_s)
    assert np.all((with_gap.start_s <= with_gap.middle_s) & (with_gap.middle_s < with_gap.end_s))


def test_a_step_and_a_drift_are_told_apart() -> None:
    found = analyse(material(ramp_rows(2, step_ppm=-2.0)), "drift")
    after, expanded = value(found, "up_minus_down_after_drift")
    assert after == pytest.approx(-2.0, abs=max(expanded, 0.05))
    assert expanded < 0.2
    assert value(found, "drift_rate")[0] == pytest.approx(0.05, abs=0.02)
    assert value(found, "drift_curvature")[0] == pytest.approx(-0.005, abs=0.002)
    assert value(found, "meter_tc1")[0] == pytest.approx(0.6, abs=0.01)
    assert value(found, "meter_tc2")[0] == pytest.approx(0.01, abs=0.002)
    assert value(found, "meter_tc3")[0] == pytest.approx(-1e-3, abs=3e-4)
    naive = [one for one in found.estimates if one.quantity == "up_minus_down"]
    assert [one.conditions["temperature_degC"] for one in naive] == [float(at) for at in range(21, 35)]
    assert not any(one.quantity in ("hysteresis_width", "thermal_lag") for one in found.estimates)


def test_a_lag_is_found_and_leaves_no_hysteresis_though_the_branches_differ(lagging: Analysis) -> None:
    lag_min, lag_expanded = value(lagging, "thermal_lag")
    assert lag_min == pytest.approx(LAG_s / 60.0, abs=max(lag_expanded, 1.0))
    assert lag_expanded < 5.0
    width, expanded = value(lagging, "hysteresis_width")
    assert abs(width) < max(expanded, 0.05)
    assert value(lagging, "up_minus_down_after_drift")[0] < -1.0
    assert any("no play half-width" in note for note in lagging.notes)


def test_overloaded_rows_are_left_out_and_counted(lagging: Analysis) -> None:
    assert {(one.n, one.dropped) for one in lagging.estimates} == {(957, 3)}
    assert lagging.notes[0].startswith("3 of 960 rows are left out")
    assert english_left(lagging) == set()


def looping(seed: int, lag_s: float, half_width_degC: float) -> Material:
    """A log of a unit that lags, with a play of 1 ppm to each side."""
    rows = ramp_rows(seed, lag_s=lag_s)
    rows["dmm"] = rows["dmm"] * (1.0 + 2e-6 * loop(lagging_by(rows["t_s"], lag_s), half_width_degC))
    return material(rows)


def loop(temperature: np.ndarray, half_width: float) -> np.ndarray:
    """One from the rising branch to the falling one."""
    return (slack(temperature, half_width) - temperature) / (2.0 * half_width)


def test_a_lag_longer_than_a_ramp_can_show_leaves_no_width() -> None:
    """Held at a tenth of the record the lag would be 29 min short, and the width and half-width off with it."""
    found = analyse(looping(5, 9000.0, 1.0))
    assert not [one for one in found.estimates if one.quantity in ("hysteresis_width", "thermal_lag")]
    (said,) = found.missing
    assert said.startswith("meter: no hysteresis width")
    assert f"No result: {said}." in found.notes
    assert value(found, "drift_rate")  # the other model stands


@pytest.mark.parametrize("half_width_degC", [0.1, 1.0])
def test_lag_and_loop_together(half_width_degC: float) -> None:
    found = analyse(looping(6, LAG_s, half_width_degC))
    for quantity, truth in (("hysteresis_width", 2.0), ("thermal_lag", 30.0), ("play_half_width", half_width_degC)):
        obtained, expanded = value(found, quantity)
        assert abs(obtained - truth) < 2.0 * expanded, quantity


def test_the_start_of_the_play_is_a_part_of_the_width() -> None:
    """Rectangular between a start from below and from above: two fits, their distance over sqrt(12), in squares."""
    columns = ramp_columns(material(ramp_rows(5, lag_s=LAG_s, step_ppm=-1.0)))
    blocks = block_means(columns.t_s, 240)
    readings, sensor = blocks.mean(columns.readings["meter"]), blocks.mean(columns.temperature_degC)
    noise = fit_drift(blocks, sensor, readings, blocks.mean(columns.branch / 2.0), 25.0).noise
    drive = ramp_drive(columns, blocks)
    found = fit_ramp_hysteresis(blocks, readings, drive, noise, 25.0)
    gates = Gates(blocks.start_s, blocks.end_s)
    widths = []
    for start in (-1.0, 1.0):
        shape = ModelShape(25.0, 3, drift_columns(blocks), ("drift rate", "drift curvature"), start)
        design = HysteresisModel(gates, drive, shape).columns(found.fit.value(LAG), found.fit.value(HALF_WIDTH))
        t_s = blocks.middle_s
        lags_s = np.abs(t_s[:, None] - t_s)
        covariance = found.noise.slow * np.exp(-lags_s / found.noise.time_s) + found.noise.white * np.eye(t_s.size)
        factor = np.linalg.cholesky(covariance)
        white = np.linalg.solve(factor, np.column_stack((design, readings)))
        widths.append(np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=None)[0][4])
    assert found.start_std == pytest.approx(abs(widths[1] - widths[0]) / np.sqrt(12.0), rel=1e-5)
    assert found.start_std > 0.0
    assert found.width[1] == pytest.approx(np.hypot(found.fit.std("hysteresis width"), found.start_std))


def test_what_the_report_gets(lagging: Analysis) -> None:
    assert len(lagging.figures) == 4
    for series in (series for figure in lagging.figures for series in figure.series):
        assert len(series.x) == len(series.y) > 0
        assert np.isfinite(series.y).all()
    segments, totals, by_sensor, left, unseen = lagging.tables
    assert [row[0] for row in segments.rows] == KINDS
    assert [row[2] for row in totals.rows] == pytest.approx([5.0, 6.0, 5.0], rel=0.02)
    assert by_sensor.rows[-1][0] == "after drift"
    assert left.rows[1][4] < left.rows[0][4]
    assert any("drift" in row[0] for row in unseen.rows)


def test_without_set_point_and_reference_the_reading_is_taken_as_it_is() -> None:
    rows = ramp_rows(3, step_ppm=-2.0)
    given = material(rows, without("set_point", "reference"))
    found = analyse(given, "drift")
    after, _ = value(found, "up_minus_down_after_drift")
    assert after == pytest.approx(-2e-6, abs=0.5e-6)
    assert {one.unit for one in found.estimates} == {"V", "V/h", "V/h2", "V/degC", "V/degC2", "V/degC3"}
    assert any("maps no set-point" in note for note in found.notes)


@pytest.mark.parametrize(
    ("given", "code", "why"),
    [
        (Material((), CAMPAIGN, {}), "B-FIT-060", "no imported log"),
        (material(ramp_rows(1), without("temperature")), "B-FIT-060", "no imported log"),
        (material({name: values[:99] for name, values in ramp_rows(1).items()}), "B-FIT-060", "99 of 99 rows"),
        (material({name: values[:500] for name, values in ramp_rows(1).items()}), "B-FIT-061", "found: hold, up, hold"),
    ],
)
def test_what_cannot_be_analysed(given: Material, code: str, why: str) -> None:
    with pytest.raises(FitError, match=f"{code}.*{why}"):
        analyse(given)


def test_a_plain_programme_is_found_to_the_second() -> None:
    found = find_segments(T_s, programme(T_s), 600.0)
    assert [one.kind for one in found] == KINDS
    np.testing.assert_allclose([one.start_s for one in found], CORNERS_s[:-1], atol=1.0)
    np.testing.assert_allclose([one.rate_degC_h for one in found], [0.0, 3.0, 0.0, -3.0, 0.0], atol=1e-6)
    np.testing.assert_allclose([one.end_degC for one in found], [20.0, 35.0, 35.0, 20.0, 20.0], atol=1e-3)
    assert [one.length_h for one in found] == pytest.approx([2.0, 5.0, 2.0, 5.0, 2.0], rel=1e-3, abs=0.01)
    asked = np.array([HOLD_s / 2, HOLD_s + RAMP_s / 2, 1.5 * HOLD_s + RAMP_s, 2 * HOLD_s + 1.5 * RAMP_s, T_s[-1]])
    assert branches(asked, found).tolist() == [0, 1, 0, -1, 0]


PLAIN = programme(T_s)
UNTOUCHED = (T_s < 9000.0) | (T_s > 14000.0)


@pytest.mark.parametrize(
    ("shown_degC", "kept", "later_s", "within_s"),
    [
        (PLAIN + np.random.default_rng(3).normal(0.0, 0.03, T_s.size), T_s >= 0.0, 0.0, 90.0),
        (np.floor(PLAIN / 0.05) * 0.05, T_s >= 0.0, 0.0, 90.0),
        (lagging_by(T_s, 300.0), T_s >= 0.0, 300.0, 200.0),
        (PLAIN + np.where((T_s > CORNERS_s[2]) & (T_s < CORNERS_s[2] + 600.0), 0.5, 0.0), T_s >= 0.0, 0.0, 600.0),
        (PLAIN, UNTOUCHED, 0.0, 60.0),
    ],
    ids=["noise", "coarse steps", "a sensor behind a lag", "a short overshoot", "a gap"],
)
def test_what_spoils_a_programme_moves_its_turns_little(
    shown_degC: np.ndarray, kept: np.ndarray, later_s: float, within_s: float
) -> None:
    found = find_segments(T_s[kept], shown_degC[kept], 600.0)
    assert [one.kind for one in found] == KINDS
    np.testing.assert_allclose([one.start_s for one in found[1:]], CORNERS_s[1:-1] + later_s, atol=within_s)


def test_a_triangle_has_no_hold_and_a_record_that_stands_still_is_one() -> None:
    triangle = np.interp(T_s, [0.0, T_s[-1] / 2, T_s[-1]], [10.0, 30.0, 10.0])
    assert [one.kind for one in find_segments(T_s, triangle, 600.0)] == ["up", "down"]
    found = find_segments(T_s, 23.0 + np.random.default_rng(4).normal(0.0, 0.01, T_s.size))
    assert [(one.kind, one.start_s, one.end_s) for one in found] == [("hold", 0.0, T_s[-1])]


PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "test"}
FROZEN_h = 10.0
Log = dict[str, np.ndarray]


def log(seed: int, *, lag_s: float = LAG_s, ppm: np.ndarray | float = 0.0) -> Log:
    """A log with noisy sensors; ``ppm`` is added to its reading."""
    rows = ramp_rows(seed, lag_s=lag_s)
    rng = np.random.default_rng(seed + 1000)
    for sensor in ("s1", "s2"):
        rows[sensor] = rows[sensor] + rng.normal(0.0, 0.01, rows["t_s"].size)
    rows["dmm"] = rows["dmm"] * (1.0 + 1e-6 * ppm)
    return rows


def analysed(rows: Log, method: str = "joint") -> tuple[Analysis, dict[str, Any]]:
    analysis = analyse(material(rows), method)
    return analysis, build_results("session", analysis, {}, PROVENANCE)


def reasons(results: dict[str, Any], quantity: str) -> dict[str, str]:
    """Return sentences by code against the one estimate of a quantity."""
    (entry,) = [one for one in results["estimates"] if one["quantity"] == quantity]
    return {reason["code"]: reason["sentence"] for reason in entry["reasons"]}


def unsound(results: dict[str, Any]) -> list[Any]:
    return [one["reasons"] for one in results["estimates"] if one["quality"] != "sound"]


def alike(seed: int, noise_s: float) -> np.ndarray:
    """Noise of 0.3 ppm, one value a minute, that is alike for a time."""
    kept = float(np.exp(-60.0 / noise_s))
    steps = np.random.default_rng(seed).normal(0.0, 0.3, 960)
    return lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], steps)


def test_a_step_midway_is_doubted_in_every_number_that_it_moves() -> None:
    t_s = log(1)["t_s"]
    _, results = analysed(log(1, ppm=2.0 * (t_s > 0.55 * t_s[-1])))
    for quantity in ("thermal_lag", "drift_rate", "drift_curvature"):
        assert "8.79 h after the begin: +1.9 ppm" in reasons(results, quantity)["departs"]


@pytest.mark.parametrize("seed", range(2))
def test_a_misfit_that_the_noise_would_take_is_doubted(seed: int) -> None:
    """A bend beside noise that is alike for 100 min; three plays, and a width that grows with the temperature."""
    felt = lagging_by(log(seed)["t_s"], LAG_s)
    bent = 3.0 * np.maximum(0.0, felt - 30.0) + alike(seed, 6000.0)
    assert "departs" in reasons(analysed(log(seed, ppm=bent))[1], "up_minus_down_after_drift")
    for ppm in (20.0 / 3.0 * sum(loop(felt, half) for half in (0.3, 1.0, 2.5)), 0.5 * (felt - 28.0) * loop(felt, 1.0)):
        assert "departs" in reasons(analysed(log(seed, ppm=ppm))[1], "hysteresis_width")


@pytest.mark.parametrize("noise_s", [0.0, 6000.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_right_log_is_not_doubted(seed: int, noise_s: float) -> None:
    """With white noise alone, and with 0.3 ppm that are alike for 100 min beside it."""
    slow = alike(seed, noise_s) if noise_s else 0.0
    assert unsound(analysed(log(seed, ppm=slow))[1]) == []


def test_a_first_row_of_junk_and_a_sensor_that_errs_once_are_named_and_left_out() -> None:
    usual = analysed(log(3), "drift")[1]["estimates"]
    rows = log(3)
    rows["dmm"][0], rows["s2"][500], rows["s1"][-1] = 18.0, 85.0, -40.0
    analysis, results = analysed(rows, "drift")
    assert {(one["n"], one["dropped"]) for one in results["estimates"] if one["n"] > 900} == {(957, 3)}
    assert any("3 of the rows: 0.000 h, 8.333 h, 15.983 h" in note for note in analysis.notes)
    assert unsound(results) == []
    for one, before in zip(results["estimates"], usual, strict=True):
        assert abs(one["value"] - before["value"]) < 0.5 * before["expanded_uncertainty"]


def test_a_row_that_came_twice_counts_once() -> None:
    rows = {name: np.insert(values, 200, values[200]) for name, values in log(3).items()}
    assert {one.dropped for one in analysed(rows, "drift")[0].estimates} == {1}


@pytest.mark.parametrize("sensors", [("s1",), ("s1", "s2")])
def test_a_sensor_that_froze_is_doubted(sensors: tuple[str, ...]) -> None:
    rows = log(4)
    late = rows["t_s"] > FROZEN_h * 3600.0
    for name in sensors:
        rows[name][late] = rows[name][late][0]
    _, results = analysed(rows, "drift")
    assert not any(one["quality"] == "sound" for one in results["estimates"])
    said = {reason["sentence"] for one in results["estimates"] for reason in one["reasons"]}
    for name in sensors:
        place = f"{NAMES[name]} stands still for 5.97 h from 10.02 h on"
        assert len([sentence for sentence in said if sentence.startswith(place)]) == 1


def test_a_coarse_sensor_may_stand_still_in_a_hold() -> None:
    rows = log(4)
    for name in ("s1", "s2"):
        rows[name] = np.round(rows[name], 1)
    assert unsound(analysed(rows, "drift")[1]) == []


def test_gaps_leave_a_ramp_sound() -> None:
    rows = log(5)
    kept = np.ones(rows["t_s"].size, dtype=bool)
    for first, length in ((100, 9), (300, 5), (500, 20), (700, 7)):
        kept[first : first + length] = False
    _, results = analysed({name: values[kept] for name, values in rows.items()}, "drift")
    assert unsound(results) == []


M, STEP_s = 150, 600.0
BLOCKS_s = np.arange(M) * STEP_s


def dense(t_s: np.ndarray, white: float, slow: float, time_s: float) -> np.ndarray:
    return white * np.eye(t_s.size) + slow * np.exp(-np.abs(t_s[:, None] - t_s) / time_s)


@pytest.mark.validates(
    "whitening of exponentially correlated noise",
    against="numpy's Cholesky factor of the dense matrix",
)
def test_whitening_equals_the_cholesky_factor_of_the_matrix(record_property: Callable[[str, object], None]) -> None:
    rng = np.random.default_rng(1)
    t_s = np.sort(rng.uniform(0.0, 1e5, 120))
    columns = rng.normal(size=(120, 4))
    factor = np.linalg.cholesky(dense(t_s, 0.5, 2.0, 3000.0))
    filtered = whitening(t_s, (0.5, 2.0, 3000.0))
    found = filtered.of(columns)
    record_property("obtained", f"{np.abs(found - np.linalg.solve(factor, columns)).max():.0e}, limit 1e-12")
    np.testing.assert_allclose(found, np.linalg.solve(factor, columns), atol=1e-12)
    assert filtered.log_volume == pytest.approx(float(np.sum(np.log(np.diag(factor)))), rel=1e-12)
    np.testing.assert_allclose(filtered.of(columns[:, 0]), found[:, 0], atol=1e-13)


def test_white_noise_is_found_white() -> None:
    rng = np.random.default_rng(2)
    design = np.vander(np.linspace(-1, 1, M), 3)
    noise = fit_noise(BLOCKS_s, rng.normal(0.0, 2.0, M), design)
    weights = np.full(M, 1.0 / M)
    variance, dof = noise.variance_of(weights, BLOCKS_s)
    assert variance == pytest.approx(4.0 / M, rel=0.5)
    assert noise.white + noise.slow == pytest.approx(4.0, rel=0.3)
    assert dof > 10


def test_size_and_duration_of_slow_noise() -> None:
    rng = np.random.default_rng(3)
    t_s = np.arange(200) * STEP_s
    factor = np.linalg.cholesky(dense(t_s, 0.2, 1.0, 6000.0))
    found = [fit_noise(t_s, factor @ rng.normal(size=200), np.ones((200, 1))) for _ in range(8)]
    assert float(np.median([one.slow for one in found])) == pytest.approx(1.0, rel=0.3)
    assert float(np.median([one.time_s for one in found])) == pytest.approx(6000.0, rel=0.4)
    assert float(np.median([one.white for one in found])) == pytest.approx(0.2, rel=0.4)


def test_variance_of_a_sum_is_that_of_the_matrix() -> None:
    rng = np.random.default_rng(4)
    noise = fit_noise(BLOCKS_s, rng.normal(size=M).cumsum(), np.ones((M, 1)))
    weights = rng.normal(size=M)
    matrix = dense(BLOCKS_s, noise.white, noise.slow, noise.time_s)
    assert noise.variance_of(weights, BLOCKS_s)[0] == pytest.approx(weights @ matrix @ weights, rel=1e-12)


@pytest.mark.validates(
    "95 % intervals of up minus down in an imported ramp",
    against="24 simulated ramps each with noise alike for 0 s, 6,000 s and 30,000 s",
)
@pytest.mark.parametrize(
    ("trials", "seed", "least", "most"), [(24, 5, 0.8, 1.0), pytest.param(500, 6, 0.92, 0.985, marks=pytest.mark.sweep)]
)
@pytest.mark.parametrize("time_s", [0.0, 6000.0, 30000.0])
def test_intervals_hold_the_truth_and_those_of_independent_rows_do_not(
    record_property: Callable[[str, object], None], time_s: float, trials: int, seed: int, least: float, most: float
) -> None:
    """Share of intervals of the up/down term that hold its true value 0: stated, and for independent rows."""
    rng = np.random.default_rng(seed)
    factor = np.linalg.cholesky(dense(BLOCKS_s, 0.1, 1.0, time_s) if time_s else np.eye(M))
    branch = np.repeat([0.0, 0.5, 0.0, -0.5, 0.0], M // 5)
    temperature = 20.0 + 15.0 * np.interp(np.arange(M), M * np.array([0.2, 0.4, 0.6, 0.8]), [0.0, 1.0, 1.0, 0.0])
    blocks = block_means(BLOCKS_s, M)
    held = naive = 0
    for _ in range(trials):
        fit = fit_drift(blocks, temperature, factor @ rng.normal(size=M), branch, 25.0)
        value, std, dof = fit.estimate("up minus down")
        held += abs(value) <= stats.t.ppf(0.975, dof) * std
        sigma = float(np.sqrt(fit.residual @ fit.residual / (M - 7)))
        naive += abs(value) <= 1.96 * sigma * float(np.linalg.norm(fit.operator[4]))
    held, naive = held / trials, naive / trials
    record_property("obtained", f"{time_s:.0f} s: {100 * held:.0f} %, as independent rows {100 * naive:.0f} %")
    assert least <= held <= most
    assert (naive < 0.7) == (time_s > 0)
