"""Estimates, from the fit to results.json and every page, and the limits that a sequence states for them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)

from bench.maths.verdict import NON_BINARY, Limit, Verdict, bounds, checked_rule, coverage_factor, decide
from bench.model import declaration
from bench.model.errors import FitError, InputError
from bench.model.units import parse_quantity
from bench.model.yamlio import first_wrong

Document = Mapping[str, Any]  # a part of a plan, a manifest or results.json, as it is read


class Closed(BaseModel):
    """A document without any other field than those it names, of plain finite values."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


def check_form(form: type[BaseModel], document: object, code: str, where: str, next_step: str) -> None:
    """Check a document against its form. Raises InputError with the given code, naming the first wrong field."""
    try:
        form.model_validate(document)
    except ValidationError as error:
        raise wrong_form(error, code, where, next_step) from error


def wrong_form(error: ValidationError, code: str, where: str, next_step: str) -> InputError:
    """Return the error of a document that has not its form, which names the first wrong field."""
    place, what = first_wrong(error)
    return InputError(code, f"{place}: {what}", where=where, next_step=next_step)


def schema_of(form: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON Schema of a document from its form."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **form.model_json_schema(by_alias=True)}


_LEAST_COMMON = 1e-4  # of the standard uncertainty; what is below is 1e-8 of the variance
UNIT = "unit"  # condition: serial number of the unit under test, where a session has several


if TYPE_CHECKING:  # a sound estimate has its numbers, and a quantity its conditions: who computes need not ask
    Number: TypeAlias = float | Any
    Plain: TypeAlias = Any
else:
    Number = float | None
    Plain = str | bool | int | float | None
_Count = Annotated[int, Field(ge=0)]
_Code = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]


