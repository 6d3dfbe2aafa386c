"""``bench coefficients``: compensation of a unit as JSON and as a C header, of its converters or of its IMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.analysis.analysis import Analysis
from bench.analysis.results import results_json
from bench.commands.console import console
from bench.model.errors import ExitStatus, InputError
from bench.session.output import write_file
from bench.session.service import read_view
from bench.session.view import SessionView, analyse_view
from bench.systems.af_converter.coefficients import coefficients_of, merged
from bench.systems.af_converter.coefficients_header import header_text
from bench.systems.gnc.coefficients import imu_coefficients_of, is_imu, merged_imu
from bench.systems.gnc.coefficients_header import imu_header_text

JSON_NAME, HEADER_NAME = "coefficients.json", "coefficients.h"
IMU_JSON_NAME, IMU_HEADER_NAME = "imu_coefficients.json", "imu_coefficients.h"
NAMES = (JSON_NAME, HEADER_NAME, IMU_JSON_NAME, IMU_HEADER_NAME)


def coefficients(folders: Sequence[Path], out: Path) -> int:
    """Fit the sessions again, merge their coefficients and write both files.

    Raises: InputError B-COEF-001 to -006; SessionDamaged for a session that is not whole.
    """
    document = merged_documents([_document(folder) for folder in folders])
    for path in _write(out, document):
        console().print(f"wrote    {path}")
    for source in document["sources"]:
        for one in source["missing"]:
            console().print(f"MISSING  {one}")
    return ExitStatus.PASS


def write_coefficients(
    folder: Path, analysis: Analysis, results: Mapping[str, Any], campaign: Mapping[str, Any]
) -> list[Path]:
    """Write coefficients.json and coefficients.h of one session; nothing if its analysis has no compensation.

    ``campaign``: that section of the manifest. Returns the files written.
    Raises: InputError B-COEF-004, B-COEF-006, B-CLI-007.
    """
    if not analysis.compensation:
        return []
    return _write(folder, merged_documents([document_of(analysis, results, campaign)]))


def document_of(analysis: Analysis, results: Mapping[str, Any], campaign: Mapping[str, Any]) -> dict[str, Any]:
    """The document of one session: of converters, or of an IMU.

    Raises: InputError B-COEF-004, B-COEF-006.
    """
    if is_imu(analysis.compensation):
        return imu_coefficients_of(analysis, results)
    return coefficients_of(analysis, results, campaign)


def coefficient_texts(document: Mapping[str, Any]) -> dict[str, str]:
    """The two files of a document, by name."""
    if "sections" in document:
        return {IMU_JSON_NAME: results_json(document), IMU_HEADER_NAME: imu_header_text(document)}
    return {JSON_NAME: results_json(document), HEADER_NAME: header_text(document)}


def merged_documents(documents: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """One document of several sessions of one unit. Raises: InputError B-COEF-001 to -003, -007."""
    kinds = {"sections" in one for one in documents}
    if len(kinds) > 1:
        raise InputError(
            "B-COEF-007",
            "some sessions are of converters, others of an IMU",
            where=", ".join(str(one["sources"][0]["session"]) for one in documents),
            next_step="merge sessions of one kind",
        )
    return merged_imu(documents) if kinds == {True} else merged(documents)


def _document(folder: Path) -> dict[str, Any]:
    view: SessionView = read_view(folder, strict=True)
    if view.has_analysis:
        results, analysis = analyse_view(view)
        if analysis.compensation:
            return document_of(analysis, results, view.manifest["campaign"])
    raise InputError(
        "B-COEF-005",
        "the session gives no coefficients",
        where=str(folder),
        next_step="name a session of a scale-factor or bias campaign with more than one temperature",
    )


def _write(folder: Path, document: Mapping[str, Any]) -> list[Path]:
    texts = coefficient_texts(document)
    for name, text in texts.items():
        write_file(folder / name, text)
    return [folder / name for name in texts]
