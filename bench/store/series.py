"""The calibrations of one unit as arrays: one row per calibration, one column per parameter of a campaign."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Select, select

from bench.analysis import Common, Limits, covariance_by_standards, limit_range
from bench.maths.drift import NO_STANDARD
from bench.model.arrays import Floats
from bench.model.clock import NS
from bench.store.adjustments import levels_of
from bench.store.contents import canonical
from bench.store.database import reading, rows_of
from bench.store.errors import StoreError
from bench.store.selection import Filters, find_calibration, find_unit, selected
from bench.store.tables import doubts, estimates, parameters, shared_components

YEAR_S = 365.25 * 86400.0
_AT_ONCE = 10_000  # every database takes as many values in one statement
_TEMPERATURES = {
    "temperature_degC": "", "unit_temperature_degC": "unit ", "reference_temperature_degC": "about ",
}  # fmt: skip
_NUMBERS = ("value", "std_uncertainty", "coverage_factor")


@dataclass(frozen=True)
class Parameter:
    """The parameter of a column."""

    campaign: str
    quantity: str
    unit: str
    conditions: dict[str, Any]

    @property
    def label(self) -> str:
        """Quantity and conditions in one line."""
        named = conditions_text(self.conditions)
        return f"{self.quantity} ({named})" if named else self.quantity


def conditions_text(conditions: Mapping[str, Any]) -> str:
    """Return conditions as a person says them, without the kind of a channel; "about": where coefficients refer to."""
    said = []
    for name, value in conditions.items():
        shown = f"{value:.6g}" if isinstance(value, float) else str(value)
        if name in _TEMPERATURES:
            said.append(f"{_TEMPERATURES[name]}{shown} degC")
        elif name != "kind" or "channel" not in conditions:
            said.append(f"{name} {shown}")
    return ", ".join(said)


@dataclass(frozen=True)
class Series:
    """Newest results of every calibration of a unit; NaN where a calibration has no such parameter.

    ``shared``: standard uncertainty that comes from the standard labelled ``standard`` (NO_STANDARD where none does).
    """

    uut: tuple[str, str]
    calibrations: list[dict[str, Any]]  # (c,)
    parameters: list[Parameter]  # (p,)
    t_year: Floats  # (c,) since 1970
    value: Floats  # (c, p)
    std: Floats  # (c, p)
    factor: Floats  # (c, p)
    shared: Floats  # (c, p)
    standard: NDArray[np.int64]  # (c, p)
    low: Floats  # (p,) limits of the newest calibration of the campaign; infinite where there is none
    high: Floats  # (p,)
    change_limit: Floats  # (p,) the same, of the change since that calibration; NaN if there is none
    level: NDArray[np.int64]  # (c,) another label after each adjustment of the unit
    certificates: list[str]  # what the labels in ``standard`` mean
    notes: list[str] = field(default_factory=list)


def read_series(url: str, filters: Filters) -> Series:
    """Read the calibrations of one unit; the unit may be left out if the history has only one.

    Simulated calibrations never stand beside real ones: if there are both, only the real ones count.
    Raises: StoreError B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    with reading(url) as connection:
        uut = find_unit(connection, filters.uut)
        whole = replace(filters, uut=" ".join(uut))
        rows = rows_of(connection, selected(connection, whole))
        notes = []
        if any(row["simulated"] for row in rows) and not all(row["simulated"] for row in rows):
            left_out = sum(row["simulated"] for row in rows)
            notes.append(f"{left_out} simulated calibrations of this unit are left out")
            rows = [row for row in rows if not row["simulated"]]
        return _series(connection, uut, rows, filters.quantity, notes)


