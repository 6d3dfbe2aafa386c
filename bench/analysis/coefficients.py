"""Files of coefficients: what those of every system say of the unit and of the sessions they come from, also in C."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from pydantic import Field

from bench.analysis.analysis import Analysis
from bench.analysis.doubt import DOUBTFUL, base_quantity, is_sound
from bench.analysis.estimates import Closed, Document, Estimate, check_form, estimates_of
from bench.maths.verdict import Verdict, worst
from bench.model.errors import InputError


class Source(Closed):
    """A session the coefficients come from, with the worst verdict in it."""

    session: str
    campaign: str
    method: str
    session_sha256: str
    software: str
    worst_verdict: Verdict
    missing: list[str]
    accepted: list[str] = Field([], description="coefficients of doubtful estimates; absent without any")


class UnitUnderTest(Closed):
    """The unit the coefficients belong to."""

    model: str
    serial: str


class CoefficientsFile(Closed):
    """Hold what stands in front of the coefficients of every system; behind them stand its ``sources``."""

    schema_version: Literal[1] = Field(alias="schema")
    uut: UnitUnderTest
    simulated: bool
    signs: dict[str, str]


def coefficients_document(
    form: type[CoefficientsFile], analysis: Analysis, results: Document, signs: Mapping[str, str], **own: Any
) -> Document:
    """Return the document of one session. Raises: InputError B-COEF-006 naming the first field not in its form.

    Args: own: what it holds beside that of every system.
    """
    document = {
        "schema": 1,
        "uut": {name: str(results["uut"][name]) for name in ("model", "serial")},
        "simulated": results["provenance"]["simulated"] is not False,
        "signs": dict(signs),
        **own,
        "sources": [source_of(analysis, results)],
    }
    next_step = "correct the analysis that makes these coefficients"
    check_form(form, document, "B-COEF-006", str(results["session"]), next_step)
    return document


def of_session(analysis: Analysis, results: Document) -> list[Document]:
    """Return the entries of a session's coefficients, each with its name."""
    return [{**entry, "session": str(results["session"])} for entry in analysis.compensation]


def merged_document(
    documents: Sequence[Document],
    name: str,
    place: Callable[[Document], Any],
    words: Callable[[Document], str],
    next_step: str,
) -> Document:
    """Return one document of the sessions of one unit, the entries below a name in the order of their places.

    Raises: InputError B-COEF-001 (another unit), B-COEF-002 (two entries of one place, named by ``words``), B-COEF-003
            (simulated and real).
    """
    same_unit(documents, next_step)
    entries = [entry for document in documents for entry in document[name]]
    seen: dict[Any, str] = {}
    for entry in entries:
        if place(entry) in seen:
            where, message = f"{seen[place(entry)]}, {entry['session']}", f"{words(entry)} comes from two sessions"
            raise InputError("B-COEF-002", message, where=where, next_step=next_step)
        seen[place(entry)] = entry["session"]
    sources = [source for document in documents for source in document["sources"]]
    return dict(documents[0]) | {name: sorted(entries, key=place), "sources": sources}


def source_of(analysis: Analysis, results: Document) -> dict[str, Any]:
    """Return where coefficients come from: session, method, hashes, the worst verdict and what is missing."""
    accepted = _accepted(analysis, results)
    return {
        "session": str(results["session"]),
        "campaign": analysis.campaign,
        "method": analysis.method,
        "session_sha256": results["provenance"]["session_sha256"],
        "software": results["provenance"]["software"],
        "worst_verdict": worst(entry.verdict for entry in estimates_of(results)),
        "missing": list(analysis.missing),
        **({"accepted": accepted} if accepted else {}),
    }


def sound_compensation(analysis: Analysis, results: Document) -> Analysis:
    """Return the analysis with the coefficients of sound and of accepted estimates; the others are named as missing.

    A parameter goes with the estimates of its name under its conditions; where nothing has its name, with all.
    """
    entries = estimates_of(results)
    unsound = [entry for entry in entries if not is_sound(entry) and entry.acceptance is None]
    if not unsound:
        return analysis
    named = {base_quantity(entry.quantity) for entry in entries}
    kept, missing = [], list(analysis.missing)
    for parameter in analysis.compensation:
        against = [entry for entry in unsound if _goes_with(parameter, entry, named)]
        if against:
            missing.append(_refusal(parameter, against[0]))
        else:
            kept.append(parameter)
    return replace(analysis, compensation=kept, missing=missing)


