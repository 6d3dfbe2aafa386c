"""The results of a session by a method, for whoever shows them: computed once, then kept outside of the session.

Only what is shown comes from there. Certificates, coefficients, verification and the history compute what they state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from bench.analysis import INCOMPLETE, Analysis, Document
from bench.model.texts import ENGLISH
from bench.session.output import write_file
from bench.session.shelf import Shelf, key_of

if TYPE_CHECKING:
    from bench.report import Report, ReportModel
    from bench.session.view import SessionView

SHOWN, MODEL, SECTIONS, PAPER = "shown", "model", "sections", "paper"
FROM_CACHE = "from cache: the same session, software and method as before; --fresh computes it again"


@dataclass(frozen=True)
class Shown:
    """What a person is shown of a fit: the document of results, tables and sentences; nothing of it is ``damaged``."""

    results: Document
    analysis: Analysis
    remarks: Sequence[str]
    damaged: bool = False


def shown_of(view: SessionView, results: Document, analysis: Analysis) -> Shown:
    """Return what a person is shown of the results of a session."""
    remarks = [*([INCOMPLETE] if view.incomplete else []), *analysis.notes, *view.remarks]
    told = replace(analysis, estimates=[], residuals=[], components=[], groups=[], figures=[], compensation=[],
                   attachments={})  # fmt: skip
    return Shown(results, told, remarks, view.damaged)


def keep(folder: Path, shown: Shown, model: ReportModel, report: Report) -> None:
    """Keep results and report of a session that was just recorded, as ``Fitted`` would have without a method."""
    if not shown.damaged:
        shelf = Shelf(key_of([folder], {"method": None}))
        for kind, value in ((MODEL, model), (SECTIONS, report.sections), (SHOWN, shown)):
            shelf.put(kind, value)


class Fitted:
    """Results and report of a session.

    Args:   folder, method, make_up: as for ``analysed``.   fresh: compute everything, and keep that.
            language: of the report.
    Raises: those of ``analysed``, by every method.
    """

    def __init__(
        self,
        folder: Path,
        method: str | None = None,
        make_up: Sequence[Path] = (),
        *,
        fresh: bool = False,
        language: str = ENGLISH,
    ) -> None:
        self._language = language
        self._asked = (folder, method, tuple(make_up))
        self._shelf = Shelf(key_of([folder, *make_up], {"method": method}))
        self._shown: Shown | None = None if fresh else self._shelf.get(SHOWN)
        self.from_cache = self._shown is not None

    @property
    def shown(self) -> Shown:
        """What a person is shown of the results."""
        if self._shown is None:
            self._compute()
        assert self._shown is not None
        return self._shown

    @cached_property
    def report(self) -> Report:
        """The report, with its figures, as the laboratory file that its session keeps has it.

        Raises: InputErrors (B-YAML-...) for a file that was changed and has mistakes.
        """
        from bench.report import Report, laboratory_of

        sections = self._shelf.get(self._kind(SECTIONS)) if self.from_cache else None
        laboratory = laboratory_of(self._asked[0])
        report = Report(self._model, self._language, sections, laboratory)
        if sections is None:
            self._shelf.put(self._kind(SECTIONS), report.sections)
        return report

    def keep_laboratory(self, path: Path) -> None:
        """Copy a laboratory file into the session, so that its report can be written again from the session alone.

        Raises: InputErrors (B-YAML-...); InputError B-DCC-014, B-CLI-007.
        """
        from bench.report import LABORATORY_FILE, days_of, load_laboratory

        laboratory, days = load_laboratory(path), days_of(self._model)
        if days is not None and not self._model.simulated:
            laboratory.refuse_other_days(str(path), *days)
        write_file(self._asked[0] / LABORATORY_FILE, path.read_bytes())

    def paper(self) -> bytes:
        """Return the report as PDF; one with a laboratory is set anew.

        Raises: InputError B-REP-001 without the extra 'pdf', B-TXT-002 without a font.
        """
        from bench.report import LABORATORY_FILE

        if (self._asked[0] / LABORATORY_FILE).is_file():
            return self.report.pdf()
        kept = self._shelf.get(self._kind(PAPER)) if self.from_cache else None
        if isinstance(kept, bytes):
            return kept
        drawn = self.report.pdf()
        self._shelf.put(self._kind(PAPER), drawn)
        return drawn

    def _kind(self, kind: str) -> str:
        """Return under what a report in this language is kept."""
        return kind if self._language == ENGLISH else f"{kind}-{self._language}"

    @cached_property
    def _model(self) -> ReportModel:
        kept = self._shelf.get(MODEL) if self.from_cache else None
        return self._compute() if kept is None else kept

    def _compute(self) -> ReportModel:
        from bench.session.service import analysed
        from bench.session.view import model_of

        folder, method, make_up = self._asked
        results, analysis, view = analysed(folder, method, make_up=make_up)
        model = model_of(view, results, analysis)
        self._shown = shown_of(view, results, analysis)
        self.from_cache = False
        if view.damaged:
            self._shelf = Shelf(None)
        self._shelf.put(MODEL, model)
        self._shelf.put(SHOWN, self._shown)
        return model
