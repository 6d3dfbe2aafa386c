"""Logs of inertial units: numbered samples, columns without names, named stretches of rows; their analyses: simulated
poses found again; recordings made by other people, a hand-held Ferraris calibration and a multi-position calibration,
give the figures known of them.
"""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imported_logs import columns_of, imported, parsed
from imu_material import turned, values
from spoken import english_left

from bench.analysis import Material
from bench.model.errors import FitError, InputError, InputErrors
from bench.record import SessionReader
from bench.systems.gnc.estimators.between_rests import fit_between_rests
from bench.systems.gnc.estimators.earth_rate import RotationRecord, static_means
from bench.systems.gnc.estimators.multi_position import NormFit, fit_multi_position
from bench.systems.gnc.estimators.rotation_inputs import Declared
from bench.systems.gnc.estimators.rotations import fit_turns_from_rest
from bench.systems.gnc.estimators.static_intervals import static_intervals
from bench.systems.gnc.estimators.triad import fit_six_position
from bench.systems.gnc.logs import multi_position as imu_multi_position
from bench.systems.gnc.logs import six_position as imu_six_position

SEED = 610
FOLDER = Path(os.environ.get("BENCH_REAL_DATA", Path(__file__).parents[5] / "shared" / "data"))
ROLES = {"gyro": ("gyro", "deg/s", "deg_s"), "accel": ("accelerometer", "m/s2", "m_s2")}
Keep = Callable[[str, object], None]
FERRARIS, XSENS = FOLDER / "imucal", FOLDER / "imu_tk"
RATE_HZ, G = 102.4, 9.81
needs_ferraris = pytest.mark.skipif(not FERRARIS.is_dir(), reason=f"no recording in {FERRARIS}")
needs_xsens = pytest.mark.skipif(not XSENS.is_dir(), reason=f"no recording in {XSENS}")
ORDER = [f"{axis}_{end}" for axis in "xyz" for end in "pa"]


def log(accel: Any, gyro: Any, t_s: Any, segments: list[dict[str, Any]], **more: Any) -> Material:
    """What an imported log gives to an analysis."""
    series, columns = {"t_s": t_s}, []
    for word, table in (("accel", accel), ("gyro", gyro)):
        for k, axis in enumerate("xyz" if table is not None else ""):
            role, unit, suffix = ROLES[word]
            unit, suffix = ("1", "counts") if more.get("counts") else (unit, suffix)
            columns.append(
                {"name": f"{word}_{axis}_{suffix}", "role": role, "axis": axis, "unit": unit, "header": axis}
            )
            series[f"{word}_{axis}_{suffix}"] = table[:, k]
    campaign = {"uut": {"model": "any", "serial": "1"}, "columns": columns, "segments": segments}
    campaign |= {"site": {"gravity_m_s2": more.get("gravity", 9.81)}, "rate_Hz": more.get("rate_Hz")}
    return Material(rows=(), campaign=campaign, standards={}, series=series)


def positions_and_turns() -> Material:
    rng = np.random.default_rng(SEED)
    K, b = np.array([[1.01, 0.004, 0.0], [-0.003, 0.99, 0.002], [0.001, 0.0, 1.02]]), np.array([0.2, -0.1, 0.3])
    accel, gyro, segments, first = [], [], [], 0
    for axis in range(3):
        for sign in (1.0, -1.0):
            force = np.zeros(3)
            force[axis] = 9.81 * sign
            accel.append(np.linalg.solve(K, force - b) + rng.normal(0.0, 0.01, (300, 3)))
            gyro.append(np.full((300, 3), 0.5) + rng.normal(0.0, 0.05, (300, 3)))
            up = f"{'+' if sign > 0 else '-'}{'xyz'[axis]}"
            segments.append({"label": up, "first": first, "last": first + 299, "item": "position", "up": up})
            first += 300
    for axis in range(3):
        rate = np.zeros((400, 3))
        rate[50:350, axis] = -120.0
        accel.append(np.zeros((400, 3)))
        gyro.append(np.linalg.solve(K, rate.T).T + 0.5 + rng.normal(0.0, 0.05, (400, 3)))
        turn = {"item": "rotation", "axis": "xyz"[axis], "turn_deg": -360.0}
        segments.append({"label": "turn", "first": first, "last": first + 399, **turn})
        first += 400
    return log(np.vstack(accel), np.vstack(gyro), np.arange(first) / 100.0, segments, rate_Hz=100.0)


def test_six_positions_and_turns_are_found_again() -> None:
    analysis = imu_six_position.analyse(positions_and_turns())
    assert english_left(analysis) == set()
    K = np.array([[1.01, 0.004, 0.0], [-0.003, 0.99, 0.002], [0.001, 0.0, 1.02]])
    np.testing.assert_allclose(values(analysis.estimates, "accel_matrix", "row", "column"), K, atol=5e-4)
    np.testing.assert_allclose(values(analysis.estimates, "accel_bias"), [0.2, -0.1, 0.3], atol=5e-3)
    np.testing.assert_allclose(values(analysis.estimates, "gyro_matrix", "row", "column"), K, atol=5e-4)
    np.testing.assert_allclose(values(analysis.estimates, "gyro_bias"), K @ [0.5, 0.5, 0.5], atol=0.02)
    assert analysis.missing == []


