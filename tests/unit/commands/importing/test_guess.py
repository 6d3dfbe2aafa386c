"""``bench import --guess``: what it proposes reads the log as soon as each FILL_IN is replaced."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.commands.import_log import import_log
from bench.commands.importing import guess
from bench.model.errors import InputError, InputErrors
from bench.plan.language.mapping import load_mapping
from bench.replay.series import replay_series

ROWS = 400
T_s = np.arange(ROWS) * 0.01
RATE = np.random.default_rng(2).normal(0.0, 0.1, (ROWS, 3))
FORCE = np.random.default_rng(3).normal(0.0, 0.01, (ROWS, 3)) + np.array([0.0, 0.0, 9.81])


def proposed(path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    assert guess(path) == 0
    return capsys.readouterr().out


def filled(text: str, **values: str) -> str:
    """Replace each FILL_IN by the value of its key."""
    return re.sub(r"(\w+): FILL_IN", lambda found: f"{found[1]}: {values[found[1]]}", text)


def test_a_text_log_is_proposed_and_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "Unit 7.csv"
    table = np.column_stack((T_s, RATE, FORCE))
    np.savetxt(log, table, delimiter=";", header="time;gyro_x;gyro_y;gyro_z;acc_x;acc_y;acc_z", comments="")
    text = proposed(log, capsys)
    assert "mapping: unit_7\n" in text
    assert "analysis: bias_log  # or: imu_six_position, imu_multi_position, imu_strapdown" in text
    assert "time: {role: time, format: elapsed, unit: s, start: 1970-01-01T00:00:00Z}  # a step of 0.01" in text
    assert "gyro_y: {role: gyro, axis: y, unit: FILL_IN}" in text
    assert "acc_z: {role: accelerometer, axis: z, unit: m/s2}" in text
    (tmp_path / "m.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InputErrors, match="'FILL_IN' is no unit"):
        load_mapping(tmp_path / "m.yaml")
    (tmp_path / "m.yaml").write_text(filled(text, model="M", serial="S-1", unit="deg/s"), encoding="utf-8")
    import_log(tmp_path / "m.yaml", log, tmp_path / "out")
    series = replay_series(next((tmp_path / "out").iterdir()))
    np.testing.assert_allclose(series.columns["gyro_y_deg_s"], RATE[:, 1])


def test_a_matrix_of_hdf5_with_the_time_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with h5py.File(tmp_path / "log", "w") as file:
        file["gyroBuffer"] = np.column_stack((np.cumsum(np.tile([0.001, 0.019], ROWS // 2)), RATE))
        file["short"] = T_s[:7]
    text = proposed(tmp_path / "log", capsys)
    assert "'gyroBuffer[0]': {role: time" in text
    assert [line.split(":")[0].strip() for line in text.splitlines() if "axis: x" in line] == ["'gyroBuffer[1]'"]
    assert "short" not in text
    (tmp_path / "m.yaml").write_text(filled(text, model="M", serial="S-1", unit="deg/s"), encoding="utf-8")
    import_log(tmp_path / "m.yaml", tmp_path / "log", tmp_path / "out")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("date,T\n2024-05-02T08:00:00,20.1\n2024-05-02T08:00:10,20.2\n", "format: iso, zone: FILL_IN}"),
        ("t,mag_x\n1700000000.5,45\n1700000001.5,46\n", "mag_x: {role: magnetometer, axis: x, unit: uT}"),
        ("t,mag_x\n1700000000.5,45\n1700000001.5,46\n", "t: {role: time, format: unix, unit: s}"),
        ("n,w_z (rad/s)\n4,0.1\n5,0.2\n6,0.1\n", "'w_z (rad/s)': {role: gyro, axis: z, unit: rad/s}"),
        ("n,w_z (rad/s)\n4,0.1\n5,0.2\n6,0.1\n", "n: {role: time, format: samples, rate: FILL_IN"),
        ("x;T\n1;20,5\n1;20,75\n", "file: {delimiter: ';', decimal: ','}"),
        ("% made by X\n1 2\n3 1\n", "file: {delimiter: whitespace, comment: '%', names: [c0, c1]}"),
        ("a report\n\nu,temp\n3,20\n1,21\n4,22\n", "file: {header: 3}"),
        ("u,v\n3,\n1,5\n", "overload: {values: ['']}"),
        ("u,count\n3,5\n1,9\n2,17\n", "analysis: rlg_count_log"),
        ("u,v\n3,5\n1,4\n", "row: {role: time, format: rows, rate: FILL_IN"),
    ],
)  # fmt: skip
def test_what_it_sees(content: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log").write_text(content, encoding="utf-8")
    assert said in proposed(tmp_path / "log", capsys)


@pytest.mark.parametrize(("content", "code"), [(b"", "B-IMP-001"), (b"only one line\n", "B-IMP-004")])
def test_what_is_no_log(content: bytes, code: str, tmp_path: Path) -> None:
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(InputError, match=code):
        guess(tmp_path / "log")


def test_the_command_needs_a_log(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,v\n1,5\n2,4\n", encoding="utf-8")
    assert "columns:" in CliRunner().invoke(app, ["import", "--guess", str(tmp_path / "log.csv")]).stdout
    assert CliRunner().invoke(app, ["import", str(tmp_path / "log.csv")]).exit_code == 2
