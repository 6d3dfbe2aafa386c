"""``bench import --guess``: what it proposes reads the log as soon as each FILL_IN is replaced."""

import gzip
import io
import re
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from bench.cli import app
from bench.commands.guess import guess
from bench.commands.import_log import import_log
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
        ("t,mag_x\n1700000000.5,45\n1700000001.5,46\n", "analysis: none"),
        ("t,mag_x\n1700000000.5,45\n1700000001.5,46\n", "t: {role: time, format: unix, unit: s}"),
        ("n,w_z (rad/s)\n4,0.1\n5,0.2\n6,0.1\n", "'w_z (rad/s)': {role: gyro, axis: z, unit: rad/s}"),
        ("n,w_z (rad/s)\n4,0.1\n5,0.2\n6,0.1\n", "n: {role: time, format: samples, rate: FILL_IN"),
        ("x;T\n1;20,5\n1;20,75\n", "file: {delimiter: ';', decimal: ','}"),
        ("% made by X\n1 2\n3 1\n", "file: {delimiter: whitespace, comment: '%', names: [c0, c1]}"),
        ("# AW2015\n# a counter, 1 s gate\n1.5\n2.5\n1.5\n", "names: [c0]"),
        ("a report\n\nu,temp\n3,20\n1,21\n4,22\n", "file: {header: 3}"),
        ("u,v\n3,\n1,5\n", "overload: {values: ['']}"),
        ("u,count\n3,5\n1,9\n2,17\n", "analysis: rlg_count_log"),
        ("u,v\n3,5\n1,4\n", "row: {role: time, format: rows, rate: FILL_IN"),
    ],
)  # fmt: skip
def test_what_it_sees(content: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "log").write_text(content, encoding="utf-8")
    assert said in proposed(tmp_path / "log", capsys)


def text(names: str, *columns: np.ndarray, separator: str = ",", end: str = "\n", above: str = "") -> bytes:
    """Return a table; of its columns texts stay as they are, numbers have nine digits."""
    rows = zip(*(column.tolist() for column in columns), strict=True)
    lines = [separator.join(each if isinstance(each, str) else f"{each:.9g}" for each in row) for row in rows]
    return (above + end.join([*([names] if names else []), *lines, ""])).encode()


def moments(form: str) -> np.ndarray:
    """Return local times, a second apart."""
    start = datetime(2024, 10, 27, 11, 59, 0)
    return np.array([(start + timedelta(seconds=k)).strftime(form) for k in range(ROWS)])


def stamps(first: int, step: int) -> np.ndarray:
    return np.array([str(first + step * k) for k in range(ROWS)])


def mat(**variables: object) -> bytes:
    savemat(stream := io.BytesIO(), {"imu": variables})
    return stream.getvalue()


