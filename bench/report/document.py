"""Documents: a report in one language, drawn once and written as often as wanted, and the page of a study.

A page is one self-contained HTML document. On paper the same sections are set in A4 by typst, with fonts that come with
the packages.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.analysis import Chapter, estimates_of
from bench.maths.verdict import meaning_of, passed, worst
from bench.model.errors import InputError
from bench.model.extras import optional
from bench.model.texts import ENGLISH, Texts, told
from bench.report.first import FirstPage, first_page
from bench.report.fonts import check_font, families, folders
from bench.report.laboratory import Laboratory
from bench.report.model import Picture, ReportModel
from bench.report.sections import Section, sections_of
from bench.report.sheet import ROOM_pt, Sheet, legible, page_parts, sheets
from bench.report.tables import Table, analysis_tables, sentence, words_of
from bench.report.verdict_tables import overall_verdict

TEMPLATES = Path(__file__).parent / "templates"
MOST_WHOLE = 12  # rows of a table that is not broken over pages
_SHORT = 12  # digits of a hash that stand in the footer
_NO_DATE = datetime(1980, 1, 1, tzinfo=UTC)


class Report:
    """The sections of a model with their figures, in one language; ``html`` and ``pdf`` write the same content.

    ``sections``: those of this model and language, if they are drawn already.   ``laboratory``: what its first page
    states beside the session.
    """

    def __init__(
        self,
        model: ReportModel,
        language: str = ENGLISH,
        sections: list[Section] | None = None,
        laboratory: Laboratory | None = None,
    ) -> None:
        self._model = model
        self._words = words_of(language)
        self._first = first_page(model, laboratory, self._words)
        self.sections = sections_of(model, self._words) if sections is None else sections

    @property
    def not_accredited(self) -> tuple[str, ...]:
        """Why the page does not stand under the accreditation that the laboratory states; () without one."""
        return self._first.not_accredited

    def html(self) -> str:
        """Return one HTML document that needs no other file, no network and no script.

        The same model gives the same bytes in the same environment; no date and no random id enters.
        """
        first, verdict = self._first, overall_verdict(self._model, self._words)
        return page(
            first.subject,
            first.number,
            self.sections,
            self._words,
            verdict=verdict,
            simulated=self._model.simulated,
            first=first,
        )

    def pdf(self) -> bytes:
        """Return A4 pages; no date and no random id enters, the fonts are inside: one model gives the same bytes.

        Raises: InputError B-REP-001 if typst, the extra 'pdf', is not installed, B-TXT-002 without a font.
        """
        check_font(self._words.language)
        return bytes(typeset(document_files(self._model, self.sections, self._words, self._first), format="pdf"))


def page(
    title: str,
    subtitle: str,
    sections: list[Section],
    words: Texts,
    *,
    verdict: tuple[str, str],
    simulated: bool,
    first: FirstPage | None = None,
) -> str:
    """Return sections as one HTML document; ``verdict``: look and words."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # the extra 'report'

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("report.html.j2").render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        parts=lambda table: page_parts(table, _continued(table, words)),
        words=words,
        language=words.language,
        watermark=words("watermark") if simulated else "",
        verdict=verdict,
        first=first,
    )


def _continued(table: Table, words: Texts) -> str:
    if not table.caption or table.goes_on:
        return table.caption
    return words("table.continued", caption=table.caption)


def study_html(document: Mapping[str, Any], chapters: Sequence[Chapter], software: str) -> str:
    """Return the page; the same study gives the same bytes in the same environment, no date and no random id enters.

    Args: document: of study.json, with ``study``, ``runs``, ``seed`` and ``estimates``.
    """
    words = words_of(ENGLISH)
    name = str(document["study"])
    subtitle = words("study.subtitle", runs=document["runs"], seed=document["seed"], software=software)
    sections = [section for section in _sections(name, chapters, words) if section]
    return page(
        words(f"study.title.{name}"), subtitle, sections, words, verdict=_verdict(document, words), simulated=True
    )


