"""Datasets of an HDF5 file, or of a MATLAB file of version 7.3, as columns of a table; they stay in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.tables.foreign.arrays import ArrayColumn, ArrayTable, columns_of
from bench.tables.library import library


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
