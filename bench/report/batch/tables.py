"""Tables of a batch: yield, units, quantities, the worst values, and what is not in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.analysis import cell, decimals_for, number, unit_text, with_uncertainty
from bench.model.texts import Texts
from bench.report.batch.model import Batch, Member, Outcome, Quantity, Spread, Unit, Yield
from bench.report.estimate_tables import readable
from bench.report.tables import Table, column
from bench.report.verdict_tables import percent

_MOST_ROWS = 400


def yield_table(batch: Batch, words: Texts) -> Table:
    """Units that passed, failed and gave no verdict, of all campaigns and of each."""
    rows = [(words("batch.all"), *_yield_cells(batch.yield_of()))]
    if len(batch.campaigns) > 1:
        rows += [(name.replace("_", " "), *_yield_cells(batch.yield_of(name))) for name in batch.campaigns]
    heads = (
        "batch.campaign",
        "batch.units",
        "batch.passed",
        "batch.failed",
        "batch.without",
        "batch.yield",
        "batch.interval",
    )
    return Table(words("batch.yield_table"), tuple(words(key) for key in heads), tuple(rows))


def _yield_cells(found: Yield) -> tuple[str, ...]:
    counts = (found.passed + found.failed + found.without, found.passed, found.failed, found.without)
    if found.share is None:
        return (*map(number, counts), "–", "–")
    low, high = (f"{100 * one:.1f}" for one in found.interval)
    return (*map(number, counts), f"{100 * found.share:.1f} %", f"{low} – {high} %")


def unit_table(batch: Batch, words: Texts) -> Table:
    """Return every unit in every session: judged, failed, verdict; those that did not pass first."""
    parts = sorted(batch.parts, key=lambda part: (part.outcome == Outcome.PASS, part.unit, part.session))
    rows = tuple(
        (
            unit_name(part.unit), part.campaign.replace("_", " "), part.session, number(part.judged),
            number(part.failed), words(f"batch.outcome.{part.outcome}"),
        )
        for part in parts[:_MOST_ROWS]
    )  # fmt: skip
    heads = ("batch.unit", "batch.campaign", "batch.session", "batch.judged", "batch.failed", "batch.verdict")
    key = "batch.unit_table" if len(parts) <= _MOST_ROWS else "batch.unit_table_cut"
    caption = words(key, shown=number(len(rows)), all=number(len(parts)))
    return Table(caption, tuple(words(key) for key in heads), rows, stub=3)


def unit_name(unit: Unit) -> str:
    """Model and serial number."""
    return f"{unit.model} {unit.serial}".strip()


def spread_tables(batch: Batch, words: Texts) -> list[Table]:
    """Return how each quantity is distributed, a table for each campaign."""
    heads = (
        "batch.quantity", "batch.conditions", "batch.measure", "batch.n", "batch.mean", "batch.std", "batch.least",
        "batch.of_unit", "batch.greatest", "batch.of_unit", "batch.limit", "batch.failed", "batch.worst",
    )  # fmt: skip
    tables = []
    for campaign in batch.campaigns:
        spreads = [one for one in batch.spreads if one.quantity.campaign == campaign]
        rows = tuple(_spread_row(one, words) for one in spreads[:_MOST_ROWS])
        key = "batch.spread_table" if len(spreads) <= _MOST_ROWS else "batch.spread_table_cut"
        shown = {"campaign": campaign.replace("_", " "), "shown": number(len(rows)), "all": number(len(spreads))}
        if rows:
            tables.append(Table(words(key, **shown), tuple(words(one) for one in heads), rows, stub=2))
    return tables


def _spread_row(one: Spread, words: Texts) -> tuple[str, ...]:
    scale, unit = readable([{"unit": one.quantity.unit, "value": member.value} for member in one.members])
    places = decimals_for(scale * (one.std or one.least.expanded))
    worst = one.worst
    return (
        one.quantity.name,
        conditions_text(words, one.quantity.where),
        unit_text(unit),
        number(len(one.members)),
        number(scale * one.mean, places),
        "–" if one.std is None else number(scale * one.std, places),
        number(scale * one.least.value, places),
        unit_name(one.least.unit),
        number(scale * one.greatest.value, places),
        unit_name(one.greatest.unit),
        _limit(one.limit, scale),
        number(one.failed) if worst is not None else "–",
        "–" if worst is None else f"{_value(worst, scale)}, {unit_name(worst.unit)}",
    )


def _value(one: Member, scale: float) -> str:
    """With its uncertainty; a count has none."""
    return with_uncertainty(scale * one.value, scale * one.expanded) if one.expanded else number(scale * one.value)


def _limit(limit: float | None, scale: float) -> str:
    if limit is None:
        return "–"
    return f"± {number(scale * limit)}" if limit else "0"


def worst_table(batch: Batch, words: Texts) -> Table | None:
    """The values that most likely are outside their limits; None if nothing is judged."""
    rows = tuple(_worst_row(quantity, one, words) for quantity, one in batch.worst)
    heads = (
        "batch.unit", "batch.quantity", "batch.conditions", "batch.value", "batch.limit", "batch.measure",
        "batch.conformance", "batch.verdict", "batch.session",
    )  # fmt: skip
    return Table(words("batch.worst_table"), tuple(words(key) for key in heads), rows, stub=3) if rows else None


def _worst_row(quantity: Quantity, one: Member, words: Texts) -> tuple[str, ...]:
    scale, unit = readable([{"unit": quantity.unit, "value": one.value}])
    return (
        unit_name(one.unit),
        quantity.name,
        conditions_text(words, quantity.where),
        _value(one, scale),
        _limit(one.limit, scale),
        unit_text(unit),
        "–" if one.probability is None else percent(one.probability),
        words(f"verdict.{one.verdict}"),
        one.session,
    )


def left_out_table(batch: Batch, words: Texts) -> Table | None:
    """Sessions that are not, or not wholly, in the batch."""
    rows = tuple((one.session, one.code, one.text) for one in batch.left_out)
    heads = ("batch.session", "batch.code", "batch.why")
    return Table(words("batch.left_out_table"), tuple(words(key) for key in heads), rows, prose=True) if rows else None


def conditions_text(words: Texts, conditions: Mapping[str, Any], names: Sequence[str] = ()) -> str:
    """Return conditions in words; only those named, if any are."""
    chosen = {name: value for name, value in conditions.items() if not names or name in names}
    return ", ".join(f"{column(words, name)} {cell(value)}" for name, value in chosen.items()) or "–"
