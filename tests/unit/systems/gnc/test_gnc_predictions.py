"""What predictions of GNC campaigns name as missing, and their figures against formulas."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from one_estimate import every
from rehearsal import ROOT

from bench.analysis import Planned, Prediction
from bench.model.errors import FitError
from bench.plan import Plan, compile_sequence
from bench.session.predicted import predicted
from bench.systems.gnc.predicted import of_magnetometer

NOISE = "gyro_random_walk: 0.3 deg/sqrt(h), "


def plan_of(tmp_path: Path, name: str, *cuts: tuple[str, str], **settings: str) -> Plan:
    """A shipped sequence with other words in it."""
    text = (ROOT / "sequences" / f"{name}.yaml").read_text(encoding="utf-8")
    for old, new in cuts:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / f"{name}.yaml"
    path.write_text(text, encoding="utf-8")
    return compile_sequence(path, None, settings)


def stds(prediction: Prediction, quantity: str, **conditions: str) -> list[float]:
    return [entry["std_uncertainty"] for entry in every(prediction, quantity, **conditions)]


def test_a_calibration_follows_the_formulas_of_white_noise(tmp_path: Path) -> None:
    """Gyro bias N / sqrt(4 T); mean of six positions; scale factors from two integrals and from two positions."""
    settled = ", gyro_wandering: [{size: 2 deg/h, over: 300 s}]"
    slow = "accelerometer_wandering: [{size: 6 ug, over: 10 s}, {size: 6 ug, over: 100 s}, {size: 6 ug, over: 1000 s}],"
    found = predicted(plan_of(tmp_path, "gnc_imu_calibration", (settled, ""), (slow, "")))
    assert found.missing == []
    walk, turn_s = math.sqrt((0.3 / 60.0) ** 2 + 0.005**2 / 12.0 / 200.0), 5.0 + 1.0  # 270 deg/s and its ramps
    np.testing.assert_allclose(stds(found, "gyro_bias"), 3600.0 * walk / math.sqrt(4.0 * 21.3), rtol=0.005)
    due_ppm = 1e6 * walk * math.sqrt(2.0 * turn_s) / 2160.0
    np.testing.assert_allclose(stds(found, "gyro_scale_error"), due_ppm, rtol=0.02)
    mean_g = math.sqrt((1e-4**2 + 1e-3**2 / 12.0 / 200.0) / 300.0)
    np.testing.assert_allclose(stds(found, "accel_bias"), mean_g / math.sqrt(6.0), rtol=1e-6)
    due_ppm = 1e6 * mean_g / math.sqrt(2.0) / (9.7969 / 9.80665)
    np.testing.assert_allclose(stds(found, "accel_scale_error"), due_ppm, rtol=1e-6)


def test_a_longer_position_buys_what_its_noise_allows(tmp_path: Path) -> None:
    short, long = (predicted(plan_of(tmp_path, "gnc_imu_calibration", position=time)) for time in ("100 s", "400 s"))
    gain = stds(short, "accel_scale_error")[0] / stds(long, "accel_scale_error")[0]
    assert 1.2 < gain < 2.0  # white noise alone would make it 2
    tilted = plan_of(tmp_path, "gnc_imu_calibration", ("azimuth: 90 deg}", "azimuth: 90 deg, tilt: 1 arcmin}"))
    assert min(stds(predicted(tilted), "accel_cross_coupling")) > 0.5 * math.radians(1.0 / 60.0)


def test_what_a_plan_leaves_open_is_named(tmp_path: Path) -> None:
    cut = '      - position: {up: +y, middle: 0 deg, inner: 90 deg, time: "{time}"}\n'
    down = cut.replace("+y", "-y").replace("inner: 90", "inner: -90")
    found = predicted(plan_of(tmp_path, "gnc_imu_calibration", (cut, ""), (down, "")))
    assert stds(found, "accel_bias") == []
    assert len(stds(found, "gyro_bias")) == 3
    assert "position +y up: no record" in found.missing
    assert any("B-FIT-001" in sentence for sentence in found.missing)
    found = predicted(plan_of(tmp_path, "gnc_imu_calibration", ("  - rotations: {axis: z}\n", "")))
    assert stds(found, "gyro_bias") == []
    assert "rotation Z+: no record" in found.missing
    found = predicted(plan_of(tmp_path, "gnc_imu_calibration", turn_record="4 s"))  # it ends within the turn
    assert stds(found, "gyro_bias") == []
    assert any("B-FIT-08" in sentence for sentence in found.missing)
    walk = ("accelerometer_random_walk: 100 ug/sqrt(Hz)", "accelerometer_random_walk: 0 ug/sqrt(Hz)")
    steps = ("accelerometer_resolution: 1 mg", "accelerometer_resolution: 0 mg")  # no uncertainty at all
    found = predicted(plan_of(tmp_path, "gnc_imu_calibration", walk, steps))
    assert stds(found, "accel_bias") == []
    assert any("accelerometers: their noise is not declared" in sentence for sentence in found.missing)


@pytest.mark.parametrize("name", ["gnc_imu_calibration", "gnc_bias"])
def test_noise_that_is_not_declared_is_asked_for(tmp_path: Path, name: str) -> None:
    found = predicted(plan_of(tmp_path, name, (NOISE, "")))
    assert stds(found, "gyro_bias") == []
    assert stds(found, "accel_bias") != []
    assert any("declare gyro_random_walk" in sentence for sentence in found.missing)


def test_a_rest_that_is_too_short_is_named(tmp_path: Path) -> None:
    found = predicted(plan_of(tmp_path, "gnc_bias", stability_time="30 min", repeat_gap="1 min"))
    assert stds(found, "gyro_bias_stability") == stds(found, "accel_bias_repeatability") == []
    assert sum("B-FIT-092" in sentence for sentence in found.missing) == 6
    assert sum("B-FIT-093" in sentence for sentence in found.missing) == 6


def test_a_magnetometer_without_declared_noise_or_field_b_gnc_008(tmp_path: Path) -> None:
    field = ",\n   magnetic_field: {size: 0.43 gauss, inclination: 55 deg, declination: -4 deg}}"
    for cut, name in (((field, "}"), "magnetic_field"), ((",\n     magnetometer_noise: 0.5 mgauss}", "}"), "noise")):
        plan = plan_of(tmp_path, "gnc_magnetometer", cut)
        found = predicted(plan)
        assert found.estimates == []
        (sentence,) = found.missing
        assert name in sentence
        assert "is not declared" in sentence
        with pytest.raises(FitError, match="B-GNC-008"):
            of_magnetometer(Planned([], plan.campaign, {}))


def test_attitudes_that_do_not_determine_an_ellipsoid_are_named(tmp_path: Path) -> None:
    lines = [f'  - attitude: {{outer: "{{north}}", middle: {middle} deg}}\n' for middle in (20, -10, -35, -60, -90)]
    found = predicted(plan_of(tmp_path, "gnc_magnetometer", *((line, "") for line in lines)))
    assert stds(found, "mag_hard_iron") == []
    assert any("B-FIT-091" in sentence for sentence in found.missing)


def test_a_unit_test_is_known_as_its_counter_and_its_noise_say(tmp_path: Path) -> None:
    """A tick over sqrt(12); noise of one sample over the root of fifty."""
    found = predicted(plan_of(tmp_path, "gnc_unit_test", units="GNC-01"))
    due = [12.0**-0.5 / setting for setting in (500, 1000, 2000, 5000)]
    assert sorted(stds(found, "timer_interval_error")) == pytest.approx(sorted(due))
    sample_deg_s = math.hypot(0.3 / 60.0 * math.sqrt(200.0), 0.005 / math.sqrt(12.0))
    assert stds(found, "imu_rate") == pytest.approx([sample_deg_s / math.sqrt(50.0)] * 3)
    of_one = predicted(plan_of(tmp_path, "gnc_unit_test", (NOISE, ""), units="GNC-01,GNC-02"))
    assert stds(of_one, "imu_rate") == []
    assert len(stds(of_one, "imu_acceleration")) == 6
    assert [sentence for sentence in of_one.missing if "declare gyro_random_walk" in sentence] == of_one.missing


def test_ellipse_and_rolls_are_known_as_their_noise_says(tmp_path: Path) -> None:
    """Offsets of n even readings of a circle: noise sqrt(2 / n); rolls: one reading less the mean of all, noise of an
    axis over the field across z, which the site declares.
    """
    found = predicted(plan_of(tmp_path, "gnc_magnetometer", record_time="48 s", attitude_time="24 s"))
    noise = math.hypot(0.5e-3, 120e-6 / math.sqrt(12.0))
    offsets = stds(found, "mag_offset", method="ellipse")
    np.testing.assert_allclose(offsets, noise * math.sqrt(2.0 / 9600.0), rtol=0.01)
    dip, east = math.radians(55.0), math.radians(4.0)
    across = 0.43 * math.hypot(math.sin(dip), math.cos(dip) * math.sin(east))
    single_deg = math.degrees(noise / across)
    assert stds(found, "mag_roll") == pytest.approx([single_deg] * 8, rel=0.01)
    assert stds(found, "mag_roll_error") == pytest.approx([single_deg * math.sqrt(7.0 / 8.0)] * 24, rel=0.02)
