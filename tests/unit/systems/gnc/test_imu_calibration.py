"""The calibration of a simulated unit found again, what is missing named, and the check of the compensation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imu_material import POSES, SITE, Rig, Unit, calibration, values
from one_estimate import every
from spoken import english_left

from bench.analysis import Analysis
from bench.model.errors import FitError
from bench.systems.gnc.calibration.analysis import analyse

SEED = 606


@pytest.fixture(scope="module")
def twice() -> Analysis:
    return analyse(calibration(Rig(SEED), sets=2).material("imu_calibration"))


def short(seed: int = SEED) -> Rig:
    """One set of a unit, its positions of 10 s."""
    return calibration(Rig(seed), rest_s=10.0)


def analysed(rig: Rig, **more: object) -> Analysis:
    return analyse(rig.material("imu_calibration", **more))


def test_coupling_is_judged_after_compensation_by_the_second_set(twice: Analysis) -> None:
    assert english_left(twice) == set()
    assert twice.missing == []
    rows = {row[0]: row[-1] for row in twice.tables[2].rows}
    for kind, name in (("accel", "accelerometer"), ("gyro", "gyro")):
        raw, left = every(twice, f"{kind}_cross_coupling"), every(twice, f"{kind}_coupling_compensated")
        assert {entry.verdict for entry in raw} == {"none"}
        assert max(abs(entry.value) for entry in raw) > 1e-3
        assert [entry.verdict for entry in left] == ["pass"] * 6
        assert max(abs(entry.value) for entry in left) < 1e-4
        again = every(twice, f"{kind}_scale_repeatability")
        assert len(again) == 3
        assert all(abs(entry.value) < 2.0 * entry.expanded_uncertainty < 1e-3 for entry in again)
        for what in ("coupling after compensation", "scale-factor repeatability, 1 sigma"):
            assert rows[f"{name}: {what}"] == "PASS"
    assert list(rows.values()).count("PASS") == 4
    once = analysed(short())  # without a second set
    assert {row[-1] for row in once.tables[2].rows} == {"not tested"}
    assert sum("no second set" in text for text in once.missing) == 2


def test_what_changes_between_the_sets_is_told_by_its_size_and_place() -> None:
    """The scale factor of x by 0.2 %, and how x answers to a rate about y by 0.3 %."""
    rig = short()
    change = np.array([[0.002, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    rig.unit = replace(rig.unit, gyro_S=rig.unit.gyro_S * (1.0 + change))
    changed = every(analysed(calibration(rig, rest_s=10.0)), "gyro_scale_repeatability")
    assert changed[0].value == pytest.approx(-2e-3 / 2.0**0.5, rel=0.05)
    assert [entry.verdict for entry in changed] == ["fail", "pass", "pass"]
    rig = short()
    rig.unit = replace(rig.unit, gyro_S=rig.unit.gyro_S + 1.5 * np.roll(change, 1, axis=1))
    left = every(analysed(calibration(rig, rest_s=10.0)), "gyro_coupling_compensated")
    verdicts = {(entry.conditions["row"], entry.conditions["column"]): entry.verdict for entry in left}
    assert verdicts == dict.fromkeys(verdicts, "pass") | {("x", "y"): "fail"}


def test_a_fast_crystal_of_the_unit_makes_no_scale_error() -> None:
    """100 ppm: the unit counts too many seconds, the angle of the table does not depend on them."""
    rig = short(SEED + 2)
    for row in rig.rows:
        tick = row.samples.columns["tick"].astype(np.int64)
        row.samples.columns["tick"] = np.rint(tick * (1.0 + 100e-6)).astype(np.uint32)
    analysis = analysed(rig)
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
    analysis = analysed(rig)
    for name in ("positions", "rotations"):
        assert any(f"switched off between the {name}" in note for note in analysis.notes)
    for kind, S in (("accel", Unit().accel_S), ("gyro", Unit().gyro_S)):
        for entry in every(analysis, f"{kind}_matrix"):
            row, column = ("xyz".index(entry.conditions[name]) for name in ("row", "column"))
            assert abs(entry.value - np.linalg.inv(S)[row, column]) < 1.5 * entry.expanded_uncertainty, entry
    assert (
        min(entry.expanded_uncertainty for entry in every(analysis, "gyro_bias")) > 0.25 * 3600 * 0.02
    )  # it is that of neither power-on


def test_a_unit_that_is_not_warm_is_told() -> None:
    rig = short()
    assert not any("let it warm up" in note for note in analysed(rig).notes)
    for number, row in enumerate(rig.rows[:6]):
        row.samples.columns["temperature"][:] = 2500 + 20 * number
    notes = analysed(rig).notes
    assert any("moved from 25.00 to 26.00 degC over the positions" in note for note in notes)


def test_a_stated_tilt_is_in_the_couplings_and_hardly_in_the_scale_factors() -> None:
    rig = short()
    tilted = analysed(rig, site=SITE | {"tilt_std_deg": 1.0 / 60.0})
    plain = analysed(rig)
    assert any(note.startswith("A tilt of 1 arcmin") for note in tilted.notes)
    for kind in ("accel", "gyro"):
        for quantity, least, most in (("cross_coupling", 150e-6, 350e-6), ("scale_error", 0.0, 20.0)):
            pairs = zip(*(every(each, f"{kind}_{quantity}") for each in (tilted, plain)), strict=True)
            extra = [(one.std_uncertainty**2 - other.std_uncertainty**2) ** 0.5 for one, other in pairs]
            assert all(least <= abs(each) <= most for each in extra)


def test_a_longer_record_is_trimmed_and_told() -> None:
    rig = Rig(SEED)
    for axis in "xyz":
        rig.turn(axis, 1080.0, 17.3, -37.5, -20.0)
        rig.turn(axis, -1080.0, 16.3, -37.5, -20.0)
    analysis = analysed(rig)
    assert set(analysis.attachments) == {
        f"GNC-07/gyro/{axis}{turn}.csv" for axis in "XYZ" for turn in ("+1080", "-1080")
    }
    lengths = {len(text.splitlines()) for text in analysis.attachments.values()}
    assert lengths == {1 + round(16.3 * 200)}
    first = analysis.attachments["GNC-07/gyro/X+1080.csv"].splitlines()
    assert first[0] == "counter,time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"
    assert any(note.startswith("X+1080: 1.000 s were cut off") for note in analysis.notes)
    assert "position +x up: no record" in analysis.missing


def test_what_is_missing_is_named_and_costs_only_its_part() -> None:
    rig = short()
    rig.rows[6].samples.columns["gyro"][1000:1010, 0] = 80_000  # a saturated record is not used either
    rig.rows = [row for row in rig.rows if row.window.number != 8 and row.window.conditions.get("up") != "-y"]
    analysis = analysed(rig)
    assert {f"{text}: no record" for text in ("position -y up", "rotation X-")} <= set(analysis.missing)
    assert "rotation X+: no record" not in analysis.missing
    (at_limit,) = (text for text in analysis.missing if "at its limit" in text)
    assert "gyro x is at its limit in rotation x +1080 (record 7): +400 deg/s of 400 deg/s in 10 samples" in at_limit
    assert "the first at sample 1000" in at_limit
    assert any(text.startswith("gyros: ") and "B-FIT-081" in text for text in analysis.missing)
    assert every(analysis, "accel_matrix") != []
    assert every(analysis, "gyro_matrix") == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"up": "+q"}, r"'up' is '\+q'"),
        ({"up": "-x"}, "in its pose up is"),
        ({"outer_deg": None}, "do not give its pose"),
        ({"item": "rotation", "axis": "x"}, "'turn_deg' None"),
    ],
)
def test_conditions_that_do_not_say_what_a_record_shows(change: dict[str, str | None], said: str) -> None:
    rig = Rig(SEED)
    rig.rest(2.0, POSES["+x"], **({"item": "position", "up": "+x"} | change))
    if "outer_deg" in change:
        rig.rows[0].window.conditions.pop("outer_deg")
    with pytest.raises(FitError, match=f"B-GNC-004.*{said}"):
        analysed(rig)


def test_no_samples_no_site_and_an_unknown_method() -> None:
    with pytest.raises(FitError, match="B-GNC-003"):
        analysed(Rig(SEED))
    with pytest.raises(FitError, match=r"B-GNC-005.*gravity"):
        analysed(short(), site={"latitude_deg": 1.0, "azimuth_deg": 0.0})
    with pytest.raises(FitError, match="B-FIT-004"):
        analyse(short().material("imu_calibration"), "other")
