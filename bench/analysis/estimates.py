"""Estimates in the form of results.json, and their conversion to currents and sensor units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.maths.verdict import NON_BINARY, checked_rule, coverage_factor, decide

Estimates = list[dict[str, Any]]  # entries of results.json
UNIT = "unit"  # condition: serial number of the unit under test, where a session has several


def estimate(
    quantity: str,
    unit: str,
    value: float,
    std_uncertainty: float,
    conditions: Mapping[str, Any],
    *,
    n: int,
    dropped: int = 0,
    limit: float | None = None,
    dof: float = math.inf,
) -> dict[str, Any]:
    """Return one entry of the flat list of results.json: 95 % interval, verdict against ``limit``.

    ``dof``: effective degrees of freedom; infinite (and then not written) where the covariance is known beforehand and
    not estimated from the residuals. The rule of the campaign is applied when the document is made (``judged``).
    """
    factor = coverage_factor(dof)
    entry = {
        "quantity": quantity,
        "unit": unit,
        "value": float(value),
        "std_uncertainty": float(std_uncertainty),
        "coverage_factor": factor,
        "expanded_uncertainty": factor * float(std_uncertainty),
        "conditions": dict(conditions),
        "n": int(n),
        "dropped": int(dropped),
        "limit": limit,
    }
    if math.isfinite(dof):
        entry["dof"] = float(dof)
    return judged(entry, NON_BINARY)


def rule_of(decision: Mapping[str, Any] | None) -> str:
    """Return the decision rule of a campaign, from the entry "decision" of its manifest section; non-binary by default.

    Raises: FitError B-FIT-041 for an unknown rule.
    """
    return checked_rule((decision or {}).get("rule", NON_BINARY))


def judged(entry: Mapping[str, Any], rule: str) -> dict[str, Any]:
    """Return an entry with verdict and conformance probability by a decision rule.

    Raises: FitError B-FIT-041 for an unknown rule.
    """
    dof = float(entry.get("dof", math.inf))
    decision = decide(entry["value"], entry["std_uncertainty"], entry["limit"], rule, dof)
    return dict(entry) | {
        "verdict": decision.verdict,
        "conformance_probability": decision.conformance_probability,
    }
