"""Calibrations of a GNC module in wrong worlds: no number that looks sound, and none lost in a right one.

Samples are made from the physics alone (``doubt_gnc``); nothing of the product or its simulators makes them.
"""

from functools import cache

import doubt_gnc as gnc
import imu_material as imu
import numpy as np
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, Seen, codes_of, is_hidden, right_world, sorted_classes

from bench.analysis import build_results
from bench.model.systems import assumptions_of
from bench.session.coefficients import coefficients_of_session
from bench.systems.gnc.calibration.analysis import analyse

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
    bench = gnc.recorded(1, SWITCHES["table_tilted"].world(0.2), form=gnc.Form(magnetic=False))
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
