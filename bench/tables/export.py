"""A session written for other tools: one file per table in a new folder, or one MCAP file with a channel per table."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from bench import __version__
from bench.model.errors import InputError
from bench.session.output import writing
from bench.tables.columns import T_MONO, UNITS
from bench.tables.library import library, pandas
from bench.tables.plain import arrays_of, flat, units_of, words_of
from bench.tables.session import RESULTS, Session

if TYPE_CHECKING:
    from pandas import DataFrame, Series

ROWS_OF_A_GROUP = 250_000  # of Parquet: small groups are slow to read


class TableFile(Protocol):
    """A table that is being written; its blocks have the same columns, and the first one may be empty."""

    def write(self, block: DataFrame) -> None:
        """Append rows."""

    def close(self) -> None:
        """Finish the file."""


class CsvFile:
    """Comma-separated text in UTF-8, units in the header as ``name [unit]``; an absent value is nothing."""

    SUFFIX = ".csv"

    def __init__(self, path: Path) -> None:
        self._stream = path.open("w", encoding="utf-8", newline="")
        self._begun = False

    def write(self, block: DataFrame) -> None:
        """Append rows, the header in front of the first ones."""
        units = block.attrs[UNITS]
        titles = [f"{name} [{units[name]}]" if units.get(name) else name for name in block.columns]
        flat(block).to_csv(self._stream, header=False if self._begun else titles, index=block.index.name is not None)
        self._begun = True

    def close(self) -> None:
        """Finish the file."""
        self._stream.close()


class ParquetFile:
    """Apache Parquet; pandas and pyarrow give back index, types and ``attrs``."""

    SUFFIX = ".parquet"

    def __init__(self, path: Path) -> None:
        self._arrow, self._parquet = library("pyarrow"), library("pyarrow.parquet")
        self._path = path
        self._open = ExitStack()
        self._writer: Any = None
        self._pending: list[Any] = []

    def write(self, block: DataFrame) -> None:
        """Append rows; those of some blocks make a group."""
        schema = None if self._writer is None else self._writer.schema
        table = self._arrow.Table.from_pandas(flat(block), schema=schema)
        if self._writer is None:
            attributes = {b"PANDAS_ATTRS": json.dumps(block.attrs).encode()}
            table = table.replace_schema_metadata({**(table.schema.metadata or {}), **attributes})
            self._writer = self._open.enter_context(self._parquet.ParquetWriter(self._path, table.schema))
        self._pending.append(table.cast(self._writer.schema))
        if sum(map(len, self._pending)) >= ROWS_OF_A_GROUP:
            self._flush()

    def _flush(self) -> None:
        self._writer.write_table(self._arrow.concat_tables(self._pending))
        self._pending.clear()

    def close(self) -> None:
        """Finish the file."""
        if self._pending:
            self._flush()
        self._open.close()


class Hdf5File:
    """HDF5: a dataset for each column with its ``unit``, attributes of the session at the root."""

    SUFFIX = ".h5"

    def __init__(self, path: Path) -> None:
        self._h5py = library("h5py")
        self._file = self._h5py.File(path, "w")

    def write(self, block: DataFrame) -> None:
        """Append rows to every dataset."""
        plain, units = flat(block), units_of(block)
        for name, values in arrays_of(plain).items():
            if name not in self._file:
                kind = self._h5py.string_dtype() if values.dtype == object else values.dtype
                made = self._file.create_dataset(name, (0,), kind, maxshape=(None,), chunks=(16_384,), compression=4)
                made.attrs["unit"] = units.get(name, "")
            column = self._file[name]
            before = len(column)
            column.resize((before + len(values),))
            column[before:] = values
        self._file.attrs.update({name: value for name, value in block.attrs.items() if name != UNITS})

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class MatFile:
    """MATLAB 5: a struct ``table`` with a column vector for each column, and a struct ``units``.

    The format knows no appending: all of a table is in memory until its end.
    """

    SUFFIX = ".mat"

    def __init__(self, path: Path) -> None:
        self._path = path
        self._blocks: list[DataFrame] = []

    def write(self, block: DataFrame) -> None:
        """Keep rows."""
        self._blocks.append(block)

    def close(self) -> None:
        """Write the file. Raises: InputError B-TAB-008 for a table that the format cannot hold."""
        if not self._blocks:
            return
        whole = self._blocks[0] if len(self._blocks) == 1 else pandas().concat(self._blocks)
        whole.attrs.update(self._blocks[0].attrs)
        columns = {name: values.reshape(-1, 1) for name, values in arrays_of(flat(whole)).items()}
        self._blocks.clear()
        document = {"table": columns, UNITS: units_of(whole), "session": str(whole.attrs["session"])}
        try:
            self._matlab.savemat(self._path, document, long_field_names=True, do_compression=True)
        except (self._matlab.matlab.MatWriteError, ValueError) as error:
            raise InputError(
                "B-TAB-008", f"{len(whole)} rows are more than a MATLAB file holds: {error}", where=self._path.name,
                next_step="export to hdf5, which MATLAB reads too",
            ) from error  # fmt: skip

    @cached_property
    def _matlab(self) -> Any:
        from scipy import io

        return io


MCAP = "mcap"
_FILES: dict[str, type[CsvFile] | type[ParquetFile] | type[Hdf5File] | type[MatFile]] = {
    "csv": CsvFile, "parquet": ParquetFile, "hdf5": Hdf5File, "mat": MatFile,
}  # fmt: skip
_NEEDS = {"parquet": "pyarrow", "hdf5": "h5py", MCAP: "mcap"}
FORMATS = (*_FILES, MCAP)
Open = Callable[[str, "DataFrame"], TableFile]


def export_session(session: Session, form: str, folder: Path) -> dict[str, int]:
    """Write events, readings, records, an imported log, estimates (where there are results) and all frames of links.

    The folder has its name when all of it is whole; frames pass block by block.

    Args:    form: one of ``FORMATS``.   folder: new; the one above it must be there or can be made.
    Returns: rows by table: ``events``, ..., ``frames.<link>.<message>``.
    Raises:  InputError B-TAB-001 (library missing), B-TAB-007 (folder exists), B-TAB-009 (no such format), B-TAB-008
             (too large for MATLAB), B-CLI-007 (cannot be written); those of ``Session``.
    """
    if form not in FORMATS:
        raise InputError("B-TAB-009", f"{form!r} is no format", where="--to", next_step=f"use {', '.join(FORMATS)}")
    for name in ("pandas", _NEEDS.get(form, "pandas")):
        library(name)
    if folder.exists():
        raise InputError("B-TAB-007", "is there already, and nothing is written over", where=str(folder),
                         next_step="name another folder by --out, or move this one away")  # fmt: skip
    with writing(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as room:
            place = Path(room) / "tables"
            place.mkdir()
            if form == MCAP:
                rows = _write_mcap(session, place)
            else:
                kind = _FILES[form]
                rows = _write(session, lambda name, _: kind(place / f"{name}{kind.SUFFIX}"))
            place.replace(folder)
    return rows


def _tables(session: Session) -> Iterator[tuple[str, DataFrame]]:
    """Yield the tables that are no frames, by name."""
    yield from (("events", session.events), ("readings", session.readings), ("records", session.records))
    if len(session.log):
        yield "log", session.log
    if (session.folder / RESULTS).exists():
        yield "estimates", session.estimates


def _write(session: Session, opened: Open) -> dict[str, int]:
    rows: dict[str, int] = {}
    for name, table in _tables(session):
        with closing(opened(name, table)) as file:
            file.write(table)
        rows[name] = len(table)
    for link in session.links:
        with ExitStack() as stack:
            files: dict[str, TableFile] = {}
            for message in session.messages(link):
                name, empty = f"frames.{link}.{message}", session.empty_frames(link, message)
                files[message] = file = stack.enter_context(closing(opened(name, empty)))
                file.write(empty)
                rows[name] = 0
            for message, block in session.frame_blocks(link):
                files[message].write(block)
                rows[f"frames.{link}.{message}"] += len(block)
    return rows


def _write_mcap(session: Session, place: Path) -> dict[str, int]:
    file = McapFile(place / f"{session.folder.name}.mcap", session.utc_offset_ns)
    try:
        rows = _write(session, lambda name, block: file.channel("/" + "/".join(name.split(".", 2)), block))
        file.close()
    finally:
        file.abandon()
    return rows


CHUNK_BYTES = 1_000_000


def json_schema(topic: str, block: DataFrame) -> dict[str, Any]:
    """Return the JSON Schema of a table's rows: type of each column, its unit as description.

    Foxglove takes one type for each property: what may be absent is left out of a message, not null.
    """
    names = words_of(block)
    columns = {name: _json_type(block[column]) for column, name in names.items()}
    for column, unit in block.attrs[UNITS].items():
        columns[names[column]]["description"] = unit
    return {"type": "object", "title": topic, "properties": columns}


def _json_type(column: Series) -> dict[str, Any]:
    kinds = pandas().api.types
    if kinds.is_bool_dtype(column.dtype):
        return {"type": "boolean"}
    if kinds.is_numeric_dtype(column.dtype):
        return {"type": "number"}  # an "integer" counts as 32 bits in Foxglove
    return {"type": "object", "properties": {}} if _holds_objects(column) else {"type": "string"}


def _holds_objects(column: Series) -> bool:
    return column.dtype == object and len(column) > 0 and all(isinstance(value, dict) for value in column)


class _Channel:
    """A table of the file."""

    def __init__(self, file: McapFile, number: int) -> None:
        self._file, self._number = file, number

    def write(self, block: DataFrame) -> None:
        """Append rows, each at its time."""
        self._file.write(self._number, block)

    def close(self) -> None:
        """Nothing: the file is finished as a whole."""


class McapFile:
    """Writes an MCAP file, lz4 chunks of about a megabyte. ``offset_ns``: UTC minus the monotonic time of rows."""

    def __init__(self, path: Path, offset_ns: int) -> None:
        self._stream = path.open("wb")
        self._offset_ns, self._last_ns = offset_ns, 0
        mcap = library("mcap.writer")
        self._writer = mcap.Writer(
            self._stream, chunk_size=CHUNK_BYTES, compression=mcap.CompressionType.LZ4, enable_data_crcs=True
        )
        self._writer.start(library=f"inertial-bench {__version__}")

    def channel(self, topic: str, block: DataFrame) -> _Channel:
        """Begin a table; ``block`` has its columns."""
        name, schema = topic.strip("/").replace("/", "."), json.dumps(json_schema(topic, block)).encode()
        number = self._writer.register_schema(name, "jsonschema", schema)
        return _Channel(self, self._writer.register_channel(topic, "json", number, {"session": block.attrs["session"]}))

    def write(self, number: int, block: DataFrame) -> None:
        """Append rows, each at its time; those that have none, such as estimates, at the last one before."""
        timed = block[T_MONO].tolist() if T_MONO in block else [self._last_ns - self._offset_ns] * len(block)
        t_utc_ns = [t_ns + self._offset_ns for t_ns in timed]
        self._last_ns = max([self._last_ns, *t_utc_ns])
        pairs = zip(*(_pairs(name, block[column]) for column, name in words_of(block).items()), strict=True)
        for t_ns, row in zip(t_utc_ns, pairs, strict=True):
            text = "{" + ",".join(filter(None, row)) + "}"
            self._writer.add_message(number, t_ns, text.encode(), t_ns)

    def close(self) -> None:
        """Write summary and footer."""
        self._writer.finish()
        self._stream.close()

    def abandon(self) -> None:
        """Let go of a file that will not be finished."""
        self._stream.close()


def _pairs(name: str, column: Series) -> list[str]:
    """Return the cells of a column as JSON behind its name, "" for what is absent or not finite."""
    key = f"{json.dumps(name)}:"
    if pandas().api.types.is_datetime64_any_dtype(column.dtype):
        return [f'{key}"{stamp.isoformat()}"' for stamp in column]
    if column.dtype == object and not _holds_objects(column):
        column = flat(column.to_frame()).iloc[:, 0]
    values = column.tolist()
    if isinstance(column.dtype, np.dtype) and column.dtype.kind in "iu":
        return [f"{key}{value}" for value in values]
    if isinstance(column.dtype, np.dtype) and column.dtype.kind == "f":
        return [f"{key}{value!r}" if math.isfinite(value) else "" for value in values]
    absent = column.isna().tolist()
    return ["" if gone else f"{key}{json.dumps(value)}" for value, gone in zip(values, absent, strict=True)]