def read_pair(url: str, first: str, second: str) -> tuple[Series, Floats]:
    """Return two calibrations in given order, and the covariance of each parameter in both by what they say to share.

    The covariance (p,) is NaN where one of them does not say what it has in common with others.
    Raises as ``read_series``, and B-STORE-011 if they are of two units.
    """
    with reading(url) as connection:
        rows = [find_calibration(connection, name) for name in (first, second)]
        if rows[0]["id"] == rows[1]["id"]:
            raise StoreError(
                "B-STORE-011",
                "both names mean the same calibration",
                where=f"{first}, {second}",
                next_step="name two calibrations; 'bench history list' shows them",
            )
        units = [(str(row["uut_model"]), str(row["uut_serial"])) for row in rows]
        if units[0] != units[1] or rows[0]["campaign"] != rows[1]["campaign"]:
            said = [f"{row['campaign']} of {' '.join(unit)}" for row, unit in zip(rows, units, strict=True)]
            raise StoreError(
                "B-STORE-011",
                f"these cannot be compared: {said[0]}, {said[1]}",
                where=f"{first}, {second}",
                next_step="compare two calibrations of one unit by the same campaign",
            )
        series = _series(connection, units[0], rows, None, [])
        if series.level[0] != series.level[1]:
            series.notes.append("the unit was adjusted between them: the change is no drift")
        return series, _covariance(connection, rows, series.parameters)


def _covariance(connection: Connection, rows: list[dict[str, Any]], wanted: Sequence[Parameter]) -> Floats:
    """Return the covariance of two calibrations by the errors of standards that the estimates of both name, (p,)."""
    columns = (parameters.c.quantity, parameters.c.unit, parameters.c.conditions, estimates.c.further)
    said = []
    for row in rows:
        query = select(*columns).join(parameters, parameters.c.id == estimates.c.parameter_id)
        found = connection.execute(query.where(estimates.c.result_set_id == row["result_set_id"]))
        said.append({tuple(entry[:3]): _common(entry.further) for entry in found})
    covariance = np.full(len(wanted), np.nan)
    for number, parameter in enumerate(wanted):
        key = parameter.quantity, parameter.unit, canonical(parameter.conditions)
        here, there = (of_one.get(key) for of_one in said)
        if here and there:
            covariance[number] = covariance_by_standards(here, there)
    return covariance


def _common(further: str | None) -> Common | None:
    """Return what an estimate shares with others, as it was stored; None if it does not say."""
    stated = json.loads(further or "{}").get("common")
    return Common(**stated) if stated else None


