"""The last good evidence of a standard: a calibration before it came into question, with a check standard in control.

Source: ISO/IEC 17025:2017, 7.7.1 (check standards) and 7.10.1 (what a nonconforming standard puts in question).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import OF_UNIT
from bench.maths.drift import fit_drift_line, individuals_chart
from bench.model.clock import NS
from bench.store import (
    LEAST_FOR_CONTROL,
    YEAR_S,
    Comparison,
    Filters,
    StoreError,
    compare_unit,
    session_document,
    show_calibration,
)

Row = Mapping[str, Any]
NO_CHECK, TOO_FEW, OUT_OF_CONTROL = "no_check_standard", "too_few", "out_of_control"


@dataclass(frozen=True)
class Evidence:
    """``session``: the last good one, "" if there is none, and then ``why``; ``since_utc``: when the question begins.

    ``certificate``: as recorded, the one in question; ``check_standard``: which was in control.
    """

    model: str
    serial: str
    certificate: str
    since_utc: str
    session: str = ""
    session_utc: str = ""
    check_standard: str = ""
    why: str = ""


def evidence_of(url: str, rows: Sequence[Row], register: Mapping[str, Mapping[str, Any]]) -> list[Evidence]:
    """Return the last good evidence of each standard whose certificate has another in its place.

    Args:   url: of the history, which knows the check standards.   rows: all sessions of the archive, by time.
            register: by certificate as recorded.
    Raises: StoreError B-STORE-001 to B-STORE-005.
    """
    return [_evidence(url, rows, number, entry) for number, entry in sorted(register.items())]


def _evidence(url: str, rows: Sequence[Row], number: str, entry: Mapping[str, Any]) -> Evidence:
    model, serial = str(entry["model"]), str(entry["serial"])
    used = [row for row in rows if row["started_utc_ns"] is not None and _role(row, model, serial)]
    since = next((row for row in used if _role(row, model, serial, number)), None)
    if since is None:
        return Evidence(model, serial, number, "", why=NO_CHECK)
    since_ns, since_utc = since["started_utc_ns"], _utc(since)
    why = NO_CHECK
    charts: dict[str, dict[str, bool]] = {}
    for row in reversed([row for row in used if row["started_utc_ns"] < since_ns and not row["code"]]):
        for unit in (unit for unit in row["units"] if unit["check_standard"]):
            name = f"{unit['model']} {unit['serial']}"
            calibration = f"{row['session_sha256']}{OF_UNIT}{unit['serial']}"
            if name not in charts:
                charts[name] = _in_control(url, name, calibration, _role(row, model, serial), since_ns)
            inside = charts[name].get(calibration)
            if inside:
                return Evidence(model, serial, number, since_utc, row["session"], _utc(row), name)
            why = TOO_FEW if inside is None else OUT_OF_CONTROL
    return Evidence(model, serial, number, since_utc, why=why)


def _utc(row: Row) -> str:
    return str(session_document(dict(row))["started_utc"])


def _role(row: Row, model: str, serial: str, certificate: str | None = None) -> str:
    """Return the role in which a session used a standard, "" if it did not."""
    for used in row["standards"]:
        if (used["model"], used["serial"]) == (model, serial) and certificate in (None, used["certificate"]):
            return str(used["role"])
    return ""


def _in_control(url: str, name: str, calibration: str, role: str, until_ns: int) -> dict[str, bool]:
    """Return whether each calibration of a check standard before a time was in control, by hash; {} if none is known.

    Only quantities count that take over the error of the standard in that role: no other would show it.
    """
    try:
        shared = show_calibration(url, calibration).shared
        comparison = compare_unit(url, Filters(uut=name))
    except StoreError as error:
        if error.code == "B-STORE-009":  # the history does not know it
            return {}
        raise
    quantities = {part["quantity"] for part in shared if part["role"] == role}
    inside: dict[str, bool] = {}
    for rows, within in _charted(comparison, quantities, until_ns / NS / YEAR_S):
        for row, is_within in zip(rows, within, strict=True):
            sha256 = str(comparison.series.calibrations[int(row)]["session_sha256"])
            inside[sha256] = inside.get(sha256, True) and bool(is_within)
    return inside


def _charted(comparison: Comparison, quantities: Collection[str], until_year: float) -> Iterator[tuple[Any, Any]]:
    """Yield calibrations and whether they are within the action limits, of each parameter, from those before a time.

    What came later is left out: limits that a wrong standard has widened would find it right.
    """
    for column, history in enumerate(comparison.parameters):
        kept = history.t_year < until_year
        rows, t_year = history.rows[kept], history.t_year[kept]
        value, std = history.value[kept], history.std[kept]
        enough = rows.size >= LEAST_FOR_CONTROL and np.unique(t_year).size > 1 and (std > 0.0).all()
        if history.parameter.quantity not in quantities or not enough:
            continue
        series = comparison.series
        shared = np.minimum(series.shared[rows, column], std)
        line = fit_drift_line(t_year, value, std, shared, series.standard[rows, column])
        low, high = individuals_chart(line.residual).action
        yield rows, (line.residual >= low) & (line.residual <= high)
