"""Tells a binary log by its first bytes, never by its name, and opens it as a table.

Of NumPy, MATLAB and HDF5 files a matrix ``a`` of k columns gives ``a[0]`` to ``a[k-1]``, a record array ``a.field``,
the only matrix of an .npy file ``0`` to ``k-1``. Complex numbers give ``a.real`` and ``a.imag``; of a complex matrix,
whose rows may lie either way, ``a.T[0].real`` is the first row too. What is no column of numbers or texts is left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bench.model.errors import BenchError, InputError
from bench.tables.foreign import messages
from bench.tables.library import library

BLOCK_ROWS = 10_000
_LISTED = 6
_PLAIN = "biufSU"  # truth values, whole numbers, numbers, texts
_COMPLEX = ("real", "imag")  # parts by their names in NumPy, and as MATLAB writes them to HDF5


@dataclass(frozen=True)
class ArrayColumn:
    """One column of an array in a file, read block by block.

    ``array``: sliced only.   ``at``: its column in a matrix, None if the array is the column.   ``field``: of a record
    array, or a part of complex numbers.   ``across``: the rows of the table are the columns of the matrix, as MATLAB
    writes HDF5.
    """

    array: Any
    at: int | None = None
    field: str | None = None
    across: bool = False

    def __len__(self) -> int:
        return int(self.array.shape[-1 if self.across else 0])

    def block(self, first: int, last: int) -> list[Any]:
        """Return values first to last - 1 as plain numbers or texts."""
        rows = slice(first, last)
        if self.at is None:
            part = self.array[0, rows] if self.across and self.array.ndim > 1 else self.array[rows]
        else:
            part = self.array[self.at, rows] if self.across else self.array[rows, self.at]
        part = np.asarray(part)
        if self.field is not None:
            part = getattr(part, self.field) if part.dtype.kind == "c" else part[self.field]
        values: list[Any] = part.ravel().tolist()
        return [value.decode("utf-8", "replace") if isinstance(value, bytes) else value for value in values]


@dataclass(frozen=True)
class ArrayTable:
    """Columns by name, not all of one length: those that are asked for together must be."""

    columns: Mapping[str, ArrayColumn]

    @property
    def names(self) -> Sequence[str]:
        """Columns that it has."""
        return tuple(self.columns)

    def rows(self, names: Sequence[str]) -> Iterator[Sequence[object]]:
        """Yield values of some columns, row by row. Raises: InputError B-IMP-010 if they differ in length."""
        chosen = [self.columns[name] for name in names]
        lengths = {name: len(column) for name, column in zip(names, chosen, strict=True)}
        if len(set(lengths.values())) > 1:
            said = ", ".join(f"{name} {length}" for name, length in list(lengths.items())[:_LISTED])
            raise InputError(
                "B-IMP-010",
                f"the columns of the mapping differ in length: {said}",
                next_step="map columns of one table; import each table with a mapping of its own",
            )
        for first in range(0, next(iter(lengths.values()), 0), BLOCK_ROWS):
            yield from zip(*(column.block(first, first + BLOCK_ROWS) for column in chosen), strict=True)


def columns_of(name: str, array: Any, across: bool = False) -> dict[str, ArrayColumn]:
    """Return the columns of one array by name; none for a scalar, an array of three axes, or other kinds of values."""
    fields = array.dtype.names
    if array.dtype.kind == "c" or fields == _COMPLEX:
        return _of_complex(name, array, across)
    if array.ndim == 1 and fields:
        plain = [field for field in fields if array.dtype[field].kind in _PLAIN and not array.dtype[field].shape]
        return {f"{name}.{field}": ArrayColumn(array, field=field) for field in plain}
    if array.dtype.kind not in _PLAIN or array.ndim not in (1, 2) or not array.size:
        return {}
    if array.ndim == 1:
        return {name: ArrayColumn(array)}
    width = array.shape[0 if across else 1]
    if width == 1:
        return {name: ArrayColumn(array, at=0, across=across)}
    return {f"{name}[{place}]": ArrayColumn(array, at=place, across=across) for place in range(width)}


def _of_complex(name: str, array: Any, across: bool) -> dict[str, ArrayColumn]:
    if array.ndim == 1:
        return {f"{name}.{part}": ArrayColumn(array, field=part) for part in _COMPLEX}
    if array.ndim != 2 or not array.size:
        return {}
    return {
        f"{turned}[{place}].{part}": ArrayColumn(array, place, part, rows_across)
        for turned, rows_across in ((name, across), (f"{name}.T", not across))
        for place in range(array.shape[0 if rows_across else 1])
        for part in _COMPLEX
    }


def npy_table(path: Path) -> ArrayTable:
    """Return the columns of an .npy file, which stays in the file."""
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if array.ndim == 2:
        return ArrayTable({str(place): ArrayColumn(array, at=place) for place in range(array.shape[1])})
    return ArrayTable({name.removeprefix("0."): column for name, column in columns_of("0", array).items()})


def npz_table(path: Path) -> ArrayTable:
    """Return the columns of all arrays of an .npz file, which are held in memory."""
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return ArrayTable(_of_variables(file))


def mat_table(path: Path) -> ArrayTable:
    """Return the columns of all variables of a MATLAB file up to version 7, fields of structures by ``a.b``.

    They are held in memory.
    """
    from scipy.io import loadmat

    return ArrayTable(_of_variables(loadmat(path, squeeze_me=True, struct_as_record=False)))


def _of_variables(values: Mapping[str, Any]) -> dict[str, ArrayColumn]:
    columns: dict[str, ArrayColumn] = {}
    for name, value in values.items():
        fields = getattr(value, "_fieldnames", ())
        is_array = isinstance(value, np.ndarray)
        inside = {f"{name}.{field}": getattr(value, field) for field in fields}
        columns |= columns_of(name, value) if is_array else _of_variables(inside)
    return columns


def hdf5_table(path: Path) -> ArrayTable:
    """Return the columns of all datasets by their path, such as ``group/array[0]``.

    Raises: InputError B-TAB-001 if h5py is not installed; OSError for a damaged file.
    """
    h5py = library("h5py")
    file = h5py.File(path, "r")
    columns: dict[str, ArrayColumn] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            columns.update(columns_of(name, item, across="MATLAB_class" in item.attrs))

    file.visititems(visit)
    return ArrayTable(columns)


_NPZ, _MCAP, _BAG = "npz", "mcap", "rosbag"
_KINDS = (  # first bytes as a pattern; the first that fits counts
    (rb"\x93NUMPY", "npy"),
    (rb"PK\x03\x04(?s:.{26}).{1,200}?\.npy", _NPZ),
    (rb"PK\x03\x04|\xd0\xcf\x11\xe0", "a workbook, or an archive"),
    (rb"ULog\x01\x12\x35", "a log of PX4"),
    (rb"MATLAB 5\.0 MAT-file", "mat"),
    (rb"MATLAB 7\.3 MAT-file|\x89HDF\r\n\x1a\n", "hdf5"),  # the former is MATLAB's own form of it
    (rb"\x89MCAP0\r\n", _MCAP),
    (rb"#ROSBAG V2\.0|SQLite format 3\x00", _BAG),
)
_ARRAYS = {"npy": npy_table, _NPZ: npz_table, "mat": mat_table, "hdf5": hdf5_table}
_INSTEAD = {
    "a workbook, or an archive": "save the sheet as CSV, or unpack the archive, and import that",
    "a log of PX4": "write its topics as CSV with 'ulog2csv FILE' (pyulog) and import the one of the sensor",
}
_HEAD_BYTES = 256


class ForeignTable(Protocol):
    """Rows of numbers or texts with names of their columns."""

    @property
    def names(self) -> Sequence[str]:
        """Columns that it has."""

    def rows(self, names: Sequence[str]) -> Iterator[Sequence[object]]:
        """Yield values of some columns, row by row. Raises: InputError B-IMP-010 if they differ in length."""


def kind_of(path: Path) -> str | None:
    """Return which binary form a file has, None for text; a folder with a ``metadata.yaml`` is a bag of ROS 2."""
    if path.is_dir():
        return _BAG if (path / "metadata.yaml").is_file() else None
    try:
        with path.open("rb") as stream:
            begin = stream.read(_HEAD_BYTES)
    except (OSError, ValueError):  # whoever reads the file as text says why it cannot be read
        return None
    return next((kind for known, kind in _KINDS if re.match(known, begin)), None)


def topics_of(path: Path, kind: str) -> list[str]:
    """Return the topics of an MCAP file or a bag. Raises: InputError B-TAB-001 without the library for it."""
    known = {_BAG: messages.bag_topics, _MCAP: messages.mcap_topics}
    return sorted(known[kind](path)) if kind in known else []


def open_table(path: Path, kind: str, topic: str | None) -> ForeignTable:
    """Return the table of a binary log.

    Args:    kind: as ``kind_of`` says.   topic: of an MCAP file or a bag; None for the only one.
    Raises:  InputError B-IMP-009 if the file cannot be read or holds no column, B-IMP-011 for a topic that is not
             there or not one, B-TAB-001 if the library for it is not installed.
    """
    if kind in _INSTEAD:
        raise InputError("B-IMP-009", f"is {kind}, which is not read", where=str(path), next_step=_INSTEAD[kind])
    try:
        table: ForeignTable
        if kind in _ARRAYS:
            table = _ARRAYS[kind](path)
        else:
            table = messages.bag_table(path, topic) if kind == _BAG else messages.mcap_table(path, topic)
    except BenchError:
        raise
    except Exception as error:  # the libraries raise what they like for a damaged file
        raise _unreadable(path, kind, f"{type(error).__name__}: {error}") from error
    if not table.names:
        raise _unreadable(path, kind, "it holds no column of numbers or texts")
    return table


def _unreadable(path: Path, kind: str, why: str) -> InputError:
    return InputError(
        "B-IMP-009",
        f"cannot be read as {kind}: {' '.join(why.split())[:200]}",
        where=str(path),
        next_step="open the file with the program that wrote it, and save it again or export it as text",
    )
