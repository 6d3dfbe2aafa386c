"""Tells a binary log by its first bytes, never by its name, and opens it as a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from bench.model.errors import BenchError, InputError
from bench.tables.foreign import arrays, messages

NPY, NPZ, MAT, HDF5, MCAP, BAG = "npy", "npz", "mat", "hdf5", "mcap", "rosbag"
ZIP, XLS, ULG = "a workbook or another archive", "a workbook", "a log of PX4"
_BEGINNINGS = (
    (b"\x93NUMPY", NPY),
    (b"PK\x03\x04", ZIP),
    (b"\xd0\xcf\x11\xe0", XLS),
    (b"ULog\x01\x12\x35", ULG),
    (b"MATLAB 5.0 MAT-file", MAT),
    (b"MATLAB 7.3 MAT-file", HDF5),  # MATLAB's own form of HDF5
    (b"\x89HDF\r\n\x1a\n", HDF5),
    (b"\x89MCAP0\r\n", MCAP),
    (b"#ROSBAG V2.0", BAG),
    (b"SQLite format 3\x00", BAG),
)
_TABLES = {NPY: arrays.npy_table, NPZ: arrays.npz_table, MAT: arrays.mat_table, HDF5: arrays.hdf5_table}
_INSTEAD = {
    ZIP: "save the sheet as CSV, or unpack the archive, and import that",
    XLS: "save the sheet as CSV and import that",
    ULG: "write its topics as CSV with 'ulog2csv FILE' (pyulog) and import the one of the sensor",
}
_HEAD_BYTES = 256
_NAME_AT = 30  # of the first member of an archive


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
        return BAG if (path / "metadata.yaml").is_file() else None
    try:
        with path.open("rb") as stream:
            begin = stream.read(_HEAD_BYTES)
    except (OSError, ValueError):  # whoever reads the file as text says why it cannot be read
        return None
    kind = next((kind for known, kind in _BEGINNINGS if begin.startswith(known)), None)
    name = begin[_NAME_AT : _NAME_AT + int.from_bytes(begin[26:28], "little")]
    return NPZ if kind == ZIP and name.endswith(b".npy") else kind


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
        if kind in (MCAP, BAG):
            table = messages.bag_table(path, topic) if kind == BAG else messages.mcap_table(path, topic)
        else:
            table = _TABLES[kind](path)
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
