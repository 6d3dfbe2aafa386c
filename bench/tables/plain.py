"""Tables as the formats of other tools hold them: numbers and texts, names that are words, absent values marked."""

from __future__ import annotations

import json
import re
from itertools import chain, count
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.tables.columns import TIME, UNITS
from bench.tables.library import pandas

if TYPE_CHECKING:
    from pandas import DataFrame, Series

_NO_WORD = re.compile(r"\W")
LONGEST_NAME = 63  # of a field in MATLAB


def flat(block: DataFrame) -> DataFrame:
    """Return a table whose cells are numbers, truths and texts: dictionaries and lists as JSON, bytes as hex."""
    plain = block.copy(deep=False)
    for name in plain.columns:
        if plain[name].dtype == object:
            plain[name] = pandas().Series([_cell(value) for value in plain[name]], index=plain.index, dtype="string")
    return plain


def _cell(value: Any) -> str | None:
    if value is None or isinstance(value, str):
        return value
    return value.hex() if isinstance(value, bytes) else json.dumps(value, sort_keys=True, ensure_ascii=False)


def arrays_of(block: DataFrame) -> dict[str, np.ndarray[Any, Any]]:
    """Return columns of a flat table as arrays, (n,) each; the index, ns since 1970, first.

    A number or truth that may be absent is a float, NaN where it is; an absent text is "". Times are ns since 1970.
    """
    columns = {} if block.index.name is None else {TIME: _array(block.index.to_series())}
    return columns | {name: _array(block[column]) for column, name in words_of(block).items()}


def words_of(block: DataFrame) -> dict[str, str]:
    """Return names of letters, digits and underscores by column, as HDF5 paths and MATLAB want them, no two alike.

    Where two would be alike, or one like the index, the later one gets a number.
    """
    taken, names = {block.index.name}, dict[str, str]()
    for column in block.columns:
        plain = _NO_WORD.sub("_", column)
        ends = chain([""], (f"_{number}" for number in count(2)))
        shortened = (plain[: LONGEST_NAME - len(end)] + end for end in ends)
        names[column] = next(name for name in shortened if name not in taken)
        taken.add(names[column])
    return names


def _array(column: Series) -> np.ndarray[Any, Any]:
    if pandas().api.types.is_datetime64_any_dtype(column.dtype):
        return np.asarray(column.dt.tz_convert(None).to_numpy("M8[ns]").view(np.int64))
    if pandas().api.types.is_string_dtype(column.dtype):
        return np.asarray(column.fillna("").to_numpy(object))
    if pandas().api.types.is_extension_array_dtype(column.dtype):
        return np.asarray(column.to_numpy(np.float64, na_value=np.nan))
    return np.asarray(column.to_numpy())


def units_of(block: DataFrame) -> dict[str, str]:
    """Return units by the name that ``arrays_of`` gives a column."""
    timed = {} if block.index.name is None else {TIME: "ns since 1970-01-01T00:00:00Z"}
    units = block.attrs.get(UNITS, {})
    return timed | {name: units[column] for column, name in words_of(block).items() if column in units}
