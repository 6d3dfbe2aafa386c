"""Files of tables, written block by block: CSV, Parquet, HDF5; MATLAB's, which is written at its end."""

from __future__ import annotations

import json
from contextlib import ExitStack
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from bench.model.errors import InputError
from bench.tables.columns import UNITS
from bench.tables.library import library, pandas
from bench.tables.plain import arrays_of, flat, units_of

if TYPE_CHECKING:
    from pandas import DataFrame


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