def _as_given(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    """Return a value that was checked as it was given: a sentence that knows its translations stays one."""
    check(value)
    return value


_Sentence = Annotated[str, WrapValidator(_as_given)]


class Reason(Closed):
    """Why an estimate is not sound: a stable code, a sentence, and the figure that led to it."""

    code: _Code
    sentence: _Sentence
    figure: float | None


class EvidenceInterval(Closed):
    """Where the value may lie by all that is known, in the unit of the estimate; no expanded uncertainty."""

    low: float
    high: float
    basis: _Sentence


class Limits(Closed):
    """The lowest and the highest value that is allowed; null where there is no limit on that side."""

    low: float | None
    high: float | None

    @model_validator(mode="after")
    def _in_order(self) -> Limits:
        if self.low is None and self.high is None:
            raise ValueError("neither a lowest nor a highest value")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError(f"low {self.low} is above high {self.high}")
        return self


class Acceptance(Closed):
    """Who released the value of a doubtful estimate, and why; the value alone."""

    by: str
    reason: str


class Common(Closed):
    """What an estimate shares with others: signed standard contributions in its unit, by the label of an error."""

    standards: dict[str, float] = Field(description="errors of standards: the same in every document with the label")
    campaign: dict[str, float] = Field(description="errors that the estimates of this document share")


class Estimate(Closed):
    """One quantity with its uncertainty, the conditions it holds for and the verdict.

    Doubtful: no uncertainty, no statement of conformity. Refused: no value either.
    """

    quantity: _Code
    unit: str
    value: Number
    std_uncertainty: Annotated[Number, Field(ge=0)]
    coverage_factor: Annotated[Number, Field(gt=0)]
    expanded_uncertainty: Annotated[Number, Field(ge=0)]
    conditions: Annotated[dict[str, Plain], WrapValidator(_as_given)]
    n: _Count
    dropped: _Count
    limit: float | None = Field(description="stands for -limit to limit")
    limits: Limits | None = Field(
        None, description="where there is one side only or both are not alike; limit is null then"
    )
    verdict: Verdict
    conformance_probability: Annotated[float | None, Field(ge=0, le=1)] = Field(
        None, description="that the true value is within the limit; absent in documents of version 0.1"
    )
    dof: Annotated[float | None, Field(gt=0)] = Field(None, description="effective; absent = infinite")
    common: Common | None = Field(None, description="part of std_uncertainty that other estimates share, if stated")
    quality: Literal["sound", "doubtful", "refused"] = Field("sound", description="absent in documents of schema 1")
    reasons: list[Reason] = Field([], description="empty for a sound estimate")
    evidence_interval: EvidenceInterval | None = None
    acceptance: Acceptance | None = None

    @model_validator(mode="after")
    def _as_the_quality_says(self) -> Estimate:
        if (self.quality == "sound") != (self.expanded_uncertainty is not None):
            raise ValueError(f"{self.quality} with an expanded uncertainty of {self.expanded_uncertainty}")
        if (self.quality == "refused") != (self.value is None):
            raise ValueError(f"{self.quality} with the value {self.value}")
        if (self.quality == "sound") != (not self.reasons):
            raise ValueError(f"{self.quality} with {len(self.reasons)} reasons")
        if self.acceptance is not None and self.quality != "doubtful":
            raise ValueError(f"{self.quality} with an acceptance")
        if self.limit is not None and self.limits is not None:
            raise ValueError(f"limit {self.limit} and limits")
        return self

    @property
    def document(self) -> dict[str, Any]:
        """The entry of results.json: what was given, so that an old entry keeps its form."""
        return self.model_dump(exclude_unset=True)


Estimates = list[Estimate]
_FORM = TypeAdapter(Estimates)
FIT_AGAIN = "fit the session again with 'bench fit'; do not edit results by hand"


def estimate(
    quantity: str,
    unit: str,
    value: float,
    std_uncertainty: float,
    conditions: Document,
    *,
    n: int,
    dropped: int = 0,
    limit: Limit | None = None,
    dof: float = math.inf,
    factor: float | None = None,
) -> Estimate:
    """Return what an analysis found, sound if its model is right: 95 % interval, verdict against ``limit``.

    ``limit``: a number for -limit to limit, or both ends, infinite on an open side.
    ``dof``: effective degrees of freedom; infinite (and then not written) where the covariance is known beforehand and
    not estimated from the residuals.   ``factor``: coverage factor where the law of the value is not Student's. The
    rule of the campaign is applied when the document is made (``judged``).
    """
    factor = coverage_factor(dof) if factor is None else factor
    if isinstance(limit, tuple) and limit[0] == -limit[1] and math.isfinite(limit[1]):
        limit = limit[1]
    given: dict[str, Any] = {
        "quantity": quantity,
        "unit": unit,
        "value": float(value),
        "std_uncertainty": float(std_uncertainty),
        "coverage_factor": factor,
        "expanded_uncertainty": factor * float(std_uncertainty),
        "conditions": dict(conditions),
        "n": int(n),
        "dropped": int(dropped),
        "limit": None if isinstance(limit, tuple) else limit,
    }
    if isinstance(limit, tuple):
        low, high = (end if math.isfinite(end) else None for end in limit)
        given["limits"] = Limits.model_construct(low=low, high=high)
    if math.isfinite(dof):
        given["dof"] = float(dof)
    # not checked here: what a fit leaves without a number is refused, or found when the document is made
    return judged(Estimate.model_construct(**given), NON_BINARY)


def estimates_of(results: Document) -> Estimates:
    """Return the estimates of a document results.json. Raises: InputError B-FIT-010 naming the first wrong field."""
    try:
        return _FORM.validate_python(results.get("estimates", []))
    except ValidationError as error:
        raise wrong_form(error, "B-FIT-010", str(results.get("session", "results.json")), FIT_AGAIN) from error


def documents(entries: Iterable[Estimate]) -> list[dict[str, Any]]:
    """Return entries of results.json."""
    return [entry.document for entry in entries]


def sharing(entry: Estimate, common: Common) -> Estimate:
    """Return an entry that says which part of its uncertainty other estimates share; what is negligible is left out."""
    least = _LEAST_COMMON * entry.std_uncertainty
    standards, campaign = (
        {label: float(part) for label, part in sorted(parts.items()) if abs(part) > least}
        for parts in (common.standards, common.campaign)
    )
    if not (standards or campaign):
        return entry
    return entry.model_copy(update={"common": Common(standards=standards, campaign=campaign)})


def covariance_by_standards(first: Common | None, second: Common | None) -> float:
    """Return the covariance of two estimates by the standards that both were measured with.

    In the product of their units; 0 where an estimate does not say what it has in common with others.
    Source: JCGM 100:2008 equation (F.2).
    """
    if first is None or second is None:
        return 0.0
    labels = first.standards.keys() & second.standards.keys()
    return math.fsum(first.standards[label] * second.standards[label] for label in labels)


def rule_of(decision: Document | None) -> str:
    """Return the decision rule of a campaign, from the entry "decision" of its manifest section; non-binary by default.

    Raises: FitError B-FIT-041 for an unknown rule.
    """
    return checked_rule((decision or {}).get("rule", NON_BINARY))


def judged(entry: Estimate, rule: str) -> Estimate:
    """Return an entry with verdict and conformance probability by a decision rule.

    Raises: FitError B-FIT-041 for an unknown rule.
    """
    dof = math.inf if entry.dof is None else entry.dof
    decision = decide(entry.value, entry.std_uncertainty, limits_of(entry), rule, dof)
    return entry.model_copy(
        update={"verdict": decision.verdict, "conformance_probability": decision.conformance_probability}
    )


def limits_of(entry: Estimate) -> tuple[float, float] | None:
    """Return lowest and highest value that an estimate may have, infinite on an open side; None without a limit."""
    return limit_range(entry.limit, entry.limits)


def limit_range(limit: float | None, limits: Limits | None) -> tuple[float, float] | None:
    """Return both ends of the limits of an estimate: of ``limits`` where they are stated, else of ``limit``."""
    if limits is None:
        return None if limit is None else bounds(float(limit))
    low, high = limits.low, limits.high
    return -math.inf if low is None else low, math.inf if high is None else high


def use_of(value: float, limits: tuple[float, float], reach: float = 0.0) -> float:
    """Return how much of its limits a value uses, its interval of half-width ``reach`` included; 1 is all of it.

    Two limits: of the way from their middle to either; one: of its size. Of a limit of nothing, anything is too much.
    """
    low, high = limits
    if math.isinf(low) or math.isinf(high):
        beyond = value + reach - high if math.isinf(low) else low - value + reach
        size = abs(high if math.isinf(low) else low)
        return 1.0 + beyond / size if size else math.copysign(math.inf, beyond)
    half, away = (high - low) / 2.0, abs(value - (low + high) / 2.0) + reach
    return away / half if half else (math.inf if away else 0.0)


def stated_limits(
    campaign: Document, declared: Mapping[str, declaration.Limit], code: str, unknown: str
) -> dict[str, float]:
    """Return the limits that a campaign states, by name, in the base unit of their dimension.

    Args:    declared: every limit the system knows.   code, unknown: of the refusal, and what it says of others.
    Raises:  FitError with the given code for an unknown limit, a wrong unit or one that is not above zero and must be.
    """
    limits = {}
    for name, stated in (campaign.get("limits") or {}).items():
        if name not in declared:
            raise _unusable(code, name, unknown, declared)
        dimension = declared[name].dimension
        try:
            limits[name] = parse_quantity(f"{float(stated['value'])!r} {stated['unit']}", dimension)
        except (KeyError, TypeError, ValueError) as error:
            raise _unusable(code, name, str(error), declared) from error
        if declared[name].above_zero and not limits[name] > 0.0:
            raise _unusable(code, name, f"{limits[name]:g} {dimension} is not above zero", declared)
    return limits


def _unusable(code: str, name: str, why: str, declared: Mapping[str, declaration.Limit]) -> FitError:
    close = [] if name in declared else difflib.get_close_matches(name, declared, n=1)
    known = f"use one of: {', '.join(declared)}, with a unit of its dimension"
    return FitError(
        code,
        f"limit {name!r}: {why}",
        where="manifest: campaign.limits",
        next_step=f"did you mean {close[0]!r}?" if close else known,
    )
