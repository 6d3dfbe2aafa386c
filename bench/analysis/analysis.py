"""Analyses by name, and what one gives back: estimates for results.json and all that explains them in the report.

A campaign names its analysis, a declaration names the module that does it; that one is loaded. A system may also offer
a study: parts that are computed by themselves, and what is made of them.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from numpy.linalg import LinAlgError

from bench.analysis.doubt import Evidence
from bench.analysis.estimates import Document, Estimates
from bench.analysis.expected import judged_values
from bench.analysis.figures import Figure, Table
from bench.analysis.material import Material
from bench.analysis.values import EXPECTED
from bench.analysis.wording import say
from bench.model.declaration import AnalysisDeclaration
from bench.model.errors import FitError
from bench.model.installed import named, unforeseen, unusable
from bench.model.systems import analyses, analysis_declaration, refuse_unknown_analysis

Documents = list[dict[str, Any]]


@dataclass(frozen=True)
class Analysis:
    """Result of an analysis: ``estimates`` hold if the model does, ``evidence`` says whether.

    Both make results.json, the rest explains them in the report. Evidence is of every check made, also of one that
    found nothing.
    ``missing`` names, one sentence each, what the campaign promises and has no result; empty if it is complete.
    ``compensation``: {"channel", "kind", "parameter", "unit", "reference_temperature_degC", "coefficients",
    "valid_degC"}, coefficient k in unit per degC^k; channel None for what belongs to the whole unit.
    ``attachments``: files that go with the results, by their path below the session's folder ``units``, as text.
    """

    campaign: str
    method: str
    uut: Document
    estimates: Estimates
    evidence: list[Evidence] = field(default_factory=list)
    residuals: Documents = field(default_factory=list)  # one per row of the fit
    components: Documents = field(default_factory=list)  # uncertainty budget
    groups: Documents = field(default_factory=list)  # reduced chi-square per channel and temperature
    notes: list[str] = field(default_factory=list)
    seen: list[str] = field(default_factory=list)  # of the notes: what the survey of a log saw
    missing: list[str] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    compensation: Documents = field(default_factory=list)
    attachments: Mapping[str, str] = field(default_factory=dict)

    def leaving_out(self, rows: int, seen: Sequence[str]) -> Analysis:
        """Return the analysis of a log of which so many rows were left out beforehand, each estimate counting them.

        ``seen``: sentences on what was seen of the log.
        """
        entries = [entry.model_copy(update={"dropped": entry.dropped + rows}) for entry in self.estimates]
        return replace(self, estimates=entries, notes=[*seen, *self.notes], seen=[*seen, *self.seen])


def no_result(missing: Iterable[str]) -> list[str]:
    """Return the notes that name what a campaign promises and has no result, a sentence each."""
    return [say("no_result", what=sentence) for sentence in missing]


def check_method(method: str, methods: Sequence[str]) -> None:
    """Refuse a method that an analysis does not have. Raises FitError B-FIT-004."""
    if method not in methods:
        raise FitError("B-FIT-004", f"unknown method {method!r}", next_step=f"use one of: {', '.join(methods)}")


def declared_analysis(name: str) -> AnalysisDeclaration:
    """Return the declaration of an analysis. Raises: FitError B-FIT-011 for an unknown name; InstallationError."""
    declared = analysis_declaration(name)
    if declared is not None:
        return declared
    refuse_unknown_analysis(name)
    known = analyses()
    close = difflib.get_close_matches(name, known, n=1)
    raise FitError(
        "B-FIT-011",
        f"unknown analysis {name!r}",
        next_step=f"did you mean {close[0]!r}?" if close else f"use one of: {', '.join(known)}",
    )


def analyse(material: Material, method: str | None = None) -> Analysis:
    """Run the analysis the campaign names, with its default method (the first it declares) unless told otherwise.

    An imported log is surveyed first; what the sequence expects of the values it names is judged beside the analysis.
    Raises: FitError, B-FIT-004 for an unknown method, B-FIT-143 where equations have no solution; InstallationError
            B-PKG-006, B-LAB-008 where a foreign analysis or one of a lab folder fails.
    """
    declared = declared_analysis(str(material.campaign.get("analysis", "")))
    chosen = method or declared.methods[0]
    check_method(chosen, declared.methods)
    if not material.series:
        return with_expected(_analysed(declared, material, chosen), material)
    from bench.analysis.survey import surveyed  # of logs alone

    survey = surveyed(material)
    analysis = _analysed(declared, survey.material, chosen).leaving_out(survey.left_out, survey.notes)
    analysis = with_expected(analysis, material)
    return replace(analysis, evidence=[*survey.evidence, *analysis.evidence])


def _analysed(declared: AnalysisDeclaration, material: Material, method: str) -> Analysis:
    analyse = named(f"{declared.module}:analyse")
    try:
        analysis: object = analyse(material, method)
    except LinAlgError as error:  # of any estimator: data that no check of its own foresaw
        raise FitError(
            "B-FIT-143",
            f"the equations of the fit have no solution ({error}): the records do not hold what is to be found",
            where=declared.name,
            next_step="look for a jump, a constant column or a gap ('bench export'), and leave it out",
        ) from error
    except (Exception, SystemExit) as error:
        raise unforeseen(error) from error
    if not isinstance(analysis, Analysis):
        raise unusable(declared.module, f"gives {type(analysis).__name__} for its 'analyse', and an Analysis is due")
    return analysis


def with_expected(analysis: Analysis, material: Material) -> Analysis:
    """Return an analysis with the values that the sequence names, in front of its own results; unchanged without."""
    if not material.campaign.get(EXPECTED):
        return analysis
    values = judged_values(material)
    return replace(
        analysis,
        estimates=[*values.estimates, *analysis.estimates],
        evidence=[*values.evidence, *analysis.evidence],
        missing=[*analysis.missing, *values.missing],
        tables=[*values.tables, *analysis.tables],
    )


@dataclass(frozen=True)
class Chapter:
    """Figures, tables and sentences under one heading; ``name`` stands for its title in the texts of the report."""

    name: str
    figures: Sequence[Figure]
    tables: Sequence[Table]
    paragraphs: Sequence[str] = ()


class Task(Protocol):
    """One part of a study, computed by itself."""

    @property
    def name(self) -> str:
        """Name that a person reads while it runs."""


class Study(Protocol):
    """A study of a system; its options, its results and their form are its own."""

    def checked_options(self, runs: int | None, seed: int, offsets: str, quick: bool) -> Any:
        """Return the options as a person gives them. Raises: InputError B-STUDY-002."""

    def tasks_of(self, options: Any) -> Sequence[Task]:
        """Return all tasks, the longest first."""

    def run_task(self, task: Any) -> Any:
        """Compute one task; it depends on nothing but the task."""

    def results_of(self, options: Any, gave: Sequence[Any]) -> Any:
        """Put together what the tasks gave, in their order."""

    def study_document(self, options: Any, found: Any, software: str) -> dict[str, Any]:
        """Return the document of the study."""

    def study_json(self, document: Document) -> str:
        """Return the text of the document."""

    def study_chapters(self, options: Any, document: Document, found: Any) -> Sequence[Chapter]:
        """Return the chapters of the page."""
