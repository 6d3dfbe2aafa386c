"""Decision rules: from a value, its uncertainty and a limit to a statement of conformity and the risk that it is wrong.

Source: JCGM 106:2012 sections 7 to 9; ILAC-G8:09/2019 section 4.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from bench.maths.verdict import NON_BINARY, RULES, coverage_factor, verdict
from bench.model.errors import FitError

Rule = Literal["simple", "guard_band", "non_binary"]
_ACCEPTED = ("pass", "conditional_pass")


@dataclass(frozen=True)
class Decision:
    """Statement of conformity of one value.

    ``conformance_probability``: that the true value is inside the limits; ``specific_risk``: that the statement is
    wrong, so 1 - p for an accepted value and p for a refused one. Both None without a limit.
    """

    verdict: str
    conformance_probability: float | None
    specific_risk: float | None


def decide(
    value: float, std_uncertainty: float, limit: float | None, rule: str = NON_BINARY, dof: float = math.inf
) -> Decision:
    """Judge a value against the limits -limit and +limit by a decision rule; all in one unit.

    Args:    limit: None for a quantity that is not judged.   rule: "simple" (accept up to the limit), "guard_band"
             (accept up to the limit minus U) or "non_binary" (four statements, guard band on both sides of the limit).
             dof: effective degrees of freedom of the uncertainty; U is the 95 % expanded uncertainty.
    Returns: Decision.
    Raises:  FitError B-FIT-041 for an unknown rule.
    Source:  ILAC-G8:09/2019 section 4.2 (rules); JCGM 106:2012 sections 7 (probability), 9 (specific risk).
    """
    statement = verdict(value, coverage_factor(dof) * std_uncertainty, limit, checked_rule(rule))
    if limit is None:
        return Decision(statement, None, None)
    inside = conformance_probability(value, std_uncertainty, -limit, limit, dof)
    return Decision(statement, inside, 1.0 - inside if statement in _ACCEPTED else inside)


def checked_rule(rule: object) -> str:
    """The rule itself, if it is one.

    Args:    rule: what a campaign names.
    Returns: the rule.
    Raises:  FitError B-FIT-041 for an unknown rule.
    Source:  docs/decisions/0008-uncertainty-and-decision.md.
    """
    if rule in RULES:
        return str(rule)
    raise FitError("B-FIT-041", f"unknown decision rule {rule!r}", next_step=f"use one of: {', '.join(RULES)}")


def conformance_probability(
    value: float, std_uncertainty: float, lower: float, upper: float, dof: float = math.inf
) -> float:
    """Probability that the true value lies between two limits, either of which may be infinite.

    Args:    value, std_uncertainty, lower, upper: one unit.   dof: infinite: normal, else Student's t.
    Returns: probability; 0 or 1 where there is no uncertainty, 0 for a value that is not finite or an uncertainty that
             is not known (NaN).
    Raises:  nothing.
    Source:  JCGM 106:2012 section 7, with the scaled t distribution of JCGM 101:2008 section 6.4.9.
    """
    if not math.isfinite(value) or math.isnan(std_uncertainty):
        return 0.0
    if std_uncertainty == 0.0:
        return float(lower <= value <= upper)
    nearer, farther = sorted(((value - lower) / std_uncertainty, (upper - value) / std_uncertainty))
    if nearer < 0:  # outside: both terms are tails, no digits are lost and the difference is not negative
        return float(max(_tail(-nearer, dof) - _tail(farther, dof), 0.0))
    return float(1.0 - _tail(nearer, dof) - _tail(farther, dof))


def _tail(distance: float, dof: float) -> float:
    """Probability beyond ``distance`` standard uncertainties; computed in the tail, where 1 - p would lose digits."""
    from scipy import special  # takes longer to load than most commands that judge nothing

    return float(special.ndtr(-distance) if math.isinf(dof) else special.stdtr(dof, -distance))
