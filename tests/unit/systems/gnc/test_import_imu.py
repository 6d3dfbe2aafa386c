"""Logs of inertial measurement units: numbered samples, columns without names, named stretches of rows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from imported_logs import columns_of, imported, parsed

from bench.model.errors import InputError, InputErrors
from bench.record import SessionReader

NUMBERED = """\
mapping: turned
uut: {model: M, serial: S-1}
columns:
  n: {role: time, format: samples, rate: 102.4 Hz, start: 2024-01-01T00:00:00Z}
  gx: {role: gyro, axis: x, unit: deg/h}
  gz: {role: gyro, axis: z, unit: deg/h}
  ax: {role: accelerometer, axis: x, unit: mg}
  T: {role: temperature, quantity: sensor, unit: degC}
segments:
  up: {rows: [0, 1], up: -x}
  turn: {rows: [2, 3], axis: z, turn: -360 deg}
site: {gravity: 9.80665 m/s2, latitude: 39.9 deg, azimuth: 90 deg}
"""
LOG = "n,gx,gz,ax,T\n100,3600,-7200,1000,20\n101,0,36,-1001,21\n103,1,2,3,22\n1123,4,5,6,23\n"

COUNTS = """\
mapping: counts
uut: {model: M, serial: S-2}
file: {delimiter: whitespace, names: [t, x, y, z]}
columns:
  t: {role: time, format: elapsed, unit: s, start: 1970-01-01T00:00:00Z}
  z: {role: accelerometer, axis: z, unit: "1"}
  x: {role: accelerometer, axis: x, unit: "1"}
"""
BARE = "   2.9840000e-02   3.3108000e+04   3.3329000e+04   3.6429000e+04\n   3.9857000e-02  33096 1 -7.5\n"


def test_numbered_samples_at_a_rate(tmp_path: Path) -> None:
    session = imported(tmp_path, NUMBERED, LOG)
    columns = columns_of(session)
    assert session.name == "20240101T000000Z_turned_S-1"
    assert list(columns) == ["t_s", "gyro_x_deg_s", "gyro_z_deg_s", "accel_x_g", "sensor"]
    # 102.4 Hz: a step is 9.765625 ms exactly, so that a whole number of ns is due only every eighth sample or so
    np.testing.assert_allclose(columns["t_s"], np.array([0, 1, 3, 1023]) * 0.009765625, atol=1.1e-9)
    np.testing.assert_allclose(columns["gyro_x_deg_s"], [1.0, 0.0, 1 / 3600, 4 / 3600], rtol=1e-12)
    np.testing.assert_allclose(columns["accel_x_g"], [1.0, -1.001, 0.003, 0.006], rtol=1e-12)
    campaign = json.loads(json.dumps(SessionReader(session).manifest["campaign"]))  # what the analysis is told
    assert campaign["segments"] == [
        {"label": "up", "first": 0, "last": 1, "item": "position", "up": "-x"},
        {"label": "turn", "first": 2, "last": 3, "item": "rotation", "axis": "z", "turn_deg": -360.0},
    ]
    assert campaign["site"] == {"gravity_m_s2": 9.80665, "latitude_deg": 39.9, "azimuth_deg": 90.0}
    assert campaign["rate_Hz"] == 102.4
    assert campaign["columns"][1] == {
        "header": "gz", "name": "gyro_z_deg_s", "role": "gyro", "unit": "deg/s", "axis": "z",
    }  # fmt: skip
    assert "axis" not in campaign["columns"][3]


def test_a_file_without_a_line_of_names(tmp_path: Path) -> None:
    session = imported(tmp_path, COUNTS, BARE)
    columns = columns_of(session)
    assert columns["accel_x_counts"].tolist() == [33108.0, 33096.0]
    assert columns["accel_z_counts"].tolist() == [36429.0, -7.5]
    np.testing.assert_allclose(columns["t_s"], [0.0, 0.010017], atol=1e-9)
    campaign = SessionReader(session).manifest["campaign"]
    assert (campaign["segments"], campaign["site"], campaign["rate_Hz"]) == ([], {}, None)
    with pytest.raises(InputError, match=r"B-IMP-005.*line 1: 3 fields, 4 are due"):  # not taken for names
        imported(tmp_path, COUNTS, "0.0 1 2\n" + BARE)


def test_a_log_of_temperatures_says_nothing_of_imus() -> None:
    text = NUMBERED.partition("segments:")[0].replace("gyro, axis: x", "reading, quantity: a")
    text = text.replace("deg/h", "V").replace("accelerometer, axis: x, unit: mg", "ignore")
    text = text.replace("gyro, axis: z", "reading, quantity: b")
    campaign = parsed(text).campaign()
    assert set(campaign) == {"analysis", "reference_temperature_degC", "uut", "columns"}
    assert all(set(one) == {"header", "name", "role", "unit"} for one in campaign["columns"])


def test_a_segment_behind_the_last_row_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"B-IMP-008.*m.yaml:11:10.*'turn' ends at row 4, the last .* is 3"):
        imported(tmp_path, NUMBERED.replace("[2, 3]", "[2, 4]"), LOG)
    assert not (tmp_path / "out").exists()


SIX = """\
  ay: {role: accelerometer, axis: y, unit: mg}
  az: {role: accelerometer, axis: z, unit: mg}
segments:
  a: {rows: [0, 1], up: +x}
  b: {rows: [2, 3], up: -x}
  c: {rows: [4, 5], up: +y}
  d: {rows: [6, 7], up: -y}
  e: {rows: [8, 9], up: +z}
  f: {rows: [10, 11], up: -z}
