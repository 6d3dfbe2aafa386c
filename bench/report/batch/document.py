"""A batch for machines and for people: batch.json with its numbers, and one self-contained HTML page.

The same sessions give the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from bench.analysis import results_json
from bench.maths.verdict import meaning_of, worst
from bench.model.texts import ENGLISH, Texts
from bench.report.batch.model import Batch, Member, Spread, Yield
from bench.report.batch.tables import left_out_table, spread_tables, unit_table, worst_table, yield_table
from bench.report.document import page
from bench.report.sections import Section
from bench.report.tables import words_of


def batch_json(batch: Batch, software: str) -> str:
    """Return the document as text: sorted keys, one newline at its end."""
    return results_json(batch_document(batch, software))


def batch_document(batch: Batch, software: str) -> dict[str, Any]:
    """Return units, sessions, yield and quantities as plain values; every value in the unit that stands beside it."""
    return {
        "schema": 1,
        "software": software,
        "simulated": bool(batch.simulated),
        "yield": {
            "units": _yield(batch.yield_of()),
            "campaigns": {name: _yield(batch.yield_of(name)) for name in batch.campaigns},
        },
        "units": [{**unit._asdict(), "verdict": outcome} for unit, outcome in batch.outcomes.items()],
        "parts": [
            {
                **part.unit._asdict(), "session": part.session, "campaign": part.campaign, "judged": part.judged,
                "failed": part.failed, "verdict": part.outcome, "not_sound": part.unsound,
            }
            for part in batch.parts
        ],
        "sessions": [
            {
                "session": name, "session_sha256": sha256, "simulated": name in batch.simulated,
                "damaged": name in batch.damaged,
            }
            for name, sha256 in batch.hashes.items()
        ],
        "left_out": [vars(left_out) for left_out in batch.left_out],
        "quantities": [_spread(spread) for spread in batch.spreads],
        "worst": [
            {"quantity": quantity.name, "unit": quantity.unit, "conditions": quantity.where, **_member(member)}
            for quantity, member in batch.worst
        ],
    }  # fmt: skip


def _yield(total: Yield) -> dict[str, Any]:
    return {
        "pass": total.passed, "fail": total.failed, "without_verdict": total.without, "yield": total.share,
        "interval_95": list(total.interval),
    }  # fmt: skip


def _member(member: Member) -> Mapping[str, Any]:
    return {
        **member.unit._asdict(), "session": member.session, "value": member.value,
        "expanded_uncertainty": member.expanded, **_limits(member.limits), "verdict": member.verdict,
        "conformance_probability": member.probability,
    }  # fmt: skip


def _limits(limits: tuple[float, float] | None) -> dict[str, Any]:
    """Return limits as results.json has them: a number for those that are alike, else both ends."""
    if limits is None or limits[0] == -limits[1]:
        return {"limit": None if limits is None else limits[1]}
    low, high = (limit if math.isfinite(limit) else None for limit in limits)
    return {"limit": None, "limits": {"low": low, "high": high}}


def _spread(spread: Spread) -> dict[str, Any]:
    return {
        "campaign": spread.quantity.campaign, "quantity": spread.quantity.name, "unit": spread.quantity.unit,
        "conditions": spread.quantity.where, "n": len(spread.members), "mean": spread.mean, "std": spread.std,
        **_limits(spread.limits), "failed": spread.failed, "min": _member(spread.least),
        "max": _member(spread.greatest),
        "worst": None if spread.worst is None else _member(spread.worst),
    }  # fmt: skip


def batch_html(batch: Batch, software: str) -> str:
    """Return the page; the same sessions give the same bytes in the same environment, no date or random id enters."""
    words = words_of(ENGLISH)
    title = words("batch.title", units=len(batch.outcomes))
    subtitle = words("batch.subtitle", sessions=len({part.session for part in batch.parts}), software=software)
    sections = [section for section in _sections(batch, words) if section]
    return page(title, subtitle, sections, words, verdict=_verdict(batch, words), simulated=bool(batch.simulated))


def _verdict(batch: Batch, words: Texts) -> tuple[str, str]:
    total = batch.yield_of()
    text = words("batch.summary", passed=total.passed, failed=total.failed, without=total.without)
    if batch.doubted:
        text = f"{text}; {words('batch.doubted', units=len(batch.doubted))}"
    return meaning_of(worst(batch.outcomes.values())).look, text


def _sections(batch: Batch, words: Texts) -> Iterator[Section]:
    from bench.report import plots  # with matplotlib

    mixed = batch.simulated and len(set(batch.simulated)) < len({part.session for part in batch.parts})
    notes = (words("batch.mixed", sessions=", ".join(batch.simulated)),) if mixed else ()
    said = (*notes, words("batch.how"))
    yield Section("yield", words("batch.section.yield"), said, (yield_table(batch, words),))
    if left_out := left_out_table(batch, words):
        yield Section("left-out", words("batch.section.left_out"), (), (left_out,))
    if worst := worst_table(batch, words):
        yield Section("worst", words("batch.section.worst"), (words("batch.said.worst"),), (worst,))
    yield Section("strips", words("batch.section.strips"), pictures=tuple(plots.strip_pictures(batch, words)))
    if batch.values:
        tables = tuple(spread_tables(batch, words))
        yield Section("quantities", words("batch.section.quantities"), (words("batch.said.quantities"),), tables)
    if batch.parts:
        units = (unit_table(batch, words),)
        yield Section("units", words("batch.section.units"), (words("batch.said.units"),), units)
