"""The chapters of a report, whatever it is written to: paragraphs, tables and pictures in their order.

Results come first; what they rest on, which few read and some look up, is an annex with letters.

Tables on the run itself: at a glance, its surroundings, records, prompts, commands, alarms, hashes; its standards
and instruments: which certificates counted at the time of the run, and what the instruments said.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from functools import partial
from string import ascii_uppercase
from typing import Any

import numpy as np

from bench.analysis import Floats, cell, number, unit_text
from bench.model.texts import Texts, campaign_title, told
from bench.report.estimate_tables import (
    across_tables,
    channel_table,
    coefficient_table,
    components_table,
    coverage_table,
    other_table,
    pivot_tables,
    prefixed,
    scale_factor_tables,
)
from bench.report.model import Picture, ReportModel
from bench.report.tables import (
    Table,
    analysis_tables,
    documents_table,
    on_uncertainty,
    pairs_table,
    place_of,
    rank,
    role_of,
    sentence,
    table_of,
)
from bench.report.verdict_tables import agreement_parts, assumption_table, verdict_table

_COUNTS = ("records", "flagged", "frames", "bad", "lost")
_OF_FRAMES = ("frames", "lost", "bad")
_HOUR_s, _LARGE = 3600.0, 1e6
_HEADERS = ("role", "model", "serial", "certificate", "calibrated", "due", "days_left", "corrections")


def summary_table(model: ReportModel, words: Texts) -> Table | None:
    """Return the campaign at a glance."""
    results, quality = model.results, model.results.get("quality", {})
    uut = results.get("uut", {})
    lines = {
        "session": results.get("session", ""),
        "campaign": campaign_title(str(results.get("campaign", "")), words.language),
        "uut": words("summary.unit", model=uut.get("model", ""), serial=uut.get("serial", "")),
        "started": model.started_utc.replace("T", " ").replace("Z", " UTC"),
        "length": duration(model.run.length_s),
        "records": quality.get("records", model.counts.records),
        "frames": quality.get("frames", model.counts.frames),
        "lost": quality.get("frames_lost", model.counts.lost),
        "bad": quality.get("frames_bad", model.counts.bad),
        "dropped": max((row.dropped for row in model.rows), default=0),
    }
    for name in _not_counted(model):
        lines.pop(name)
    check = model.campaign.get("check_standard")
    if check is not None:
        lines["check_standard"] = words("summary.of_check", **check)
    lines |= {name: quality[name] for name in ("retaken", "splices") if quality.get(name)}
    named = {words(f"summary.{name}"): value for name, value in lines.items() if value != ""}
    return pairs_table(words("summary.table"), (words("column.item"), words("column.value")), named)


def _not_counted(model: ReportModel) -> tuple[str, ...]:
    """Return the counts that a session cannot have: a log has no records, a bench without a link no frames."""
    if not model.counts.records and not any(model.results.get("quality", {}).values()):
        return ("records", *_OF_FRAMES)
    return () if model.results.get("provenance", {}).get("frame_sha256", "–") else _OF_FRAMES


def duration(seconds: float) -> str:
    """Return hours, minutes and seconds; empty if unknown."""
    if not math.isfinite(seconds):
        return ""
    whole = round(seconds)
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min {whole % 60:02d} s"


def environment_table(model: ReportModel, words: Texts) -> Table | None:
    """Return least, mean and greatest temperature of the chamber's air, the unit and its surroundings over the run."""
    places = {words("environment.air"): model.trace.air_degC, words("environment.unit"): model.trace.unit_degC}
    places |= {
        _place(surrounding.name, surrounding.laboratory, words): surrounding.degC
        for surrounding in model.run.surroundings
    }
    rows = ((name, *_span(values)) for name, values in places.items() if np.isfinite(values).any())
    headers = ("environment.place", "environment.least", "environment.mean", "environment.greatest", "environment.n")
    return table_of(words, words("environment.table"), headers, rows)


def _place(name: str, laboratory: bool, words: Texts) -> str:
    place = place_of(words, name)
    return words("environment.laboratory", channel=place) if laboratory else place


def _span(values: Floats) -> tuple[str, ...]:
    known = values[np.isfinite(values)]
    return (*(number(float(value), 2) for value in (known.min(), known.mean(), known.max())), number(known.size))


def quality_table(model: ReportModel, words: Texts) -> Table | None:
    """Return records and frames of the session; flagged readings stay recorded."""
    counts = model.counts
    quality: Mapping[str, Any] = model.results.get("quality", {})
    if not any(quality.values()) and not counts.records:
        return None  # a log of another system has no frames
    of_frames = "frames" in _not_counted(model)
    lines: dict[str, Any] = {
        words.all.get(f"quality.{name}", name): value
        for name, value in quality.items()
        if not (of_frames and name.startswith("frames"))
    }
    lines[words("quality.flagged")] = counts.flagged
    lines |= {words("quality.flag", flag=name.replace("_", " ")): value for name, value in counts.by_flag.items()}
    return pairs_table(words("quality.table"), (words("column.item"), words("column.count")), lines, prose=False)


def channel_quality_table(model: ReportModel, words: Texts) -> Table | None:
    """Return records and frames of each channel, where records belong to one."""
    rows = ((str(channel), *map(number, counts)) for channel, counts in model.counts.by_channel.items())
    headers = ("column.channel", *(f"quality.by_channel.{name}" for name in _COUNTS))
    return table_of(words, words("quality.by_channel"), headers, rows)


