"""DataFrames out of rows: columns typed by what they hold, absent values as NA, units beside them.

Every table has the index ``time`` (UTC), where its rows have a time, and ``attrs["units"]``: unit by column.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Estimate
from bench.tables.library import pandas

if TYPE_CHECKING:
    from pandas import DataFrame

TIME, T_MONO = "time", "t_mono_ns"
UNITS = "units"
CONDITION = "condition_"
_PARTS = ("conditions", "limits", "common", "reasons", "evidence_interval", "acceptance")  # of several values each
_PLAIN = [name for name in Estimate.model_fields if name not in _PARTS]
_NUMBERS = [name for name in _PLAIN if float in get_args(Estimate.model_fields[name].annotation)]
_UNITS = (
    "ns", "s", "min", "A", "V", "m", "Hz", "Pa", "degC", "ppm", "nA", "mrad", "deg", "deg/s", "deg/h", "g", "gauss",
    "m/s", "m/s2",
)  # fmt: skip
_SUFFIXES = {f"_{unit.replace('/', '_')}": unit for unit in _UNITS}
_LONGEST_FIRST = sorted(_SUFFIXES, key=len, reverse=True)


def unit_of(name: str) -> str:
    """Return the unit that the end of a name states, "" if it states none."""
    return next((_SUFFIXES[end] for end in _LONGEST_FIRST if name.endswith(end)), "")


def typed(values: Sequence[Any]) -> Any:
    """Return values as a column: numbers, texts or truths where all of them are, else objects; None is NA."""
    kinds = {type(value) for value in values if value is not None}
    pd, absent = pandas(), None in values
    if kinds and kinds <= {int, float} and float in kinds:
        return pd.Series([np.nan if value is None else value for value in values], dtype="float64")
    for kind, plain, nullable in ((int, "int64", "Int64"), (bool, "bool", "boolean"), (str, "string", "string")):
        if kinds == {kind} and not (kind is int and _too_large(values)):
            return pd.Series(list(values), dtype=nullable if absent else plain)
    return pd.Series(list(values), dtype=object)


def _too_large(values: Iterable[int | None]) -> bool:
    return any(value is not None and not -(1 << 63) <= value < 1 << 63 for value in values)


def table(columns: Mapping[str, Any], units: Mapping[str, str], t_mono_ns: Any = None, offset_ns: int = 0) -> DataFrame:
    """Return columns as a DataFrame; with times (n,), ns, on the axis of the session it has them as index, in UTC."""
    pd = pandas()
    if t_mono_ns is None:
        frame = pd.DataFrame(dict(columns))
    else:
        stamps: NDArray[np.int64] = np.asarray(t_mono_ns, np.int64)
        index = pd.DatetimeIndex((stamps + offset_ns).view("M8[ns]"), name=TIME).tz_localize("UTC")
        arrays = {name: getattr(column, "array", column) for name, column in columns.items()}
        frame = pd.DataFrame({T_MONO: stamps, **arrays}, index=index)
        units = {T_MONO: "ns", **units}
    frame.attrs[UNITS] = {str(name): units[name] for name in frame.columns if units.get(name)}
    return frame


def spread(rows: Sequence[Mapping[str, Any]], taken: Iterable[str], prefix: str = CONDITION) -> dict[str, list[Any]]:
    """Return mappings as columns, a value that one of them lacks as None; a name that is taken gets the prefix."""
    names = dict.fromkeys(name for row in rows for name in row)
    taken = set(taken)
    return {f"{prefix}{name}" if name in taken else name: [row.get(name) for row in rows] for name in names}


def table_of_estimates(estimates: Sequence[Estimate]) -> DataFrame:
    """Return the estimates of a document results.json, a row each; conditions are columns.

    Each row has its own ``unit``, which holds for value, uncertainties and limits: ``limit`` for -limit to limit, else
    ``lower_limit`` and ``upper_limit``. Documents of schema 1 have no ``quality`` but sound estimates.
    """
    columns: dict[str, list[Any]] = {}
    for name in _PLAIN:
        columns[name] = [getattr(estimate, name) for estimate in estimates]
    for name, side in (("lower_limit", "low"), ("upper_limit", "high")):
        columns[name] = [getattr(estimate.limits, side, None) for estimate in estimates]
    columns["reasons"] = ["; ".join(reason.sentence for reason in row.reasons) for row in estimates]
    columns |= spread([estimate.conditions for estimate in estimates], columns)
    shown = {name: typed(values) for name, values in columns.items()}
    shown |= {name: shown[name].astype("float64") for name in (*_NUMBERS, "lower_limit", "upper_limit")}
    return table(shown, {name: unit_of(name) for name in columns})
