"""The last good evidence of a standard: a calibration before it came into question, with a check standard in control.

Source: ISO/IEC 17025:2017, 7.7.1 (check standards) and 7.10.1 (what a nonconforming standard puts in question).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.analysis import OF_UNIT
from bench.model.clock import utc_text
from bench.store import (
    Filters,
    StoreError,
    compare_unit,
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
    since_ns, since_utc = since["started_utc_ns"], utc_text(since["started_utc_ns"])
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
                return Evidence(model, serial, number, since_utc, row["session"], utc_text(row["started_utc_ns"]), name)
            why = TOO_FEW if inside is None else OUT_OF_CONTROL
    return Evidence(model, serial, number, since_utc, why=why)


def _role(row: Row, model: str, serial: str, certificate: str | None = None) -> str:
    """Return the role in which a session used a standard, "" if it did not."""
    for used in row["standards"]:
        if (used["model"], used["serial"]) == (model, serial) and certificate in (None, used["certificate"]):
            return str(used["role"])
    return ""


def _in_control(url: str, name: str, calibration: str, role: str, until_ns: int) -> dict[str, bool]:
    """Return whether each calibration of a check standard before a time was in control, by hash; {} if none is known.

    Only quantities count that take over the error of the standard in that role: no other would show it. What came later
    is left out: limits that a wrong standard has widened would find it right.
    """
    try:
        shared = show_calibration(url, calibration).shared
        comparison = compare_unit(url, Filters(uut=name, until_utc_ns=until_ns))
    except StoreError as error:
        if error.code == "B-STORE-009":  # the history does not know it
            return {}
        raise
    quantities = {part["quantity"] for part in shared if part["role"] == role}
    inside: dict[str, bool] = {}
    for history in comparison.parameters:
        if history.chart is not None and history.parameter.quantity in quantities:
            for row in history.rows:
                sha256 = str(comparison.series.calibrations[row]["session_sha256"])
                inside[sha256] = inside.get(sha256, True) and row not in history.outside
    return inside
