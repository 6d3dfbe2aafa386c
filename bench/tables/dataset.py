"""A table as an xarray Dataset, as the conventions CF name things: units and long names of its variables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bench.tables.columns import CONDITION, T_MONO, TIME, UNITS, unit_of
from bench.tables.library import library, pandas
from bench.tables.plain import arrays_of, flat, units_of, words_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

ROW = "row"
_LONG_NAMES = {
    T_MONO: "monotonic time of the session",
    "t_end_ns": "monotonic time of the end of the record",
    "stop": "end of the record, UTC",
    "number": "number of the record",
    "step": "number of the step in the plan",
    "uut": "unit under test",
    "valid": "whether an analysis may use the record",
    "problem": "why no analysis uses the record",
    "flags": "quality flags of the record",
    "first_counter": "unwrapped counter of the first frame",
    "frames_asked": "frames that the record was to have",
    "frames": "good frames",
    "lost": "lost frames",
    "bad": "frames that failed their check",
    "duplicate": "frames that came twice",
    "suspect": "frames whose constant fields differ",
    "readings": "readings with a value",
    "unread": "readings without a value",
    "role": "role of the instrument",
    "name": "action of the instrument",
    "std_uncertainty": "standard uncertainty",
    "dof": "degrees of freedom",
    "n": "number of values",
    "dropped": "number of values that were left out",
}


def to_xarray(table: DataFrame) -> Dataset:
    """Return a table of a session, or a part of its rows and columns, as an xarray Dataset along ``time`` or ``row``.

    Each column is a variable with ``long_name`` and ``units``, as far as pandas has kept ``attrs`` of the table; the
    Dataset has ``session`` and ``simulated`` (0 or 1). Times are UTC without a zone. What netCDF cannot hold is other
    here: names have ``_`` for a dot, numbers that may be absent are floats with NaN, an absent text is empty,
    dictionaries and lists are JSON.

    Args:   table: of ``Session`` or ``Fit``, times (n,) as index or none.
    Raises: InputError B-TAB-001 if xarray is not installed.
    """
    xarray = library("xarray")
    if table.index.name != TIME:  # no time, or what rows were grouped by
        table = table.reset_index(drop=table.index.names == [None]).rename(columns={ROW: f"{CONDITION}{ROW}"})
    plain, names, units = flat(table), words_of(table), units_of(table)
    dimension = ROW if table.index.name is None else TIME
    is_time = pandas().api.types.is_datetime64_any_dtype
    times = {names[column] for column in plain.columns if is_time(plain[column].dtype)}
    variables: dict[str, Any] = {}
    for name, values in arrays_of(plain).items():
        if name == dimension or name in times:
            variables[name] = (dimension, values.view("M8[ns]"), {"long_name": _long_name(name)})
        else:
            unit = {"units": units[name]} if name in units else {}
            variables[name] = (dimension, values, {"long_name": _long_name(name), **unit})
    if TIME in variables:
        variables[TIME][2].update(standard_name="time", axis="T")
    attributes = {name: int(value) if value in (True, False) else value for name, value in table.attrs.items()
                  if name != UNITS}  # fmt: skip
    dataset: Dataset = xarray.Dataset(variables, attrs=attributes)
    for variable in dataset.variables.values():
        if variable.dtype.kind in "iuM" and not np.array_equal(variable.values.astype(np.int32), variable.values):
            variable.encoding["dtype"] = "float64"  # netCDF 3 has no wider integers; exact below 2 to the 53rd
    return dataset


def _long_name(name: str) -> str:
    """Return what a variable is: its name in words, without the unit."""
    if name in _LONG_NAMES:
        return _LONG_NAMES[name]
    unit = unit_of(name)
    return name.removesuffix(f"_{unit.replace('/', '_')}").replace("_", " ") if unit else name.replace("_", " ")