@pytest.mark.parametrize(("count", "moved"), [(2, 0.0), (20, 0.5)])
def test_samples_that_stand_alone_are_left_out_and_many_are_doubted(count: int, moved: float) -> None:
    material = positions_and_turns()
    right = values(imu_six_position.analyse(material).estimates, "accel_bias")
    rows = np.arange(count) * 7  # of 300
    force, rate = (material.series[str(material.campaign["columns"][k]["name"])] for k in (0, 3))
    force[rows] -= 5.0
    rate[rows] += 90.0
    rate[1860 + rows] += 0.9  # while it turns: as a shock may be
    analysis = imu_six_position.analyse(material)
    told = [check.sentence for check in analysis.evidence if check.code == "lone_samples"]
    if moved:
        assert told[0].startswith("20 of 300 samples of the accelerometer x in the stretch from row 0 on stand alone")
        assert told[1].startswith("20 of 300 samples of the gyro x in the stretch from row 0 on stand alone")
        assert len(told) == 2
    else:
        stretch = "2 samples of the accelerometer x in the stretch from row 0 on stand alone, far off their neighbours"
        assert f"{stretch}, and are left out." in analysis.notes
        assert told == []
    np.testing.assert_allclose(values(analysis.estimates, "accel_bias"), right, atol=2e-4 + moved)


def test_a_missing_turn_costs_the_gyros_and_is_named() -> None:
    material = positions_and_turns()
    material.campaign["segments"].pop()
    material.campaign["segments"].pop(0)
    analysis = imu_six_position.analyse(material)
    assert "position +x up: no stretch" in analysis.missing
    assert any(one.startswith("gyros: ") for one in analysis.missing)
    assert not any(one.quantity == "gyro_matrix" for one in analysis.estimates)


def test_logs_that_do_not_serve() -> None:
    material = positions_and_turns()
    for lacking, code in (("segments", "B-GNC-007"), ("site", "B-GNC-006"), ("columns", "B-GNC-006")):
        with pytest.raises(FitError, match=code):
            imu_six_position.analyse(Material((), material.campaign | {lacking: {}}, {}, series=material.series))


def test_many_poses_are_found_again() -> None:
    rng = np.random.default_rng(SEED)
    zero, scale = np.array([33_000.0, 32_900.0, 33_100.0]), np.array([410.0, 412.0, 415.0])
    pieces = []
    for number in range(36):
        towards = turned(2, rng.uniform(0, 360)) @ turned(1, rng.uniform(0, 360)) @ np.array([0.0, 0.0, 9.8])
        seconds = 35 if number == 0 else 5
        pieces.append(np.tile(towards * scale + zero, (seconds * 100, 1)))
        pieces.append(towards * scale + zero + rng.normal(0.0, 300.0, (200, 3)))
    accel = np.vstack(pieces)
    accel = accel + rng.normal(0.0, 2.0, accel.shape)
    material = log(accel, None, np.arange(len(accel)) / 100.0, [], counts=True, gravity=9.8)
    analysis = imu_multi_position.analyse(material)
    assert english_left(analysis) == set()
    np.testing.assert_allclose(values(analysis.estimates, "accel_sensitivity"), scale, rtol=5e-4)
    np.testing.assert_allclose(values(analysis.estimates, "accel_zero"), zero, atol=1.5)
    assert analysis.tables[1].rows[0][0] == 36
    fit = fit_multi_position(static_intervals(accel, 100.0, initial_s=30.0).means(accel), 9.8)
    for quantity, stds in (("accel_sensitivity", fit.counts_per_unit_std), ("accel_zero", fit.zero_std)):
        found = [one for one in analysis.estimates if one.quantity == quantity]
        assert [one.std_uncertainty for one in found] == pytest.approx(stds)
        assert {one.dof for one in found} == {27.0}  # 36 poses less nine parameters


@pytest.fixture(scope="module")
def sections() -> dict[str, np.ndarray]:
    """Gyroscope deg/s and accelerometer m/s2, (m, 6), of each section."""
    rows = np.genfromtxt(FERRARIS / "imucal_example_ferraris_session.csv", delimiter=",", skip_header=1)
    listed = json.loads((FERRARIS / "imucal_example_ferraris_session_list.json").read_text())
    return {name: rows[span["start"] : span["end"], 1:] for name, span in listed.items()}


