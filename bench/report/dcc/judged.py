"""Statements of conformity beside the values they judge, with the limits and the probability of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.report.dcc.calibration import TEXTS
from bench.report.dcc.dsi import ONE, SiUnit, si_number
from bench.report.dcc.elements import Element, dcc, leaf, number_list, words

STATUS = {
    "pass": "pass", "fail": "fail", "conditional_pass": "conditionalPass", "conditional_fail": "conditionalFail",
}  # fmt: skip


def is_judged(estimate: Mapping[str, Any]) -> bool:
    """Return True for an estimate with a limit and a verdict."""
    return estimate["limit"] is not None and estimate["verdict"] in STATUS


def conformity(rows: Sequence[Mapping[str, Any]], unit: SiUnit) -> Element | None:
    """The element measurementMetaData of judged values, all judged or none; None if they have no limit or verdict."""
    if not all(is_judged(one) for one in rows):
        return None
    limits = [float(one["limit"]) for one in rows]
    quantities = [
        _quantity("toleranceLimitLower", [si_number(-limit, unit.power) for limit in limits], unit.token),
        _quantity("toleranceLimitUpper", [si_number(limit, unit.power) for limit in limits], unit.token),
    ]
    inside = [one.get("conformance_probability") for one in rows]
    if None not in inside:
        quantities.append(_probability([float(value or 0.0) for value in inside]))
    judged = dcc(
        "metaData",
        words("declaration", TEXTS("conformity.declaration")),
        leaf("conformityXMLList", " ".join(STATUS[one["verdict"]] for one in rows)),
        dcc("data", *quantities),
        refType="basic_conformity",
    )
    return dcc("measurementMetaData", judged)


def _probability(values: Sequence[float]) -> Element:
    listed = number_list([si_number(value) for value in values], ONE)
    name = words("name", TEXTS("conformity.probability"))
    return dcc("quantity", name, listed, refType="bench_conformanceProbability")


def _quantity(name: str, values: Sequence[str], token: str) -> Element:
    named = words("name", TEXTS(f"conformity.{name}"))
    return dcc("quantity", named, number_list(values, token), refType=f"basic_{name}")
