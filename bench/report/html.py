"""The page: sections of text, tables and figures in one self-contained HTML document."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from bench.report.figures import timetable_picture
from bench.report.graphs import analysis_pictures
from bench.report.model import ReportModel
from bench.report.multiples import dsf_picture, residual_picture
from bench.report.numbers import number
from bench.report.style import Picture
from bench.report.tables import (
    Table,
    analysis_tables,
    channel_table,
    coefficient_table,
    documents_table,
    other_table,
    pairs_table,
    pivot_tables,
    scale_factor_tables,
    standards_table,
    verdict_table,
)

_TEMPLATES = Path(__file__).parent / "templates"
WATERMARK = "SIMULATED — not a calibration"


@dataclass(frozen=True)
class Section:
    """A chapter of the page; one without content is left out."""

    name: str
    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = field(default=())

    def __bool__(self) -> bool:
        return bool(self.paragraphs or self.tables or self.pictures)


def build_report(model: ReportModel) -> str:
    """The report as one HTML document that needs no other file, no network and no script.

    The same model gives the same bytes in the same environment; no date and no random id enters.
    """
    sections = [section for build in _SECTIONS if (section := build(model))]
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    template = environment.get_template("report.html.j2")
    return template.render(
        model=model, sections=sections, watermark=WATERMARK if model.simulated else "", verdict=_verdict(model)
    )


def verdict_counts(model: ReportModel) -> Counter[str]:
    """How many estimates carry each verdict other than none."""
    rows = model.results.get("estimates", ())
    return Counter(str(row["verdict"]) for row in rows if row.get("verdict", "none") != "none")


def _verdict(model: ReportModel) -> tuple[str, str]:
    """Class and words of the overall verdict."""
    counts = verdict_counts(model)
    if not counts:
        return "none", "No verdict: no estimate of this campaign is judged by a limit"
    words = ", ".join(f"{number(counts[name])} {name.replace('_', ' ')}" for name in sorted(counts))
    return ("fail" if counts["fail"] or counts["conditional_fail"] else "pass"), f"Verdicts: {words}"


def _summary(model: ReportModel) -> Section:
    results = model.results
    uut = results.get("uut", {})
    quality = results.get("quality", {})
    estimates = results.get("estimates", ())
    lines = {
        "session": results.get("session", ""),
        "campaign": results.get("campaign", ""),
        "unit under test": f"{uut.get('model', '')}, serial number {uut.get('serial', '')}",
        "records": quality.get("records", model.counts.records),
        "frames": quality.get("frames", model.counts.frames),
        "frames lost": quality.get("frames_lost", model.counts.lost),
        "frames bad": quality.get("frames_bad", model.counts.bad),
        "most rows left out of an estimate": max((int(row.get("dropped") or 0) for row in estimates), default=0),
    }
    words = {"records taken again": quality.get("retaken"), "gone on with after a stop": quality.get("splices")}
    lines |= {word: count for word, count in words.items() if count}
    table = pairs_table("The campaign at a glance.", ("item", "value"), lines)
    return Section("summary", "Summary", tables=(table,) if table else ())


def _verdicts(model: ReportModel) -> Section:
    table = verdict_table(model)
    return Section("verdicts", "Verdicts", tables=(table,) if table else ())


def _figures(model: ReportModel) -> Section:
    return Section("figures", "Figures", pictures=tuple(analysis_pictures(model.figures)))


def _explanations(model: ReportModel) -> Section:
    return Section("explanations", "Tables of the analysis", tables=tuple(analysis_tables(model.tables)))


def _scale_factor(model: ReportModel) -> Section:
    picture = dsf_picture(model)
    tables = scale_factor_tables(model)
    return Section("scale-factor", "Scale-factor errors", (), tuple(tables), (picture,) if picture else ())


def _coefficients(model: ReportModel) -> Section:
    table = coefficient_table(model)
    return Section("coefficients", "Temperature coefficients", tables=(table,) if table else ())


def _residuals(model: ReportModel) -> Section:
    picture = residual_picture(model)
    return Section("residuals", "Residuals", pictures=(picture,) if picture else ())


def _others(model: ReportModel) -> Section:
    tables = (channel_table(model), other_table(model))
    return Section("others", "Other results", tables=(*pivot_tables(model), *(table for table in tables if table)))


def _timetable(model: ReportModel) -> Section:
    picture = timetable_picture(model.timetable, model.trace)
    return Section("timetable", "Timetable and temperature", pictures=(picture,) if picture else ())


def _quality(model: ReportModel) -> Section:
    counts = model.counts
    lines = {name.replace("_", " "): value for name, value in model.results.get("quality", {}).items()}
    lines["records carrying a flag"] = counts.flagged
    lines |= {f"flag {name.replace('_', ' ')}": value for name, value in counts.by_flag.items()}
    table = pairs_table("Records and frames; flagged readings stay recorded.", ("item", "count"), lines, prose=False)
    return Section("quality", "Data quality", tables=(table,) if table else ())


def _standards(model: ReportModel) -> Section:
    table = standards_table(model)
    return Section("standards", "Standards used", tables=(table,) if table else ())


def _components(model: ReportModel) -> Section:
    table = documents_table("What the stated uncertainties are made of; largest value per kind.", _rounded(model))
    return Section("components", "Components of uncertainty", tables=(table,) if table else ())


def _rounded(model: ReportModel) -> list[dict[str, object]]:
    """Components with three significant digits: more of an uncertainty says nothing."""
    return [
        {name: float(f"{value:.3g}") if isinstance(value, float) else value for name, value in one.items()}
        for one in model.components
    ]


def _prompts(model: ReportModel) -> Section:
    table = documents_table("What the operator was asked, and the answer.", model.prompts)
    return Section("prompts", "Operator prompts", tables=(table,) if table else ())


def _notes(model: ReportModel) -> Section:
    return Section("notes", "Notes of the analysis", paragraphs=model.notes)


def _provenance(model: ReportModel) -> Section:
    names = ("item", "value")
    tables = (
        pairs_table("What the numbers were computed from, and by what.", names, model.results.get("provenance", {})),
        pairs_table("What wrote the session.", names, model.origin),
        documents_table("The instruments, as they identified themselves.", _identities(model)),
    )
    return Section("provenance", "Provenance", tables=tuple(table for table in tables if table))


def _identities(model: ReportModel) -> list[dict[str, object]]:
    return [{"role": role, **identity} for role, identity in sorted(model.identities.items())]


_SECTIONS: tuple[Callable[[ReportModel], Section], ...] = (
    _summary,
    _timetable,
    _scale_factor,
    _coefficients,
    _residuals,
    _figures,
    _verdicts,
    _others,
    _explanations,
    _quality,
    _standards,
    _components,
    _prompts,
    _notes,
    _provenance,
)
