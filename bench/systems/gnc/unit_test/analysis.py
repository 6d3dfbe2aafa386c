"""The unit tests of GNC modules: every exchange of a session judged again from what was sent and what came back.

Source: GNC-module paper, table 1 and section 3 (2).

Report of the unit tests: tables of units, items, measured values and wrong results; and what is filed of each
unit: a folder per test item with its result and its log, and a summary.

Source: GNC-module paper, section 5.2 (results in a folder per test item) and section 4.1 (what a test log shows).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from bench.analysis import UNIT, Analysis, Document, Estimates, Material, Table, estimate, results_json, worded_table
from bench.model.errors import FitError
from bench.model.lab import folder_name
from bench.systems.gnc.limits import table_3
from bench.systems.gnc.unit_test.judges import IDENTITY
from bench.systems.gnc.unit_test.units import (
    ITEMS,
    NOT_TESTED,
    STATIC,
    SUPPLY,
    ItemResult,
    UnitResult,
    unit_results,
)
from bench.systems.gnc.wording import kind_name, quantity_name, say

METHODS = ("exchanges",)


if TYPE_CHECKING:
    from bench.analysis import Material
    from bench.systems.gnc.unit_test.units import ItemResult

_MOST_WRONG = 200  # rows that are printed; the folders of the units hold all


def title_of(item: str) -> str:
    """Return name of an item as people read it."""
    return say(f"item.{item}") if item in (STATIC, SUPPLY, IDENTITY, *ITEMS) else item


def unit_table(units: Sequence[UnitResult], offset_s: float | None) -> Table:
    """Start, elapsed time, end and verdict of each unit; ``offset_s``: UTC minus bench clock, None if unknown."""
    rows: list[list[Any]] = []
    for unit in units:
        span_s = unit.span_s
        times: list[Any] = ["–", "–", "–"]
        if span_s is not None:
            times = [_moment(span_s[0], offset_s), f"{span_s[1] - span_s[0]:.3f}", _moment(span_s[1], offset_s)]
        failed = [title_of(item.item) for item in unit.all if item.verdict == "fail"]
        rows.append([unit.unit, *times, len(unit.wrong), say.listed(failed or ["–"]), _verdict(unit.verdict)])
    clock = "s" if offset_s is None else "UTC"
    heads = ["unit", "start", "elapsed", "end", "wrong", "failed", "verdict"]
    return worded_table(say, "units", heads, rows, prose=True, lead=True, clock=clock)


def _moment(at_s: float, offset_s: float | None) -> str:
    """Date and time in UTC; without it the seconds of the bench clock."""
    if offset_s is None:
        return f"{at_s:.3f}"
    return datetime.fromtimestamp(at_s + offset_s, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]


def item_table(units: Sequence[UnitResult]) -> Table:
    """Table 1: one row per unit, one column per item."""
    names = list(dict.fromkeys(item.item for unit in units for item in unit.all))
    rows = []
    for unit in units:
        by_item = {item.item: _verdict(item.verdict) for item in unit.all}
        rows.append([unit.unit, *(by_item.get(name, _verdict("not tested")) for name in names)])
    return worded_table(say, "table1", ["unit"], rows, [*map(title_of, names)], prose=True, lead=True)


def measured_table(units: Sequence[UnitResult]) -> list[Table]:
    """Return lowest and highest value of what the tests measured, by quantity; the limits it is judged by."""
    values: dict[tuple[str, str, str], list[float]] = {}
    limits: dict[tuple[str, str, str], float | None] = {}
    for unit in units:
        for item in unit.all:
            for measured in item.findings.measured:
                key = measured.quantity, _place(measured.conditions), measured.unit
                values.setdefault(key, []).append(measured.value)
                limits[key] = measured.limit
    rows = [
        [
            quantity_name(quantity),
            place,
            len(members),
            min(members),
            max(members),
            unit,
            _limit(limits[quantity, place, unit]),
        ]
        for (quantity, place, unit), members in values.items()
    ]
    heads = ["quantity", "of", "values", "lowest", "highest", "unit", "limit"]
    return [worded_table(say, "measured", heads, rows)] if rows else []


def wrong_table(units: Sequence[UnitResult]) -> list[Table]:
    """Return every wrong result: what was sent, expected, received."""
    rows = [
        [unit.unit, title_of(item.item), wrong.what, wrong.sent or say("nothing"), wrong.expected, wrong.received]
        for unit in units
        for item in unit.all
        for wrong in item.findings.wrong
    ]
    if not rows:
        return []
    more = len(rows) - _MOST_WRONG
    caption = say("wrong.caption_more", more=more) if more > 0 else say("wrong.caption")
    headers = say.heads("wrong", "unit", "item", "what", "sent", "expected", "received")
    return [Table(say("wrong.title"), caption, headers, rows[:_MOST_WRONG], prose=True, lead=True)]


def _verdict(text: str) -> str:
    return say(f"verdict.{text.replace(' ', '_')}")


def _place(conditions: Document) -> str:
    """Return conditions as people say them: ``supply``, ``accelerometer``, ``0.5 ms``; a dash for none."""
    said = (
        kind_name(value) if isinstance(value, str) else say(f"measured.{name}", value=value)
        for name, value in conditions.items()
    )
    return say.listed(list(said) or ["–"])


def _limit(value: float | None) -> Any:
    return "–" if value is None else f"{value:g}"


def folders_of(units: Sequence[UnitResult], material: Material) -> dict[str, str]:
    """Relative path to text: ``<unit>/<item>/result.json``, ``<unit>/<item>/log.txt``, ``<unit>/summary.json``."""
    offset_s = material.utc_offset_s
    texts = {}
    for unit in units:
        folder = folder_name(unit.unit)
        for item in unit.all:
            if item.runs:
                texts[f"{folder}/{item.item}/result.json"] = results_json(_result(unit.unit, item, offset_s))
                texts[f"{folder}/{item.item}/log.txt"] = _log(unit.unit, item, offset_s)
        texts[f"{folder}/summary.json"] = results_json(_summary(unit, offset_s))
    return texts


def _result(unit: str, item: ItemResult, offset_s: float | None) -> dict[str, Any]:
    return {
        "unit": unit,
        "item": item.item,
        "verdict": item.verdict,
        "exchanges": item.runs,
        "repeated": item.retries,
        **_times(item.begin_s, item.end_s, offset_s),
        "wrong": [vars(wrong) for wrong in item.findings.wrong],
        "measured": [
            {name: getattr(measured, name) for name in ("quantity", "unit", "value", "conditions", "limit")}
            for measured in item.findings.measured
        ],
        "remarks": item.findings.remarks,
    }  # fmt: skip


def _summary(unit: UnitResult, offset_s: float | None) -> dict[str, Any]:
    begin_s, end_s = unit.span_s or (None, None)
    items = {item.item: item.verdict for item in unit.all}
    return {"unit": unit.unit, "verdict": unit.verdict, **_times(begin_s, end_s, offset_s), "items": items}


def _times(begin_s: float | None, end_s: float | None, offset_s: float | None) -> dict[str, Any]:
    """Return times of the bench clock; UTC labels beside them where the session says how the two belong together."""
    if begin_s is None or end_s is None:
        return {"begin_s": None, "elapsed_s": None, "end_s": None}
    times: dict[str, Any] = {"begin_s": begin_s, "elapsed_s": end_s - begin_s, "end_s": end_s}
    if offset_s is not None:
        times |= {"begin_utc": _utc(begin_s + offset_s), "end_utc": _utc(end_s + offset_s)}
    return times


def _log(unit: str, item: ItemResult, offset_s: float | None) -> str:
    times = _times(item.begin_s, item.end_s, offset_s)
    lines = [
        f"unit     {unit}",
        f"item     {title_of(item.item)}",
        f"start    {_stamp(times, 'begin')}",
        f"elapsed  {times['elapsed_s']:.3f} s",
        f"end      {_stamp(times, 'end')}",
        f"verdict  {item.verdict.upper()}: {len(item.findings.wrong)} wrong in {item.runs} exchanges, "
        f"{item.retries} repeated",
    ]
    for wrong in item.findings.wrong:
        lines += ["", f"{wrong.at_s:.3f} s  {wrong.what}", f"  sent      {wrong.sent or 'nothing'}"]
        lines += [f"  expected  {wrong.expected}", f"  received  {wrong.received}"]
    return "\n".join([*lines, *(f"remark   {remark}" for remark in item.findings.remarks)]) + "\n"


def _stamp(times: Document, name: str) -> str:
    utc = times.get(f"{name}_utc")
    return f"{times[f'{name}_s']:.3f} s" + (f"  {utc}" if utc else "")


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Judge the test items of every unit of a session.

    Returns: Analysis; ``<item>_wrong`` counts the wrong results of an item (limit 0). What was not tested has no
             estimate, is named in ``missing`` and printed as not tested.
    Raises:  FitError B-GNC-001 (limits), B-GNC-002 if nothing was tested at all.
    """
    units = unit_results(material)
    if not any(item.runs for unit in units for item in unit.all):
        raise FitError(
            "B-GNC-002",
            "the session holds no exchange of a test item and no supply reading",
            next_step="look at the session with 'bench recover'; a run that ended before the first test has none",
        )
    estimates = [entry for unit in units for entry in _estimates(unit)]
    return Analysis(
        "gnc_unit_test",
        method,
        material.campaign["uut"],
        estimates,
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
        conditions = place | value.conditions
        key = f"{value.quantity} {conditions}"
        if seen[key]:
            conditions["repeat"] = seen[key]
        seen[key] += 1
        entries.append(value.model_copy(update={"conditions": conditions}))
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
