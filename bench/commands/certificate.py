"""``bench certificate``: a Digital Calibration Certificate of a session, or a clear reason why there is none."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from bench.analysis import (
    doubt_lines,
    estimates_of,
    is_sound,
    outlived,
    outlived_text,
    validate_results,
    without_check_standard,
)
from bench.commands.console import say, warn
from bench.commands.requests import CertificateRequest
from bench.model.clock import NS, WallClock
from bench.model.errors import BenchError, InputError, SessionDamaged
from bench.model.events import Environment
from bench.model.extras import missing_extra
from bench.record import SessionReader, layout
from bench.replay import ABSENT, Difference
from bench.report import (
    CERTIFICATE_FILE,
    LABORATORY_FILE,
    SPECIMEN_FILE,
    Calibration,
    CertificateSchema,
    Laboratory,
    Span,
    below_capability,
    certificate_text,
    laboratory_of,
    load_laboratory,
    nobody,
    not_valid,
    overdue,
)
from bench.session.history import VARIABLE, chosen_url
from bench.session.output import write_file
from bench.session.service import read_view
from bench.session.verification import value_differences
from bench.session.view import SessionView, analyse_view

NO_HISTORY = "B-STORE-007"
REL_TOL = 1e-9  # in another environment floats agree to this, and no better


def certificate(request: CertificateRequest) -> None:
    """Write the certificate; nothing is written unless the recording gives every number of results.json again.

    Raises: InputError B-DCC-001 to -004, -006 to -010, -012 to -017, B-YAML-..., B-CLI-007;
            SessionDamaged B-DCC-005, B-REC-011.
    """
    simulated = SessionReader(request.session).manifest.get("simulated") is not False
    if simulated and not request.specimen:
        raise InputError(
            "B-DCC-001",
            "the session is simulated: nothing was measured that could be certified",
            where=request.session,
            next_step="'--specimen' writes a marked specimen",
        )
    laboratory = _laboratory(request)
    schema = None if request.schema is None else CertificateSchema(request.schema)
    calibration = _calibration(request, laboratory)
    path = request.out or request.session / (SPECIMEN_FILE if request.specimen else CERTIFICATE_FILE)
    text = certificate_text(calibration)
    if schema is not None:
        _validate(schema, text, path)
    _refuse_to_replace(path, text, request.specimen)
    write_file(path, text)
    untold = _entered(request, text, calibration)
    held = "" if schema is None else f", holds {schema.path.name}"
    say(f"wrote    {path}{held}")
    if untold is not None:
        warn(f"{untold}; the certificate is written, the same command enters it later")


def _entered(request: CertificateRequest, text: str, calibration: Calibration) -> BenchError | None:
    """Enter the certificate into the archive; returns why it is not there, None too where nobody keeps a history."""
    named = request.history or os.environ.get(VARIABLE)
    try:
        from bench.archive.issued import enter_issued

        url = chosen_url(request.history, request.session.resolve().parent, os.environ)
        enter_issued(url, text.encode(), calibration.results, calibration.manifest)
    except ModuleNotFoundError as error:
        return missing_extra(error) if named else None
    except BenchError as error:
        return None if error.code == NO_HISTORY and not named else error
    return None


def _laboratory(request: CertificateRequest) -> Laboratory:
    if request.laboratory is not None:
        return load_laboratory(request.laboratory)
    kept = laboratory_of(request.session)
    if kept is not None:
        return kept
    if request.specimen:
        return nobody()
    raise InputError(
        "B-DCC-002",
        "a certificate needs a laboratory: who calibrates, for whom, who signs",
        where=request.session,
        next_step="name its file by --laboratory; docs/laboratory.yaml is an example",
    )


def _calibration(request: CertificateRequest, laboratory: Laboratory) -> Calibration:
    folder = request.session
    if not (folder / "results.json").exists():  # a run that was stopped has none
        _refuse_unfinished(folder, read_view(folder))
    stored, digests = _stored(folder)
    view = read_view(folder, strict=True)
    _refuse_unfinished(folder, view)
    _refuse_other_numbers(folder, stored, view)
    began_ns, ended_ns = _span_utc_ns(folder)
    began, ended = _day(began_ns), _day(ended_ns)
    standards = view.manifest.get("standards", {})
    if not request.specimen:
        laboratory.refuse_other_days(str(request.laboratory or folder / LABORATORY_FILE), began, ended)
        _refuse_expired(standards, ended_ns, folder)
        _refuse_below_capability(laboratory, stored, folder)
    late = overdue(standards, began, ended)
    if not request.specimen and (late or not standards):
        raise InputError(
            "B-DCC-006",
            f"not calibrated at the time of the measurement, {began} to {ended}: {'; '.join(late) or 'any standard'}",
            where=folder,
            next_step="have the standards calibrated and measure again",
        )
    return Calibration(
        results=without_check_standard(stored, view.manifest["campaign"]),
        manifest=view.manifest,
        laboratory=laboratory,
        hashes={"session": view.session_sha256, **digests},
        began=began,
        ended=ended,
        issued=laboratory.issued or (None if request.specimen else _day(WallClock().utc_ns())),
        specimen=request.specimen,
        chamber=_span(view, "air_degC"),
        unit=_span(view, "unit_degC"),
    )


def _stored(folder: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Return results.json, and the SHA-256 of it and of the report that goes with it."""
    path, report = folder / "results.json", folder / "report.html"
    try:
        raw = path.read_bytes()
        document = json.loads(raw)
        digests = {"results": hashlib.sha256(raw).hexdigest()}
        if report.is_file():
            digests["report"] = hashlib.sha256(report.read_bytes()).hexdigest()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            "B-DCC-004",
            f"there are no results to certify: {reason}",
            where=path,
            next_step="certify a session whose run ended with results",
        ) from error
    validate_results(document, str(path))
    entries = estimates_of(document)
    if entries and not any(map(is_sound, entries)):
        raise InputError(
            "B-DCC-015",
            f"no estimate is sound: {doubt_lines(entries)[0]}",
            where=path,
            next_step="correct what is named and measure again; what is accepted by a person is not certified either",
        )
    return document, digests


