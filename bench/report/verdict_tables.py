"""Tables of the verdicts: each judged value with its limit; doubt, what no data can show, what was predicted."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from bench.analysis import (
    NOTED,
    ORDINARY,
    Agreement,
    Estimate,
    agreements,
    doubt_lines,
    is_sound,
    limits_of,
    limits_text,
    number,
    significant,
    unit_text,
    use_of,
)
from bench.maths.verdict import Verdict, count_verdicts, meaning_of, worst
from bench.model.systems import is_size
from bench.model.texts import Texts, sizes_of_assumptions, told
from bench.report.estimate_tables import prefixed, readable, span, two_places, value_text
from bench.report.model import ReportModel
from bench.report.tables import Table, grouped, sentence, table_of

_HEADERS = ("quantity", "channel", "judged", "worst", "limit", "unit", "conformance", "verdicts")
_ASSUMED = ("taken_for_granted", "unseen", "effect", "shown_by")
_CHANNEL = 1  # its column
_NO_CHANNEL = "–"
_AGREED = (
    "column.quantity", "column.unit", "coverage.count", "agreement.predicted", "agreement.achieved", "agreement.ratio",
)  # fmt: skip


def overall_verdict(model: ReportModel, words: Texts) -> tuple[str, str]:
    """Return look (of ``bench.maths.verdict``) and words of the overall verdict."""
    counts = count_verdicts(row.verdict for row in model.rows)
    if not counts:
        return "none", words(f"verdicts.{_lacking(model) or 'none'}")
    return meaning_of(worst(counts)).look, words("verdicts.overall", counts=_listed(words, counts))


def _lacking(model: ReportModel) -> str:
    """Return why a report is one of a part of its campaign, as its texts are keyed; "" for one of all of it."""
    if not model.results.get("incomplete"):
        return ""
    return "left_out" if model.run.left_out else "incomplete"


def doubt_paragraphs(model: ReportModel, words: Texts) -> tuple[str, ...]:
    """Return what casts doubt on all of it, what is not sound and why, and what that means; () without doubt."""
    lacking = _lacking(model)
    said = [words(f"doubt.{lacking}")] if lacking else []
    said += [words("doubt.damaged", count=number(model.run.damage))] if model.run.damage else []
    lines = doubt_lines(model.rows)
    title = partial(model.title_of, language=words.language)
    said += [sentence(line, title) for line in told(lines, words.language)]
    return (*said, words("doubt.means")) if lines else tuple(said)


def assumption_table(model: ReportModel, words: Texts) -> Table | None:
    """Return what the data cannot show: each assumption with the size that passes unseen; None if none is named."""
    taken = model.results.get("assumptions", ())
    title = partial(model.title_of, language=words.language)
    rows = (tuple(sentence(told(entry[name], words.language), title) for name in _ASSUMED) for entry in taken)
    headers = (f"column.{name}" for name in _ASSUMED)
    sizes = sizes_of_assumptions(model.analysis, words.language)
    return table_of(words, f"{words('assumptions.table')} {sizes}".rstrip(), headers, rows, prose=True)


def verdict_table(model: ReportModel, words: Texts) -> Table | None:
    """Return verdicts, one row per quantity and channel: the estimate nearest to its limit; None without verdicts."""
    analysis = model.analysis
    limited = [row for row in model.rows if limits_of(row) is not None and row.verdict != "none"]
    judged = grouped(limited, lambda row: (row.quantity, row.conditions.get("channel", _NO_CHANNEL)))
    rows = tuple(
        (model.title_of(quantity, words.language), *_row(words, channel, group, size=is_size(analysis, quantity)))
        for (quantity, channel), group in judged.items()
    )
    rule = model.results.get("decision_rule")
    sentences = [words("verdicts.table")]
    sentences += [words("verdicts.rule", rule=words(f"rule.{rule}"))] if rule else []
    caption = " ".join([*sentences, words("verdicts.conformance")])
    if not rows:
        return None
    channels = any(channel != _NO_CHANNEL for _, channel in judged)
    shown = [index for index in range(len(_HEADERS)) if channels or index != _CHANNEL]
    headers = tuple(words(f"column.{_HEADERS[index]}") for index in shown)
    cells = tuple(tuple(row[index] for index in shown) for row in rows)
    return Table(caption, headers, cells, stub=2 if channels else 1)


def used(row: Estimate) -> float:
    """Return how much of its limits a value with its interval uses."""
    limits = limits_of(row)
    if limits is None or not is_sound(row):
        return -math.inf
    return use_of(float(row.value), limits, float(row.expanded_uncertainty or 0.0))


def _row(words: Texts, channel: Any, group: Sequence[Estimate], *, size: bool) -> tuple[str, ...]:
    worst = max(group, key=lambda row: (used(row), abs(row.value or 0.0)))
    scale, unit = readable([worst])
    probability = worst.conformance_probability
    return (
        str(channel),
        str(len(group)),
        value_text(worst, scale),
        limits_text(limits_of(worst), scale, words.all["coverage.span"], size=size),
        unit_text(unit),
        "–" if probability is None or not worst.expanded_uncertainty else percent(probability),
        _listed(words, count_verdicts(row.verdict for row in group)),
    )


def _listed(words: Texts, counts: Mapping[Verdict, int]) -> str:
    of_each = ((number(count), words(f"verdict.{verdict}")) for verdict, count in counts.items())
    return ", ".join(words("verdict.counted", count=count, verdict=verdict) for count, verdict in of_each)


def percent(probability: float) -> str:
    """Per cent, never rounded up to certainty."""
    return "> 99.99 %" if probability > 0.9999 else f"{100.0 * probability:.2f} %"


def agreement_parts(model: ReportModel, words: Texts) -> tuple[tuple[str, ...], Table | None]:
    """Return the sentences and the table; none where nothing was predicted."""
    by_quantity = grouped(agreements(model.predicted, model.rows), lambda pair: pair.predicted.quantity)
    planned = [entry.quantity for entry in model.predicted]
    rows = (_agreed_row(model, words, group, planned.count(quantity)) for quantity, group in by_quantity.items())
    caption = words("agreement.table", per_cent=number(100.0 * NOTED), ordinary=number(100.0 * ORDINARY))
    return tuple(_sentences(model, words, by_quantity)), table_of(words, caption, _AGREED, rows, stub=2)


def _agreed_row(model: ReportModel, words: Texts, group: Sequence[Agreement], planned: int) -> tuple[str, ...]:
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