SIX = (*RATE.T, *FORCE.T)
XYZ = "gyro_x,gyro_y,gyro_z"
UNITS = (("w", "rad s^-1"), ("a", "m s^-2"))
EUROC = ",".join(["#timestamp [ns]", *(f"{word}_RS_S_{axis} [{unit}]" for word, unit in UNITS for axis in "xyz")])
PX4 = "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt,accelerometer_timestamp_relative"
PX4 += ",accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2]"
OPENBCI = "Sample Index,Accel Channel 0,Accel Channel 1,Accel Channel 2,Timestamp"
XSENS = "PacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z"
FINE = np.array([str((2**32 - 3000 + 200 * k) % 2**32) for k in range(ROWS)])  # begins anew
DAYS = np.array([f"{45592 + 10 * k / 86400:.6f}" for k in range(ROWS)])
NANOSECONDS = stamps(1_730_000_000_000_000_000, 10_000_000)
GYRO, ACCEL = ({f"{word}_{axis}_{unit}" for axis in "xyz"} for word, unit in (("gyro", "deg_s"), ("accel", "m_s2")))
MAG = {f"mag_{axis}_gauss" for axis in "xyz"}
GYRO_X = {"gyro_x_deg_s"}
PLAIN = text(f"t,{XYZ}", T_s, *RATE.T)
FORMS: dict[str, tuple[bytes, set[str], float]] = {  # by name of the file: its bytes, what is read of it, its step
    "EuRoC.csv": (text(EUROC, NANOSECONDS, *SIX), GYRO | ACCEL, 0.01),
    "tum.txt": (text("# timestamp ax ay az", T_s + 1.3e9, *FORCE.T, separator=" ", above="# made\n"), ACCEL, 0.01),
    "kitti oxts.txt": (text("", *[T_s] * 30, separator=" "), set(), 0.01),
    "kitti stamps.txt": (text("", moments("%Y-%m-%d %H:%M:%S.964389445")), set(), 1.0),
    "MT.txt": (text(XSENS, stamps(7626, 1), stamps(0, 100), *FORCE.T, separator="\t", above="// made\n"), ACCEL, 0.01),
    "sensor.csv": (text(PX4, stamps(26_000_000, 4000), *RATE.T, T_s * 0, T_s * 0, *FORCE.T), GYRO | ACCEL, 0.004),
    "phyphox.csv": (text('"Time (s)","Gyroscope x (rad/s)","Absolute (rad/s)"', T_s, *RATE.T[:2]), GYRO_X, 0.01),
    "Gyroscope.csv": (text("time,seconds_elapsed,z,y,x", NANOSECONDS, T_s, *RATE.T), GYRO, 0.01),
    "navego.mat": (mat(t=T_s, wb=RATE, fb=FORCE, **{f"v{k}": np.arange(3.0) for k in range(13)}), GYRO | ACCEL, 0.01),
    "data_imu_acc_z.txt": (text("", FORCE[:, 2]), {"accel_z_m_s2"}, 0.01),
    "trailing.csv": (PLAIN.replace(b",", b";").replace(b"\n", b";\n").replace(b"_z;", b"_z"), GYRO, 0.01),
    "us.csv": (text(f"date,{XYZ}", moments("%m/%d/%Y %I:%M:%S %p"), *RATE.T), GYRO, 1.0),
    "day first.csv": (text(f"date,{XYZ}", moments("%d/%m/%y %H:%M:%S"), *RATE.T), GYRO, 1.0),
    "sheet.csv": (text(f"time,{XYZ}", DAYS, *RATE.T), GYRO, 10.0),
    "lost.tsv": (text(f"time,{XYZ}", np.full(ROWS, "1.73E+12"), *RATE.T).replace(b",", b"\t"), GYRO, 0.01),
    "mac.csv": (PLAIN.replace(b"\n", b"\r"), GYRO, 0.01),
    "wide.csv": (PLAIN.decode().encode("utf-16-be"), GYRO, 0.01),
    "packed.csv": (gzip.compress(PLAIN.decode().encode("utf-16")), GYRO, 0.01),
    "ticks.txt": (text(XSENS[14:], FINE, *FORCE.T, separator="\t"), ACCEL, 0.02),
    "gauss.csv": (text("t,Mag X (G),Mag Y (G),Mag Z (G)", T_s, *RATE.T * 3), MAG, 0.01),
    "model.csv": (text("TOW,X Gyro [x8005],Y Gyro [x8005],Z Gyro [x8005]", T_s, *RATE.T), GYRO, 0.01),
    "OpenBCI.txt": (text(OPENBCI, T_s % 1 * 250, *FORCE.T, T_s + 1.7e9, above="%Sample Rate = 250 Hz\n"), ACCEL, 0.01),
    "pandas.csv": (text("sensor,left,left,left\naxis,gyr_x,gyr_y,gyr_z", T_s, *RATE.T), GYRO, 0.01),
    "meter.csv": (PLAIN.replace(b"\n0.01,", b"\n0.01,9.9E+37,OL,0\n0.01,"), GYRO, 0.01),
}  # fmt: skip
FILLED = {"model": "M", "serial": "S-1", "unit": "rad/s", "zone": "UTC", "rate": "100 Hz"}


@pytest.mark.parametrize("name", FORMS)
def test_what_it_prints_is_what_an_import_takes(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, quantities, step_s = FORMS[name]
    (tmp_path / name).write_bytes(content)
    mapping = proposed(tmp_path / name, capsys).replace("elapsed, unit: FILL_IN", "elapsed, unit: us")
    mapping = filled(mapping, **FILLED)
    (tmp_path / "m.yaml").write_text(mapping, encoding="utf-8")
    load_mapping(tmp_path / "m.yaml")
    (tmp_path / "m.yaml").write_text(re.sub("analysis: .*", "analysis: none", mapping), encoding="utf-8")
    import_log(tmp_path / "m.yaml", tmp_path / name, tmp_path / "out")
    columns = replay_series(next((tmp_path / "out").iterdir())).columns
    assert (set(columns) - {"t_s"}, columns["t_s"].size) == (quantities, ROWS + (name == "meter.csv"))
    assert columns["t_s"][1] == pytest.approx(step_s, rel=0.05)
    if quantities >= GYRO and name != "meter.csv":
        order = "zyx" if name == "Gyroscope.csv" else "xyz"
        turned = np.column_stack([columns[f"gyro_{axis}_deg_s"] for axis in order])
        np.testing.assert_allclose(turned, np.degrees(RATE), rtol=1e-8)


@pytest.mark.parametrize(("content", "code"), [(b"", "B-IMP-001"), (b"only one line\n", "B-IMP-004")])
def test_what_is_no_log(content: bytes, code: str, tmp_path: Path) -> None:
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(InputError, match=code):
        guess(tmp_path / "log")


def test_the_command_needs_a_log(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,v\n1,5\n2,4\n", encoding="utf-8")
    assert "columns:" in CliRunner().invoke(app, ["import", "--guess", str(tmp_path / "log.csv")]).stdout
    assert CliRunner().invoke(app, ["import", str(tmp_path / "log.csv")]).exit_code == 2
