"""A session of each system, written from docs/session-format.md alone, through ``bench fit``; and what it may not lack.

Physics, frames and readings are made by the tests themselves.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stranger_af import TRUTH_ppm, converter_session
from stranger_gnc import (
    ACCEL_S,
    GYRO_S,
    MAGNETIC,
    ACCEL_BIAS_g,
    GYRO_BIAS_deg_s,
    STEPS_deg_s,
    bias_session,
    calibration_session,
    earth_at_rest,
    indicated_bias,
    magnetometer_session,
    short_bias_session,
)
from stranger_laser import BACKSCATTER_deg, LOCK_IN_deg_s, laser_session, random_walk_deg_rth
from stranger_north import SOUGHT_deg, north_session
from stranger_page import DOCUMENT, Session
from stranger_ramp import BIAS_A, WIDTH_A, LAG_s, PLAY_degC, SLOPE_A_degC, ramp_session
from stranger_sync import OFFSET_s, sync_session
from stranger_tests import SUPPLY_A, SUPPLY_V, WIDTH_m, module_session

from bench.commands.fit import fit
from bench.model.errors import BenchError, ExitStatus

Estimates = list[dict[str, Any]]


def fitted(session: Session, folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, Estimates]:
    """Exit status and estimates of ``bench fit --json``."""
    status = fit(session.write(folder), None, as_json=True, fresh=True)
    found: Estimates = json.loads(capsys.readouterr().out)["estimates"]
    return status, found


def held(found: Estimates, truth: Mapping[str, float], **conditions: Any) -> None:
    """Each quantity is there, sound, and its interval holds the truth."""
    assert max(errors_in_U(found, truth, **conditions)) <= 1.0


def errors_in_U(found: Estimates, truth: Mapping[str, float], **conditions: Any) -> list[float]:
    """How far each of these estimates is from its truth, in its expanded uncertainty."""
    errors = []
    for quantity, true in truth.items():
        entries = [
            entry
            for entry in found
            if entry["quantity"] == quantity and conditions.items() <= entry["conditions"].items()
        ]
        assert entries, quantity
        assert {entry["quality"] for entry in entries} == {"sound"}, entries
        errors += [abs(entry["value"] - true) / entry["expanded_uncertainty"] for entry in entries]
    return errors


def test_scale_factor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = fitted(converter_session("scale_factor"), tmp_path, capsys)
    held(found, TRUTH_ppm)
    assert status == ExitStatus.PASS


def test_swapped_leads_are_refused_with_that_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = fitted(converter_session("scale_factor", swapped=True), tmp_path, capsys)
    assert status == ExitStatus.VERDICT_FAIL
    for entry in found:
        if entry["quantity"] in TRUTH_ppm:
            assert (entry["quality"], entry["value"]) == ("refused", None)
            assert "swapped_leads" in [reason["code"] for reason in entry["reasons"]]


def test_dmm_method(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, found = fitted(converter_session("dmm_method"), tmp_path, capsys)
    held(found, TRUTH_ppm)


def test_bias_ramp(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = fitted(SESSIONS["bias_ramp"](), tmp_path, capsys)
    held(found, {"bias_tc1": SLOPE_A_degC, "hysteresis_width": WIDTH_A, "thermal_lag": LAG_s / 60.0})
    held(found, {"bias": BIAS_A}, temperature_degC=20.0)
    held(found, {"play_half_width": PLAY_degC})
    assert status == ExitStatus.PASS


def test_north(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = fitted(SESSIONS["fog_north"](), tmp_path, capsys)
    for method in ("least_squares", "likelihood"):
        held(found, {"azimuth": SOUGHT_deg}, item="search", method=method)
    held(found, {"azimuth_error": 0.0}, item="test")
    assert status == ExitStatus.PASS


def mostly_held(errors: Sequence[float]) -> None:
    """Of many intervals of 95 % one in ten may miss, none by more than half of itself."""
    assert np.mean(np.asarray(errors) > 1.0) <= 0.1, errors
    assert max(errors) < 1.5, errors


def test_imu_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, found = fitted(SESSIONS["imu_calibration"](), tmp_path, capsys)
    errors = []
    for prefix, matrix in (("gyro", GYRO_S), ("accel", ACCEL_S)):
        inverse = np.linalg.inv(matrix)
        for row, name in enumerate("xyz"):
            for column, other in enumerate("xyz"):
                errors += errors_in_U(found, {f"{prefix}_matrix": inverse[row, column]}, row=name, column=other)
    for k, axis in enumerate("xyz"):
        biases = {"gyro_bias": 3600.0 * GYRO_BIAS_deg_s[k], "accel_bias": ACCEL_BIAS_g[k]}
        errors += errors_in_U(found, biases, axis=axis)
    mostly_held(errors)


def test_imu_bias(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, found = fitted(bias_session(), tmp_path, capsys)
    gyro_deg_h, errors = 3600.0 * indicated_bias(earth_at_rest()), []
    for k, axis in enumerate("xyz"):
        truth = {
            "gyro_bias": gyro_deg_h[k],
            "gyro_bias_stability": 3600.0 * 5e-3 / 10.0**0.5,
            "accel_bias_stability": 0.5 / 10.0**0.5,
            "gyro_bias_repeatability": 3600.0 * GYRO_S[k].sum() * np.std(STEPS_deg_s, ddof=1),
        }
        if axis != "x":  # the axis of the flip, which does not reverse it
            truth["accel_bias"] = float(ACCEL_S[k] @ ACCEL_BIAS_g)
        errors += errors_in_U(found, truth, axis=axis)
    mostly_held(errors)


def test_magnetometer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, found = fitted(SESSIONS["magnetometer"](), tmp_path, capsys)
    for axis in "xy":
        held(found, {"mag_offset": MAGNETIC[axis]}, axis=axis, method="ellipse")
    truth = {"mag_gain": "gain", "mag_angle": "angle_deg", "mag_radius": "radius"}
    held(found, {name: MAGNETIC[key] for name, key in truth.items()}, method="ellipse")


@pytest.mark.parametrize("dead_line", [False, True])
def test_unit_tests(tmp_path: Path, capsys: pytest.CaptureFixture[str], dead_line: bool) -> None:
    status, found = fitted(module_session(dead_line), tmp_path, capsys)
    wrong = {entry["quantity"]: entry["value"] for entry in found if entry["quantity"].endswith("_wrong")}
    assert wrong.pop("io_wrong") == float(dead_line)
    assert len(wrong) == 12
    assert set(wrong.values()) == {0.0}
    assert status == (ExitStatus.VERDICT_FAIL if dead_line else ExitStatus.PASS)
    values = {entry["quantity"]: entry["value"] for entry in found}
    measured = {"supply_voltage": SUPPLY_V, "supply_current": SUPPLY_A, "width": WIDTH_m, "gps_latitude": 37.5}
    assert {name: values[name] for name in measured} == pytest.approx(measured)


def test_time_offset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = fitted(SESSIONS["time_sync"](), tmp_path, capsys)
    held(found, {"time_offset": OFFSET_s, "time_offset_from_stamps": OFFSET_s})
    assert status == ExitStatus.PASS


def test_ring_laser(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = fitted(SESSIONS["rlg_lock_in"](), tmp_path, capsys)
    held(found, {"lock_in_rate": LOCK_IN_deg_s, "backscatter_phase": BACKSCATTER_deg})
    assert status == ExitStatus.PASS
    walks = [found, *(fitted(laser_session(seed), tmp_path / str(seed), capsys)[1] for seed in (7, 8))]
    errors = [errors_in_U(each, {"angle_random_walk": random_walk_deg_rth()}, method="raw") for each in walks]
    assert np.sqrt(np.mean(np.square(errors))) < 1.0, errors


SESSIONS: Mapping[str, Callable[[], Session]] = {
    "scale_factor": cache(lambda: converter_session("scale_factor")),
    "dmm_method": cache(lambda: converter_session("dmm_method")),
    "bias_ramp": cache(ramp_session),
    "fog_north": cache(north_session),
    "imu_calibration": cache(calibration_session),
    "imu_bias": cache(short_bias_session),
    "magnetometer": cache(magnetometer_session),
    "gnc_unit_test": cache(module_session),
    "time_sync": cache(sync_session),
    "rlg_lock_in": cache(laser_session),
}
_EVERY = (
    "session", "simulated", "plan_sha256", "links", "measurement_link", "planned", "planned.prepare_s",
    "standards", "campaign.analysis", "campaign.uut", "campaign.uut.model", "campaign.uut.serial",
)  # fmt: skip
_RECORD = tuple(
    f"record.{name}" for name in ("number", "link", "first_counter", "frames", "t_start_ns", "t_end_ns", "conditions")
)
_POINTS = ("channel", "temperature_degC", "current_A", "polarity", "range_A")
_POSE = tuple(f"record.conditions.{name}" for name in ("item", "mounting", "outer_deg", "middle_deg", "inner_deg"))
_EXCHANGE = (
    "step", "item", "name", "sequence", "attempts", "begin_ns", "end_ns", "status", "refused", "sent", "received",
    "conditions",
)  # fmt: skip
_CONSTANTS = (
    "manifest.campaign.af_clock_Hz", "manifest.campaign.master_Hz", "manifest.campaign.channels",
    *(f"manifest.campaign.channels.0.{name}" for name in ("number", "kind", "k0_C", "full_scale_A",
      "sensor_full_scale", "sensor_unit", "noise", "noise.white_A_rtHz", "noise.walk_A_rth")),
)  # fmt: skip
_CONVERTER = (*_CONSTANTS, *(f"record.conditions.{name}" for name in _POINTS))
NEEDED: Mapping[str, Sequence[str]] = {
    "scale_factor": (*(f"manifest.{key}" for key in _EVERY), *_RECORD, *_CONVERTER, "manifest.standards.calibrator"),
    "dmm_method": (
        *_CONVERTER, "manifest.standards.dmm", "manifest.standards.dmm.uncertainty",
        *(f"reading.{name}" for name in ("role", "name", "value", "conditions")),
    ),
    "bias_ramp": (
        *_CONSTANTS, "record.conditions.route", "record.conditions.branch", "environment.air_degC",
        "environment.unit_degC",
    ),
    "fog_north": (
        *(f"manifest.campaign.site.{name}" for name in ("latitude_deg", "azimuth_deg")),
        *(f"record.conditions.{name}" for name in ("item", "head_deg", "index", "repeat", "rate_deg_s")),
        *(f"reading.value.{name}" for name in ("x_V", "x_mrad", "y_mrad")),
    ),
    "imu_calibration": (
        *(f"manifest.campaign.site.{name}" for name in ("latitude_deg", "azimuth_deg", "gravity_m_s2")),
        *_POSE, *(f"record.conditions.{name}" for name in ("up", "axis", "turn_deg")),
    ),
    "imu_bias": ("manifest.campaign.site.latitude_deg", "manifest.campaign.site.azimuth_deg", _POSE[1]),
    "gnc_unit_test": (
        *(f"exchange.{name}" for name in _EXCHANGE),
        *(f"prompt.{name}" for name in ("step", "value", "unit", "low", "high")),
    ),
    "rlg_lock_in": (
        "manifest.campaign.site.latitude_deg", "record.conditions.path_length_m", "record.conditions.clock_Hz",
    ),
    "time_sync": (
        *(f"record.conditions.{name}" for name in ("item", "manoeuvre")),
        *(f"manifest.campaign.latency.{name}" for name in ("egi_s", "imu_s", "std_s")),
        *(f"manifest.campaign.egi.{name}" for name in ("velocity_m_s", "level_deg", "heading_deg", "wander_s")),
        *(f"manifest.campaign.inertial.{name}" for name in ("accel_bias_g", "gyro_bias_deg_s")),
    ),
    "magnetometer": (*_POSE, "record.conditions.rate_deg_s"),
}  # fmt: skip


def test_the_page_names_all_that_is_needed() -> None:
    page = DOCUMENT.read_text(encoding="utf-8")
    keys = {key.split(".")[-1] for keys in NEEDED.values() for key in keys}
    fields = {field for _, names in FIELDS.values() for field in names}
    assert {name for name in keys | fields if not re.search(rf"[`.\"]{name}[`\"]", page)} == set()


@pytest.mark.parametrize(("analysis", "key"), [(name, key) for name, keys in NEEDED.items() for key in keys])
def test_a_session_that_lacks_what_is_needed_is_refused_in_one_sentence(
    tmp_path: Path, analysis: str, key: str
) -> None:
    session = SESSIONS[analysis]().without(key.split("."))
    with pytest.raises(BenchError, match="B-") as refused:
        fit(session.write(tmp_path), None, as_json=True, fresh=True)
    assert refused.value.exit_status in (ExitStatus.BAD_INPUT, ExitStatus.SESSION_DAMAGED)
    assert key.rsplit(".", maxsplit=1)[-1] in str(refused.value)


@pytest.mark.parametrize(
    ("key", "code"),
    [
        ("manifest.planned", "B-RPL-004"),
        ("manifest.campaign.uut", "B-RPL-004"),
        ("record.conditions.polarity", "B-RPL-005"),
        ("reading.value", "B-RPL-003"),
    ],
)
def test_what_is_missing_has_a_code(tmp_path: Path, key: str, code: str) -> None:
    session = SESSIONS["dmm_method"]().without(key.split("."))
    with pytest.raises(BenchError) as refused:
        fit(session.write(tmp_path), None, as_json=True, fresh=True)
    assert refused.value.code == code


FIELDS: Mapping[str, tuple[str, Sequence[str]]] = {
    "fog_north": ("fog", ("output", "encoder")),
    "imu_calibration": ("rs422", ("tick", "gyro", "accel", "temperature")),
    "magnetometer": ("rs422", ("tick", "mag", "temperature")),
    "time_sync": ("imu", ("delta_angle", "delta_velocity")),
    "rlg_lock_in": ("edges", ("dropped",)),
}


@pytest.mark.parametrize(("analysis", "field"), [(name, field) for name, (_, of) in FIELDS.items() for field in of])
def test_samples_without_a_field_are_refused(tmp_path: Path, analysis: str, field: str) -> None:
    session = SESSIONS[analysis]().renamed(FIELDS[analysis][0], field)
    with pytest.raises(BenchError, match=field) as refused:
        fit(session.write(tmp_path), None, as_json=True, fresh=True)
    assert refused.value.code in ("B-RPL-006", "B-RLG-002", "B-SYNC-002")
