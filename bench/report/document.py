"""A report in one language, drawn once and written as often as wanted."""

from __future__ import annotations

from bench.model.texts import ENGLISH
from bench.report.html import html_page
from bench.report.model import ReportModel
from bench.report.pdf import pdf_pages, png_pages
from bench.report.sections import sections_of
from bench.report.words import words_of


class Report:
    """The sections of a model with their figures; ``html`` and ``pdf`` write the same content."""

    def __init__(self, model: ReportModel, language: str = ENGLISH) -> None:
        self._model = model
        self._words = words_of(language)
        self.sections = sections_of(model, self._words)

    def html(self) -> str:
        """Return one self-contained page; the same model gives the same bytes."""
        return html_page(self._model, self.sections, self._words)

    def pdf(self) -> bytes:
        """A4 pages; the same model gives the same bytes. Raises: InputError B-REP-001 without the extra 'pdf'."""
        return pdf_pages(self._model, self.sections, self._words)

    def pages(self, dots_per_inch: float = 100.0) -> list[bytes]:
        """Return the pages of the PDF as PNG pictures. Raises: InputError B-REP-001."""
        return png_pages(self._model, self.sections, self._words, dots_per_inch)
