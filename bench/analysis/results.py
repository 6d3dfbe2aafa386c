"""results.json: its form, its JSON Schema, and the writer that gives the same bytes for the same numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bench.analysis.analysis import Analysis
from bench.analysis.estimates import judged, rule_of
from bench.maths.verdict import Rule
from bench.model.errors import InputError

INCOMPLETE = "Incomplete: the run has not ended. These are the records so far; nothing is judged."
_Count = Annotated[int, Field(ge=0)]
_Plain = str | bool | int | float | None


class Closed(BaseModel):
    """A document without any other field than those it names, of plain finite values."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class Estimate(Closed):
    """One quantity with its uncertainty, the conditions it holds for and the verdict."""

    quantity: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    unit: str
    value: float
    std_uncertainty: Annotated[float, Field(ge=0)]
    coverage_factor: Annotated[float, Field(gt=0)]
    expanded_uncertainty: Annotated[float, Field(ge=0)]
    conditions: dict[str, _Plain]
    n: _Count
    dropped: _Count
    limit: float | None
    verdict: Literal["pass", "fail", "conditional_pass", "conditional_fail", "none"]
    conformance_probability: Annotated[float, Field(ge=0, le=1)] | None = Field(
        None, description="that the true value is within the limit; absent in documents of version 0.1"
    )
    dof: Annotated[float, Field(gt=0)] | None = Field(None, description="effective; absent = infinite")


class Quality(Closed):
    """Counts of what was recorded and what became of it."""

    records: _Count
    frames: _Count
    frames_bad: _Count
    frames_lost: _Count
    splices: _Count
    retaken: _Count


class Provenance(Closed):
    """What the numbers were made from; more keys are allowed."""

    model_config = ConfigDict(extra="allow", frozen=True)

    simulated: bool
    plan_sha256: str
    frame_sha256: str
    session_sha256: str
    software: str


class UnitUnderTest(Closed):
    """Who was calibrated; more keys are allowed."""

    model_config = ConfigDict(extra="allow", frozen=True)

    model: str
    serial: str


class Splice(Closed):
    """Where a run was gone on with after a stop: UTC of stop and start (ISO 8601), what was done again."""

    stopped: str | None
    started: str | None
    away_s: float | None
    step: int
    reason: str
    drift_degC: float | None = Field(description="change of the unit's temperature while nothing was recorded")
    soaked: bool


class Results(Closed):
    """The document results.json of a session."""

    schema_version: Literal[1] = Field(alias="schema")
    session: str
    campaign: str
    method: str
    uut: UnitUnderTest
    estimates: list[Estimate]
    quality: Quality
    provenance: Provenance
    notes: list[str]
    decision_rule: Rule | None = Field(None, description="absent in documents of version 0.1, which are non_binary")
    splices: list[Splice] = Field([], description="absent if the run was never stopped")
    incomplete: bool = Field(False, description="the run has not ended: nothing is judged; absent if it has")


def build_results(
    session_name: str,
    analysis: Analysis,
    counts: Mapping[str, int],
    provenance: Mapping[str, Any],
    decision: Mapping[str, Any] | None = None,
    *,
    splices: Sequence[Mapping[str, Any]] = (),
    incomplete: bool = False,
) -> dict[str, Any]:
    """Assemble and check the document of results.json; every estimate is judged by the rule of the campaign.

    Args:    session_name: name of the session folder without a suffix.   analysis: what ``analyse`` returned.
             counts: records, frames, frames_bad, frames_lost, splices, retaken; missing ones are 0.
             provenance: simulated, plan_sha256, frame_sha256, session_sha256, software and more.
             decision: the entry "decision" of the manifest's campaign, None for the non-binary rule.
             splices: where the run was gone on with (``Splice``).   incomplete: the run has not ended, so that nothing
             is judged.
    Raises:  InputError B-FIT-010 if the document would not be valid, naming the first wrong field; FitError B-FIT-041
             for an unknown rule.
    """
    rule = rule_of(decision)
    judgements = [judged(entry, rule) for entry in analysis.estimates]
    document: dict[str, Any] = {
        "schema": 1,
        "session": session_name,
        "campaign": analysis.campaign,
        "method": analysis.method,
        "uut": dict(analysis.uut),
        "decision_rule": rule,
        "estimates": [_unjudged(entry) for entry in judgements] if incomplete else judgements,
        "quality": {name: int(counts.get(name, 0)) for name in Quality.model_fields},
        "provenance": dict(provenance),
        "notes": [INCOMPLETE, *analysis.notes] if incomplete else analysis.notes,
    }
    if splices:
        document["splices"] = [dict(splice) for splice in splices]
    if incomplete:
        document["incomplete"] = True
    validate_results(document)
    return document


def _unjudged(estimate: Mapping[str, Any]) -> dict[str, Any]:
    """Return an estimate of a run that has not ended: what is still to come may change it."""
    return {**estimate, "verdict": "none", "conformance_probability": None}


def validate_results(document: object, where: str = "results.json") -> None:
    """Check a document against the form of results.json. Raises InputError B-FIT-010 naming the first wrong field."""
    next_step = "fit the session again with 'bench fit'; do not edit results by hand"
    check_form(Results, document, "B-FIT-010", where, next_step)


def check_form(form: type[BaseModel], document: object, code: str, where: str, next_step: str) -> None:
    """Check a document against its form. Raises InputError with the given code, naming the first wrong field."""
    try:
        form.model_validate(document)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        message = f"{place}: {first['msg'][:1].lower()}{first['msg'][1:]} (found {str(first['input'])[:60]})"
        raise InputError(code, message, where=where, next_step=next_step) from error


def results_json(document: Mapping[str, Any]) -> str:
    """Return canonical text of a document: sorted keys, shortest exact floats, one trailing newline."""
    return json.dumps(document, sort_keys=True, ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def results_schema() -> dict[str, Any]:
    """Return the JSON Schema of results.json, made from the same declarations that check it."""
    return schema_of(Results)


def schema_of(form: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON Schema of a document from its form."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **form.model_json_schema(by_alias=True)}
