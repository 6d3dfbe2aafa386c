"""Analysis egi_offset: a log of both units, by a physics of its own (``sync_physics``), whose offset is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sync_physics import IMU_s, OFFSET_s, Recording

from bench.analysis import Material
from bench.analysis.doubt import weigh
from bench.commands.import_log import import_log
from bench.model.errors import FitError, InputErrors
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model
from bench.replay.series import replay_series
from bench.systems.time_sync import egi_log

Array = NDArray[np.float64]
MAPPING = """\
mapping: pair
uut: {model: EGI and IMU, serial: S-1}
analysis: egi_offset
latency: {egi: 8 ms, imu: 0.8 ms, uncertainty: 1 ms}
overload: {values: [""]}
columns:
  received: {role: time, format: unix, unit: s}
  imu_stamp: {role: imu_stamp, unit: s}
  delta_angle_x: {role: delta_angle, axis: x, unit: rad/s}
  delta_angle_y: {role: delta_angle, axis: y, unit: rad/s}
  delta_angle_z: {role: delta_angle, axis: z, unit: rad/s}
  delta_velocity_x: {role: delta_velocity, axis: x, unit: m/s}
  delta_velocity_y: {role: delta_velocity, axis: y, unit: m/s}
  delta_velocity_z: {role: delta_velocity, axis: z, unit: m/s}
  egi_stamp: {role: egi_stamp, unit: s}
  latitude: {role: latitude, unit: deg}
  longitude: {role: longitude, unit: deg}
  height: {role: height, unit: m}
  velocity_north: {role: velocity, axis: north, unit: m/s}
  velocity_east: {role: velocity, axis: east, unit: m/s}
  velocity_down: {role: velocity, axis: down, unit: m/s}
  attitude_roll: {role: attitude, axis: roll, unit: deg}
  attitude_pitch: {role: attitude, axis: pitch, unit: deg}
  attitude_heading: {role: attitude, axis: heading, unit: deg}
  position_sigma: {role: position_sigma, unit: m}
"""
NAMES = [line.split(":")[0].strip() for line in MAPPING.splitlines()[7:]]
AXES = {"velocity": ("north", "east", "down"), "attitude": ("roll", "pitch", "heading")}


def log_of(seed: int) -> dict[str, Array]:
    """Return one row for each frame of both units in the order in which they came, rates of turn in rad/s."""
    (row,) = Recording(seed).material().rows
    parts = []
    for unit, samples in (("imu", row.samples), ("egi", row.beside["egi"])):
        assert samples is not None
        columns = {name: samples.scaled(name) for name in samples.columns if name not in ("tick", "mode", "status")}
        columns = {
            f"{name}_{axis}": column[:, at] if column.ndim > 1 else column
            for name, column in columns.items()
            for at, axis in enumerate(AXES.get(name, "xyz") if column.ndim > 1 else ("",))
        }
        columns = {name.rstrip("_"): column for name, column in columns.items()}
        columns[f"{unit}_stamp"] = samples.columns["tick"].astype(np.float64) * 1e-7
        parts.append((samples.t_ns * 1e-9, columns))
    received_s = np.concatenate([part[0] for part in parts])
    order = np.argsort(received_s, kind="stable")
    series = {"t_s": received_s[order]}
    for name in NAMES:
        pieces = [columns.get(name, np.full(at_s.size, np.nan)) for at_s, columns in parts]
        series[name] = np.concatenate(pieces)[order] * (1.0 / IMU_s if name.startswith("delta_angle") else 1.0)
    return series


def material(seed: int) -> Material:
    """Return the log as an import hands it on, in base units."""
    campaign = parse_yaml(MAPPING, "m.yaml", mapping_model()).model.campaign()
    series: dict[str, Any] = log_of(seed)
    for axis in "xyz":
        series[f"delta_angle_{axis}"] = np.degrees(series[f"delta_angle_{axis}"])
    return Material((), campaign, {}, series=series)


def test_the_offset_is_that_which_the_log_was_made_with() -> None:
    analysis = egi_log.analyse(material(6))
    offsets = [entry for entry in analysis.estimates if entry["quantity"] == "time_offset"]
    assert len(offsets) == 2
    for offset in offsets:
        assert offset["value"] == pytest.approx(OFFSET_s, abs=1.5 * offset["expanded_uncertainty"])
        assert offset["expanded_uncertainty"] < 5e-3
    (stamps,) = [entry for entry in analysis.estimates if entry["quantity"] == "time_offset_from_stamps"]
    assert stamps["value"] == pytest.approx(OFFSET_s, abs=1.5 * stamps["expanded_uncertainty"])
    assert weigh(analysis.evidence).against == []


def test_a_log_comes_back_from_its_session(tmp_path: Path) -> None:
    series = {name: column[:400] for name, column in log_of(5).items()}
    lines = [",".join(["received", *NAMES])]
    lines += [
        ",".join("" if np.isnan(value) else f"{value:.17g}" for value in row)
        for row in zip(*series.values(), strict=True)
    ]
    (tmp_path / "log.csv").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "m.yaml").write_text(MAPPING.replace("analysis: egi_offset\n", ""), encoding="utf-8")
    assert import_log(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "out") == 0
    read = replay_series(next((tmp_path / "out").iterdir())).columns
    np.testing.assert_array_equal(read["latitude"], series["latitude"])
    np.testing.assert_allclose(read["delta_angle_z"], np.degrees(series["delta_angle_z"]), rtol=1e-14)


def test_too_few_rows_of_a_unit_are_refused() -> None:
    log = material(5)
    log.series["height"][:] = np.nan
    with pytest.raises(FitError, match="B-SYNC-014: 0 rows of the log hold egi_stamp"):
        egi_log.analyse(log)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("  height: {role: height, unit: m}\n", "", "needs columns of the role height in units of m"),
        ("role: attitude, axis: heading", "role: attitude, axis: x", "attitude, axes roll, pitch, heading,"),
        ("delta_angle, axis: z, unit: rad/s", "delta_angle, axis: z, unit: rad", "in units of deg or deg/s"),
        ("role: latitude", "role: motion", "it takes: time, imu_stamp, delta_angle"),
    ],
)
def test_mistakes_of_a_mapping_are_named(old: str, new: str, said: str) -> None:
    with pytest.raises(InputErrors) as raised:
        parse_yaml(MAPPING.replace(old, new).replace("role: motion, unit", "role: motion, stream: one, unit"), "m.yaml",
                   mapping_model())  # fmt: skip
    assert said in str(raised.value)
