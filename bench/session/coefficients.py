"""Coefficients of a session: which system makes the document, and its two files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from bench.analysis import (
    Analysis,
    Document,
    compensation_of_unit,
    results_json,
    sound_compensation,
    without_check_standard,
)
from bench.model.declaration import CoefficientsDeclaration
from bench.model.errors import InputError
from bench.model.installed import named
from bench.model.systems import system_of_analysis, systems
from bench.session.output import write_file


class CoefficientsModule(Protocol):
    """A module of a system that makes coefficients; ``NAME`` is that of the files and of the schema."""

    NAME: str

    def coefficients_of(self, analysis: Analysis, results: Document, campaign: Document) -> Document:
        """Return the document of one session. Raises: InputError B-COEF-004, B-COEF-006."""

    def merged(self, documents: Sequence[Document]) -> Document:
        """Return one document of several sessions of one unit. Raises: InputError B-COEF-001 to B-COEF-003."""

    def coefficients_schema(self) -> dict[str, Any]:
        """Return the JSON Schema of the document."""


@dataclass(frozen=True)
class Coefficients:
    """A document, and who made it."""

    declared: CoefficientsDeclaration
    document: Document

    @property
    def texts(self) -> dict[str, str]:
        """The two files, by name."""
        module: CoefficientsModule = named(self.declared.module)
        header: str = named(self.declared.header)(self.document)
        return {f"{module.NAME}.json": results_json(self.document), f"{module.NAME}.h": header}

    def write(self, folder: Path) -> list[Path]:
        """Write both files. Raises: InputError B-CLI-007."""
        for name, text in self.texts.items():
            write_file(folder / name, text)
        return [folder / name for name in self.texts]


def all_modules() -> list[CoefficientsModule]:
    """Load what makes coefficients in all systems that are installed."""
    return [named(system.coefficients.module) for system in systems() if system.coefficients is not None]


def all_files() -> list[str]:
    """Return the names of all files that coefficients may stand in."""
    return [f"{module.NAME}.{ending}" for module in all_modules() for ending in ("json", "h")]


def coefficients_of_session(analysis: Analysis, results: Document, campaign: Document) -> Coefficients | None:
    """Return the coefficients of one session, None if its analysis has no compensation.

    ``campaign``: that section of the manifest. Raises: InputError B-COEF-004, B-COEF-006.
    """
    system = system_of_analysis(analysis.campaign)
    results = without_check_standard(results, campaign)
    analysis, campaign = compensation_of_unit(sound_compensation(analysis, results), campaign)
    if not analysis.compensation or system is None or system.coefficients is None:
        return None
    module: CoefficientsModule = named(system.coefficients.module)
    return Coefficients(system.coefficients, module.coefficients_of(analysis, results, campaign))


def write_coefficients(folder: Path, analysis: Analysis, results: Document, campaign: Document) -> list[Path]:
    """Write both files of one session, none if its analysis has no compensation; return them.

    Raises: InputError B-COEF-004, B-COEF-006, B-CLI-007.
    """
    coefficients = coefficients_of_session(analysis, results, campaign)
    return [] if coefficients is None else merged_coefficients([coefficients]).write(folder)


def merged_coefficients(parts: Sequence[Coefficients]) -> Coefficients:
    """Return one document of several sessions of one unit. Raises: InputError B-COEF-001 to -003, -007."""
    kinds = sorted({part.declared for part in parts}, key=lambda declared: declared.module)
    if len(kinds) > 1:
        raise InputError(
            "B-COEF-007",
            f"some sessions are of {kinds[0].of}, others of {kinds[1].of}",
            where=", ".join(str(part.document["sources"][0]["session"]) for part in parts),
            next_step="merge sessions of one kind",
        )
    module: CoefficientsModule = named(kinds[0].module)
    return Coefficients(kinds[0], module.merged([part.document for part in parts]))