def _goes_with(parameter: Document, entry: Estimate, named: Collection[str]) -> bool:
    """Return whether a coefficient rests on an estimate; a section of several holds all of its kind and method."""
    if "parameter" not in parameter:
        about = {"kind": parameter["section"], "method": parameter.get("method")}
        return all(entry.conditions.get(key, value) == value for key, value in about.items())
    name = parameter["parameter"]
    same = entry.conditions.items()
    return name not in named or (
        base_quantity(entry.quantity) == name and all(parameter.get(key, value) == value for key, value in same)
    )


def _accepted(analysis: Analysis, results: Document) -> list[str]:
    """Return a sentence for each coefficient that rests on a doubtful value somebody released."""
    entries = estimates_of(results)
    released = [entry for entry in entries if entry.acceptance is not None]
    named = {base_quantity(entry.quantity) for entry in entries}
    said = []
    for parameter in analysis.compensation:
        entry = next((entry for entry in released if _goes_with(parameter, entry, named)), None)
        if entry is not None and (released_by := entry.acceptance) is not None:
            said.append(
                f"{_of(parameter)}{_name(parameter)} is {DOUBTFUL} ({entry.reasons[0].sentence}); "
                f"its value without an uncertainty was accepted by {released_by.by}: {released_by.reason}"
            )
    return said


def _of(parameter: Document) -> str:
    return "" if parameter.get("channel") is None else f"channel {parameter['channel']}: "


def _name(parameter: Document) -> str:
    return str(parameter["parameter"] if "parameter" in parameter else parameter["section"])


def _refusal(parameter: Document, entry: Estimate) -> str:
    what = f"{_of(parameter)}no coefficients of {_name(parameter)}"
    return f"{what}, {entry.quality}: {entry.reasons[0].sentence}"


def same_unit(documents: Sequence[Document], next_step: str) -> None:
    """Refuse documents that do not belong together.

    Raises: InputError B-COEF-001 (another unit), B-COEF-003 (simulated and real).
    """
    for other in documents[1:]:
        _same(documents[0], other, "uut", "B-COEF-001", "belong to different units", next_step)
        _same(documents[0], other, "simulated", "B-COEF-003", "are partly simulated, partly measured", next_step)


def _same(first: Document, other: Document, name: str, code: str, what: str, next_step: str) -> None:
    if first[name] != other[name]:
        places = ", ".join(str(document["sources"][0]["session"]) for document in (first, other))
        both = f"{_words(first[name])} and {_words(other[name])}"
        raise InputError(code, f"the sessions {what} ({both})", where=places, next_step=next_step)


def _words(value: Any) -> str:
    return " ".join(value.values()) if isinstance(value, Mapping) else ("simulated" if value else "measured")


def c_header(document: Document, guarded: str, prefix: str, parts: Iterable[str]) -> str:
    """Return the C header of a document; ``guarded``, ``prefix``: in front of the names of its guard and constants."""
    unit = document["uut"]
    guard = re.sub("[^A-Z0-9]+", "_", f"{guarded}_{unit['model']}_{unit['serial']}_H".upper())
    head = f"#ifndef {guard}\n#define {guard}\n", f"#define {prefix}_SIMULATED {int(document['simulated'])}\n"
    return "\n".join([_preamble(document), *head, *parts, f"#endif /* {guard} */\n"])


def _preamble(document: Document) -> str:
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
        lines += [f"    ACCEPTED: {sentence}" for sentence in source.get("accepted", ())]
    return "\n".join(["/*", *(f" * {c_text(line)}".rstrip() for line in lines), " */", ""])


def c_text(text: str) -> str:
    """Return what a session says so that nothing in it ends a C comment or leaves ASCII."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").encode("ascii", "replace").decode().splitlines())
