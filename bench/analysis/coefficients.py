"""Files of coefficients: what those of every system say of the unit and of the sessions they come from, also in C."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

from pydantic import BaseModel

from bench.analysis.analysis import Analysis
from bench.analysis.results import Closed, check_form
from bench.model.errors import InputError


class Source(Closed):
    """A session the coefficients come from, with the worst verdict in it."""

    session: str
    campaign: str
    method: str
    session_sha256: str
    software: str
    worst_verdict: Literal["pass", "fail", "conditional_pass", "conditional_fail", "none"]
    missing: list[str]


class UnitUnderTest(Closed):
    """The unit the coefficients belong to."""

    model: str
    serial: str


def source_of(analysis: Analysis, results: Mapping[str, Any]) -> dict[str, Any]:
    """Return where coefficients come from: session, method, hashes, the worst verdict and what is missing."""
    return {
        "session": str(results["session"]),
        "campaign": analysis.campaign,
        "method": analysis.method,
        "session_sha256": results["provenance"]["session_sha256"],
        "software": results["provenance"]["software"],
        "worst_verdict": _worst(estimate["verdict"] for estimate in results["estimates"]),
        "missing": list(analysis.missing),
    }


def same_unit(documents: Sequence[Mapping[str, Any]], next_step: str) -> None:
    """Refuse documents that do not belong together.

    Raises: InputError B-COEF-001 (another unit), B-COEF-003 (simulated and real).
    """
    for other in documents[1:]:
        _same(documents[0], other, "uut", "B-COEF-001", "belong to different units", next_step)
        _same(documents[0], other, "simulated", "B-COEF-003", "are partly simulated, partly measured", next_step)


def _same(first: Mapping[str, Any], other: Mapping[str, Any], name: str, code: str, what: str, next_step: str) -> None:
    if first[name] != other[name]:
        places = ", ".join(str(document["sources"][0]["session"]) for document in (first, other))
        both = f"{_words(first[name])} and {_words(other[name])}"
        raise InputError(code, f"the sessions {what} ({both})", where=places, next_step=next_step)


def _words(value: Any) -> str:
    return " ".join(value.values()) if isinstance(value, Mapping) else ("simulated" if value else "measured")


def _worst(verdicts: Iterable[str]) -> str:
    known = set(verdicts)
    worst_first = ("fail", "conditional_fail", "conditional_pass", "pass")
    return next((verdict for verdict in worst_first if verdict in known), "none")


def validate_coefficients(document: object, where: str, form: type[BaseModel]) -> None:
    """Check a document against its form. Raises InputError B-COEF-006 naming the first wrong field."""
    check_form(form, document, "B-COEF-006", where, "correct the analysis that makes these coefficients")


def c_preamble(document: Mapping[str, Any]) -> str:
    """Return the comment that opens a C header: unit, simulated or not, signs, sources."""
    unit = document["uut"]
    lines = [f"Compensation of {unit['model']}, serial number {unit['serial']}."]
    if document["simulated"]:
        lines += ["", "SIMULATED: these numbers come from a simulated bench. They are no calibration of any unit."]
    lines += ["", "Signs:"] + [f"  {name}: {text}" for name, text in document["signs"].items()]
    lines += ["", "Sources:"]
    for source in document["sources"]:
        lines += [f"  {source['session']}: {source['campaign']}, method {source['method']}, {source['software']}"]
        lines += [f"    session SHA-256 {source['session_sha256']}", f"    worst verdict: {source['worst_verdict']}"]
        lines += [f"    MISSING: {sentence}" for sentence in source["missing"]]
    return "\n".join(["/*", *(f" * {c_text(line)}".rstrip() for line in lines), " */", ""])


def c_text(text: str) -> str:
    """Return what a session says so that nothing in it ends a C comment or leaves ASCII."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").encode("ascii", "replace").decode().splitlines())
