"""Results of a certificate: the estimates of one quantity under like conditions are one table, a column each.

A table is a dcc:list of columns, as the good practice of the DCC has it: the conditions, then the value with its
expanded uncertainty, coverage factor and probability, then what it was made from. No digit of results.json is lost.
Statements of conformity stand beside the values they judge, with the limits and the probability of each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bench.analysis import Estimate, limits_of
from bench.maths.verdict import coverage_factor
from bench.report.dcc.calibration import TEXTS, Calibration
from bench.report.dcc.dsi import PLAIN, SiUnit, condition_unit, estimate_unit, si_number
from bench.report.dcc.elements import Element, dcc, leaf, number_list, si, words
from bench.report.tables import grouped

PROBABILITY = "0.95"
_SAME_K = 1e-3
_LEAST_K = 1.0  # D-SI has no smaller coverage factor
STATUS = {
    "pass": "pass", "fail": "fail", "conditional_pass": "conditionalPass", "conditional_fail": "conditionalFail",
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """Estimates of one quantity that are listed together.

    ``numeric``, ``texts``: names of the conditions that are columns; ``common``: those that are one sentence for all.
    """

    quantity: str
    unit: str
    numeric: tuple[str, ...]
    texts: tuple[str, ...]
    common: tuple[tuple[str, str], ...]
    estimates: tuple[Estimate, ...]


def left_out(estimate: Estimate) -> bool:
    """Return True for an estimate without value or uncertainty, or with a coverage factor that D-SI cannot hold."""
    needed = [getattr(estimate, name) for name in ("value", "expanded_uncertainty", "coverage_factor")]
    return None in needed or float(needed[2] or 0.0) < _LEAST_K


def tables_of(estimates: Sequence[Estimate]) -> list[Table]:
    """Return tables in the order of results.json; every estimate that can be given is in one of them."""
    shown = [estimate for estimate in estimates if not left_out(estimate)]
    return [
        Table(quantity, unit, numeric, texts, common, tuple(rows))
        for (quantity, unit, numeric, texts, common, *_), rows in grouped(shown, _key).items()
    ]


def _key(estimate: Estimate) -> tuple[Any, ...]:
    """Return the key of a table: quantity, unit, conditions by sort, limits on which sides, whether dof are finite."""
    conditions = estimate.conditions
    numeric = tuple(name for name, value in conditions.items() if _is_number(name, value))
    others = {name: _text(value) for name, value in conditions.items() if name not in numeric}
    texts = tuple(name for name, value in others.items() if _is_word(value))
    common = tuple((name, value) for name, value in others.items() if name not in texts)
    sides, finite = _sides(estimate), estimate.dof is not None
    return (estimate.quantity, estimate.unit, numeric, texts, common, sides, finite)


def _sides(estimate: Estimate) -> tuple[bool, bool]:
    """Return on which sides a judged estimate has a limit."""
    limits = limits_of(estimate) if is_judged(estimate) else None
    return (False, False) if limits is None else (math.isfinite(limits[0]), math.isfinite(limits[1]))


def _is_number(name: str, value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and condition_unit(name) is not None


def _is_word(text: str) -> bool:
    return bool(text) and text.split() == [text]


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) or value is None else str(value)


def results(calibration: Calibration, ref_ids: Sequence[str]) -> Element:
    """Return the element results; ``ref_ids``: methods, software and equipment that every result was made with."""
    refs = " ".join(ref_ids)
    tables = tables_of(calibration.estimates)
    return dcc("results", *(_result(calibration, table, refs) for table in tables))


def _result(calibration: Calibration, table: Table, refs: str) -> Element:
    unit = estimate_unit(table.quantity, table.unit)
    return dcc(
        "result",
        words("name", calibration.marked(quantity_name(table.quantity))),
        words("description", _description(table, unit)),
        dcc("data", dcc("list", *_columns(table, unit))),
        refId=refs,
        refType=f"bench_{table.quantity}",
    )


def _description(table: Table, unit: SiUnit) -> str:
    key = "result.moved" if unit.moved else "result.same"
    return TEXTS(key, quantity=table.quantity, unit=table.unit, factor=unit.moved, count=len(table.estimates))


def _columns(table: Table, unit: SiUnit) -> list[Element]:
    rows = table.estimates
    columns = [_condition(table, name) for name in (*table.numeric, *table.texts)]
    columns += [dcc("quantity", words("name", name), words("noQuantity", text)) for name, text in table.common]
    columns.append(_values(table, unit))
    counted = ("n", "dropped") if rows[0].dof is None else ("n", "dropped", "dof")
    columns += [_numbered(f"column.{name}", f"bench_{name}", [getattr(row, name) for row in rows]) for name in counted]
    return columns


def _condition(table: Table, name: str) -> Element:
    """Return a condition as a column of numbers or words."""
    values = [estimate.conditions[name] for estimate in table.estimates]
    unit = condition_unit(name)
    if name in table.texts or unit is None:
        listed = dcc("charsXMLList", text=" ".join(map(_text, values)))
    else:
        listed = number_list([si_number(value, unit) for value in values], unit.token)
    return dcc("quantity", words("name", name), listed, refType=f"bench_{camel('condition_' + name)}")


def _distribution(row: Estimate) -> list[Element]:
    """Return the law that the coverage factor is by: none for a value with a law of its own, such as a ratio."""
    dof = row.dof
    if dof is not None and not math.isclose(row.coverage_factor, coverage_factor(dof), rel_tol=_SAME_K):
        return []
    return [si("distributionXMLList", text="normal" if dof is None else "student-t")]


def _values(table: Table, unit: SiUnit) -> Element:
    rows = table.estimates
    uncertainty = si(
        "expandedUncXMLList",
        si("uncertaintyXMLList", text=_numbers(rows, "expanded_uncertainty", unit)),
        si("coverageFactorXMLList", text=_numbers(rows, "coverage_factor")),
        si("coverageProbabilityXMLList", text=PROBABILITY),
        *_distribution(rows[0]),
    )
    values = si(
        "realListXMLList",
        si("valueXMLList", text=_numbers(rows, "value", unit)),
        si("unitXMLList", text=unit.token),
        uncertainty,
    )
    name = words("name", quantity_name(table.quantity))
    return dcc("quantity", name, values, conformity(rows, unit), refType=f"basic_measuredValue bench_{table.quantity}")


def _numbers(rows: Sequence[Estimate], name: str, unit: SiUnit = PLAIN) -> str:
    return " ".join(si_number(getattr(estimate, name), unit) for estimate in rows)


def _numbered(key: str, ref_type: str, values: Sequence[float], unit: SiUnit = PLAIN) -> Element:
    """Return a column of numbers, one a row, named by a text of the catalogue."""
    listed = number_list([si_number(value, unit) for value in values], unit.token)
    return dcc("quantity", words("name", TEXTS(key)), listed, refType=ref_type)


def quantity_name(quantity: str) -> str:
    """Return name of a quantity in words, by the catalogue where it has one."""
    known = TEXTS.all
    if f"quantity.{quantity}" in known:
        return known[f"quantity.{quantity}"]
    base, _, ending = quantity.rpartition("_")
    if base and f"ending.{ending}" in known:
        return TEXTS(f"ending.{ending}", quantity=quantity_name(base))
    return quantity.replace("_", " ")


def camel(name: str) -> str:
    """Return a name as the good practice writes the second part of a refType: conditionTemperatureDegC."""
    first, *rest = name.split("_")
    return first + "".join(part[:1].upper() + part[1:] for part in rest)


def is_judged(estimate: Estimate) -> bool:
    """Return True for an estimate with a limit and a verdict."""
    return limits_of(estimate) is not None and estimate.verdict in STATUS


def conformity(rows: Sequence[Estimate], unit: SiUnit) -> Element | None:
    """Return the element measurementMetaData of judged values, alike on both sides; None without limit or verdict."""
    if not all(is_judged(estimate) for estimate in rows):
        return None
    sides = zip(("toleranceLimitLower", "toleranceLimitUpper"), zip(*map(limits_of, rows), strict=True), strict=True)
    quantities = [
        _numbered(f"conformity.{name}", f"basic_{name}", limits, unit)
        for name, limits in sides
        if all(map(math.isfinite, limits))
    ]
    inside = [estimate.conformance_probability for estimate in rows]
    if None not in inside:
        chances = [float(value or 0.0) for value in inside]
        quantities.append(_numbered("conformity.probability", "bench_conformanceProbability", chances))
    judged = dcc(
        "metaData",
        words("declaration", TEXTS("conformity.declaration")),
        leaf("conformityXMLList", " ".join(STATUS[estimate.verdict] for estimate in rows)),
        dcc("data", *quantities),
        refType="basic_conformity",
    )
    return dcc("measurementMetaData", judged)
