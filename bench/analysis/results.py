"""results.json: its form, its JSON Schema, and the writer that gives the same bytes for the same numbers; acceptances.

An acceptance says who released the value of a doubtful estimate, and why. It never gives an uncertainty or a verdict
back, and holds no longer once the value or the reasons of the doubt are others than those that were looked at.

Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, StringConstraints

from bench.analysis.analysis import Analysis
from bench.analysis.doubt import DOUBTFUL, REFUSED, base_quantity, stated, weigh
from bench.analysis.estimates import (
    FIT_AGAIN,
    Acceptance,
    Closed,
    Document,
    Estimate,
    Estimates,
    check_form,
    documents,
    judged,
    rule_of,
    schema_of,
)
from bench.analysis.wording import say
from bench.maths.verdict import Rule
from bench.model.errors import InputError
from bench.model.systems import Assumption

_SAME_VALUE = 1e-9  # relative; another machine may round the last digits otherwise
_Said = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]


class Accepted(Closed):
    """One estimate that was accepted: which it is, the value and the doubts that were looked at, and who said what."""

    quantity: str
    conditions: dict[str, str | bool | int | float | None]
    method: str
    value: float
    reasons: Annotated[list[str], Field(min_length=1, description="codes of the doubts that were known")]
    by: _Said
    reason: _Said
    utc: str

    def is_for(self, entry: Estimate, method: str) -> bool:
        """Return whether an estimate by a method is the one that was accepted."""
        named = self.quantity == entry.quantity and self.method == method
        conditions = entry.conditions
        same = self.conditions.keys() == conditions.keys()
        return named and same and all(_alike(value, conditions[name]) for name, value in self.conditions.items())

    def holds_for(self, entry: Estimate) -> bool:
        """Return whether the estimate still is what was accepted: doubtful, the same value, no other doubt."""
        return (
            entry.quality == DOUBTFUL
            and _alike(self.value, entry.value)
            and {reason.code for reason in entry.reasons} <= set(self.reasons)
        )


class Acceptances(Closed):
    """The document acceptances.json beside a recording."""

    schema_version: Literal[1] = Field(1, alias="schema")
    session_sha256: str
    acceptances: list[Accepted]


def _alike(first: object, second: object) -> bool:
    numbers = isinstance(first, float | int) and isinstance(second, float | int)
    return math.isclose(first, second, rel_tol=_SAME_VALUE) if numbers else first == second  # type: ignore[arg-type]


def with_acceptances(entries: Estimates, accepted: Sequence[Accepted], method: str) -> tuple[Estimates, list[str]]:
    """Return estimates, marked where an acceptance holds, and sentences about those that do not."""
    marked: Estimates = []
    held: set[int] = set()
    for entry in entries:
        for number, acceptance in enumerate(accepted):
            if acceptance.is_for(entry, method) and acceptance.holds_for(entry):
                released = Acceptance.model_construct(by=acceptance.by, reason=acceptance.reason)
                entry = entry.model_copy(update={"acceptance": released})
                held.add(number)
        marked.append(entry)
    lost = [
        f"The acceptance of {acceptance.quantity} by {acceptance.by} holds no longer: its value or doubts are others."
        for number, acceptance in enumerate(accepted)
        if acceptance.method == method and number not in held
    ]
    return marked, list(dict.fromkeys(lost))


def acceptable(entries: Estimates, named: str) -> Estimates:
    """Return the doubtful estimates that a person names: "dsf_n", or "dsf_n channel=2" for those of one condition.

    A temperature coefficient, residual or change belongs to its quantity.
    Raises: InputError B-ACC-001 if none is doubtful, B-ACC-002 if one is refused.
    """
    quantity, *narrowed = named.replace(",", " ").split() or [""]
    wanted = [part.partition("=") for part in narrowed]
    of_it = [
        entry
        for entry in entries
        if quantity in (entry.quantity, base_quantity(entry.quantity))
        and all(_condition_is(entry.conditions.get(name), value) for name, _, value in wanted)
    ]
    refused = next((entry for entry in of_it if entry.quality == REFUSED), None)
    if refused is not None:
        raise InputError(
            "B-ACC-002",
            f"{refused.quantity} is refused and has no value to accept: {refused.reasons[0].sentence}",
            where=", ".join(f"{name} {value}" for name, value in refused.conditions.items()),
            next_step="measure again; what is only doubtful is accepted by its conditions, such as 'dsf_n channel=2'",
        )
    doubtful = [entry for entry in of_it if entry.quality == DOUBTFUL]
    if not doubtful:
        others = sorted({base_quantity(entry.quantity) for entry in entries if entry.quality == DOUBTFUL})
        state = "is sound, there is nothing to accept" if of_it else "is no estimate of this session"
        next_step = f"doubtful here: {', '.join(others)}" if others else "no estimate of this session is doubtful"
        raise InputError("B-ACC-001", f"{named!r} {state}", next_step=next_step)
    return doubtful


def _condition_is(condition: object, text: str) -> bool:
    if isinstance(condition, float):
        try:
            return math.isclose(condition, float(text), rel_tol=_SAME_VALUE)
        except ValueError:
            return False
    return str(condition) == text


SCHEMA = 2
INCOMPLETE = say("incomplete")
_Count = Annotated[int, Field(ge=0)]


class TakenForGranted(Closed):
    """What no data of this campaign can show (``bench.model.systems``)."""

    code: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    taken_for_granted: str
    unseen: str = Field(description="size that leaves no trace in this campaign")
    effect: str
    shown_by: str = Field(description="measurement that would show it")
    quantities: list[str] = Field(description="empty for every estimate")


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

    schema_version: Literal[1, 2] = Field(alias="schema", description="1: before doubt was stated")
    session: str
    campaign: str
    method: str
    uut: UnitUnderTest
    estimates: list[Estimate]
    quality: Quality
    provenance: Provenance
    notes: list[str]
    decision_rule: Rule | None = Field(None, description="absent in documents of version 0.1, which are non_binary")
    assumptions: list[TakenForGranted] = Field([], description="what these data cannot show; absent in schema 1")
    splices: list[Splice] = Field([], description="absent if the run was never stopped")
    incomplete: bool = Field(False, description="the run has not ended: nothing is judged; absent if it has")


def build_results(
    session_name: str,
    analysis: Analysis,
    counts: Mapping[str, int],
    provenance: Document,
    decision: Document | None = None,
    *,
    assumptions: Sequence[Assumption] = (),
    splices: Sequence[Document] = (),
    incomplete: bool = False,
    acceptances: Sequence[Accepted] = (),
) -> dict[str, Any]:
    """Assemble and check the document of results.json; every estimate is judged by the rule of the campaign.

    Args:    session_name: name of the session folder without a suffix.   analysis: what ``analyse`` returned.
             counts: records, frames, frames_bad, frames_lost, splices, retaken; missing ones are 0.
             provenance: simulated, plan_sha256, frame_sha256, session_sha256, software and more.
             decision: the entry "decision" of the manifest's campaign, None for the non-binary rule.
             assumptions: what the campaign takes for granted.
             splices: where the run was gone on with (``Splice``).   incomplete: the run has not ended, so that nothing
             is judged.   acceptances: those of the session; of a run that has not ended none counts.
    Raises:  InputError B-FIT-010 if the document would not be valid, naming the first wrong field; FitError B-FIT-041
             for an unknown rule.
    """
    rule = rule_of(decision)
    accepted = () if incomplete else acceptances
    entries, lost = with_acceptances(stated_estimates(analysis, rule), accepted, analysis.method)
    noted = [seen.sentence for seen in weigh(analysis.evidence).noted]
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "session": session_name,
        "campaign": analysis.campaign,
        "method": analysis.method,
        "uut": dict(analysis.uut),
        "decision_rule": rule,
        "estimates": documents(map(_unjudged, entries) if incomplete else entries),
        "quality": {name: int(counts.get(name, 0)) for name in Quality.model_fields},
        "provenance": dict(provenance),
        "assumptions": [{**asdict(taken), "quantities": list(taken.quantities)} for taken in assumptions],
        "notes": [*([INCOMPLETE] if incomplete else []), *lost, *noted, *analysis.notes],
    }
    if splices:
        document["splices"] = [dict(splice) for splice in splices]
    if incomplete:
        document["incomplete"] = True
    validate_results(document)
    return document


def stated_estimates(analysis: Analysis, rule: str) -> Estimates:
    """Return what the checks leave of the estimates. Raises: FitError B-FIT-041 for an unknown rule."""
    against = weigh(analysis.evidence).against
    return [stated(judged(entry, rule), against) for entry in analysis.estimates]


def _unjudged(entry: Estimate) -> Estimate:
    """Return an estimate of a run that has not ended: what is still to come may change it."""
    return entry.model_copy(update={"verdict": "none", "conformance_probability": None})


def validate_results(document: object, where: str = "results.json") -> None:
    """Check a document against the form of results.json. Raises InputError B-FIT-010 naming the first wrong field."""
    check_form(Results, document, "B-FIT-010", where, FIT_AGAIN)


def results_json(document: Document) -> str:
    """Return canonical text of a document: sorted keys, shortest exact floats, one trailing newline."""
    return json.dumps(document, sort_keys=True, ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def results_schema() -> dict[str, Any]:
    """Return the JSON Schema of results.json, made from the same declarations that check it."""
    return schema_of(Results)