def _refuse_unfinished(folder: Path, view: SessionView) -> None:
    if view.incomplete:
        raise InputError(
            "B-DCC-003",
            "the run has not ended, or was stopped before its end",
            where=folder,
            next_step="'bench resume' goes on with it",
        )


def _refuse_other_numbers(folder: Path, stored: Mapping[str, Any], view: SessionView) -> None:
    """Each number of results.json must follow from the recording, today."""
    if not view.has_analysis:
        raise InputError("B-DCC-004", "the sequence of this session asks for no analysis", where=folder)
    if stored["provenance"]["session_sha256"] != view.session_sha256:
        raise _other("results.json is of another recording", folder)
    found = value_differences(stored, analyse_view(view)[0])
    differences = [difference for difference in found if not _agrees(difference)]
    if differences:
        raise _other(
            f"results.json differs in {len(differences)} values from what it gives today: {differences[0]}", folder
        )


def _agrees(difference: Difference) -> bool:
    """Return whether only this software gives a value, or another machine rounds a number otherwise."""
    numbers = isinstance(difference.first, float) and isinstance(difference.second, float)
    return difference.first == ABSENT or (
        numbers and math.isclose(difference.first, difference.second, rel_tol=REL_TOL, abs_tol=0.0)
    )


def _other(message: str, folder: Path) -> SessionDamaged:
    next_step = f"'bench replay {folder}' lists what differs"
    return SessionDamaged("B-DCC-005", message, where=folder, next_step=next_step)


def _refuse_expired(standards: Mapping[str, Mapping[str, Any]], ended_ns: int, folder: Path) -> None:
    """Refuse a measurement that ended when a specification in the register did not hold any more."""
    gone = [ranges for role in sorted(standards) if (ranges := outlived(standards, role, ended_ns / NS))]
    if gone:
        raise InputError(
            "B-DCC-016",
            "; ".join(map(outlived_text, gone)),
            where=folder,
            next_step="have the standard calibrated and measure again",
        )


def _refuse_below_capability(laboratory: Laboratory, stored: Mapping[str, Any], folder: Path) -> None:
    """Refuse to state, under an accreditation, less uncertainty than the laboratory is accredited for."""
    if laboratory.accreditation is None:
        return
    wrong = below_capability(laboratory.accreditation, str(stored["campaign"]), estimates_of(stored))
    if wrong:
        raise InputError(
            "B-DCC-017",
            "; ".join(f"{quantity}: {reason}" for quantity, reason in wrong.items()),
            where=folder,
            next_step="state in the register what is missing in U, or take 'accreditation' out of the laboratory file",
        )


def _span_utc_ns(folder: Path) -> tuple[int, int]:
    """Return the UTC at which the recording began and ended, by its first and last pair of times."""
    pairs = [message.document() for message in SessionReader(folder).select(frozenset({layout.CLOCK}))]
    if not pairs:
        raise InputError(
            "B-DCC-013",
            "the session does not say when it was recorded: it holds no UTC beside its own time",
            where=folder,
            next_step="certify a session that does; docs/session-format.md says how",
        )
    times_ns = [int(pair["t_utc_ns"]) for pair in pairs]
    return min(times_ns), max(times_ns)


def _day(utc_ns: int) -> date:
    return datetime.fromtimestamp(utc_ns // NS, UTC).date()


def _span(view: SessionView, name: str) -> Span | None:
    """Return lowest and highest reading of a temperature in the session."""
    readings = (getattr(event, name) for _, event in view.events_of(Environment))
    values = [float(reading) for reading in readings if reading is not None]
    return Span(min(values), max(values)) if values else None


def _validate(schema: CertificateSchema, text: str, path: Path) -> None:
    violations = schema.violations(text)
    if violations:
        beside = path.with_name(f"{path.stem}.invalid.xml")
        write_file(beside, text)
        raise not_valid(violations, beside, schema.path)


def _refuse_to_replace(path: Path, text: str, specimen: bool) -> None:
    """A certificate that was handed out is not changed under its own number."""
    if not specimen and path.is_file() and path.read_bytes() != text.encode():
        raise InputError(
            "B-DCC-012",
            "is there already and says something else",
            where=path,
            next_step="remove it if it was never issued; otherwise write to another file by --out",
        )
