"""What all documents of coefficients share: the unit, the sessions they come from, the check of their form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from bench.analysis.analysis import Analysis
from bench.model.errors import InputError


class Closed(BaseModel):
    """Base of the forms: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


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
    """Where coefficients come from: session, method, hashes, the worst verdict and what is missing."""
    return {
        "session": str(results["session"]),
        "campaign": analysis.campaign,
        "method": analysis.method,
        "session_sha256": results["provenance"]["session_sha256"],
        "software": results["provenance"]["software"],
        "worst_verdict": _worst(one["verdict"] for one in results["estimates"]),
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
        places = ", ".join(str(one["sources"][0]["session"]) for one in (first, other))
        both = f"{_words(first[name])} and {_words(other[name])}"
        raise InputError(code, f"the sessions {what} ({both})", where=places, next_step=next_step)


def _words(value: Any) -> str:
    return " ".join(value.values()) if isinstance(value, Mapping) else ("simulated" if value else "measured")


def _worst(verdicts: Iterable[str]) -> str:
    found = set(verdicts)
    return next((one for one in ("fail", "conditional_fail", "conditional_pass", "pass") if one in found), "none")


def validate(document: object, where: str, form: type[BaseModel]) -> None:
    """Check a document against its form. Raises InputError B-COEF-006 naming the first wrong field."""
    try:
        form.model_validate(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(
            "B-COEF-006",
            f"{place}: {first['msg'][:1].lower()}{first['msg'][1:]} (found {str(first['input'])[:60]})",
            where=where,
            next_step="correct the analysis that makes these coefficients",
        ) from error
