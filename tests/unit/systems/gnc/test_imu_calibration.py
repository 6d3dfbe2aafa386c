"""The calibration of a simulated unit found again, what is missing named, and the check of the compensation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imu_material import POSES, SITE, Rig, Unit, calibration, values
from spoken import english_left

from bench.analysis import build_results
from bench.model.errors import FitError
from bench.systems.gnc.calibration.analysis import analyse

SEED = 606
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "x 1"}


@pytest.fixture(scope="module")
def twice():
    return analyse(calibration(Rig(SEED), sets=2).material("imu_calibration"))


def test_matrices_and_biases_are_those_of_the_unit(twice) -> None:
    unit = Unit()
    K = values(twice.estimates, "gyro_matrix", "row", "column")
    np.testing.assert_allclose(K, np.linalg.inv(unit.gyro_S), atol=50e-6)
    K = values(twice.estimates, "accel_matrix", "row", "column")
    np.testing.assert_allclose(K, np.linalg.inv(unit.accel_S), atol=50e-6)
    gyro_bias = values(twice.estimates, "gyro_bias")
    np.testing.assert_allclose(gyro_bias, 3600 * unit.gyro_bias_deg_s, atol=4.5 * 18.0 / (4 * 16.3) ** 0.5)
    accel_bias = values(twice.estimates, "accel_bias")
    np.testing.assert_allclose(accel_bias, -np.linalg.inv(unit.accel_S) @ unit.accel_bias_g, atol=5e-5)
    scale = values(twice.estimates, "gyro_scale_error")
    np.testing.assert_allclose(scale, 1e6 * (np.diag(unit.gyro_S) - 1.0), atol=50)
    coupling = values(twice.estimates, "accel_cross_coupling", "row", "column")
    np.testing.assert_allclose(coupling, unit.accel_S - np.diag(np.diag(unit.accel_S)), atol=50e-6)


def test_coupling_is_judged_after_compensation_by_the_second_set(twice) -> None:
    assert english_left(twice) == set()
    for kind in ("accel", "gyro"):
        raw = [one for one in twice.estimates if one["quantity"] == f"{kind}_cross_coupling"]
        left = [one for one in twice.estimates if one["quantity"] == f"{kind}_coupling_compensated"]
        assert {one["verdict"] for one in raw} == {"none"}
        assert max(abs(one["value"]) for one in raw) > 1e-3
        assert len(left) == 6
        assert {one["verdict"] for one in left} == {"pass"}
        assert max(abs(one["value"]) for one in left) < 1e-4
    rows = {row[0]: row[-1] for row in twice.tables[2].rows}
    assert rows["gyro: coupling after compensation"] == "PASS"
    assert rows["gyro: range"] == rows["position, 1 sigma"] == "not tested"
    for kind, row in (("accel", "accelerometer"), ("gyro", "gyro")):
        again = [one for one in twice.estimates if one["quantity"] == f"{kind}_scale_repeatability"]
        assert len(again) == 3
        assert all(abs(one["value"]) < 2.0 * one["expanded_uncertainty"] < 1e-3 for one in again)
        assert rows[f"{row}: scale-factor repeatability, 1 sigma"] == "PASS"
    assert sum(verdict == "PASS" for verdict in rows.values()) == 4
    assert twice.missing == []
    build_results("one", twice, {}, PROVENANCE)


def test_a_scale_factor_that_changes_between_the_sets_is_told_by_its_size() -> None:
    rig = calibration(Rig(SEED), rest_s=10.0)
    rig.unit = replace(rig.unit, gyro_S=rig.unit.gyro_S * np.array([1.002, 1.0, 1.0]))
    analysis = analyse(calibration(rig, rest_s=10.0).material("imu_calibration"))
    changed = [one for one in analysis.estimates if one["quantity"] == "gyro_scale_repeatability"]
    assert changed[0]["value"] == pytest.approx(-2e-3 / 2.0**0.5, rel=0.05)
    assert [one["verdict"] for one in changed] == ["fail", "pass", "pass"]


def test_a_unit_that_changes_between_the_sets_fails_the_check() -> None:
    rig = calibration(Rig(SEED), rest_s=10.0)
    rig.unit = replace(rig.unit, gyro_S=rig.unit.gyro_S + np.array([[0, 3e-3, 0], [0, 0, 0], [0, 0, 0]]))
    analysis = analyse(calibration(rig, rest_s=10.0).material("imu_calibration"))
    left = {
        (one["conditions"]["row"], one["conditions"]["column"]): one["verdict"]
        for one in analysis.estimates
        if one["quantity"] == "gyro_coupling_compensated"
    }
    assert left.pop(("x", "y")) == "fail"
    assert set(left.values()) == {"pass"}


def test_without_a_second_set_coupling_after_compensation_is_not_tested() -> None:
    analysis = analyse(calibration(Rig(SEED), rest_s=10.0).material("imu_calibration"))
    rows = {row[0]: row[-1] for row in analysis.tables[2].rows}
    assert set(rows.values()) == {"not tested"}
    assert sum("no second set" in one for one in analysis.missing) == 2


def test_a_fast_crystal_of_the_unit_makes_no_scale_error() -> None:
    """100 ppm: the unit counts too many seconds, the angle of the table does not depend on them."""
    rig = calibration(Rig(SEED + 2), rest_s=10.0)
    for row in rig.rows:
        tick = row.samples.columns["tick"].astype(np.int64)
        row.samples.columns["tick"] = np.rint(tick * (1.0 + 100e-6)).astype(np.uint32)
    analysis = analyse(rig.material("imu_calibration"))
    off_ppm = values(analysis.estimates, "gyro_scale_error") - 1e6 * (np.diag(Unit().gyro_S) - 1.0)
    assert abs(np.mean(off_ppm)) < 25.0
    assert any("by +100.0 ±" in note for note in analysis.notes)


def switched_off(rig: Rig) -> None:
    """Behind the records so far: the unit's clock begins again, its bias is another one."""
    rig.unit = replace(
        rig.unit, accel_bias_g=rig.unit.accel_bias_g + 3e-4, gyro_bias_deg_s=rig.unit.gyro_bias_deg_s + 0.02
    )


