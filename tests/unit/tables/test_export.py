"""Exports read back by the libraries of others, and logs in binary form that come back to the last digit."""

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from mcap.writer import Writer
from record_sample import write_resumed
from rehearsal import Inside
from scipy import io
from scipy.io import savemat

from bench.commands.guess import guess
from bench.commands.import_log import import_log
from bench.model.errors import InputError
from bench.record import SessionReader
from bench.replay import replay_series
from bench.replay.series import ImportedSeries
from bench.tables import FORMATS, Session, export, export_session, kind_of
from bench.tables.plain import arrays_of, flat, words_of

Tables = dict[str, pd.DataFrame]


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory, golden: Path) -> list[Session]:
    """A rehearsed session with results, and one of two parts with groups that are not full."""
    folder = tmp_path_factory.mktemp("export") / "resumed"
    write_resumed(folder)
    return [Session(golden), Session(folder)]


@pytest.fixture(scope="module")
def exported(sessions: list[Session], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Iterator[Any]]:
    """Export by format: yields folder and tables of each session."""
    out = tmp_path_factory.mktemp("exports")

    def each(form: str) -> Iterator[tuple[Path, Tables]]:
        for session in sessions:
            folder = out / f"{session.folder.name}-{form}"
            tables = tables_of(session)
            assert export_session(session, form, folder) == {name: len(table) for name, table in tables.items()}
            yield folder, tables

    return each


def tables_of(session: Session) -> Tables:
    tables = {"events": session.events, "readings": session.readings, "records": session.records}
    if (session.folder / "results.json").exists():
        tables["estimates"] = session.estimates
    for link in session.links:
        tables |= {f"frames.{link}.{name}": session.frames(link, name) for name in session.messages(link)}
    return tables


