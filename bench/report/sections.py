"""The chapters of a report, whatever it is written to: paragraphs, tables and pictures in their order.

Results come first; what they rest on, which few read and some look up, is an annex with letters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from string import ascii_uppercase

from bench.model.texts import Texts, told
from bench.report.estimate_tables import (
    across_tables,
    channel_table,
    coefficient_table,
    components_table,
    coverage_table,
    other_table,
    pivot_tables,
    scale_factor_tables,
)
from bench.report.model import Picture, ReportModel
from bench.report.run_tables import (
    channel_quality_table,
    command_parts,
    computed_from,
    environment_table,
    hash_table,
    identities_table,
    prompt_table,
    provenance,
    quality_table,
    standards_table,
    summary_table,
    written_by,
)
from bench.report.tables import Table, analysis_tables, on_uncertainty, pairs_table, sentence
from bench.report.verdict_tables import agreement_parts, assumption_table, verdict_table


@dataclass(frozen=True)
class Section:
    """A chapter; one without content is left out. ``annex``: its letter, if it is one of the annex."""

    name: str
    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = field(default=())
    annex: str = ""

    def __bool__(self) -> bool:
        return bool(self.paragraphs or self.tables or self.pictures)


def sections_of(model: ReportModel, words: Texts) -> list[Section]:
    """Return all chapters that have content; every figure is drawn here, once for all that is written."""
    body = [section for section in (*_on_results(model, words), *_on_the_run(model, words)) if section]
    annex = [section for section in _annex(model, words) if section]
    return body + [
        replace(section, annex=letter, title=words("annex.title", letter=letter, title=section.title))
        for letter, section in zip(ascii_uppercase, annex, strict=False)
    ]


def _chapter(words: Texts, name: str, *parts: Table | Picture | None, paragraphs: tuple[str, ...] = ()) -> Section:
    tables = tuple(told(part, words.language) for part in parts if isinstance(part, Table))
    pictures = tuple(part for part in parts if isinstance(part, Picture))
    return Section(name, words(f"section.{name}"), paragraphs, tables, pictures)


def _on_results(model: ReportModel, words: Texts) -> Iterator[Section]:
    """Yield the chapters on what was found, and how well."""
    from bench.report import plots  # with matplotlib

    chapter, title = partial(_chapter, words), partial(model.title_of, language=words.language)
    yield chapter("summary", summary_table(model, words))
    yield chapter("results", *analysis_tables([table for table in model.tables if table.lead], words.language, title))
    yield chapter("verdicts", verdict_table(model, words))
    pictures = [draw(model, words) for draw in (plots.dsf_picture, plots.asymmetry_picture, plots.current_picture)]
    yield chapter("scale-factor", *pictures, *scale_factor_tables(model, words))
    yield chapter("coefficients", coefficient_table(model, words))
    yield chapter("figures", *plots.analysis_pictures(told(model.figures, words.language), title))
    tables = (*pivot_tables(model, words), channel_table(model, words), *across_tables(model, words))
    yield chapter("others", plots.bias_picture(model, words), *tables, other_table(model, words))
    yield chapter("uncertainty", coverage_table(model, words))
    yield chapter("assumptions", assumption_table(model, words))


def _annex(model: ReportModel, words: Texts) -> Iterator[Section]:
    """Yield what the results rest on: what the fits left, budgets, further tables, and what computed it all."""
    from bench.report import plots  # with matplotlib

    chapter, title = partial(_chapter, words), partial(model.title_of, language=words.language)
    budgets = [table for table in model.tables if on_uncertainty(table) and not table.lead]
    others = [table for table in model.tables if not on_uncertainty(table) and not table.lead]
    yield chapter("residuals", plots.residual_picture(model, words), *pivot_tables(model, words, residuals=True))
    yield chapter("budgets", components_table(model, words), *analysis_tables(budgets, words.language, title))
    said, agreed = agreement_parts(model, words)
    yield chapter("agreement", agreed, paragraphs=said)
    yield chapter("explanations", *analysis_tables(others, words.language, title))
    heads = (words("column.item"), words("column.value"))
    computed = pairs_table(words("provenance.results"), heads, provenance(computed_from(model), words))
    origin = pairs_table(words("provenance.origin"), heads, provenance(written_by(model), words))
    yield chapter("provenance", identities_table(model, words), computed, hash_table(model, words), origin)


def _on_the_run(model: ReportModel, words: Texts) -> Iterator[Section]:
    """Yield the chapters on how it was found, and by whom."""
    from bench.report import plots  # with matplotlib

    chapter = partial(_chapter, words)
    timetable = plots.timetable_picture(model.timetable, model.trace, words)
    pictures = (timetable, plots.surroundings_picture(model, words))
    yield chapter("environment", *pictures, environment_table(model, words))
    yield chapter("quality", quality_table(model, words), channel_quality_table(model, words))
    said, tables = command_parts(model, words)
    yield chapter("run", *analysis_tables(model.run.tables, words.language), *tables, paragraphs=said)
    yield chapter("prompts", prompt_table(model, words))
    yield chapter("standards", standards_table(model, words))
    title = partial(model.title_of, language=words.language)
    yield chapter("notes", paragraphs=tuple(sentence(note, title) for note in told(model.notes, words.language)))