def test_a_unit_that_was_switched_off_between_the_records_is_noticed() -> None:
    """A resumed run: behind the third position, and between the two turns about y."""
    rig, off = Rig(SEED), []
    for number, (up, pose) in enumerate(POSES.items()):
        if number == 3:
            switched_off(rig)
            off.append(len(rig.rows))
        rig.rest(10.0, pose, item="position", up=up)
    for axis, sign in [(axis, sign) for axis in "xyz" for sign in (1, -1)]:
        if (axis, sign) == ("y", -1):
            switched_off(rig)
            off.append(len(rig.rows))
        rig.turn(axis, sign * 1080.0, 16.3, -37.5, -20.0)
    for first in off:
        for row in rig.rows[first:]:
            tick = row.samples.columns["tick"].astype(np.int64) - 60_000_000
            row.samples.columns["tick"] = (tick % (1 << 32)).astype(np.uint32)
    analysis = analyse(rig.material("imu_calibration"))
    for name in ("positions", "rotations"):
        assert any(f"switched off between the {name}" in note for note in analysis.notes)
    truth = {"accel_matrix": np.linalg.inv(Unit().accel_S), "gyro_matrix": np.linalg.inv(Unit().gyro_S)}
    for one in analysis.estimates:
        if one["quantity"] in truth:
            row, column = ("xyz".index(one["conditions"][name]) for name in ("row", "column"))
            assert abs(one["value"] - truth[one["quantity"]][row, column]) < 1.5 * one["expanded_uncertainty"], one
    biases = [one for one in analysis.estimates if one["quantity"] == "gyro_bias"]
    assert min(one["expanded_uncertainty"] for one in biases) > 0.25 * 3600 * 0.02  # it is that of neither power-on


def test_a_unit_that_is_not_warm_is_told() -> None:
    rig = calibration(Rig(SEED), rest_s=10.0)
    assert not any("let it warm up" in note for note in analyse(rig.material("imu_calibration")).notes)
    for number, row in enumerate(rig.rows[:6]):
        row.samples.columns["temperature"][:] = 2500 + 20 * number
    notes = analyse(rig.material("imu_calibration")).notes
    assert any("moved from 25.00 to 26.00 degC over the positions" in note for note in notes)


