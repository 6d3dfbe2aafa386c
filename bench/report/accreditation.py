"""What an accreditation covers: real, sound results within the declared scope, with U not below its CMC.

A reported U below the calibration and measurement capability (CMC) would claim more than the laboratory was accredited
for.

Source: ILAC-P14:09/2020 (reported uncertainties against the CMC); ILAC-P8 (use of the mark).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from bench.analysis import Estimate, is_sound, number, unit_text
from bench.model.units import read_quantity
from bench.report.laboratory import Accreditation, Capability

Row = Estimate
_EQUAL = 1.0 - 1e-9  # a U that is the CMC itself, computed another way


def not_covered(accreditation: Accreditation, method: str, rows: Iterable[Row]) -> dict[str, str]:
    """Return why results may not be stated under an accreditation, by quantity; {} if all may.

    Args: method: the analysis that gave them.   rows: entries of results.json.
    """
    by_quantity: dict[str, list[str]] = {}
    for row in rows:
        reason = _reason(accreditation.scope, method, row)
        if reason:
            by_quantity.setdefault(str(row.quantity), []).append(reason)
    return {
        quantity: reasons[0] + (f", and {len(reasons) - 1} more of it" if len(reasons) > 1 else "")
        for quantity, reasons in by_quantity.items()
    }


def below_capability(accreditation: Accreditation, method: str, rows: Iterable[Row]) -> dict[str, str]:
    """Return only those of the reasons that are an uncertainty below the CMC of a result within the scope."""
    within = [row for row in rows if is_sound(row) and _matching(accreditation.scope, method, row)]
    return not_covered(accreditation, method, within)


def _reason(scope: Sequence[Capability], method: str, row: Row) -> str:
    if not is_sound(row):
        return f"is {row.quality}"
    lines = _matching(scope, method, row)
    if not lines:
        return f"{number(row.value)} {unit_text(row.unit)} by {method} is outside the scope"
    expanded = row.expanded_uncertainty or 0.0
    least = min(line.cmc[0] for line in lines) / _factor(row.unit)
    if expanded >= least * _EQUAL:
        return ""
    unit = unit_text(row.unit)
    return f"U = {number(float(f'{expanded:.3g}'))} {unit} is below the CMC of {number(float(f'{least:.6g}'))} {unit}"


def _matching(scope: Sequence[Capability], method: str, row: Row) -> list[Capability]:
    """Return the lines of the scope that a result falls under; none if its unit is not one that a scope can state."""
    unit = read_quantity(f"1 {row.unit}")
    if unit is None or row.value is None:
        return []
    value = float(row.value) * unit[0]
    return [
        line
        for line in scope
        if (line.quantity, line.method, line.cmc[1]) == (row.quantity, method, unit[1])
        and line.range[0][0] <= value <= line.range[1][0]
    ]


def _factor(unit: str) -> float:
    known = read_quantity(f"1 {unit}")
    assert known is not None
    return known[0]