def _series(
    connection: Connection, uut: tuple[str, str], rows: list[dict[str, Any]], quantity: str | None, notes: list[str]
) -> Series:
    notes = [*notes, *_unsound(connection, rows)]
    table, described = _numbers(connection, [row["result_set_id"] for row in rows], quantity)
    places = _places(np.array([row["result_set_id"] for row in rows], dtype=np.int64), table[:, 0].astype(np.int64))
    names = sorted({str(row["campaign"]) for row in rows})
    campaign = np.array([names.index(row["campaign"]) for row in rows], dtype=np.int64)
    many = max(described, default=0) + 1
    codes, columns = np.unique(campaign[places] * many + table[:, 1].astype(np.int64), return_inverse=True)
    column_of = {(names[code // many], code % many): number for number, code in enumerate(codes.tolist())}
    grids = np.full((len(_NUMBERS), len(rows), len(column_of)), np.nan)
    grids[:, places, columns] = table[:, 2:].T
    parameters = [Parameter(name, *described[number]) for name, number in column_of]
    shared, standard, certificates = _shared(connection, rows, parameters)
    t_year = np.array([row["started_utc_ns"] / NS / YEAR_S for row in rows])
    value, std, factor = grids
    limits = _limits(connection, rows, column_of)
    level = levels_of(connection, uut, rows)
    return Series(
        uut, rows, parameters, t_year, value, std, factor, shared, standard, *limits, level, certificates, notes
    )


def _unsound(connection: Connection, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each calibration of which estimates are not sound: nothing is compared with those."""
    session_of = {row["result_set_id"]: str(row["session"]) for row in rows}
    some = connection.execute(select(doubts.c.result_set_id, doubts.c.document))
    of_these = [row for row in some if row.result_set_id in session_of]
    counted = Counter((row.result_set_id, str(json.loads(row.document)["quality"])) for row in of_these)
    return [
        f"{session_of[result_set]}: {count} {quality} estimates are left out"
        for (result_set, quality), count in sorted(counted.items())
    ]


def _places(known: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where each of ``wanted`` stands in ``known``."""
    order = known.argsort()
    return order[np.searchsorted(known[order], wanted)]


def _numbers(
    connection: Connection, result_sets: Sequence[int], quantity: str | None
) -> tuple[Floats, dict[int, tuple[str, str, dict[str, Any]]]]:
    """Return rows (result set, parameter, numbers ...) of the estimates wanted, and what the parameters are."""
    query = select(parameters.c.id, parameters.c.quantity, parameters.c.unit, parameters.c.conditions)
    if quantity is not None:
        query = query.where(parameters.c.quantity == quantity)
    described = {row.id: (row.quantity, row.unit, json.loads(row.conditions)) for row in connection.execute(query)}
    columns = (estimates.c.result_set_id, estimates.c.parameter_id, *(estimates.c[name] for name in _NUMBERS))
    parts = []
    for start in range(0, len(result_sets), _AT_ONCE):
        some = select(*columns).where(estimates.c.result_set_id.in_(result_sets[start : start + _AT_ONCE]))
        parts.append(np.array(_plain_rows(connection, some), dtype=np.float64).reshape(-1, len(columns)))
    table = np.vstack(parts) if parts else np.empty((0, len(columns)))
    return table[np.isin(table[:, 1], list(described))], described


def _plain_rows(connection: Connection, query: Select[Any]) -> list[tuple[Any, ...]]:
    """Return rows as the driver gives them: of 200,000 rows the library's own row objects would take too long."""
    result = connection.execute(query)
    assert result.cursor is not None
    rows = result.cursor.fetchall()
    result.close()
    return list(rows)


def _limits(
    connection: Connection, rows: list[dict[str, Any]], column_of: dict[tuple[str, int], int]
) -> tuple[Floats, Floats, Floats]:
    """Return limits of the newest calibration of every campaign: low and high of the value, and of its change."""
    newest = {str(row["campaign"]): int(row["result_set_id"]) for row in rows}
    low, high = np.full(len(column_of), -np.inf), np.full(len(column_of), np.inf)
    change = np.full(len(column_of), np.nan)
    columns = [estimates.c[name] for name in ("parameter_id", "limit_value", "further", "change_limit")]
    for campaign, result_set in newest.items():
        query = select(*columns).where(estimates.c.result_set_id == result_set)
        for number, limit, further, of_change in connection.execute(query):
            column = column_of.get((campaign, number))
            if column is not None:
                ends = json.loads(further or "{}").get("limits")
                stated = limit_range(limit, None if ends is None else Limits(**ends))
                low[column], high[column] = (-np.inf, np.inf) if stated is None else stated
                change[column] = np.nan if of_change is None else of_change
    return low, high, change


def _shared(
    connection: Connection, rows: list[dict[str, Any]], parameters: list[Parameter]
) -> tuple[Floats, NDArray[np.int64], list[str]]:
    """Return shared standard uncertainty and the label of its standard, (c, p) each, and what the labels mean."""
    ids = {row["id"]: number for number, row in enumerate(rows)}
    shared = np.zeros((len(rows), len(parameters)))
    standard = np.full(shared.shape, NO_STANDARD)
    labels: dict[str, int] = {}
    columns: dict[tuple[str, str], list[int]] = {}
    for number, parameter in enumerate(parameters):
        columns.setdefault((parameter.quantity, parameter.unit), []).append(number)
    for row in connection.execute(select(shared_components)).mappings():
        place = ids.get(row["calibration_id"])
        touched = columns.get((row["quantity"], row["unit"]))
        if place is not None and touched:
            shared[place, touched] = row["std_uncertainty"]
            standard[place, touched] = labels.setdefault(row["standard"], len(labels))
    return shared, standard, list(labels)
