"""Estimates in the form of results.json, and the limits that a sequence states for them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from typing import Any, NotRequired, TypedDict

from bench.analysis.form import Document
from bench.maths.verdict import NON_BINARY, Limit, Verdict, bounds, checked_rule, coverage_factor, decide
from bench.model import declaration
from bench.model.errors import FitError
from bench.model.units import parse_quantity

_LEAST_COMMON = 1e-4  # of the standard uncertainty; what is below is 1e-8 of the variance
UNIT = "unit"  # condition: serial number of the unit under test, where a session has several


class Limits(TypedDict):
    """The lowest and the highest value that is allowed, None where there is no limit on that side."""

    low: float | None
    high: float | None


class Common(TypedDict):
    """What an estimate shares with others: signed contribution, standard, in its own unit, by the label of an error.

    ``standards``: errors of standards, the same wherever the label stands, also in the results of another unit;
    ``campaign``: errors that the estimates of one session share.
    """

    standards: dict[str, float]
    campaign: dict[str, float]


class Estimate(TypedDict):
    """One quantity as an analysis found it, if its model is right; the conditions it holds for, and the verdict.

    ``limit`` stands for -limit to limit; ``limits`` in its place where there is one side only or they are not alike.
    ``dof`` is left out where it is infinite. What the checks leave of it stands in results.json.
    """

    quantity: str
    unit: str
    value: float
    std_uncertainty: float
    coverage_factor: float
    expanded_uncertainty: float
    conditions: dict[str, Any]
    n: int
    dropped: int
    limit: float | None
    verdict: Verdict
    conformance_probability: float | None
    limits: NotRequired[Limits]
    dof: NotRequired[float]
    common: NotRequired[Common]


Estimates = list[Estimate]


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
    """Return one entry of the flat list of results.json: 95 % interval, verdict against ``limit``.

    ``limit``: a number for -limit to limit, or both ends, infinite on an open side.
    ``dof``: effective degrees of freedom; infinite (and then not written) where the covariance is known beforehand and
    not estimated from the residuals.   ``factor``: coverage factor where the law of the value is not Student's. The
    rule of the campaign is applied when the document is made (``judged``).
    """
    factor = coverage_factor(dof) if factor is None else factor
    if isinstance(limit, tuple) and limit[0] == -limit[1] and math.isfinite(limit[1]):
        limit = limit[1]
    entry: Estimate = {
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
        "verdict": "none",
        "conformance_probability": None,
    }
    if isinstance(limit, tuple):
        low, high = (end if math.isfinite(end) else None for end in limit)
        entry["limits"] = {"low": low, "high": high}
    if math.isfinite(dof):
        entry["dof"] = float(dof)
    return judged(entry, NON_BINARY)


def sharing(entry: Estimate, common: Common) -> Estimate:
    """Return an entry that says which part of its uncertainty other estimates share; what is negligible is left out."""
    least = _LEAST_COMMON * entry["std_uncertainty"]
    standards, campaign = (
        {label: float(part) for label, part in sorted(parts.items()) if abs(part) > least}
        for parts in (common["standards"], common["campaign"])
    )
    return {**entry, "common": {"standards": standards, "campaign": campaign}} if standards or campaign else entry


def covariance_by_standards(first: Document, second: Document) -> float:
    """Return the covariance of two entries of results.json by the standards that both were measured with.

    In the product of their units; 0 where an entry does not say what it has in common with others.
    Source: JCGM 100:2008 equation (F.2).
    """
    here, there = ((entry.get("common") or {}).get("standards", {}) for entry in (first, second))
    return math.fsum(here[label] * there[label] for label in here.keys() & there.keys())


def rule_of(decision: Document | None) -> str:
    """Return the decision rule of a campaign, from the entry "decision" of its manifest section; non-binary by default.

    Raises: FitError B-FIT-041 for an unknown rule.
    """
    return checked_rule((decision or {}).get("rule", NON_BINARY))


def judged(entry: Estimate, rule: str) -> Estimate:
    """Return an entry with verdict and conformance probability by a decision rule.

    Raises: FitError B-FIT-041 for an unknown rule.
    """
    dof = entry.get("dof", math.inf)
    decision = decide(entry["value"], entry["std_uncertainty"], limits_of(entry), rule, dof)
    return {**entry, "verdict": decision.verdict, "conformance_probability": decision.conformance_probability}


def limits_of(entry: Document) -> tuple[float, float] | None:
    """Return lowest and highest value that an entry of results.json may have, infinite on an open side; else None."""
    limits = entry.get("limits")
    if limits is None:
        limit = entry.get("limit")
        return None if limit is None else bounds(float(limit))
    low, high = limits["low"], limits["high"]
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
