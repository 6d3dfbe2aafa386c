"""Tells a binary log by its first bytes, never by its name, and opens it as a table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from bench.model.errors import BenchError, InputError
from bench.tables.foreign import arrays, messages

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
_ARRAYS = {"npy": arrays.npy_table, _NPZ: arrays.npz_table, "mat": arrays.mat_table, "hdf5": arrays.hdf5_table}
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
