"""Verification of the files computed from a session against its raw bytes: one comparison for each of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from bench.analysis import Analysis, Document, results_json, validate_results
from bench.model.errors import InputError
from bench.model.extras import missing_extra
from bench.replay import Difference, compare
from bench.report import Laboratory, Report
from bench.session.coefficients import all_files, coefficients_of_session, merged_coefficients
from bench.session.view import SessionView, report_of

RESULTS, REPORT, PAPER = "results.json", "report.html", "report.pdf"
PROVENANCE = "provenance"
SMALLEST = 1e-300  # of two zeros that differ in their sign
NAMED = 20  # differences of one file that are named; all are counted


def released_results(folder: Path) -> Document | None:
    """Return results.json of a session, None without one. Raises: InputError B-FIT-010 if it is not in its form."""
    path = folder / RESULTS
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise InputError(
            "B-FIT-010",
            f"cannot be read ({error})",
            where=str(path),
            next_step="remove it to have the results computed again",
        ) from error
    validate_results(document, str(path))
    results: Document = document
    return results


def no_results(folder: Path) -> InputError:
    """Return the error of a session without results.json where they are to be compared."""
    return InputError(
        "B-CLI-010",
        "is not there, so there is nothing to compare with",
        where=folder / RESULTS,
        next_step="'bench fit' prints the results of the session",
    )


@dataclass(frozen=True)
class Change:
    """One thing that is not what the session gives: in which file, and what."""

    file: str
    what: str

    def __str__(self) -> str:
        return f"{self.file}: {self.what}"


@dataclass
class Verification:
    """``compared`` and ``absent`` are names of files; ``notes`` are sentences that make nothing wrong."""

    changes: list[Change] = field(default_factory=list)
    compared: list[str] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, file: str, *what: str) -> None:
        """Name what is wrong with a file."""
        self.changes += [Change(file, text) for text in what]

    def content(self, path: Path) -> bytes | None:
        """Return bytes of a file, which counts as compared then; None if it cannot be read, which is noted."""
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            self.absent.append(path.name)
            return None
        except OSError as error:
            self.add(path.name, f"cannot be read: {error.strerror}")
            return None
        self.compared.append(path.name)
        return content


def check_results(verification: Verification, folder: Path, results: Document) -> Document | None:
    """Compare results.json value by value, then byte by byte; returns what is stored, None if there is nothing."""
    content = verification.content(folder / RESULTS)
    if content is None:
        return None
    try:
        stored = json.loads(content)
    except ValueError as error:
        verification.add(RESULTS, f"cannot be read as JSON: {error}")
        return None
    if not isinstance(stored, dict) or not isinstance(stored.get(PROVENANCE, {}), dict):
        verification.add(RESULTS, "is not a document of results")
        return None
    written, now = software_of(stored), software_of(results)
    if written != now:
        verification.notes.append(f"{RESULTS} was written by {written}, this is {now}")
    values = value_differences(stored, results)
    values.sort(
        key=lambda difference: not difference.path.startswith(PROVENANCE)
    )  # another recording explains all that follows
    verification.add(RESULTS, *(_said(difference) for difference in values[:NAMED]))
    if len(values) > NAMED:
        verification.add(RESULTS, f"{len(values) - NAMED} more values differ")
    if not values and written == now and content != results_json(results).encode():
        verification.add(RESULTS, "has the same values, but is not the text that the bench writes")
    verification.notes += _rounding(values)
    return stored


def value_differences(stored: Document, results: Document) -> list[Difference]:
    """Return where results that were read from a file are not those computed now, but for the software."""
    differences = compare(stored, json.loads(results_json(results)))
    return [difference for difference in differences if difference.path != "provenance.software"]


def _said(difference: Difference) -> str:
    return f"{difference.path} {_value(difference.first)} -> {_value(difference.second)}"


def _value(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _rounding(differences: Sequence[Difference]) -> list[str]:
    """Return a sentence if nothing but the last digits of numbers differ, as they may on another machine."""
    pairs = [(difference.first, difference.second) for difference in differences]
    if not pairs or not all(isinstance(value, float) for pair in pairs for value in pair):
        return []
    worst = max(abs(first - second) / max(abs(first), abs(second), SMALLEST) for first, second in pairs)
    if worst > 1e-9:
        return []
    return [f"the largest relative difference is {worst:.1g}: results.json may be of another machine"]


class Pages:
    """The reports of a session, drawn with the name of today's software and with that of the results' own."""

    def __init__(
        self,
        view: SessionView,
        results: Document,
        analysis: Analysis,
        stored: Document,
        laboratory: Laboratory | None = None,
    ) -> None:
        self._laboratory = laboratory
        self._view, self._results, self._analysis = view, results, analysis
        self.written, self.now = software_of(stored), software_of(results)

    @cached_property
    def _today(self) -> Report:
        return report_of(self._view, self._results, self._analysis, self._laboratory)

    @cached_property
    def _then(self) -> Report:
        provenance = {**self._results[PROVENANCE], "software": self.written}
        return report_of(self._view, {**self._results, PROVENANCE: provenance}, self._analysis, self._laboratory)

    def check(self, verification: Verification, path: Path, form: Callable[[Report], bytes]) -> None:
        """Compare a report with the one drawn now, byte by byte."""
        content = verification.content(path)
        if content is None or content == form(self._today):
            return
        if self.written == self.now:
            verification.add(path.name, "is not what the session gives")
        elif content == form(self._then):
            verification.notes.append(
                f"{path.name} differs in the software it names only: {self.written}, now {self.now}"
            )
        else:
            text = (
                f"is not what the session gives with {self.now}; it was written by {self.written}: verify it with that"
            )
            verification.add(path.name, text)


def check_reports(verification: Verification, folder: Path, pages: Pages) -> None:
    """Compare report.html, and report.pdf if there is one; what an extra is missing for is noted."""
    forms: dict[str, Callable[[Report], bytes]] = {REPORT: lambda report: report.html().encode()}
    if (folder / PAPER).exists():
        forms[PAPER] = lambda report: report.pdf()
    for name, form in forms.items():
        try:
            pages.check(verification, folder / name, form)
        except (InputError, ModuleNotFoundError) as error:
            missing = missing_extra(error) if isinstance(error, ModuleNotFoundError) else error
            verification.compared.remove(name)
            verification.notes.append(f"{name} is not compared: {missing}")


def check_coefficients(
    verification: Verification, folder: Path, view: SessionView, results: Document, analysis: Analysis
) -> None:
    """Compare the coefficients, JSON and header, byte by byte; an analysis may give none."""
    texts: dict[str, str | None] = dict.fromkeys(all_files())
    coefficients = coefficients_of_session(analysis, results, view.manifest["campaign"])
    if coefficients is not None:
        texts |= merged_coefficients([coefficients]).texts
    for name, text in texts.items():
        if text is None and not (folder / name).exists():
            continue
        content = verification.content(folder / name)
        if content is None:
            continue
        if text is None:
            verification.add(name, "this session gives no coefficients")
        elif content != text.encode():
            verification.add(name, "is not what the session gives")


def software_of(results: Document) -> str:
    """Return name and version of the software that wrote results."""
    return str(results.get("provenance", {}).get("software", "unknown"))
