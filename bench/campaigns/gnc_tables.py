"""Tables of the unit tests: units, items, measured values, wrong results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.campaigns.gnc_units import IDENTITY, ITEMS, SUPPLY, UnitResult

Document = dict[str, Any]
_MOST_WRONG = 200  # rows that are printed; the folders of the units hold all


def title_of(item: str) -> str:
    """Name of an item as people read it."""
    return {SUPPLY: "supply", IDENTITY: "identity"}.get(item, ITEMS.get(item, item))


def unit_table(units: Sequence[UnitResult]) -> Document:
    """Start, elapsed time, end and verdict of each unit, by the clock of the bench."""
    rows: list[list[Any]] = []
    for unit in units:
        span_s = unit.span_s
        times: list[Any] = ["–", "–", "–"]
        if span_s is not None:
            times = [round(span_s[0], 3), round(span_s[1] - span_s[0], 3), round(span_s[1], 3)]
        failed = ", ".join(title_of(one.item) for one in unit.all if one.verdict == "fail") or "–"
        rows.append([unit.unit, *times, len(unit.wrong), failed, _verdict(unit.verdict)])
    headers = ["unit", "start / s", "elapsed / s", "end / s", "wrong results", "failed", "verdict"]
    caption = "Times by the clock of the bench, from the first to the last test; PASS only if everything was tested."
    return {"title": "Units tested", "caption": caption, "headers": headers, "rows": rows}


def item_table(units: Sequence[UnitResult]) -> Document:
    """Table 1: one row per unit, one column per item."""
    names = list(dict.fromkeys(one.item for unit in units for one in unit.all))
    rows = []
    for unit in units:
        by_item = {one.item: _verdict(one.verdict) for one in unit.all}
        rows.append([unit.unit, *(by_item.get(name, _verdict("not tested")) for name in names)])
    caption = (
        "The six rows of table 1 of the GNC-module paper, IO, SPI, SCI and CAN of its section 3 (2), and the supply "
        "of its table 3. Position, velocity and timing accuracy of the receiver are not tested here."
    )
    headers = ["unit", *map(title_of, names)]
    return {"title": "Table 1: unit tests", "caption": caption, "headers": headers, "rows": rows, "prose": True}


def measured_table(units: Sequence[UnitResult]) -> list[Document]:
    """Lowest and highest value of what the tests measured, by quantity; the limits it is judged by."""
    values: dict[tuple[str, str, str], list[float]] = {}
    limits: dict[tuple[str, str, str], float | None] = {}
    for unit in units:
        for item in unit.all:
            for one in item.findings.measured:
                key = one.quantity, ", ".join(str(value) for value in one.conditions.values()), one.unit
                values.setdefault(key, []).append(one.value)
                limits[key] = one.limit
    rows = [
        [
            quantity.replace("_", " "),
            place,
            len(found),
            min(found),
            max(found),
            unit,
            _limit(limits[quantity, place, unit]),
        ]
        for (quantity, place, unit), found in values.items()
    ]
    headers = ["quantity", "of", "values", "lowest", "highest", "unit", "limit"]
    caption = "Over all units and repeats; without a limit: reported, not judged."
    return (
        [{"title": "Measured in the unit tests", "caption": caption, "headers": headers, "rows": rows}] if rows else []
    )


def wrong_table(units: Sequence[UnitResult]) -> list[Document]:
    """Every wrong result: what was sent, expected, received."""
    rows = [
        [unit.unit, title_of(item.item), one.what, one.sent or "nothing", one.expected, one.received]
        for unit in units
        for item in unit.all
        for one in item.findings.wrong
    ]
    if not rows:
        return []
    more = len(rows) - _MOST_WRONG
    caption = f"{more} more are in the folders of the units." if more > 0 else "All of them; payloads as hex bytes."
    headers = ["unit", "item", "what", "sent", "expected", "received"]
    shown = rows[:_MOST_WRONG]
    return [{"title": "Wrong results", "caption": caption, "headers": headers, "rows": shown, "prose": True}]


def _verdict(text: str) -> str:
    return text.upper() if text in ("pass", "fail") else text


def _limit(value: float | None) -> Any:
    return "–" if value is None else value
