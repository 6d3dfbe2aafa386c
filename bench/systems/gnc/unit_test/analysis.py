"""The unit tests of GNC modules: every exchange of a session judged again from what was sent and what came back.

Source: GNC-module paper, table 1 and section 3 (2).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from bench.analysis import UNIT, Analysis, Estimates, Material, check_method, estimate
from bench.model.errors import FitError
from bench.systems.gnc.limits import table_3
from bench.systems.gnc.unit_test.report import folders_of, item_table, measured_table, title_of, unit_table, wrong_table
from bench.systems.gnc.unit_test.units import NOT_TESTED, STATIC, SUPPLY, ItemResult, UnitResult, unit_results
from bench.systems.gnc.wording import say

METHODS: tuple[str, ...] = ("exchanges",)


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Judge the test items of every unit of a session.

    Returns: Analysis; ``<item>_wrong`` counts the wrong results of an item (limit 0). What was not tested has no
             estimate, is named in ``missing`` and printed as not tested.
    Raises:  FitError B-FIT-004 (unknown method), B-GNC-001 (limits), B-GNC-002 if nothing was tested at all.
    """
    check_method(method, METHODS)
    units = unit_results(material)
    if not any(item.runs for unit in units for item in unit.all):
        raise FitError(
            "B-GNC-002",
            "the session holds no exchange of a test item and no supply reading",
            next_step="look at the session with 'bench recover'; a run that ended before the first test has none",
        )
    estimates = [entry for unit in units for entry in _estimates(unit)]
    return Analysis(
        campaign="gnc_unit_test",
        method=method,
        uut=dict(material.campaign["uut"]),
        estimates=estimates,
        notes=_notes(units),
        missing=_missing(units),
        tables=[
            unit_table(units, material.utc_offset_s),
            item_table(units),
            *wrong_table(units),
            *measured_table(units),
            table_3(estimates, material.campaign),
        ],
        attachments=folders_of(units, material),
    )


def _estimates(unit: UnitResult) -> Estimates:
    entries = []
    for item in unit.all:
        if not item.runs or not item.judged:
            continue
        place = {UNIT: unit.unit}
        wrong = float(len(item.findings.wrong))
        entries.append(estimate(f"{item.item}_wrong", "1", wrong, 0.0, place, n=item.runs, limit=0.0))
        entries += values_of_item(item, place)
    if (span_s := unit.span_s) is not None:
        entries.append(estimate("test_time", "s", span_s[1] - span_s[0], 0.0, {UNIT: unit.unit}, n=1))
    return entries


def values_of_item(item: ItemResult, place: dict[str, Any]) -> Estimates:
    """Return measured values; those of a looped item are told apart by ``repeat``."""
    entries, seen = [], Counter[str]()
    for value in item.findings.measured:
        conditions = place | dict(value.conditions)
        key = f"{value.quantity} {conditions}"
        if seen[key]:
            conditions["repeat"] = seen[key]
        seen[key] += 1
        entries.append(
            estimate(
                value.quantity, value.unit, value.value, value.std_uncertainty, conditions, n=value.n, limit=value.limit
            )
        )
    return entries


def _missing(units: Sequence[UnitResult]) -> list[str]:
    return [
        say("missing.untested", unit=unit.unit, item=title_of(item.item))
        for unit in units
        for item in unit.all
        if item.judged and item.verdict == NOT_TESTED
    ]


def _notes(units: Sequence[UnitResult]) -> list[str]:
    notes = [
        say("note.remark", unit=unit.unit, item=title_of(item.item), remark=remark)
        for unit in units
        for item in unit.items
        for remark in dict.fromkeys(item.findings.remarks)
    ]
    again = Counter[str]()
    for unit in units:
        again.update({unit.unit: sum(item.retries for item in unit.items)})
    notes += [say("note.repeated", unit=name, count=count) for name, count in again.items() if count]
    if any(item.runs for unit in units for item in unit.all if item.item == SUPPLY):
        notes.append(say("note.no_meter"))
    if any(item.runs for unit in units for item in unit.all if item.item == STATIC):
        notes.append(say("note.no_gauge"))
    return notes