def prompt_table(model: ReportModel, words: Texts) -> Table | None:
    """Return what the operator was asked, what was allowed, the answer and who gave it."""
    rows = (
        (
            cell(prompt.get("step")),
            unit_text(cell(prompt.get("text"))),
            _allowed(prompt),
            _amount(prompt.get("value"), prompt.get("unit")),
            words.all.get(f"by.{prompt.get('by')}") or cell(prompt.get("by")),
        )
        for prompt in model.prompts
    )
    headers = ("column.step", "prompts.text", "prompts.allowed", "prompts.answer", "prompts.by")
    return table_of(words, words("prompts.table"), headers, rows, prose=True)


def _allowed(prompt: Mapping[str, Any]) -> str:
    low, high, unit = prompt.get("low"), prompt.get("high"), prompt.get("unit")
    bounds = [f"≥\u00a0{_amount(low, unit)}"] if low is not None else []
    bounds += [f"≤\u00a0{_amount(high, unit)}"] if high is not None else []
    return ", ".join(bounds) or "–"


def _amount(value: Any, unit: str | None) -> str:
    """Return a value with its unit as people write it: megohms, and hours from one hour on."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return cell(value)
    scale, shown = 1.0, unit or ""
    if shown == "s" and abs(value) >= _HOUR_s:
        scale, shown = 1.0 / _HOUR_s, "h"
    elif abs(value) >= _LARGE:
        scale, shown = prefixed(shown, [value])
    scaled = scale * value
    text = number(scaled, 0) if float(scaled).is_integer() else number(scaled)
    return f"{text}\u00a0{unit_text(shown)}".rstrip("\u00a0")


def command_parts(model: ReportModel, words: Texts) -> tuple[tuple[str, ...], tuple[Table, ...]]:
    """Return tables of commands and alarms, and a sentence for each that is empty; nothing for a foreign log."""
    if not math.isfinite(model.run.length_s):
        return (), ()
    said, tables = [], []
    for name, documents in (("commands", model.run.commands), ("alarms", model.run.alarms)):
        table = documents_table(words, words(f"run.{name}"), documents)
        if table is None:
            said.append(words(f"run.no_{name}"))
        else:
            tables.append(table)
    return tuple(said), tuple(tables)


def hash_table(model: ReportModel, words: Texts) -> Table | None:
    """Return SHA-256 of every text the run was made from."""
    heads = (words("provenance.file"), "SHA-256")
    rows = tuple(sorted(model.run.hashes.items()))
    return Table(words("provenance.hashes"), heads, rows, prose=True) if rows else None


def computed_from(model: ReportModel) -> dict[str, Any]:
    """Return what the numbers were computed from; a log has neither plan nor frame, its mapping is among the texts."""
    pairs = dict(model.results.get("provenance", {}))
    if model.of_a_log:
        pairs = {name: value for name, value in pairs.items() if name not in ("plan_sha256", "frame_sha256")}
    return pairs


def written_by(model: ReportModel) -> dict[str, Any]:
    """Return what wrote the session; a log was written by nothing here, a mapping stands where a sequence would."""
    pairs = dict(model.origin)
    if not model.of_a_log:
        return pairs
    return {"mapping": pairs.pop("sequence", "–")} | {name: value for name, value in pairs.items() if name != "clock"}


def provenance(pairs: Mapping[str, Any], words: Texts) -> dict[str, Any]:
    """Return the names and answers of a document on where something comes from in words."""
    said = {True: words("yes"), False: words("no")}
    nested = {name: value for name, value in pairs.items() if isinstance(value, Mapping)}
    return {
        words.all.get(f"provenance.of.{name}") or name: said[value] if isinstance(value, bool) else value
        for name, value in pairs.items()
        if name not in nested and value != ""
    } | nested


def standards_table(model: ReportModel, words: Texts) -> Table | None:
    """Return the standards register: which instrument, which certificate, until when, applied corrections."""
    rows = (
        (
            role_of(words, role),
            cell(entry.get("model", entry.get("driver"))),
            cell(entry.get("serial")),
            cell(entry.get("certificate")),
            cell(entry.get("calibrated")),
            cell(entry.get("due")),
            _days_left(words, model, entry),
            _corrections(words, entry.get("corrections") or ()),
        )
        for role, entry in sorted(model.standards.items())
    )
    headers = (f"column.{name}" for name in _HEADERS)
    return table_of(words, words("standards.table"), headers, rows, prose=True)


def _days_left(words: Texts, model: ReportModel, entry: Mapping[str, Any]) -> str:
    """Return days from the start of the run to the due date, in words if there are none; a dash if one is unknown."""
    try:
        days = (date.fromisoformat(str(entry.get("due"))) - date.fromisoformat(model.started_utc[:10])).days
    except ValueError:
        return "–"
    return number(days) if days >= 0 else words("standards.overdue", days=number(-days))


def _corrections(words: Texts, corrections: Iterable[Mapping[str, Any]]) -> str:
    """Return corrections that change a number; a register full of zeros reads "none"."""
    applied = [
        correction
        for correction in corrections
        if any(value for name, value in correction.items() if not name.startswith("range"))
    ]
    texts = (cell(dict(sorted(correction.items(), key=lambda item: rank(item[0])))) for correction in applied)
    return "; ".join(texts) or words("none")


def identities_table(model: ReportModel, words: Texts) -> Table | None:
    """Return what the instruments answered to the question who they are."""
    documents = [
        {"role": role_of(words, role), **{key: value or None for key, value in identity.items()}}
        for role, identity in sorted(model.identities.items())
    ]
    return documents_table(words, words("identities.table"), documents)


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
