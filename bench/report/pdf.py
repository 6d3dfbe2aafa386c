"""The report on paper: the same sections set in A4 by typst, with fonts that come with the packages."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

from bench.model.errors import InputError
from bench.model.texts import Texts
from bench.report.fonts import FAMILY, folder, legible
from bench.report.html import TEMPLATES
from bench.report.model import ReportModel
from bench.report.plots.style import Picture
from bench.report.sections import Section
from bench.report.sheet import ROOM_pt, Sheet, sheets
from bench.report.tables import Table
from bench.report.verdict_tables import overall_verdict

_SHORT = 12  # digits of a hash that stand in the footer
_NO_DATE = datetime(1980, 1, 1, tzinfo=UTC)


def pdf_pages(model: ReportModel, sections: list[Section], words: Texts) -> bytes:
    """Return the report as a PDF of A4 pages; no date and no random id enters, the fonts are inside.

    Raises: InputError B-REP-001 if typst, the extra 'pdf', is not installed.
    """
    return bytes(_typeset(document_files(model, sections, words), "pdf", None))


def png_pages(model: ReportModel, sections: list[Section], words: Texts, dots_per_inch: float) -> list[bytes]:
    """Return the same pages as pictures, for eyes and tests. Raises: InputError B-REP-001."""
    found = _typeset(document_files(model, sections, words), "png", dots_per_inch)
    return found if isinstance(found, list) else [found]


def _typeset(files: dict[str, bytes], form: str, dots_per_inch: float | None) -> Any:
    return _typst()(
        files, format=form, ppi=dots_per_inch, font_paths=[str(folder())], ignore_system_fonts=True, timestamp=_NO_DATE
    )


def _typst() -> Callable[..., Any]:
    try:
        compiler: Callable[..., Any] = import_module("typst").compile
    except ImportError as error:
        raise InputError(
            "B-REP-001",
            "a PDF needs typst, which is not installed",
            where="--pdf",
            next_step="pip install 'inertial-bench[pdf]'; report.html prints to paper too",
        ) from error
    return compiler


def document_files(model: ReportModel, sections: list[Section], words: Texts) -> dict[str, bytes]:
    """Return the typst document, the content as JSON and every figure as SVG."""
    files = {"main": (TEMPLATES / "report.typ").read_bytes()}
    chapters = [_chapter(section) for section in sections]
    for section in sections:
        files |= {_file(one): _figure(one) for one in section.pictures}
    text = json.dumps({**_frame(model, words), "chapters": chapters}, ensure_ascii=False)
    files["report.json"] = legible(text).encode()
    return files


def _frame(model: ReportModel, words: Texts) -> dict[str, Any]:
    """Return what stands on every page and at the head of the first."""
    kind, verdict = overall_verdict(model, words)
    sha256 = str(model.results.get("provenance", {}).get("session_sha256", ""))
    return {
        "font": FAMILY,
        "language": words.language,
        "title": model.title,
        "session": str(model.results.get("session", "")),
        "hash": f"SHA-256 {sha256[:_SHORT]}" if sha256 else "",
        "watermark": words("watermark") if model.simulated else "",
        "page": words("page.number", number="#n", total="#total"),
        "verdict": verdict,
        "verdict_kind": kind,
    }


def _chapter(section: Section) -> dict[str, Any]:
    return {
        "title": section.title,
        "paragraphs": section.paragraphs,
        "pictures": [
            {"file": _file(one), "caption": one.caption, "description": one.description} for one in section.pictures
        ],
        "tables": [
            _table(one, table, continued=index > 0)
            for table in section.tables
            for index, one in enumerate(sheets(table, ROOM_pt))
        ],
    }


def _table(sheet: Sheet, table: Table, continued: bool) -> dict[str, Any]:
    return {
        "caption": table.caption if not continued else "",
        "headers": sheet.table.headers,
        "rows": sheet.table.rows,
        "widths": sheet.widths_pt,
        "size": sheet.size_pt,
        "left": len(sheet.widths_pt) if table.prose else table.stub,
        "to_fill": table.to_fill,
    }


def _file(picture: Picture) -> str:
    return f"{Path(picture.name).name}.svg"


def _figure(picture: Picture) -> bytes:
    return legible(picture.svg).encode()
