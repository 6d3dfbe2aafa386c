"""Predicted against achieved uncertainties: a table of all quantities, and sentences on those that differ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bench.analysis import NOTED, ORDINARY, Agreement, agreements, number, significant, unit_text
from bench.model.texts import Texts, told
from bench.report.estimate_tables import prefixed, span, two_places
from bench.report.model import ReportModel
from bench.report.tables import Table, grouped, table_of

_HEADERS = (
    "column.quantity", "column.unit", "coverage.count", "agreement.predicted", "agreement.achieved", "agreement.ratio",
)  # fmt: skip


def agreement_parts(model: ReportModel, words: Texts) -> tuple[tuple[str, ...], Table | None]:
    """Return the sentences and the table; none where nothing was predicted."""
    by_quantity = grouped(agreements(model.predicted, model.rows), lambda pair: pair.predicted.quantity)
    planned = [entry.quantity for entry in model.predicted]
    rows = (_row(model, words, group, planned.count(quantity)) for quantity, group in by_quantity.items())
    caption = words("agreement.table", per_cent=number(100.0 * NOTED), ordinary=number(100.0 * ORDINARY))
    return tuple(_sentences(model, words, by_quantity)), table_of(words, caption, _HEADERS, rows, stub=2)


def _row(model: ReportModel, words: Texts, group: Sequence[Agreement], planned: int) -> tuple[str, ...]:
    before, after = (
        [float(entry.expanded_uncertainty) for entry in entries]
        for entries in ([pair.predicted for pair in group], [pair.achieved for pair in group])
    )
    quantity, unit = group[0].predicted.quantity, group[0].predicted.unit
    scale, shown = prefixed(unit, [*before, *after])
    count = str(planned) if len(group) == planned else words("agreement.count", known=len(group), planned=planned)
    spans = (span(words, [scale * U for U in values], significant) for values in (before, after))
    ratio = span(words, [pair.ratio for pair in group], two_places)
    return model.title_of(quantity, words.language), unit_text(shown), count, *spans, ratio


def _sentences(model: ReportModel, words: Texts, by_quantity: dict[str, list[Agreement]]) -> Iterator[str]:
    """Yield one sentence for each error that has grown, one for what none explains, one for what is below."""
    noted: dict[tuple[bool, str], list[str]] = {}
    for quantity, group in by_quantity.items():
        outside = [pair for pair in group if pair.is_noted]
        for cause, pairs in grouped(outside, lambda pair: (pair.ratio > 1.0, pair.grown)).items():
            side = "above" if cause[0] else "below"
            most = max((pair.ratio for pair in pairs), key=lambda ratio: abs(ratio - 1.0))
            name = model.title_of(quantity, words.language)
            counted = words(
                f"agreement.counted_{side}", quantity=name, count=len(pairs), of=len(group), most=two_places(most)
            )
            noted.setdefault(cause, []).append(counted)
    per_cent = number(100.0 * NOTED)
    for (above, grown), listed in noted.items():
        key = "above_by" if above and grown else "above" if above else "below"
        error = told(grown, words.language)
        yield words(f"agreement.{key}", per_cent=per_cent, error=error, quantities="; ".join(listed))
