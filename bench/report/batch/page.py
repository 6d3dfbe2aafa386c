"""The page of a batch: one self-contained HTML document about many sessions."""

from __future__ import annotations

from bench.model.texts import ENGLISH, Texts
from bench.report.batch.model import Batch, Outcome
from bench.report.batch.strips import strip_pictures
from bench.report.batch.tables import left_out_table, spread_tables, unit_table, worst_table, yield_table
from bench.report.html import page
from bench.report.sections import Section
from bench.report.words import words_of


def batch_html(batch: Batch, software: str, language: str = ENGLISH) -> str:
    """The page; the same sessions give the same bytes in the same environment, no date and no random id enters."""
    words = words_of(language)
    title = words("batch.title", units=len(batch.outcomes))
    subtitle = words("batch.subtitle", sessions=len({part.session for part in batch.parts}), software=software)
    sections = [section for section in _sections(batch, words) if section]
    return page(title, subtitle, sections, words, verdict=_verdict(batch, words), simulated=bool(batch.simulated))


def _verdict(batch: Batch, words: Texts) -> tuple[str, str]:
    found = batch.yield_of()
    text = words("batch.summary", passed=found.passed, failed=found.failed, without=found.without)
    return (Outcome.FAIL if found.failed else Outcome.PASS if found.passed else "none"), text


def _sections(batch: Batch, words: Texts) -> list[Section]:
    left_out, worst = left_out_table(batch, words), worst_table(batch, words)
    mixed = batch.simulated and len(set(batch.simulated)) < len({part.session for part in batch.parts})
    notes = (words("batch.mixed", sessions=", ".join(batch.simulated)),) if mixed else ()
    said = (*notes, words("batch.how"))
    return [
        Section("yield", words("batch.section.yield"), said, (yield_table(batch, words),)),
        Section("left-out", words("batch.section.left_out"), (), (left_out,) if left_out else ()),
        Section(
            "worst",
            words("batch.section.worst"),
            (words("batch.said.worst"),) if worst else (),
            (worst,) if worst else (),
        ),
        Section("strips", words("batch.section.strips"), (), (), tuple(strip_pictures(batch, words))),
        Section(
            "quantities",
            words("batch.section.quantities"),
            (words("batch.said.quantities"),) if batch.values else (),
            tuple(spread_tables(batch, words)),
        ),
        Section(
            "units",
            words("batch.section.units"),
            (words("batch.said.units"),) if batch.parts else (),
            (unit_table(batch, words),) if batch.parts else (),
        ),
    ]
