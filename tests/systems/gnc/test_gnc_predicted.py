"""Holds what is predicted of GNC campaigns against the spread of their estimates about the truth of the simulator, and
against formulas of white noise; what predictions name as missing. Calibrations in wrong worlds, made from the physics
alone (``doubt_gnc``): no number that looks sound, and none lost in a right one.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import doubt_gnc as gnc
import imu_material as imu
import numpy as np
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, Seen, codes_of, is_hidden, right_world, sorted_classes
from gnc_campaigns import bias_truth, calibration_study, magnetometer_truth, plan_of, rewritten, study
from one_estimate import every
from spread_study import Study

from bench.analysis import Planned, Prediction, build_results
from bench.model.errors import FitError
from bench.model.systems import assumptions_of
from bench.session.coefficients import coefficients_of_session
from bench.session.predicted import planned_of, predicted
from bench.systems.gnc import bias, magnetometer
from bench.systems.gnc.calibration.analysis import analyse
from bench.systems.gnc.predicted import of_magnetometer, of_unit_test

SHORT = {"position": "60 s", "check_position": "20 s"}


def bias_study(units: int) -> Study:
    return study(plan_of("gnc_bias", 50.0), bias.analyse, lambda module, _: bias_truth(module), 6000, units)


def magnetometer_study(units: int) -> Study:
    plan = plan_of("gnc_magnetometer", 50.0)
    return study(plan, magnetometer.analyse, lambda module, _: magnetometer_truth(module), 7000, units)


STUDIES: dict[str, tuple[Callable[[int], Study], int, int, int]] = {  # units of a few and of many, estimates of each
    "calibrations": (lambda n: calibration_study(plan_of("gnc_imu_calibration", **SHORT), 5000, n), 2, 1000, 60),
    "vertical": (lambda n: calibration_study(plan_of("gnc_imu_calibration_vertical", **SHORT), 5000, n), 2, 1000, 60),
    "biases": (bias_study, 1, 500, 17),
    "magnetometers": (magnetometer_study, 2, 500, 19),
}


@pytest.mark.parametrize("name", STUDIES)
@pytest.mark.parametrize("many", [False, pytest.param(True, marks=pytest.mark.sweep)])
def test_units_scatter_as_predicted(name: str, many: bool) -> None:
    of, *units, estimates = STUDIES[name]
    found = of(units[many])
    print(*found.lines(), f"median {found.median():.3f}, outside of 99.9 %: {found.outside()}", sep="\n")
    assert found.prediction.missing == []
    unanswered = [entry for entry in found.prediction.estimates if not entry.quantity.startswith("mag_roll")]
    assert len(found.scores) == len(unanswered) == estimates
    assert found.outside() == {}
    assert not many or 0.97 < found.median() < 1.03


def test_a_request_of_another_form_is_named() -> None:
    planned = planned_of(plan_of("gnc_unit_test", units="GNC-01"))
    cut = [replace(one, sent=one.sent[:-1]) if one.name == "timer" else one for one in planned.exchanges]
    found = of_unit_test(replace(planned, exchanges=cut))
    assert {entry.quantity for entry in found.estimates} == {"imu_rate", "imu_acceleration"}
    (sentence,) = found.missing
    assert sentence.startswith("timer: not predicted, as a request of ")


NOISE = "gyro_random_walk: 0.3 deg/sqrt(h), "


def stds_of(prediction: Prediction, quantity: str, **conditions: str) -> list[float]:
    return [entry.std_uncertainty for entry in every(prediction, quantity, **conditions)]


def test_a_calibration_follows_the_formulas_of_white_noise(tmp_path: Path) -> None:
    """Gyro bias N / sqrt(4 T); mean of six positions; scale factors from two integrals and from two positions."""
    settled = ", gyro_wandering: [{size: 2 deg/h, over: 300 s}]"
    slow = "accelerometer_wandering: [{size: 6 ug, over: 10 s}, {size: 6 ug, over: 100 s}, {size: 6 ug, over: 1000 s}],"
    found = predicted(rewritten(tmp_path, "gnc_imu_calibration", (settled, ""), (slow, "")))
    assert found.missing == []
    walk, turn_s = math.sqrt((0.3 / 60.0) ** 2 + 0.005**2 / 12.0 / 200.0), 5.0 + 1.0  # 270 deg/s and its ramps
    np.testing.assert_allclose(stds_of(found, "gyro_bias"), 3600.0 * walk / math.sqrt(4.0 * 21.3), rtol=0.005)
    due_ppm = 1e6 * walk * math.sqrt(2.0 * turn_s) / 2160.0
    np.testing.assert_allclose(stds_of(found, "gyro_scale_error"), due_ppm, rtol=0.02)
    mean_g = math.sqrt((1e-4**2 + 1e-3**2 / 12.0 / 200.0) / 300.0)
    np.testing.assert_allclose(stds_of(found, "accel_bias"), mean_g / math.sqrt(6.0), rtol=1e-6)
    due_ppm = 1e6 * mean_g / math.sqrt(2.0) / (9.7969 / 9.80665)
    np.testing.assert_allclose(stds_of(found, "accel_scale_error"), due_ppm, rtol=1e-6)


def test_a_longer_position_buys_what_its_noise_allows(tmp_path: Path) -> None:
    short, long = (predicted(rewritten(tmp_path, "gnc_imu_calibration", position=time)) for time in ("100 s", "400 s"))
    gain = stds_of(short, "accel_scale_error")[0] / stds_of(long, "accel_scale_error")[0]
    assert 1.2 < gain < 2.0  # white noise alone would make it 2
    tilted = rewritten(tmp_path, "gnc_imu_calibration", ("azimuth: 90 deg}", "azimuth: 90 deg, tilt: 1 arcmin}"))
    assert min(stds_of(predicted(tilted), "accel_cross_coupling")) > 0.5 * math.radians(1.0 / 60.0)


def test_what_a_plan_leaves_open_is_named(tmp_path: Path) -> None:
    cut = '      - position: {up: +y, middle: 0 deg, inner: 90 deg, time: "{time}"}\n'
    down = cut.replace("+y", "-y").replace("inner: 90", "inner: -90")
    found = predicted(rewritten(tmp_path, "gnc_imu_calibration", (cut, ""), (down, "")))
    assert stds_of(found, "accel_bias") == []
    assert len(stds_of(found, "gyro_bias")) == 3
    assert "position +y up: no record" in found.missing
    assert any("B-FIT-001" in sentence for sentence in found.missing)
    found = predicted(rewritten(tmp_path, "gnc_imu_calibration", ("  - rotations: {axis: z}\n", "")))
    assert stds_of(found, "gyro_bias") == []
    assert "rotation Z+: no record" in found.missing
    found = predicted(rewritten(tmp_path, "gnc_imu_calibration", turn_record="4 s"))  # it ends within the turn
    assert stds_of(found, "gyro_bias") == []
    assert any("B-FIT-08" in sentence for sentence in found.missing)
    walk = ("accelerometer_random_walk: 100 ug/sqrt(Hz)", "accelerometer_random_walk: 0 ug/sqrt(Hz)")
    steps = ("accelerometer_resolution: 1 mg", "accelerometer_resolution: 0 mg")  # no uncertainty at all
    found = predicted(rewritten(tmp_path, "gnc_imu_calibration", walk, steps))
    assert stds_of(found, "accel_bias") == []
    assert any("accelerometers: their noise is not declared" in sentence for sentence in found.missing)


@pytest.mark.parametrize("name", ["gnc_imu_calibration", "gnc_bias"])
def test_noise_that_is_not_declared_is_asked_for(tmp_path: Path, name: str) -> None:
    found = predicted(rewritten(tmp_path, name, (NOISE, "")))
    assert stds_of(found, "gyro_bias") == []
    assert stds_of(found, "accel_bias") != []
    assert any("declare gyro_random_walk" in sentence for sentence in found.missing)


def test_a_rest_that_is_too_short_is_named(tmp_path: Path) -> None:
    found = predicted(rewritten(tmp_path, "gnc_bias", stability_time="30 min", repeat_gap="1 min"))
    assert stds_of(found, "gyro_bias_stability") == stds_of(found, "accel_bias_repeatability") == []
    assert sum("B-FIT-092" in sentence for sentence in found.missing) == 6
    assert sum("B-FIT-093" in sentence for sentence in found.missing) == 6


def test_a_magnetometer_without_declared_noise_or_field_b_gnc_008(tmp_path: Path) -> None:
    field = ",\n   magnetic_field: {size: 0.43 gauss, inclination: 55 deg, declination: -4 deg}}"
    for cut, name in (((field, "}"), "magnetic_field"), ((",\n     magnetometer_noise: 0.5 mgauss}", "}"), "noise")):
        plan = rewritten(tmp_path, "gnc_magnetometer", cut)
        found = predicted(plan)
        assert found.estimates == []
        (sentence,) = found.missing
        assert name in sentence
        assert "is not declared" in sentence
        with pytest.raises(FitError, match="B-GNC-008"):
            of_magnetometer(Planned([], plan.campaign, {}))


def test_attitudes_that_do_not_determine_an_ellipsoid_are_named(tmp_path: Path) -> None:
    lines = [f'  - attitude: {{outer: "{{north}}", middle: {middle} deg}}\n' for middle in (20, -10, -35, -60, -90)]
    found = predicted(rewritten(tmp_path, "gnc_magnetometer", *((line, "") for line in lines)))
    assert stds_of(found, "mag_hard_iron") == []
    assert any("B-FIT-091" in sentence for sentence in found.missing)


def test_a_unit_test_is_known_as_its_counter_and_its_noise_say(tmp_path: Path) -> None:
    """A tick over sqrt(12); noise of one sample over the root of fifty."""
    found = predicted(rewritten(tmp_path, "gnc_unit_test", units="GNC-01"))
    due = [12.0**-0.5 / setting for setting in (500, 1000, 2000, 5000)]
    assert sorted(stds_of(found, "timer_interval_error")) == pytest.approx(sorted(due))
    sample_deg_s = math.hypot(0.3 / 60.0 * math.sqrt(200.0), 0.005 / math.sqrt(12.0))
    assert stds_of(found, "imu_rate") == pytest.approx([sample_deg_s / math.sqrt(50.0)] * 3)
    sample_g = math.hypot(1e-4 * math.sqrt(200.0), 1e-3 / math.sqrt(12.0))
    assert stds_of(found, "imu_acceleration") == pytest.approx([sample_g / math.sqrt(50.0)] * 3)
    of_one = predicted(rewritten(tmp_path, "gnc_unit_test", (NOISE, ""), units="GNC-01,GNC-02"))
    assert stds_of(of_one, "imu_rate") == []
    assert len(stds_of(of_one, "imu_acceleration")) == 6
    assert [sentence for sentence in of_one.missing if "declare gyro_random_walk" in sentence] == of_one.missing


def test_ellipse_and_rolls_are_known_as_their_noise_says(tmp_path: Path) -> None:
    """Offsets of n even readings of a circle: noise sqrt(2 / n); rolls: one reading less the mean of all, noise of an
    axis over the field across z, which the site declares.
    """
    found = predicted(rewritten(tmp_path, "gnc_magnetometer", record_time="48 s", attitude_time="24 s"))
    noise = math.hypot(0.5e-3, 120e-6 / math.sqrt(12.0))
    offsets = stds_of(found, "mag_offset", method="ellipse")
    np.testing.assert_allclose(offsets, noise * math.sqrt(2.0 / 9600.0), rtol=0.01)
    dip, east = math.radians(55.0), math.radians(4.0)
    across = 0.43 * math.hypot(math.sin(dip), math.cos(dip) * math.sin(east))
    single_deg = math.degrees(noise / across)
    assert stds_of(found, "mag_roll") == pytest.approx([single_deg] * 8, rel=0.01)
    assert stds_of(found, "mag_roll_error") == pytest.approx([single_deg * math.sqrt(7.0 / 8.0)] * 24, rel=0.02)


SWITCHES = {switch.name: switch for switch in gnc.SWITCHES}


@cache
def wrong_world(name: str, size: float) -> Seen:
    return gnc.seen(1, SWITCHES[name], size)


@pytest.mark.parametrize(
    ("name", "size", "left", "least", "code"),
    [
        ("one_turn_short", 10.0, DOUBTED, 21, "departs"),
        ("one_pose_tilted", 2.0, DOUBTED, 11, "departs"),  # what it does not move stays sound
        ("table_tilted", 0.2, DOUBTED, 9, "departs"),
        ("gyro_bias_step", 1.0, DOUBTED, 21, "departs"),
        ("upside_down", 12.0, REFUSED, 21, "implausible_axis"),
        ("scale_changes", 3e-4, DOUBTED, 12, "departs"),  # all scales and the diagonals of both matrices
        ("hung_axis", 1.0, DOUBTED, 21, "stands_still"),
        ("field_drifts", 1e-3, DOUBTED, 9, "field_wanders"),
        ("magnetised_between", 1e-3, DOUBTED, 6, "departs"),  # zeros of x and y: no gain, no soft iron
        ("axis_saturates", 1e-3, DOUBTED, 9, "departs"),
    ],
)
def test_what_is_wrong_is_named(name: str, size: float, left: str, least: int, code: str) -> None:
    wrong = wrong_world(name, size)
    counted = sorted_classes(wrong, right_world(gnc, 1))
    assert counted[WRONG] == 0
    assert counted[left] >= least
    assert code in codes_of(wrong)


@pytest.mark.parametrize(
    ("name", "size", "words"),
    [
        ("one_pose_tilted", 2.0, "The zero of the sensors, sensor y, record 1 (+x), there only: +3.49e+04 ug"),
        ("scale_changes", 3e-4, "What is indicated, at set "),
        ("magnetised_between", 1e-3, "The zero of axis x, at the turn only: +0."),
        ("axis_saturates", 1e-3, "Harmonic of order "),
        ("bias_step", 1e-2, "The zero of the sensors, step between 16 s and 24 s after the begin: +1e+04 ug"),
    ],
)
def test_what_departs_is_named_with_its_size(name: str, size: float, words: str) -> None:
    said = [reason.sentence for entry in wrong_world(name, size).entries for reason in entry.reasons]
    assert any(sentence.startswith(words) for sentence in said), set(said)


def test_a_tilt_of_the_table_is_that_of_least_squares_with_the_tilt_free() -> None:
    """Means of the samples against matrix, biases of both sets and two tilts, equal weights, by numpy alone."""
    bench = gnc.recorded(1, SWITCHES["table_tilted"].world(0.2), magnetic=False)
    made = [(row, due) for row, (kind, due) in zip(bench.rows, bench.stated, strict=True) if kind == "accel"]
    means = np.concatenate([row.samples.scaled("accel").mean(axis=0) for row, _ in made])
    columns = []
    for number, (_, due) in enumerate(made):
        attitude = imu.to_local(*list(imu.POSES.values())[number % 6], "x")
        leaning = attitude.T @ imu.turned(2, 90.0 - imu.SITE["azimuth_deg"])[:, :2]
        known = np.concatenate([due[0], [number < 6, number >= 6]])
        columns.append(np.hstack([np.kron(known, np.eye(3)), imu.Unit().accel_S @ np.deg2rad(leaning)]))
    free_deg = np.linalg.lstsq(np.concatenate(columns), means, rcond=None)[0][-2:]
    (figure,) = {reason.figure for entry in wrong_world("table_tilted", 0.2).entries for reason in entry.reasons}
    print(f"{figure:.5f} deg, by least squares {np.linalg.norm(free_deg):.5f}")
    assert figure == pytest.approx(np.linalg.norm(free_deg), abs=0.003)


@pytest.mark.parametrize("seed", range(3))
def test_one_turn_in_a_field_that_wanders_has_the_noise_of_all_attitudes(seed: int) -> None:
    """By its own readings alone it would take the wandering for an offset in four of the first six."""
    assert sorted_classes(gnc.seen(seed, SWITCHES["field_wanders"], 1e-4), right_world(gnc, seed))[WRONG] == 0


@pytest.mark.parametrize(("name", "size"), [("bad_samples", 30.0), ("bad_reading", 0.7)])
def test_one_bad_sample_costs_nothing(name: str, size: float) -> None:
    counted = sorted_classes(wrong_world(name, size), right_world(gnc, 1))
    assert counted[WRONG] == counted[DOUBTED] == counted[REFUSED] == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_right_world_is_not_doubted(seed: int) -> None:
    assert [entry.reasons for entry in right_world(gnc, seed).entries if entry.quality != "sound"] == []
    assert len(right_world(gnc, seed).entries) == right_world(gnc, seed).promised


def test_coefficients_hold_sound_sections_alone() -> None:
    """Accelerometers whose bias steps by 10 mg: their section is left out and named, that of the gyros stays."""
    material = gnc.recorded(3, SWITCHES["bias_step"].world(1e-2)).material("imu_calibration", ("accel", "gyro"))
    analysis = analyse(material)
    results = build_results("session", analysis, {"records": len(material.rows)}, gnc.PROVENANCE)
    written = coefficients_of_session(analysis, results, material.campaign)
    assert written is not None
    assert [part["section"] for part in written.document["sections"]] == ["gyro"]
    assert any("no coefficients of accelerometer" in text for text in written.document["sources"][0]["missing"])


def test_what_no_data_can_show_is_named() -> None:
    """Every switch that hides names an assumption of one of both campaigns."""
    site = {"latitude_deg": 34.2, "gravity_m_s2": 9.7969, "tilt_std_deg": 1.0 / 60.0}
    taken = {
        assumption.code: assumption
        for analysis in ("imu_calibration", "magnetometer", "imu_bias")
        for assumption in assumptions_of({"analysis": analysis, "site": site})
    }
    assert {switch.assumption for switch in gnc.SWITCHES} - {""} <= set(taken)
    assert "9.7969 m/s2" in taken["local_gravity"].taken_for_granted
    assert "within 1 arcmin" in taken["mounting"].taken_for_granted
    untold = next(each for each in assumptions_of({"analysis": "imu_calibration"}) if each.code == "mounting")
    assert "states no tilt" in untold.taken_for_granted


def test_what_is_hidden_leaves_no_trace() -> None:
    for name in ("gravity_wrong", "mounted_askew", "table_turns_more"):
        switch = SWITCHES[name]
        assert is_hidden(gnc, switch, switch.sizes[1])
