"""Tables of a batch: yield, units, quantities, the worst values, and what is not in it."""

from __future__ import annotations

from bench.analysis import decimals_for, limits_text, number, unit_text, with_uncertainty
from bench.maths.verdict import meaning_of
from bench.model.systems import is_size
from bench.model.texts import Texts, campaign_title, quantity_title
from bench.report.batch.model import Batch, Member, Quantity, Spread, Unit, Yield
from bench.report.estimate_tables import conditions_text, prefixed
from bench.report.tables import Table, table_of
from bench.report.verdict_tables import percent

_MOST_ROWS = 400


def yield_table(batch: Batch, words: Texts) -> Table:
    """Return units that passed, failed and gave no verdict, of all campaigns and of each."""
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
    return Table(words("batch.yield_table"), tuple(map(words, heads)), tuple(rows))


def _yield_cells(total: Yield) -> tuple[str, ...]:
    counts = (total.passed + total.failed + total.without, total.passed, total.failed, total.without)
    if total.share is None:
        return (*map(number, counts), "–", "–")
    low, high = (f"{100 * share:.1f}" for share in total.interval)
    return (*map(number, counts), f"{100 * total.share:.1f} %", f"{low} – {high} %")


def unit_table(batch: Batch, words: Texts) -> Table:
    """Return every unit in every session: judged, failed, verdict; those that did not pass first."""
    parts = sorted(batch.parts, key=lambda part: (bool(meaning_of(part.outcome).accepts), part.unit, part.session))
    rows = tuple(
        (
            unit_name(part.unit), part.campaign.replace("_", " "), part.session, number(part.judged),
            number(part.failed), number(part.unsound), words(f"batch.outcome.{part.outcome}"),
        )
        for part in parts[:_MOST_ROWS]
    )  # fmt: skip
    heads = (
        *("batch.unit", "batch.campaign", "batch.session", "batch.judged", "batch.failed", "batch.not_sound"),
        "batch.verdict",
    )
    key = "batch.unit_table" if len(parts) <= _MOST_ROWS else "batch.unit_table_cut"
    caption = words(key, shown=number(len(rows)), all=number(len(parts)))
    return Table(caption, tuple(map(words, heads)), rows, stub=3)


def unit_name(unit: Unit) -> str:
    """Return model and serial number."""
    return f"{unit.model} {unit.serial}".strip()


def spread_tables(batch: Batch, words: Texts) -> list[Table]:
    """Return how each quantity is distributed, a table for each campaign."""
    heads = (
        "batch.quantity", "batch.conditions", "batch.measure", "batch.n", "batch.mean", "batch.std", "batch.least",
        "batch.of_unit", "batch.greatest", "batch.of_unit", "batch.limit", "batch.failed", "batch.worst",
    )  # fmt: skip
    tables = []
    for campaign in batch.campaigns:
        spreads = [spread for spread in batch.spreads if spread.quantity.campaign == campaign]
        rows = tuple(_spread_row(spread, words) for spread in spreads[:_MOST_ROWS])
        key = "batch.spread_table" if len(spreads) <= _MOST_ROWS else "batch.spread_table_cut"
        shown = {
            "campaign": campaign_title(campaign, words.language),
            "shown": number(len(rows)),
            "all": number(len(spreads)),
        }
        if rows:
            tables.append(Table(words(key, **shown), tuple(map(words, heads)), rows, stub=2))
    return tables


def _spread_row(spread: Spread, words: Texts) -> tuple[str, ...]:
    scale, unit = prefixed(spread.quantity.unit, [member.value for member in spread.members])
    places = decimals_for(scale * (spread.std or spread.least.expanded))
    worst = spread.worst
    return (
        quantity_title(spread.quantity.campaign, spread.quantity.name, words.language),
        conditions_text(words, spread.quantity.where, spread.quantity.campaign) or "–",
        unit_text(unit),
        number(len(spread.members)),
        number(scale * spread.mean, places),
        "–" if spread.std is None else number(scale * spread.std, places),
        number(scale * spread.least.value, places),
        unit_name(spread.least.unit),
        number(scale * spread.greatest.value, places),
        unit_name(spread.greatest.unit),
        _limits(spread.quantity, spread.limits, scale, words),
        number(spread.failed) if worst is not None else "–",
        "–" if worst is None else f"{_value(worst, scale)}, {unit_name(worst.unit)}",
    )


def _value(member: Member, scale: float) -> str:
    """With its uncertainty; a count has none."""
    return (
        with_uncertainty(scale * member.value, scale * member.expanded)
        if member.expanded
        else number(scale * member.value)
    )


def _limits(quantity: Quantity, limits: tuple[float, float] | None, scale: float, words: Texts) -> str:
    return limits_text(limits, scale, words.all["coverage.span"], size=is_size(quantity.campaign, quantity.name))


def worst_table(batch: Batch, words: Texts) -> Table | None:
    """Return the values that most likely are outside their limits; None if nothing is judged."""
    rows = (_worst_row(quantity, member, words) for quantity, member in batch.worst)
    heads = (
        "batch.unit", "batch.quantity", "batch.conditions", "batch.value", "batch.limit", "batch.measure",
        "batch.conformance", "batch.verdict", "batch.session",
    )  # fmt: skip
    return table_of(words, words("batch.worst_table"), heads, rows, stub=3)


def _worst_row(quantity: Quantity, member: Member, words: Texts) -> tuple[str, ...]:
    scale, unit = prefixed(quantity.unit, [member.value])
    return (
        unit_name(member.unit),
        quantity_title(quantity.campaign, quantity.name, words.language),
        conditions_text(words, quantity.where, quantity.campaign) or "–",
        _value(member, scale),
        _limits(quantity, member.limits, scale, words),
        unit_text(unit),
        "–" if member.probability is None else percent(member.probability),
        words(f"verdict.{member.verdict}"),
        member.session,
    )


def left_out_table(batch: Batch, words: Texts) -> Table | None:
    """Return sessions that are not, or not wholly, in the batch."""
    rows = ((left_out.session, left_out.code, left_out.text) for left_out in batch.left_out)
    heads = ("batch.session", "batch.code", "batch.why")
    return table_of(words, words("batch.left_out_table"), heads, rows, prose=True)