def test_a_stated_tilt_is_in_the_couplings_and_hardly_in_the_scale_factors() -> None:
    rig = calibration(Rig(SEED), rest_s=10.0)
    tilted = analyse(rig.material("imu_calibration", site=SITE | {"tilt_std_deg": 1.0 / 60.0}))
    plain = analyse(rig.material("imu_calibration"))
    assert any(note.startswith("A tilt of 1 arcmin") for note in tilted.notes)
    for kind in ("accel", "gyro"):
        for quantity, least, most in (("cross_coupling", 150e-6, 350e-6), ("scale_error", 0.0, 20.0)):
            for one, other in zip(tilted.estimates, plain.estimates, strict=True):
                if one["quantity"] == f"{kind}_{quantity}":
                    extra = (one["std_uncertainty"] ** 2 - other["std_uncertainty"] ** 2) ** 0.5
                    assert least <= abs(extra) <= most, one


def test_rotations_are_filed_at_equal_length(twice) -> None:
    names = {f"GNC-07/gyro/{axis}{turn}.csv" for axis in "XYZ" for turn in ("+1080", "-1080")}
    assert set(twice.attachments) == names
    lengths = {len(text.splitlines()) for text in twice.attachments.values()}
    assert lengths == {1 + round(16.3 * 200)}
    first = twice.attachments["GNC-07/gyro/X+1080.csv"].splitlines()
    assert first[0] == "counter,time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"


def test_a_longer_record_is_trimmed_and_told() -> None:
    rig = Rig(SEED)
    for axis in "xyz":
        rig.turn(axis, 1080.0, 17.3, -37.5, -20.0)
        rig.turn(axis, -1080.0, 16.3, -37.5, -20.0)
    analysis = analyse(rig.material("imu_calibration"))
    lengths = {len(text.splitlines()) for text in analysis.attachments.values()}
    assert lengths == {1 + round(16.3 * 200)}
    assert any(note.startswith("X+1080: 1.000 s were cut off") for note in analysis.notes)
    assert "position +x up: no record" in analysis.missing


def test_what_is_missing_is_named_and_costs_only_its_part() -> None:
    rig = calibration(Rig(SEED), rest_s=10.0)
    rig.rows = [row for row in rig.rows if row.window.conditions.get("turn_deg") != -1080.0 or row.window.number != 8]
    rows = [row for row in rig.rows if row.window.conditions.get("up") != "-y"]
    rig.rows = rows
    analysis = analyse(rig.material("imu_calibration"))
    assert "position -y up: no record" in analysis.missing
    assert "rotation X-: no record" in analysis.missing
    assert any(one.startswith("gyros: ") and "B-FIT-081" in one for one in analysis.missing)
    assert any(one["quantity"] == "accel_matrix" for one in analysis.estimates)
    assert not any(one["quantity"] == "gyro_matrix" for one in analysis.estimates)


def test_a_saturated_record_is_not_used() -> None:
    rig = calibration(Rig(SEED), rest_s=10.0)
    rig.rows[6].samples.columns["gyro"][1000:1010, 0] = 80_000
    analysis = analyse(rig.material("imu_calibration"))
    assert any("at the end of the range" in one for one in analysis.missing)
    assert "rotation X+: no record" in analysis.missing


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"up": "+q"}, "'up' is '\\+q'"),
        ({"up": "-x"}, "in its pose up is"),
        ({"mounting": "w"}, "do not give its pose|mounting"),
        ({"item": "rotation", "axis": "x"}, "'turn_deg' None"),
    ],
)
def test_conditions_that_do_not_say_what_a_record_shows(change: dict[str, object], says: str) -> None:
    rig = Rig(SEED)
    rig.rest(
        2.0, POSES["+x"], **({"item": "position", "up": "+x"} | {k: v for k, v in change.items() if k != "mounting"})
    )
    if "mounting" in change:
        rig.rows[0].window.conditions.pop("outer_deg")
        says = "do not give its pose"
    with pytest.raises(FitError, match=says) as caught:
        analyse(rig.material("imu_calibration"))
    assert caught.value.code == "B-GNC-004"


def test_no_samples_no_site_and_an_unknown_method() -> None:
    with pytest.raises(FitError) as caught:
        analyse(Rig(SEED).material("imu_calibration"))
    assert caught.value.code == "B-GNC-003"
    rig = calibration(Rig(SEED), rest_s=10.0)
    with pytest.raises(FitError, match="gravity") as caught:
        analyse(rig.material("imu_calibration", site={"latitude_deg": 1.0, "azimuth_deg": 0.0}))
    assert caught.value.code == "B-GNC-005"
    with pytest.raises(FitError) as caught:
        analyse(rig.material("imu_calibration"), "other")
    assert caught.value.code == "B-FIT-004"