"""
POSITIONS = NUMBERED.partition("segments:")[0] + SIX + "site: {gravity: 9.81 m/s2}\nanalysis: imu_six_position\n"


def refused(text: str) -> str:
    with pytest.raises(InputErrors) as caught:
        parsed(text)
    return str(caught.value)


ROWS = """\
mapping: counted
uut: {model: M, serial: S-3}
analysis: none
columns:
  offset: {role: time, format: rows, rate: 10 Hz, start: 2024-01-01T00:00:00Z}
  "gyro_x [rad/s]": {role: gyro, axis: x, unit: rad/s}
"""


def test_rows_are_counted_whatever_their_column_holds(tmp_path: Path) -> None:
    log = "offset,gyro_x [rad/s]\n271,0.1\n410,-0.5\n\nno number,3.141592653589793\n"
    columns = columns_of(imported(tmp_path, ROWS, log))
    assert columns["t_s"].tolist() == [0.0, 0.1, 0.2]
    np.testing.assert_allclose(columns["gyro_x_deg_s"], np.degrees([0.1, -0.5, np.pi]), rtol=1e-15)


def test_what_counted_rows_need() -> None:
    assert "takes no 'unit'" in refused(ROWS.replace("rate:", "unit: s, rate:"))
    assert "needs 'rate'" in refused(ROWS.replace("rate: 10 Hz, ", ""))
    assert "needs 'start'" in refused(ROWS.replace(", start: 2024-01-01T00:00:00Z", ""))
    assert "no row may be left out" in refused(ROWS + "bad_rows: 1 %\n")


def test_a_strapdown_needs_both_triads() -> None:
    columns = [f"  {role[0]}{axis}: {{role: {role}, axis: {axis}, unit: \"1\"}}\n" for role in ("gyro", "accelerometer")
               for axis in "xyz"]  # fmt: skip
    head = ROWS.partition('  "gyro')[0].replace("none", "imu_strapdown")
    text = head + "".join(columns) + "site: {gravity: 9.81 m/s2}\n"
    assert parsed(text).analysis == "imu_strapdown"
    assert "needs a gyro column of the axis y" in refused(text.replace(columns[1], ""))
    assert "needs an accelerometer column of the axis z" in refused(text.replace(columns[5], ""))


def test_what_an_analysis_of_positions_needs() -> None:
    assert parsed(POSITIONS).analysis == "imu_six_position"
    assert "'up: -y'" in refused(POSITIONS.replace("up: -y", "up: +y"))
    assert "needs an accelerometer column of the axis z" in refused(
        POSITIONS.replace("az: {role: accelerometer, axis: z, unit: mg}", "az: {role: ignore}")
    )
    assert "needs 'site' with the local gravity" in refused(POSITIONS.replace("site: {gravity: 9.81 m/s2}\n", ""))
    several = POSITIONS.replace("six", "multi").replace("up: -y", "up: +y")
    assert parsed(several).analysis == "imu_multi_position"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("rows: [0, 1], up: -x", "rows: [1, 0], up: -x", "stands before the first one"),
        ("rows: [0, 1], up: -x", "rows: [0, 1]", "either 'up', or 'axis' and a 'turn'"),
        ("rows: [0, 1], up: -x", "rows: [0, 1], up: -x, turn: 1 deg", "either 'up', or 'axis' and a 'turn'"),
        ("rows: [0, 1], up: -x", "rows: [0, 1], up: -x, axis: x, turn: 1 deg", "either 'up', or 'axis' and a 'turn'"),
        ("turn: -360 deg", "turn: 0 deg", "either 'up', or 'axis' and a 'turn'"),
        ("turn: -360 deg", "turn: -360", "has no unit"),
        ("up: -x", "up: x", "up"),
        ("rows: [0, 1]", "rows: [0, 1.5]", "rows"),
        ("9.80665 m/s2", "1 g", "m/s2"),
        ("9.80665 m/s2", "98 m/s2", "above the limit"),
        ("site:", "bad_rows: 1 %\nsite:", "no row may be left out"),
        ("gyro, axis: z, unit: deg/h", "gyro, axis: z, unit: mg", "a gyro needs a unit of deg/s, 1"),
        ("gyro, axis: z, unit: deg/h", 'gyro, axis: z, unit: "1"', "have different units"),
        ("gyro, axis: z", "gyro, axis: x", "two columns have the quantity 'gyro_x_deg_s'"),
        ("gyro, axis: z", "gyro, axis: w", "axis"),
        ("quantity: sensor", "quantity: accel_x_g", "two columns have the quantity 'accel_x_g'"),
        ("unit: deg/h", "unit: furlong", "is no unit"),
        ("rate: 102.4 Hz, ", "", "the time format 'samples' needs 'rate'"),
        (", start: 2024-01-01T00:00:00Z", "", "the time format 'samples' needs 'start'"),
        ("format: samples", "format: elapsed, unit: s", "takes no 'rate'"),
        ("rate: 102.4 Hz", "rate: 102.4", "has no unit"),
        ("columns:", "file: {names: [n, gx], header: 1}\ncolumns:", "either a 'header' line or 'names'"),
        ("columns:", "file: {names: [n, gx, gx]}\ncolumns:", "two of the 'names' are the same"),
        ("columns:", "file: {names: [n, gx, gz, ax, temp]}\ncolumns:", "'T' is not among the 'names'"),
    ],
)
def test_mistakes_are_named(old: str, new: str, said: str) -> None:
    assert old in NUMBERED
    assert said in refused(NUMBERED.replace(old, new))
