"""The chapters of a report, whatever it is written to: paragraphs, tables and pictures in their order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from bench.model.texts import Texts
from bench.report.across_tables import across_tables
from bench.report.estimate_tables import (
    channel_table,
    coefficient_table,
    components_table,
    coverage_table,
    other_table,
    pivot_tables,
    scale_factor_tables,
)
from bench.report.model import ReportModel
from bench.report.plots.currents import current_picture, residual_picture
from bench.report.plots.figures import timetable_picture
from bench.report.plots.graphs import analysis_pictures
from bench.report.plots.style import Picture
from bench.report.plots.temperatures import asymmetry_picture, bias_picture, dsf_picture, surroundings_picture
from bench.report.run_tables import (
    channel_quality_table,
    command_parts,
    environment_table,
    hash_table,
    prompt_table,
    quality_table,
    summary_table,
)
from bench.report.standards_tables import identities_table, standards_table
from bench.report.tables import Table, analysis_tables, on_uncertainty, pairs_table, sentence
from bench.report.verdict_tables import verdict_table

_ROLES = ("prepared", "checked", "approved")
_LINES = ("name", "date", "signature")


@dataclass(frozen=True)
class Section:
    """A chapter; one without content is left out."""

    name: str
    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = field(default=())

    def __bool__(self) -> bool:
        return bool(self.paragraphs or self.tables or self.pictures)


def sections_of(model: ReportModel, words: Texts) -> list[Section]:
    """All chapters that have content; every figure is drawn here, once for all that is written."""
    return [section for name, build in _CHAPTERS.items() if (section := build(name, model, words))]


def _chapter(name: str, words: Texts, *parts: Table | Picture | None, paragraphs: tuple[str, ...] = ()) -> Section:
    tables = tuple(one for one in parts if isinstance(one, Table))
    pictures = tuple(one for one in parts if isinstance(one, Picture))
    return Section(name, words(f"section.{name}"), paragraphs, tables, pictures)


def _summary(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, summary_table(model, words))


def _verdicts(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, verdict_table(model, words))


def _results(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, *analysis_tables([table for table in model.tables if table.lead]))


def _scale_factor(name: str, model: ReportModel, words: Texts) -> Section:
    pictures = (dsf_picture(model, words), asymmetry_picture(model, words), current_picture(model, words))
    return _chapter(name, words, *pictures, *scale_factor_tables(model, words))


def _coefficients(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, coefficient_table(model, words))


def _residuals(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, residual_picture(model, words))


def _figures(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, *analysis_pictures(model.figures))


def _others(name: str, model: ReportModel, words: Texts) -> Section:
    across = across_tables(model, words)
    tables = (*pivot_tables(model, words), channel_table(model, words), *across, other_table(model, words))
    return _chapter(name, words, bias_picture(model, words), *tables)


def _uncertainty(name: str, model: ReportModel, words: Texts) -> Section:
    budgets = analysis_tables([table for table in model.tables if on_uncertainty(table) and not table.lead])
    return _chapter(name, words, coverage_table(model, words), components_table(model, words), *budgets)


def _explanations(name: str, model: ReportModel, words: Texts) -> Section:
    others = [table for table in model.tables if not on_uncertainty(table) and not table.lead]
    return _chapter(name, words, *analysis_tables(others))


def _environment(name: str, model: ReportModel, words: Texts) -> Section:
    pictures = (timetable_picture(model.timetable, model.trace, words), surroundings_picture(model, words))
    return _chapter(name, words, *pictures, environment_table(model, words))


def _quality(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, quality_table(model, words), channel_quality_table(model, words))


def _run(name: str, model: ReportModel, words: Texts) -> Section:
    said, tables = command_parts(model, words)
    return _chapter(name, words, *analysis_tables(model.run.tables), *tables, paragraphs=said)


def _prompts(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, prompt_table(model, words))


def _standards(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, standards_table(model, words), identities_table(model, words))


def _notes(name: str, model: ReportModel, words: Texts) -> Section:
    return _chapter(name, words, paragraphs=tuple(map(sentence, model.notes)))


def _provenance(name: str, model: ReportModel, words: Texts) -> Section:
    heads = (words("column.item"), words("column.value"))
    computed = pairs_table(words("provenance.results"), heads, model.results.get("provenance", {}))
    return _chapter(
        name, words, computed, hash_table(model, words), pairs_table(words("provenance.origin"), heads, model.origin)
    )


def _signatures(name: str, model: ReportModel, words: Texts) -> Section:
    headers = ("", *(words(f"signature.{line}") for line in _LINES))
    rows = tuple((words(f"signature.{role}"), *("" for _ in _LINES)) for role in _ROLES)
    caption = words("signature.watermarked" if model.simulated else "signature.table")
    return _chapter(name, words, Table(caption, headers, rows, prose=True, to_fill=True))


_CHAPTERS: dict[str, Callable[[str, ReportModel, Texts], Section]] = {
    "summary": _summary,
    "results": _results,
    "verdicts": _verdicts,
    "scale-factor": _scale_factor,
    "coefficients": _coefficients,
    "residuals": _residuals,
    "figures": _figures,
    "others": _others,
    "uncertainty": _uncertainty,
    "explanations": _explanations,
    "environment": _environment,
    "quality": _quality,
    "run": _run,
    "prompts": _prompts,
    "standards": _standards,
    "notes": _notes,
    "provenance": _provenance,
    "signatures": _signatures,
}