def ferraris(sections: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K of the accelerometers, their bias (output), and S of the gyroscopes, by the formulas of the 1995 paper."""
    up = np.array([sections[f"{axis}_p"].mean(axis=0) for axis in "xyz"])
    down = np.array([sections[f"{axis}_a"].mean(axis=0) for axis in "xyz"])
    bias = np.diag((up + down)[:, 3:]) / 2.0
    matrix = np.linalg.inv((up - down)[:, 3:].T / (2.0 * G))
    of_force = (up - down)[:, :3].T / (2.0 * G)  # how the gyroscopes answer to acceleration
    rest = np.vstack([sections[name] for name in ORDER])[:, :3].mean(axis=0)
    turns = []
    for axis in "xyz":
        turn = sections[f"{axis}_rot"]
        true = (turn[:, 3:] - bias) @ matrix.T
        turns.append((turn[:, :3] - rest - true @ of_force.T).sum(axis=0) / RATE_HZ)
    return matrix, bias, np.array(turns).T / -360.0


@pytest.mark.real
@needs_ferraris
@pytest.mark.validates(
    "six positions and one turn about each axis of a real unit, held in the hand",
    against="the formulas of Ferraris, Grimaldi and Parvis 1995 on the recording published with the package imucal",
)
def test_ferraris_recording(sections: dict[str, np.ndarray], record_property: Keep) -> None:
    matrix, bias, sensitivity = ferraris(sections)
    means, _, _ = static_means([sections[name][:, 3:] for name in ORDER], RATE_HZ)
    force = np.kron(np.eye(3), [[G], [-G]])
    triad = fit_six_position(means, force)
    rms = float(np.sqrt(np.mean(triad.residual**2)))
    rest, spread, _ = static_means([sections[name][:, :3] for name in ORDER], RATE_HZ)
    length_s = np.array([len(sections[name]) for name in ORDER]) / RATE_HZ
    records = []
    for axis in "xyz":
        turn = sections[f"{axis}_rot"]
        place = np.arange(len(turn))
        records.append(RotationRecord(axis, -360.0, place, place / RATE_HZ, turn[:, :3]))
    mean = length_s @ rest / length_s.sum()
    gyro = fit_turns_from_rest(records, mean, spread.mean(axis=0) / 6.0, spread[0] * length_s[0], Declared())
    apart = np.abs(triad.matrix - matrix).max(), np.abs(gyro.sensitivity - sensitivity).max()
    bias_apart = np.abs(triad.bias + matrix @ bias).max()
    record_property(
        "obtained", f"apart {apart[0]:.1e}, turns {apart[1]:.1e} (limits 1e-4), bias {bias_apart:.3f} m/s2 (0.03)"
    )
    record_property("obtained", f"residual {rms:.4f} m/s2")
    assert max(apart) < 1e-4
    assert bias_apart < 0.03
    assert rms == pytest.approx(0.0131, abs=1e-4)


def published(means: np.ndarray) -> NormFit:
    return fit_multi_position(means, 9.81744)  # gravity of the publication


@pytest.mark.real
@needs_xsens
@pytest.mark.validates(
    "multi-position calibration of a real unit turned by hand",
    against="the figures of the public multi-position method on the recording published with it (imu_tk)",
)
def test_multi_position_recording(record_property: Keep) -> None:
    acceleration, gyro = (np.loadtxt(XSENS / f"xsens_{name}.mat") for name in ("acc", "gyro"))
    rests = static_intervals(acceleration[:, 1:], 100.0, initial_s=50.0, least_s=2.0)
    means = rests.means(acceleration[:, 1:])
    fit = published(means)
    third = np.arange(len(means)) % 3
    left = np.concatenate(
        [np.linalg.norm(published(means[third != k]).apply(means[third == k]), axis=1) - 9.81744 for k in range(3)]
    )
    step = np.diff(gyro[:, 0], prepend=gyro[0, 0] - 0.01)
    turned = fit_between_rests(step, gyro[:, 1:], rests, fit.apply(means), 83.0)
    per_rad = np.degrees(1.0 / turned.matrix.diagonal())
    scale, zero = ", ".join(f"{v:.2f}" for v in fit.counts_per_unit), ", ".join(f"{v:.1f}" for v in fit.zero)
    record_property(
        "obtained", f"{len(means)} rests, {scale} counts/(m/s2), zero {zero}, residual {fit.residual_rms:.5f} m/s2"
    )
    record_property("obtained", f"rests left out, every third, {np.sqrt(np.mean(left**2)):.4f} m/s2")
    record_property(
        "obtained",
        f"gyroscopes {per_rad[0]:.0f}, {per_rad[1]:.0f}, {per_rad[2]:.0f} counts/(rad/s), maker 4778, 4758, 4766",
    )
    assert 36 <= len(means) <= 38
    assert fit.counts_per_unit == pytest.approx([414.42, 412.03, 414.62], rel=5e-4)
    assert fit.zero == pytest.approx([33123.8, 33275.1, 32364.5], abs=1.0)
    assert fit.residual_rms <= 0.0011
    assert np.sqrt(np.mean(left**2)) < 0.002
    assert per_rad == pytest.approx([4778.0, 4758.0, 4766.0], rel=0.005)


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
        ("columns:", "file: {names: [n, gx, gx]}\ncolumns:", "two of the 'names' are the same"),
        ("columns:", "file: {names: [n, gx, gz, ax, temp]}\ncolumns:", "'T' is not among the 'names'"),
    ],
)
def test_mistakes_are_named(old: str, new: str, said: str) -> None:
    assert old in NUMBERED
    assert said in refused(NUMBERED.replace(old, new))