def same(read: pd.DataFrame, table: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(
        read, flat(table), check_dtype=False, check_index_type=False, check_freq=False, check_exact=True
    )


def test_csv_reads_back(exported: Callable[[str], Any]) -> None:
    for folder, tables in exported("csv"):
        assert {path.name for path in folder.iterdir()} == {f"{name}.csv" for name in tables}
        for name, table in tables.items():
            expected, units = flat(table), table.attrs["units"]
            titles = {f"{column} [{units[column]}]" if column in units else column: column for column in expected}
            kinds = {title: expected[column].dtype for title, column in titles.items() if column != "stop"}
            read = pd.read_csv(
                folder / f"{name}.csv", dtype=kinds, keep_default_na=False,
                na_values={title: [""] for title in titles},
            )  # fmt: skip
            if table.index.name:
                read = read.set_index("time")
                read.index = pd.to_datetime(read.index, utc=True, format="ISO8601").as_unit("ns")
            for column in ("stop",) if "stop" in read else ():
                read[column] = pd.to_datetime(read[column], utc=True, format="ISO8601").dt.as_unit("ns")
            read.columns = expected.columns
            same(read, expected.replace({"": pd.NA}))  # an empty text and an absent one are the same there


def test_parquet_reads_back_with_units_and_types(exported: Callable[[str], Any]) -> None:
    for folder, tables in exported("parquet"):
        for name, table in tables.items():
            read = pd.read_parquet(folder / f"{name}.parquet")
            same(read, table)
            assert read.attrs == table.attrs
            assert {k: str(v) for k, v in read.dtypes.items() if v.kind in "iu"} == {
                k: str(v) for k, v in table.dtypes.items() if v.kind in "iu"
            }


def test_hdf5_reads_back(exported: Callable[[str], Any]) -> None:
    for folder, tables in exported("hdf5"):
        for name, table in tables.items():
            with h5py.File(folder / f"{name}.h5") as file:
                assert file.attrs["session"] == table.attrs["session"]
                expected = arrays_of(flat(table))
                assert set(file) == set(expected)
                for column, values in expected.items():
                    read = file[column].asstr()[:] if values.dtype == object else file[column][:]
                    np.testing.assert_array_equal(read, values)
                for column, unit in table.attrs["units"].items():
                    assert file[column.replace(".", "_")].attrs["unit"] == unit
            if table.index.name and len(table):
                assert expected["time"][0] == table.index[0].value


def test_mat_reads_back(exported: Callable[[str], Any]) -> None:
    for folder, tables in exported("mat"):
        for name, table in tables.items():
            read = io.loadmat(folder / f"{name}.mat")
            columns = read["table"][0, 0]
            assert read["session"][0] == table.attrs["session"]
            for column, values in arrays_of(flat(table)).items():
                found = columns[column]
                if values.dtype == object:
                    assert [str(cell[0]) if len(cell) else "" for cell in found[:, 0]] == values.tolist()
                else:
                    np.testing.assert_array_equal(found.ravel(), values)
            for column, unit in table.attrs["units"].items():
                assert read["units"][0, 0][column.replace(".", "_")][0] == unit


def test_what_matlab_cannot_hold(sessions: list[Session], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def too_large(*_: Any, **__: Any) -> None:
        raise io.matlab.MatWriteError("Matrix too large to save with Matlab 5 format")

    monkeypatch.setattr(io, "savemat", too_large)
    with pytest.raises(InputError, match=r"B-TAB-008: .*hdf5"):
        export_session(sessions[1], "mat", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_mcap_reads_back_and_holds_its_schemas(exported: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "CHUNK_BYTES", 50_000)
    for folder, tables in exported("mcap"):
        (path,) = folder.iterdir()
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            rows: dict[str, list[Any]] = {name: [] for name in tables}
            times: dict[str, list[int]] = {name: [] for name in tables}
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
                name = channel.topic.strip("/").replace("/", ".")
                rows[name].append(json.loads(message.data))
                times[name].append(message.log_time)
        assert summary.statistics.message_count == sum(map(len, tables.values()))
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 1
        schemas = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
        for name, table in tables.items():
            topic = "/" + (name.replace(".", "/") if name.startswith("frames.") else name)
            _same_rows(rows[name], table, json.loads(schemas[topic].data))
            if table.index.name:
                assert times[name] == [stamp.value for stamp in table.index]


def _same_rows(rows: list[Any], table: pd.DataFrame, schema: Any) -> None:
    Draft202012Validator.check_schema(schema)
    for row in rows[:20]:
        Draft202012Validator(schema).validate(row)
    properties = schema["properties"]
    for column in properties.values():  # what Foxglove understands: one plain type each, objects with properties
        assert column["type"] in {"boolean", "number", "string"} or column["properties"] == {}
    names = words_of(table)
    assert list(properties) == list(names.values())
    units = {name: column["description"] for name, column in properties.items() if "description" in column}
    assert units == {names[column]: unit for column, unit in table.attrs["units"].items()}
    for name in table.columns:
        column, read = table[name], [row.get(names[name]) for row in rows]
        if isinstance(column.dtype, pd.DatetimeTZDtype):
            assert [pd.Timestamp(text) for text in read] == column.tolist()
        else:
            plain = column if properties[names[name]]["type"] == "object" else flat(column.to_frame())[name]
            assert read == plain.astype(object).where(plain.notna(), None).tolist()


@pytest.mark.parametrize("form", FORMATS)
def test_the_command_writes_a_new_folder(inside: Inside, golden: Path, tmp_path: Path, form: str) -> None:
    done = inside("export", str(golden), "--to", form, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (folder,) = tmp_path.iterdir()
    assert folder.name == f"{golden.name}-{form}"
    assert f"wrote    {folder.name}" in done.stdout
    assert "frames.port_b.housekeeping" in done.stdout
    again = inside("export", str(golden), "--to", form, cwd=tmp_path)
    assert again.returncode == 2
    assert "B-TAB-007" in again.stderr
    assert list(tmp_path.iterdir()) == [folder]


def test_the_command_refuses_what_it_cannot_do(
    inside: Inside, golden: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("x")
    for words, code in (
        ((str(tmp_path / "nothing"), "--to", "csv"), "B-REC-010"),
        ((str(golden), "--to", "xlsx"), "B-TAB-009"),
        ((str(golden), "--to", "csv", "--out", str(tmp_path / "file" / "out")), "B-CLI-007"),
    ):
        done = inside("export", *words)
        assert (done.returncode, done.stdout) == (2, "")
        assert f"error {code}: " in done.stderr
        assert "Next: " in done.stderr
    for library, form in (("pyarrow", "parquet"), ("h5py", "hdf5"), ("pandas", "mcap")):
        with monkeypatch.context() as without:
            without.setitem(__import__("sys").modules, library, None)
            done = inside("export", str(golden), "--to", form, "--out", str(tmp_path / "out"))
        assert done.returncode == 2
        assert "B-TAB-001" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


BLOCK_ROWS, ROWS = 1000, 2500  # more than two blocks
T_s = np.arange(ROWS) / 100.0
RATE = np.random.default_rng(21).normal(0.0, 1.0, (ROWS, 3))
MAPPING = """\
mapping: binary
uut: {{model: M, serial: S-1}}
columns:
  {time}: {{role: time, format: elapsed, unit: s, start: 2024-01-01T00:00:00Z}}
  {x}: {{role: gyro, axis: x, unit: deg/s}}
  {z}: {{role: gyro, axis: z, unit: deg/s}}
"""
STAMPED = MAPPING.replace("format: elapsed, unit: s, start: 2024-01-01T00:00:00Z", "format: unix, unit: ns")
START_ns = 1_704_067_200_000_000_000


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.tables.foreign.opening.BLOCK_ROWS", BLOCK_ROWS)


def npy(path: Path) -> None:
    with path.open("wb") as stream:
        np.save(stream, np.column_stack((T_s, RATE)))


def npz(path: Path) -> None:
    with path.open("wb") as stream:
        np.savez(stream, t=T_s, gyro=RATE, rate=np.array(100.0), image=np.zeros((2, 2, 2)))


def mat(path: Path) -> None:
    with path.open("wb") as stream:
        savemat(stream, {"imu": {"t": T_s, "wb": RATE, "name": "x"}})


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["imu/t"], file["imu/gyro"] = T_s, RATE
        file["imu/short"] = T_s[:9]


def matlab_hdf5(path: Path) -> None:
    """As MATLAB 7.3 writes: a block of 512 bytes before HDF5, matrices turned over, the class as an attribute."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in (("t", T_s[None, :]), ("gyro", RATE.T)):
            file[name] = array
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(512))


def records(path: Path) -> None:
    table = np.empty(ROWS, [("t", "f8"), ("x", "f8"), ("z", "f8")])
    table["t"], table["x"], table["z"] = T_s, RATE[:, 0], RATE[:, 2]
    with path.open("wb") as stream:
        np.save(stream, table)


def mcap(path: Path) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=4000)
        writer.start()
        schema = writer.register_schema("imu", "jsonschema", b"{}")
        for topic in ("/imu", "/other"):
            channel = writer.register_channel(topic, "json", schema)
            for k in range(300):
                body = {"w": {"x": RATE[k, 0], "z": RATE[k, 2]}, "stamp": {"sec": 1704067200 + k, "nanosec": 5}}
                writer.add_message(channel, START_ns + k * 10**9, json.dumps(body).encode(), START_ns)
        writer.finish()


def imported(folder: Path, mapping: str, write: Callable[[Path], None], status: int = 0) -> ImportedSeries:
    (folder / "m.yaml").write_text(mapping, encoding="utf-8")
    write(folder / "log.bin")  # no form is told by the name
    assert import_log(folder / "m.yaml", folder / "log.bin", folder / "out") == status
    return replay_series(next((folder / "out").iterdir()))


@pytest.mark.parametrize(
    ("write", "kind", "names"),
    [
        (npy, "npy", ("0", "1", "3")),
        (records, "npy", ("t", "x", "z")),
        (npz, "npz", ("t", "gyro[0]", "gyro[2]")),
        (mat, "mat", ("imu.t", "imu.wb[0]", "imu.wb[2]")),
        (hdf5, "hdf5", ("imu/t", "imu/gyro[0]", "imu/gyro[2]")),
        (matlab_hdf5, "hdf5", ("t", "gyro[0]", "gyro[2]")),
    ],
)
def test_arrays_come_back_to_the_last_digit(
    write: Callable[[Path], None],
    kind: str,
    names: tuple[str, str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    time, x, z = names
    series = imported(tmp_path, MAPPING.format(time=time, x=x, z=z), write)
    np.testing.assert_array_equal(series.columns["gyro_x_deg_s"], RATE[:, 0])
    np.testing.assert_array_equal(series.columns["gyro_z_deg_s"], RATE[:, 2])
    np.testing.assert_allclose(series.columns["t_s"], T_s, atol=1.1e-9)
    assert kind_of(tmp_path / "log.bin") == kind
    (session,) = (tmp_path / "out").iterdir()
    assert SessionReader(session).manifest["log"]["origin"]["kind"] == kind
    (tmp_path / "log.bin").unlink()
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert replay_series(session).sha256 == series.sha256


def test_messages_of_a_topic_of_an_mcap_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = STAMPED.format(time="log_time", x="w.x", z="w.z").replace("columns:", "file: {topic: /imu}\ncolumns:")
    series = imported(tmp_path, text, mcap)
    np.testing.assert_array_equal(series.columns["gyro_x_deg_s"], RATE[:300, 0])
    np.testing.assert_array_equal(series.columns["t_s"], np.arange(300.0))
    capsys.readouterr()
    guess(tmp_path / "log.bin")
    said = capsys.readouterr().out
    assert "file: {topic: '/imu'}  # or: '/other'\n" in said
    assert "  stamp: {role: time, format: unix, unit: ns}" in said
    (tmp_path / "two").mkdir()
    assert imported(tmp_path / "two", said.replace("FILL_IN", "S"), mcap).counts.rows == 300
    again = imported(tmp_path, text.replace("log_time", "stamp"), mcap)
    np.testing.assert_array_equal(again.columns["t_s"], np.arange(300.0))


def spoiled(change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        mcap(path)
        path.write_bytes(change(path.read_bytes()))

    return write


@pytest.mark.parametrize(
    ("change", "broken"),
    [
        (lambda raw: raw[: len(raw) * 4 // 10], 1),
        (lambda raw: raw[:2000] + bytes(40) + raw[2040:], 1),
        (lambda raw: raw[:2000] + bytes(40) + raw[2040 : len(raw) * 4 // 10], 2),
    ],
)
def test_of_a_spoiled_mcap_file_what_is_whole_is_taken(
    change: Callable[[bytes], bytes], broken: int, tmp_path: Path
) -> None:
    text = STAMPED.format(time="log_time", x="w.x", z="w.z").replace("columns:", "file: {topic: /imu}\ncolumns:")
    series = imported(tmp_path, text, spoiled(change))
    rows = series.columns["t_s"].astype(int)
    assert 150 < len(rows) < 300
    np.testing.assert_array_equal(series.columns["gyro_x_deg_s"], RATE[rows, 0])
    assert series.notes == (f"{broken} parts of the file are broken or cut off: what they held is not in the log.",)


def test_a_missing_number_is_named_in_the_mapping(tmp_path: Path) -> None:
    def holes(path: Path) -> None:
        with path.open("wb") as stream:
            np.save(stream, np.array([[0.0, 1.0, np.nan], [1.0, 2.0, 3.0]]))

    text = MAPPING.format(time="0", x="1", z="2")
    with pytest.raises(InputError, match=r"B-IMP-005: .*'nan' is not finite"):
        imported(tmp_path, text, holes)
    series = imported(tmp_path, text.replace("columns:", "overload: {values: [nan]}\ncolumns:"), holes)
    np.testing.assert_array_equal(series.columns["gyro_z_deg_s"], [np.nan, 3.0])


def test_rows_need_no_column_of_time(tmp_path: Path) -> None:
    rows = "format: rows, rate: 50 Hz, start: 2024-01-01T00:00:00Z"
    text = MAPPING.format(time="row", x="1", z="3").replace(
        "format: elapsed, unit: s, start: 2024-01-01T00:00:00Z", rows
    )
    assert imported(tmp_path, text, npy).columns["t_s"][-1] == pytest.approx((ROWS - 1) / 50.0)
    (tmp_path / "log.csv").write_text("1,3\n0.5,0.25\n0.5,0.75\n")
    assert import_log(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "text") == 0


@pytest.mark.parametrize(
    ("write", "change", "said"),
    [
        (hdf5, ("imu/t", "imu/short"), "B-IMP-010: .*differ in length: imu/short 9, imu/gyro.0. 2500"),
        (hdf5, ("imu/t", "imu/time"), "B-IMP-003: .*no column 'imu/time'.*--guess"),
        (hdf5, ("columns:", "file: {delimiter: ';'}\ncolumns:"), "B-IMP-009: .*'delimiter' under 'file'"),
        (mcap, ("imu/t", "log_time"), "B-IMP-011: .*holds 2 topics: /imu, /other.*topic"),
        (mcap, ("columns:", "file: {topic: /imi}\ncolumns:"), "B-IMP-011: .*did you mean '/imu'"),
        (lambda path: path.write_bytes(b"\x93NUMPY\x01\x00"), ("x", "x"), "B-IMP-009: .*cannot be read as npy"),
        (lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n"), ("x", "x"), "B-IMP-009: .*cannot be read as hdf5"),
        (lambda path: path.write_bytes(b"PK\x03\x04"), ("x", "x"), "B-IMP-009: .*a workbook.*save the sheet as CSV"),
        (lambda path: path.write_bytes(b"ULog\x01\x12\x35\x01"), ("x", "x"), "B-IMP-009: .*a log of PX4.*ulog2csv"),
        (lambda path: path.write_bytes(b"\x89MCAP0\r\n"), ("x", "x"), "B-IMP-009: .*cannot be read as mcap"),
    ],
)
def test_what_cannot_be_read_is_one_error(
    write: Callable[[Path], None], change: tuple[str, str], said: str, tmp_path: Path
) -> None:
    text = MAPPING.format(time="imu/t", x="imu/gyro[0]", z="imu/gyro[2]").replace(*change)
    with pytest.raises(InputError, match=said):
        imported(tmp_path, text, write)
    assert not (tmp_path / "out").exists()


def bag(path: Path) -> None:
    path.write_bytes(b"#ROSBAG V2.0\n")


@pytest.mark.parametrize(("write", "extra"), [(hdf5, "hdf5"), (mcap, "mcap"), (bag, "ros")])
def test_a_missing_library_is_one_line(
    write: Callable[[Path], None], extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"no {name}", name=name.partition(".")[0])

    write(tmp_path / "written")
    monkeypatch.setattr("bench.model.extras.import_module", missing)
    with pytest.raises(InputError, match=rf"B-TAB-001: .*pip install 'inertial-bench\[{extra}\]'"):
        imported(tmp_path, MAPPING.format(time="t", x="x", z="z"), (tmp_path / "written").rename)


@pytest.mark.parametrize("form", ["bag", "db3", "mcap"])
def test_messages_of_a_bag(form: str, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'inertial-bench[ros]'")
    bag = tmp_path / ("log.bag" if form == "bag" else "log")
    write_bag(bag, form)
    if form == "mcap":  # the file alone, without the folder of the bag
        (bag,) = bag.glob("*.mcap")
    text = STAMPED.format(time="header.stamp", x="angular_velocity.x", z="angular_velocity.z")
    (tmp_path / "m.yaml").write_text(text, encoding="utf-8")
    assert import_log(tmp_path / "m.yaml", bag, tmp_path / "out") == 0
    series = replay_series(next((tmp_path / "out").iterdir()))
    np.testing.assert_array_equal(series.columns["gyro_z_deg_s"], RATE[:50, 2])
    np.testing.assert_allclose(series.columns["t_s"], np.arange(50) / 100.0, atol=1e-9)


def write_bag(path: Path, form: str) -> None:
    """Write fifty messages sensor_msgs/Imu, stamped each 10 ms, with the library rosbags."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    first = form == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    storage = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    types = store.types
    vector, header = types["geometry_msgs/msg/Vector3"], types["std_msgs/msg/Header"]
    order = {"seq": 0} if first else {}
    none = np.zeros(9)
    with Writer1(path) if first else Writer2(path, version=9, storage_plugin=storage) as writer:
        topic = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for k in range(50):
            stamp = types["builtin_interfaces/msg/Time"](sec=1_704_067_200, nanosec=k * 10_000_000)
            message = types["sensor_msgs/msg/Imu"](
                header=header(**order, stamp=stamp, frame_id="imu"),
                orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
                orientation_covariance=none,
                angular_velocity=vector(*RATE[k]),
                angular_velocity_covariance=none,
                linear_acceleration=vector(0.0, 0.0, 9.8),
                linear_acceleration_covariance=none,
            )
            raw = (store.serialize_ros1 if first else store.serialize_cdr)(message, message.__msgtype__)
            writer.write(topic, START_ns + k * 10_000_000, raw)
