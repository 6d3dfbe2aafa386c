"""Tables of the unit tests: units, items, measured values, wrong results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from bench.analysis import Table
from bench.systems.gnc.unit_test.units import IDENTITY, ITEMS, SUPPLY, UnitResult

_MOST_WRONG = 200  # rows that are printed; the folders of the units hold all


def title_of(item: str) -> str:
    """Return name of an item as people read it."""
    return {SUPPLY: "supply", IDENTITY: "identity"}.get(item, ITEMS.get(item, item))


def unit_table(units: Sequence[UnitResult], offset_s: float | None) -> Table:
    """Start, elapsed time, end and verdict of each unit; ``offset_s``: UTC minus bench clock, None if unknown."""
    rows: list[list[Any]] = []
    for unit in units:
        span_s = unit.span_s
        times: list[Any] = ["–", "–", "–"]
        if span_s is not None:
            times = [_moment(span_s[0], offset_s), f"{span_s[1] - span_s[0]:.3f}", _moment(span_s[1], offset_s)]
        failed = ", ".join(title_of(item.item) for item in unit.all if item.verdict == "fail") or "–"
        rows.append([unit.unit, *times, len(unit.wrong), failed, _verdict(unit.verdict)])
    clock = "s" if offset_s is None else "UTC"
    headers = ["unit", f"start / {clock}", "elapsed / s", f"end / {clock}", "wrong results", "failed", "verdict"]
    caption = "Times from the first to the last test; PASS only if everything was tested."
    return Table("Units tested", caption, headers, rows, prose=True, lead=True)


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
    caption = (
        "The six rows of table 1 of the GNC-module paper, IO, SPI, SCI and CAN of its section 3 (2), and the supply "
        "of its table 3. Position, velocity and timing accuracy of the receiver are not tested here."
    )
    headers = ["unit", *map(title_of, names)]
    title = "Table 1: unit tests"
    return Table(title, caption, headers, rows, prose=True, lead=True)


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
            quantity.replace("_", " "),
            place,
            len(members),
            min(members),
            max(members),
            unit,
            _limit(limits[quantity, place, unit]),
        ]
        for (quantity, place, unit), members in values.items()
    ]
    headers = ["quantity", "of", "values", "lowest", "highest", "unit", "limit"]
    caption = "Over all units and repeats; without a limit: reported, not judged."
    return [Table("Measured in the unit tests", caption, headers, rows)] if rows else []


def wrong_table(units: Sequence[UnitResult]) -> list[Table]:
    """Return every wrong result: what was sent, expected, received."""
    rows = [
        [unit.unit, title_of(item.item), wrong.what, wrong.sent or "nothing", wrong.expected, wrong.received]
        for unit in units
        for item in unit.all
        for wrong in item.findings.wrong
    ]
    if not rows:
        return []
    more = len(rows) - _MOST_WRONG
    caption = f"{more} more are in the folders of the units." if more > 0 else "All of them; payloads as hex bytes."
    headers = ["unit", "item", "what", "sent", "expected", "received"]
    return [Table("Wrong results", caption, headers, rows[:_MOST_WRONG], prose=True, lead=True)]


def _verdict(text: str) -> str:
    return text.upper() if text in ("pass", "fail") else text


def _place(conditions: Mapping[str, Any]) -> str:
    """Words as they are, numbers with their name: ``supply``, ``setting ms 0.5``."""
    said = (
        value if isinstance(value, str) else f"{name.replace('_', ' ')} {value:g}" for name, value in conditions.items()
    )
    return ", ".join(said) or "–"


def _limit(value: float | None) -> Any:
    return "–" if value is None else f"{value:g}"
