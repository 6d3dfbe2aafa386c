"""Exports read back by the libraries of others: every table, every number, units, absent values."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from record_sample import write_resumed
from rehearsal import Inside
from scipy import io

from bench.model.errors import InputError
from bench.tables import FORMATS, Session, export_session, mcap_file
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


# --- csv, parquet ------------------------------------------------------------------------------------------------


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


# --- hdf5, mat ---------------------------------------------------------------------------------------------------


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
    with pytest.raises(InputError, match="hdf5") as caught:
        export_session(sessions[1], "mat", tmp_path / "out")
    assert caught.value.code == "B-TAB-008"
    assert list(tmp_path.iterdir()) == []


# --- mcap --------------------------------------------------------------------------------------------------------


def test_mcap_reads_back_and_holds_its_schemas(exported: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_file, "CHUNK_BYTES", 50_000)
    for folder, tables in exported("mcap"):
        (path,) = folder.iterdir()
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            rows: dict[str, list[Any]] = {name: [] for name in tables}
            times: dict[str, list[int]] = {name: [] for name in tables}
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                assert schema is not None
                assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
                name = channel.topic.strip("/").replace("/", ".")
                rows[name].append(json.loads(message.data))
                times[name].append(message.log_time)
        assert summary is not None
        assert summary.statistics is not None
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


# --- the command -------------------------------------------------------------------------------------------------


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
