"""The magnetometer of a simulated unit by both methods, its roll angles, and the table it stands on."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from gnc_exchanges import FRAME, exchange
from imu_material import Rig
from spoken import english_left

from bench.analysis import build_results
from bench.frame import load_frame
from bench.model.errors import FitError
from bench.systems.gnc.magnetometer import analyse

SEED = 608
FIELD_gauss = 0.43
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "x 1"}


def rolls(deg: range = range(0, 360, 45)):
    """Answers of a module without compensation: LSB of its field and the roll angle that it makes of them."""
    found = [exchange("set_magnetometer", struct.pack("<5h", 0, 0, 0, 10_000, 0), b"", 0, item="")]
    alpha = np.deg2rad(1.5)
    for number, angle in enumerate(deg, 1):
        x, y = FIELD_gauss * np.cos(np.deg2rad(angle + 17.0)), -FIELD_gauss * np.sin(np.deg2rad(angle + 17.0))
        raw = np.rint(np.array([0.05 + x * np.cos(alpha) + y * np.sin(alpha), -0.03 + y / 1.04, 0.2]) / 120e-6)
        roll = np.rad2deg(np.arctan2(-raw[1], raw[0]))
        answer = struct.pack("<4h", round(100 * roll), *(int(one) for one in raw))
        found.append(exchange("roll", b"", answer, number, conditions={"roll_deg": float(angle)}))
    return found


def analysed(method: str = "ellipse", **more):
    rig = Rig(SEED)
    rig.spin(60.0, 90.0, FIELD_gauss, **more)
    layouts = load_frame(FRAME).commands
    limits = {"roll_error": {"value": 2.0, "unit": "deg"}}
    return analyse(rig.material("magnetometer", exchanges=rolls(), layouts=layouts, limits=limits), method)


@pytest.fixture(scope="module")
def found():
    return analysed(table="non_magnetic")


def of(analysis, quantity: str, method: str):
    return [
        one for one in analysis.estimates if (one["quantity"], one["conditions"].get("method")) == (quantity, method)
    ]


def test_a_turn_without_a_gap_is_said_to_have_none(found) -> None:
    (caption,) = [one.caption for one in found.tables if one.title == "Magnetometer by two methods"]
    assert caption.endswith("The turn was read without a gap.")
    assert any("no gap between phases" in note for note in found.notes)


def test_the_ellipse_finds_the_parameters_and_the_extremes_are_told_beside(found) -> None:
    x, y = (one["value"] for one in of(found, "mag_offset", "ellipse"))
    assert (x, y) == (pytest.approx(0.05, abs=2e-5), pytest.approx(-0.03, abs=2e-5))
    assert of(found, "mag_gain", "ellipse")[0]["value"] == pytest.approx(1.04, abs=2e-4)
    assert of(found, "mag_angle", "ellipse")[0]["value"] == pytest.approx(1.5, abs=0.02)
    worse = (
        of(found, "mag_angle", "extremes")[0]["std_uncertainty"]
        / of(found, "mag_angle", "ellipse")[0]["std_uncertainty"]
    )
    assert worse > 20.0
    assert found.missing == []
    build_results("one", found, {}, PROVENANCE)


def test_roll_is_right_after_compensation_and_only_then(found) -> None:
    returned = [one["value"] for one in of(found, "mag_roll_error", "returned")]
    assert len(returned) == 8
    assert max(map(abs, returned)) > 4.0
    compensated = of(found, "mag_roll_error", "ellipse")
    assert max(abs(one["value"]) for one in compensated) < 0.05
    assert {one["verdict"] for one in compensated} == {"pass"}
    assert {one["verdict"] for one in of(found, "mag_roll_error", "extremes")} == {"none"}
    single_deg = np.rad2deg(5e-4 / FIELD_gauss)  # noise of one reading; a step of the output makes a tenth of it
    less_mean_deg = single_deg * np.sqrt(7.0 / 8.0)
    assert [one["std_uncertainty"] for one in compensated] == pytest.approx([less_mean_deg] * 8, rel=0.05)


def test_no_specification_states_a_limit_of_the_roll_angle() -> None:
    rig = Rig(SEED)
    rig.spin(60.0, 90.0, FIELD_gauss, table="non_magnetic")
    material = rig.material("magnetometer", exchanges=rolls(), layouts=load_frame(FRAME).commands)
    assert {one["verdict"] for one in analyse(material, "ellipse").estimates} == {"none"}


def test_the_correction_in_force_is_undone() -> None:
    """The same module with a correction of its own: its answers change, the errors after ours do not."""
    rig = Rig(SEED)
    rig.spin(60.0, 90.0, FIELD_gauss)
    layouts = load_frame(FRAME).commands
    plain = rolls()
    offset = (250, -100)
    moved = [replace(plain[0], sent=struct.pack("<5h", *offset, 0, 10_000, 0))]
    for one in plain[1:]:
        roll, x, y, z = struct.unpack("<4h", one.received)
        moved.append(replace(one, received=struct.pack("<4h", roll, x - offset[0], y - offset[1], z)))
    errors = []
    for exchanges in (plain, moved):
        analysis = analyse(rig.material("magnetometer", exchanges=exchanges, layouts=layouts))
        errors.append([one["value"] for one in of(analysis, "mag_roll_error", "ellipse")])
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-9)


def test_the_table_must_be_declared_non_magnetic(found) -> None:
    assert not any("non-magnetic" in note for note in found.notes)
    assert any("does not say which table" in note for note in analysed().notes)
    assert any("names the table 'turntable'" in note for note in analysed(table="turntable").notes)


def test_figures_before_and_after(found) -> None:
    assert english_left(found) == set()
    plane = found.figures[0]
    before, after = plane.series
    assert (before.label, after.label) == ("before", "after")
    radius = np.hypot(after.x, after.y)
    assert np.std(radius) < 1.0  # mgauss
    assert np.std(np.hypot(before.x, before.y)) > 10.0


def test_less_than_a_turn_is_refused_and_the_other_record_is_used() -> None:
    rig = Rig(SEED)
    rig.spin(2.0, 90.0, FIELD_gauss)
    with pytest.raises(FitError) as caught:
        analyse(rig.material("magnetometer"))
    assert caught.value.code in ("B-FIT-090", "B-FIT-091")
    rig.spin(60.0, 90.0, FIELD_gauss)
    analysis = analyse(rig.material("magnetometer"))
    assert len(analysis.missing) == 1
    assert of(analysis, "mag_angle", "ellipse")[0]["value"] == pytest.approx(1.5, abs=0.02)


def test_the_method_chosen_is_the_one_that_compensates() -> None:
    assert analysed("extremes").compensation[0]["method"] == "extremes"
    with pytest.raises(FitError) as caught:
        analysed("other")
    assert caught.value.code == "B-FIT-004"


def test_a_field_beyond_the_word_of_the_frame_is_saturated() -> None:
    """The range of 6 gauss is 50,000 steps, a 16-bit word ends at 32,767: 3.93 gauss."""
    rig = Rig(SEED)
    rig.spin(60.0, 90.0, FIELD_gauss)
    rig.rows[0].samples.columns["mag"][2000:2003, 1] = 32_767
    rig.spin(60.0, 90.0, FIELD_gauss)
    analysis = analyse(rig.material("magnetometer"))
    assert [one for one in analysis.missing if "magnetometer y: 3 samples at the end of the range" in one]
    assert len(of(analysis, "mag_gain", "ellipse")) == 1


def attitudes(rig: Rig, hard_gauss: tuple[float, float, float]) -> None:
    """A minute of readings all over the sphere about a hard iron, without soft iron."""
    field = rig.rng.normal(size=(12_000, 3))
    field = FIELD_gauss * field / np.linalg.norm(field, axis=1)[:, None] + hard_gauss
    seen = np.rint((field + rig.rng.normal(0.0, 5e-4, field.shape)) / 120e-6)
    rig._add(0.0 * field, 0.0 * field, (90.0, 0.0, 0.0), "z", {"item": "attitudes"}, mag=seen)


def test_a_saturated_record_of_the_attitudes_is_not_used() -> None:
    rig, hard_gauss = Rig(SEED), (0.11, -0.07, 0.05)
    rig.spin(60.0, 90.0, FIELD_gauss, table="non_magnetic")
    attitudes(rig, hard_gauss)
    attitudes(rig, hard_gauss)
    rig.rows[2].samples.columns["mag"][:400, 2] = 32_767
    analysis = analyse(rig.material("magnetometer"))
    assert [one for one in analysis.missing if one.startswith("record 3 (attitudes): magnetometer z: 400 samples")]
    found = [one for one in analysis.estimates if one["quantity"] == "mag_hard_iron"]
    np.testing.assert_allclose([one["value"] for one in found], hard_gauss, atol=5e-5)
    assert {one["n"] for one in found} == {12_000}