def _verdict(document: Mapping[str, Any], words: Texts) -> tuple[str, str]:
    verdicts = [estimate.verdict for estimate in estimates_of(document) if estimate.verdict != "none"]
    failed = sum(not passed([verdict]) for verdict in verdicts)
    return meaning_of(worst(verdicts)).look, words("study.verdict", kept=len(verdicts) - failed, failed=failed)


def _sections(name: str, chapters: Sequence[Chapter], words: Texts) -> list[Section]:
    from bench.report import plots  # with matplotlib

    figures = [(chapter.name, figure) for chapter in chapters for figure in chapter.figures]
    pictures = plots.analysis_pictures(
        told([figure for _, figure in figures], words.language)
    )  # all at once: each gets a name of its own
    groups = dict.fromkeys((place, figure.group) for place, figure in figures)
    placed = list(zip(groups, pictures, strict=True))
    return [
        Section(
            chapter.name,
            words(f"study.{name}.{chapter.name}"),
            tuple(map(sentence, told(tuple(chapter.paragraphs), words.language))),
            tuple(analysis_tables(chapter.tables, words.language)),
            tuple(drawn for (place, _), drawn in placed if place == chapter.name),
        )
        for chapter in chapters
    ]


def typeset(files: dict[str, bytes], **form: Any) -> Any:
    """Return a document set by typst; ``form``: what it is written as. Raises: InputError B-REP-001."""
    cure = "pip install 'inertial-bench[pdf]'; report.html prints to paper too"
    missing = InputError("B-REP-001", "a PDF needs typst, which is not installed", where="--pdf", next_step=cure)
    compiler = optional("typst", missing).compile
    fonts = list(map(str, folders()))
    return compiler(files, font_paths=fonts, ignore_system_fonts=True, timestamp=_NO_DATE, **form)


def document_files(
    model: ReportModel, sections: list[Section], words: Texts, first: FirstPage | None = None
) -> dict[str, bytes]:
    """Return the typst document, the content as JSON and every figure as SVG; ``first``: without a laboratory."""
    files = {"main": (TEMPLATES / "report.typ").read_bytes()}
    chapters = [_chapter(section, words) for section in sections]
    for section in sections:
        files |= {_file(picture): legible(picture.svg).encode() for picture in section.pictures}
    text = json.dumps(
        {**_frame(model, first or first_page(model, None, words), words), "chapters": chapters}, ensure_ascii=False
    )
    files["report.json"] = legible(text).encode()
    return files


def _frame(model: ReportModel, first: FirstPage, words: Texts) -> dict[str, Any]:
    """Return what stands on every page and at the head of the first."""
    kind, verdict = overall_verdict(model, words)
    sha256 = str(model.results.get("provenance", {}).get("session_sha256", ""))
    return {
        "font": families(),
        "language": words.language,
        "title": first.subject,
        "first": asdict(first),
        "lines": [words(f"signature.{line}") for line in ("name", "date", "signature")],
        "hash": f"SHA-256 {sha256[:_SHORT]}" if sha256 else "",
        "watermark": words("watermark") if model.simulated else "",
        "page": words("page.number", number="#n", total="#total"),
        "verdict": verdict,
        "verdict_kind": kind,
    }


def _chapter(section: Section, words: Texts) -> dict[str, Any]:
    return {
        "title": section.title,
        "part": words("annex") if section.annex == "A" else "",
        "paragraphs": section.paragraphs,
        "pictures": [
            {"file": _file(picture), "caption": picture.caption, "description": picture.description}
            for picture in section.pictures
        ],
        "tables": [
            _table(sheet, table, _continued(table, words), first=index == 0)
            for table in section.tables
            for index, sheet in enumerate(sheets(table, ROOM_pt))
        ],
    }


def _table(sheet: Sheet, table: Table, continued: str, *, first: bool) -> dict[str, Any]:
    return {
        "caption": table.caption if first else continued,
        "continued": continued,
        "headers": sheet.table.headers,
        "rows": sheet.table.rows,
        "widths": sheet.widths_pt,
        "size": sheet.size_pt,
        "left": len(sheet.widths_pt) if table.prose else table.stub,
        "whole": len(sheet.table.rows) <= MOST_WHOLE and not table.prose,
    }


def _file(picture: Picture) -> str:
    return f"{Path(picture.name).name}.svg"
