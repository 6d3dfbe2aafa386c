"""Strangers write sessions of all systems with the stock MCAP library, by docs/session-format.md alone."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import stranger_af as af
import stranger_gnc as gnc
import stranger_north as north
from one_estimate import every, holds
from stranger_page import DOCUMENT, Session, documented_writer

from bench.analysis import Material, analyse
from bench.commands.fit import fit
from bench.model.errors import BenchError, ExitStatus, SessionDamaged
from bench.record import SessionReader
from bench.replay import replay_rows


def sample(messages: int | None = None) -> tuple[Any, Any, list[Any]]:
    """Manifest, texts and the first messages of a scale-factor campaign."""
    manifest, texts, sent = SESSIONS["scale_factor"]().content()
    return manifest, texts, sent[:messages]


VARIANTS = {
    "lz4": {},
    "plain": {"compression=CompressionType.LZ4": "compression=CompressionType.NONE"},
    "no index": {"CompressionType.LZ4)": "CompressionType.LZ4, index_types=IndexType.NONE)"},
    "no chunks": {"CompressionType.LZ4)": "CompressionType.LZ4, use_chunking=False)"},
    "no CRC": {"CompressionType.LZ4)": "CompressionType.LZ4, enable_crcs=False, chunk_size=10_000_000)"},
    "data CRC": {"CompressionType.LZ4)": "CompressionType.LZ4, enable_data_crcs=True, chunk_size=5_000)"},
}


@pytest.mark.validates(
    "reading a session, six forms of the container",
    against="sessions written by the stock package mcap",
)
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_strangers_session_is_replayed_and_fitted(tmp_path: Path, variant: str) -> None:
    documented_writer(**VARIANTS[variant])(tmp_path, *sample())
    done = replay_rows(tmp_path, strict=True)
    assert (done.damage, done.unfinished, done.notes) == ((), (), ())
    frames = (af.SECONDS + af.PAUSE_s) * (af.RATE_Hz + 1) * len(af.points())
    assert done.totals == {"frames": frames, "frames_bad": 0, "frames_lost": 0, "jumps": 0}
    for row, point in zip(done.rows, af.points(), strict=True):
        counted = af.pulses(point.get("current_A", 0.0) * point.get("polarity", 0), af.SECONDS * af.RATE_Hz)
        for name, counts in zip(("npp", "ppp"), counted, strict=True):
            assert row.sums[name].tolist() == [counts.sum(), *[0] * 9]
        assert int(row.sums["af_clock"]) == 2560 * af.SECONDS * af.RATE_Hz
        assert row.quality == 0
        assert row.context["unit_temperature_degC"] == pytest.approx(20.03, abs=1e-9)
    analysis = analyse(Material(done.rows, done.manifest["campaign"], done.manifest["standards"]))
    for quantity, true_ppm in af.TRUTH_ppm.items():
        assert all(holds(entry, true_ppm) for entry in every(analysis, quantity))
    assert {estimate.quantity for estimate in analysis.estimates} >= set(af.TRUTH_ppm)


def test_the_hash_of_a_session_without_a_chain_covers_its_data(tmp_path: Path) -> None:
    write = documented_writer()
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
        manifest, texts, messages = sample()
        sent = messages[:40]
        if name == "c":
            sent[7] = (sent[7][0], sent[7][1], sent[7][2][:-1] + b"\0")
        write(tmp_path / name, manifest, texts, sent)
    one, same, other = (SessionReader(tmp_path / name).sha256 for name in ("a", "b", "c"))
    assert one == same != other


def test_zstd_is_refused_with_the_reason_and_foreign_topics_are_left_alone(tmp_path: Path) -> None:
    edits = {"compression=CompressionType.LZ4": "compression=CompressionType.ZSTD"}
    documented_writer(**edits)(tmp_path, *sample(10))
    assert "zstd" in SessionReader(tmp_path).damage[0].what
    extra = 'writer.register_channel("/camera", "jpeg", schema_id=0)'
    edits = {"        writer.finish()": f"        writer.add_message({extra}, 1, b'any', 1)\n        writer.finish()"}
    documented_writer(**edits)(tmp_path, *sample(10))
    reader = SessionReader(tmp_path)
    assert reader.damage == []
    assert "/camera" not in reader.counts


def test_data_section_crc_of_a_file_without_a_chain_is_checked(tmp_path: Path) -> None:
    documented_writer(**VARIANTS["data CRC"])(tmp_path, *sample(40))
    path = tmp_path / "session.0001.mcap"
    content = bytearray(path.read_bytes())
    content[9 + 8 + 4] ^= 1  # inside the profile of the header record
    path.write_bytes(content)
    assert [item.what for item in SessionReader(tmp_path).damage] == ["CRC of the data section is wrong"]


@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        ("/event", b"{"),
        ("/event", b"[1]"),
        ("/event", b'{"kind": "record"}'),
        ("/manifest", b"\xff"),
        ("/text/a", b"\xff"),
    ],
)
def test_content_that_is_not_what_its_topic_promises(tmp_path: Path, topic: str, payload: bytes) -> None:
    sent = [(topic, 0, payload), ("/clock", 0, b"{}")]
    edits = (
        {'head = [("/manifest", start_ns, json.dumps(manifest).encode())]': "head = []"} if topic == "/manifest" else {}
    )
    documented_writer(**edits)(tmp_path, *sample()[:2], sent)
    with pytest.raises(SessionDamaged, match="B-REC-014"):
        replay_rows(tmp_path)


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
        entries = every(found, quantity, **conditions)
        assert entries, quantity
        assert {entry.quality for entry in entries} == {"sound"}, entries
        errors += [abs(entry.value - true) / entry.expanded_uncertainty for entry in entries]
    return errors


HELD: Mapping[str, Sequence[tuple[Mapping[str, float], Mapping[str, Any]]]] = {
    "scale_factor": [(af.TRUTH_ppm, {})],
    "dmm_method": [(af.TRUTH_ppm, {})],
    "bias_ramp": [
        ({"bias_tc1": af.SLOPE_A_degC, "hysteresis_width": af.WIDTH_A, "thermal_lag": af.LAG_s / 60.0}, {}),
        ({"bias": af.RAMP_BIAS_A}, {"temperature_degC": 20.0}),
        ({"play_half_width": af.PLAY_degC}, {}),
    ],
    "fog_north": [
        *(
            ({"azimuth": north.SOUGHT_deg}, {"item": "search", "method": name})
            for name in ("least_squares", "likelihood")
        ),
        ({"azimuth_error": 0.0}, {"item": "test"}),
    ],
    "magnetometer": [
        *(({"mag_offset": gnc.MAGNETIC[axis]}, {"axis": axis, "method": "ellipse"}) for axis in "xy"),
        ({"mag_gain": gnc.MAGNETIC["gain"], "mag_angle": gnc.MAGNETIC["angle_deg"]}, {"method": "ellipse"}),
        ({"mag_radius": gnc.MAGNETIC["radius"]}, {"method": "ellipse"}),
    ],
    "time_sync": [({"time_offset": north.OFFSET_s, "time_offset_from_stamps": north.OFFSET_s}, {})],
}


@pytest.mark.parametrize("analysis", HELD)
def test_intervals_hold_the_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str], analysis: str) -> None:
    status, found = fitted(SESSIONS[analysis](), tmp_path, capsys)
    for truth, conditions in HELD[analysis]:
        held(found, truth, **conditions)
    assert status == ExitStatus.PASS or analysis in ("dmm_method", "magnetometer")


def test_swapped_leads_are_refused_with_that_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = fitted(af.converter_session("scale_factor", swapped=True), tmp_path, capsys)
    assert status == ExitStatus.VERDICT_FAIL
    for entry in found:
        if entry["quantity"] in af.TRUTH_ppm:
            assert (entry["quality"], entry["value"]) == ("refused", None)
            assert "swapped_leads" in [reason["code"] for reason in entry["reasons"]]


def mostly_held(errors: Sequence[float]) -> None:
    """Of many intervals of 95 % one in ten may miss, none by more than half of itself."""
    assert np.mean(np.asarray(errors) > 1.0) <= 0.1, errors
    assert max(errors) < 1.5, errors


def test_imu_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, found = fitted(SESSIONS["imu_calibration"](), tmp_path, capsys)
    errors = []
    for prefix, matrix in (("gyro", gnc.GYRO_S), ("accel", gnc.ACCEL_S)):
        inverse = np.linalg.inv(matrix)
        for row, name in enumerate("xyz"):
            for column, other in enumerate("xyz"):
                errors += errors_in_U(found, {f"{prefix}_matrix": inverse[row, column]}, row=name, column=other)
    for k, axis in enumerate("xyz"):
        biases = {"gyro_bias": 3600.0 * gnc.GYRO_BIAS_deg_s[k], "accel_bias": gnc.ACCEL_BIAS_g[k]}
        errors += errors_in_U(found, biases, axis=axis)
    mostly_held(errors)


def test_imu_bias(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, found = fitted(gnc.bias_session(), tmp_path, capsys)
    gyro_deg_h, errors = 3600.0 * gnc.indicated_bias(gnc.earth_at_rest()), []
    for k, axis in enumerate("xyz"):
        truth = {
            "gyro_bias": gyro_deg_h[k],
            "gyro_bias_stability": 3600.0 * 5e-3 / 10.0**0.5,
            "accel_bias_stability": 0.5 / 10.0**0.5,
            "gyro_bias_repeatability": 3600.0 * gnc.GYRO_S[k].sum() * np.std(gnc.STEPS_deg_s, ddof=1),
        }
        if axis != "x":  # the axis of the flip, which does not reverse it
            truth["accel_bias"] = float(gnc.ACCEL_S[k] @ gnc.ACCEL_BIAS_g)
        errors += errors_in_U(found, truth, axis=axis)
    mostly_held(errors)


@pytest.mark.parametrize("dead_line", [False, True])
def test_unit_tests(tmp_path: Path, capsys: pytest.CaptureFixture[str], dead_line: bool) -> None:
    status, found = fitted(gnc.module_session(dead_line), tmp_path, capsys)
    wrong = {entry["quantity"]: entry["value"] for entry in found if entry["quantity"].endswith("_wrong")}
    assert wrong.pop("io_wrong") == float(dead_line)
    assert len(wrong) == 12
    assert set(wrong.values()) == {0.0}
    assert status == (ExitStatus.VERDICT_FAIL if dead_line else ExitStatus.PASS)
    values = {entry["quantity"]: entry["value"] for entry in found}
    measured = {
        "supply_voltage": gnc.SUPPLY_V,
        "supply_current": gnc.SUPPLY_A,
        "width": gnc.WIDTH_m,
        "gps_latitude": 37.5,
    }
    assert {name: values[name] for name in measured} == pytest.approx(measured)


def test_ring_laser(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = fitted(SESSIONS["rlg_lock_in"](), tmp_path, capsys)
    held(found, {"lock_in_rate": north.LOCK_IN_deg_s, "backscatter_phase": north.BACKSCATTER_deg})
    assert status == ExitStatus.PASS
    walks = [found, *(fitted(north.laser_session(seed), tmp_path / str(seed), capsys)[1] for seed in (7, 8))]
    errors = [errors_in_U(each, {"angle_random_walk": north.random_walk_deg_rth()}, method="raw") for each in walks]
    assert np.sqrt(np.mean(np.square(errors))) < 1.0, errors  # seed 6 alone is 1.03, as one record in twenty is


SESSIONS: Mapping[str, Callable[[], Session]] = {
    "scale_factor": cache(lambda: af.converter_session("scale_factor")),
    "dmm_method": cache(lambda: af.converter_session("dmm_method")),
    "bias_ramp": cache(af.ramp_session),
    "fog_north": cache(north.north_session),
    "imu_calibration": cache(gnc.calibration_session),
    "imu_bias": cache(gnc.short_bias_session),
    "magnetometer": cache(gnc.magnetometer_session),
    "gnc_unit_test": cache(gnc.module_session),
    "time_sync": cache(north.sync_session),
    "rlg_lock_in": cache(north.laser_session),
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
def test_a_session_that_lacks_what_is_needed_is_refused(tmp_path: Path, analysis: str, key: str) -> None:
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
