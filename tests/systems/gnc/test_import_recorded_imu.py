"""Two recordings of other people's sensors, read without edits, against what numpy reads in the same files."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from rehearsal import ROOT, Inside

from bench.record import SessionReader
from bench.replay.series import ImportedSeries, replay_series

FOLDER = Path(os.environ.get("BENCH_REAL_DATA", ROOT.parent / "shared" / "data"))
TURNED = FOLDER / "imucal" / "imucal_example_ferraris_session.csv"
RANGES = TURNED.with_name("imucal_example_ferraris_session_list.json")
POSES = FOLDER / "imu_tk" / "xsens_acc.mat"
GRAVITY_m_s2 = 9.81
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not (TURNED.exists() and POSES.exists()), reason=f"no recordings in {FOLDER}"),
]


def imported(inside: Inside, out: Path, mapping: str, file: Path, status: int = 0) -> tuple[Path, ImportedSeries]:
    """The session of a recording, with its analysis, and its columns."""
    path = ROOT / "docs" / "mappings" / f"{mapping}.yaml"
    done = inside("import", str(path), str(file), "--out", str(out))
    assert done.returncode == status, done.stderr
    session = next(folder for folder in out.iterdir() if folder.name.endswith(f"_{mapping}_unknown"))
    return session, replay_series(session)


def estimates(session: Path, quantity: str, **conditions: str) -> list[float]:
    results = json.loads((session / "results.json").read_text(encoding="utf-8"))
    found = [one for one in results["estimates"] if one["quantity"] == quantity]
    return [one["value"] for one in found if conditions.items() <= one["conditions"].items()]


def test_six_positions_and_three_turns(inside: Inside, tmp_path: Path) -> None:
    session, series = imported(
        inside, tmp_path, "imucal_six_position", TURNED, status=1
    )  # gyro z stands still in a turn
    table = np.loadtxt(TURNED, delimiter=",", skiprows=1)
    names = [f"{kind}_{axis}_{unit}" for kind, unit in (("gyro", "deg_s"), ("accel", "m_s2")) for axis in "xyz"]
    for place, name in enumerate(names, 1):
        np.testing.assert_array_equal(series.columns[name], table[:, place])
    np.testing.assert_allclose(series.columns["t_s"], table[:, 0] / 102.4, atol=1.1e-9)
    segments = {one["label"]: one for one in SessionReader(session).manifest["campaign"]["segments"]}
    ranges = json.loads(RANGES.read_text(encoding="utf-8"))
    assert {name: (one["first"], one["last"] + 1) for name, one in segments.items()} == {
        name: (one["start"], one["end"]) for name, one in ranges.items()
    }
    for one in segments.values():
        rows = slice(one["first"], one["last"] + 1)
        if one["item"] == "position":
            sign, axis = (1.0 if one["up"][0] == "+" else -1.0), one["up"][1]
            assert abs(np.mean(series.columns[f"accel_{axis}_m_s2"][rows]) - sign * GRAVITY_m_s2) < 1.0
        else:  # half the rate, as the file might suggest, would make a half turn of it
            turned_deg = np.sum(series.columns[f"gyro_{one['axis']}_deg_s"][rows]) / 102.4
            assert abs(turned_deg - one["turn_deg"]) < 15.0
    for axis in "xyz":
        for name in ("accel_matrix", "gyro_matrix"):
            (diagonal,) = estimates(session, name, row=axis, column=axis)
            assert abs(diagonal - 1.0) < 0.03


def test_many_poses_in_raw_counts(inside: Inside, tmp_path: Path) -> None:
    session, series = imported(inside, tmp_path, "imu_tk_xsens", POSES)
    table = np.loadtxt(POSES)
    for place, axis in enumerate("xyz", 1):
        np.testing.assert_array_equal(series.columns[f"accel_{axis}_counts"], table[:, place])
    np.testing.assert_allclose(series.columns["t_s"], table[:, 0] - table[0, 0], atol=1.1e-9)
    assert series.counts.rows == 51175
    np.testing.assert_allclose(estimates(session, "accel_sensitivity"), [414.42, 412.03, 414.62], atol=0.05)
    assert SessionReader(session).manifest["campaign"]["site"]["gravity_m_s2"] == 9.81744


def test_drift_of_a_decoded_capture_and_of_two_files_side_by_side(inside: Inside, tmp_path: Path) -> None:
    """As docs/importing.md says: a capture through its frame, counts of two triads pasted, no setting for either."""
    table = tmp_path / "vn100.csv"
    done = inside("decode", "vn100_binary", str(FOLDER / "vn100" / "F00379"), "--csv", str(table))
    assert done.returncode == 0, done.stderr
    session, series = imported(inside, tmp_path / "vn100", "vn100_strapdown", table)
    assert (series.counts.rows, series.columns["t_s"][-1]) == (8895, 889.4)
    (walk,) = estimates(session, "angle_random_walk")
    assert abs(walk - 0.21) < 0.03  # the maker: 0.0035 deg/s/sqrt(Hz)
    assert estimates(session, "gyro_drift", sensor_class="tactical")
    both = tmp_path / "xsens.txt"
    files = [POSES.with_name(name).read_text(encoding="ascii").splitlines() for name in (POSES.name, "xsens_gyro.mat")]
    both.write_text("".join(f"{one} {other}\n" for one, other in zip(*files, strict=True)), encoding="ascii")
    session, _ = imported(inside, tmp_path / "xsens", "imu_tk_strapdown", both)
    (level,) = estimates(session, "level_error")
    assert level < 1.0
    assert estimates(session, "angle_random_walk", sensor_class="consumer")
