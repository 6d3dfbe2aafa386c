"""Coverage factor, verdicts by the decision rules of a campaign and the risk that one is wrong, counted proportions.

Source: JCGM 100:2008 annex G (coverage); ILAC-G8:09/2019 section 4.2 (simple acceptance, guard band, non-binary);
JCGM 106:2012 sections 7 to 9.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

from bench.model.errors import FitError

SIMPLE, GUARD_BAND, NON_BINARY = "simple", "guard_band", "non_binary"
RULES = (SIMPLE, GUARD_BAND, NON_BINARY)
_NORMAL_95 = 1.959963984540054  # two-sided; known without scipy, which takes longer to load than a history to compare
Rule = Literal["simple", "guard_band", "non_binary"]
Limit = float | tuple[float, float]  # a number stands for -limit to limit; either of two may be infinite
INDETERMINATE: Literal["indeterminate"] = "indeterminate"  # no statement of conformity: the value is doubtful
Verdict = Literal["pass", "fail", "conditional_pass", "conditional_fail", "indeterminate", "none"]
Look = Literal["good", "warn", "bad", "none"]
_CERTAIN = 8.5  # standard uncertainties; what a normal distribution has beyond is less than the last digit of 1


class Meaning(NamedTuple):
    """What a verdict says: whether it accepts the value (None: no statement), and how it looks wherever it is shown."""

    accepts: bool | None
    look: Look


MEANINGS: Mapping[Verdict, Meaning] = {  # the worst first; every exit status, word and colour is taken from here
    "fail": Meaning(False, "bad"),
    "indeterminate": Meaning(None, "warn"),
    "conditional_fail": Meaning(False, "bad"),
    "conditional_pass": Meaning(True, "warn"),
    "pass": Meaning(True, "good"),
}
WORST_FIRST: tuple[Verdict, ...] = tuple(MEANINGS)
_NOT_JUDGED = Meaning(None, "none")


@cache
def coverage_factor(dof: float = math.inf, probability: float = 0.95) -> float:
    """Return two-sided coverage factor: Student's t for ``dof`` degrees of freedom, the normal one for infinity.

    Args:    dof: degrees of freedom, not necessarily whole.   probability: of the interval.
    Returns: coverage factor.
    Raises:  nothing.
    Source:  JCGM 100:2008 table G.2.
    """
    if math.isinf(dof) and probability == 0.95:
        return _NORMAL_95
    from scipy import special  # takes longer to load than most commands that judge nothing

    upper = 0.5 + probability / 2
    if math.isinf(dof):
        return float(special.ndtri(upper))
    return float(special.stdtrit(dof, upper))


def bounds(limit: Limit) -> tuple[float, float]:
    """Return the lowest and the highest value that a limit allows.

    Args:    limit: a number for -limit to limit, or both ends, either of which may be infinite.
    Returns: lower, upper.
    Raises:  nothing.
    Source:  JCGM 106:2012 section 3.3 (tolerance limits and interval).
    """
    return limit if isinstance(limit, tuple) else (-limit, limit)


def verdict(value: float, expanded_uncertainty: float, limit: Limit | None, rule: str = NON_BINARY) -> Verdict:
    """Judge a value against its limits; guard band w = U at every limit, all in one unit.

    Args:    limit: see ``bounds``.   rule: "simple": "pass" up to the limits, else "fail"; "guard_band": "pass" up to U
             inside of them, else "fail"; "non_binary": "pass" up to U inside, "conditional_pass" up to the limits,
             "conditional_fail" up to U outside, else "fail".
    Returns: the verdict; "none" without a limit. A value that is not finite fails, and so does one whose uncertainty
             is not known (NaN).
    Raises:  nothing; ``checked_rule`` refuses an unknown rule.
    Source:  ILAC-G8:09/2019 sections 4.2.1 to 4.2.3.
    """
    if limit is None:
        return "none"
    if math.isnan(expanded_uncertainty) or not math.isfinite(value):
        return "fail"
    lower, upper = bounds(limit)
    guard = 0.0 if rule == SIMPLE else expanded_uncertainty
    if lower + guard <= value <= upper - guard:
        return "pass"
    if rule != NON_BINARY:
        return "fail"
    if lower <= value <= upper:
        return "conditional_pass"
    return "conditional_fail" if lower - guard <= value <= upper + guard else "fail"


def count_verdicts(verdicts: Iterable[str]) -> dict[Verdict, int]:
    """Return how often each verdict was given, the worst first; what is not judged is not counted.

    Args:    verdicts: of single values.
    Returns: counts by verdict, {} if nothing is judged.
    Raises:  nothing.
    Source:  docs/method-uncertainty.md.
    """
    counts = Counter(verdicts)
    return {verdict: counts[verdict] for verdict in WORST_FIRST if counts[verdict]}


def worst(verdicts: Iterable[str]) -> Verdict:
    """Return the verdict that stands for several: a sound fail, else one that is indeterminate, else the worst.

    Args:    verdicts: of single values.
    Returns: the verdict; "none" if nothing is judged.
    Raises:  nothing.
    Source:  docs/method-uncertainty.md.
    """
    return next(iter(count_verdicts(verdicts)), "none")


def passed(verdicts: Iterable[str]) -> bool:
    """Return whether none of several verdicts fails, conditionally or not, or is indeterminate.

    Args:    verdicts: of single values.
    Returns: True also where nothing is judged.
    Raises:  nothing.
    Source:  docs/method-uncertainty.md.
    """
    return not any(verdict in MEANINGS and not meaning_of(verdict).accepts for verdict in verdicts)


def meaning_of(verdict: str) -> Meaning:
    """Return what a verdict says, nothing for "none" and for words of other software."""
    return next((meaning for name, meaning in MEANINGS.items() if name == verdict), _NOT_JUDGED)


def is_refused(verdict: str) -> bool:
    """Return whether a verdict refuses the value, conditionally too."""
    return meaning_of(verdict).accepts is False


def verdict_words(verdict: str) -> str:
    """Return a verdict as English words."""
    return "not judged" if verdict == "none" else verdict.replace("_", " ")


@dataclass(frozen=True)
class Decision:
    """Statement of conformity of one value.

    ``conformance_probability``: that the true value is inside the limits; None without a limit.
    """

    verdict: Verdict
    conformance_probability: float | None


def decide(
    value: float, std_uncertainty: float, limit: Limit | None, rule: str = NON_BINARY, dof: float = math.inf
) -> Decision:
    """Judge a value against its limits by a decision rule; all in one unit.

    Args:    limit: see ``bounds``; None for a quantity that is not judged.
             rule: "simple" (accept up to the limits), "guard_band" (accept up to U inside of them) or "non_binary"
             (four statements, guard band on both sides of each limit).   dof: effective degrees of freedom of the
             uncertainty; U is the 95 % expanded uncertainty, at one limit as at two.
    Returns: Decision.
    Raises:  FitError B-FIT-041 for an unknown rule.
    Source:  ILAC-G8:09/2019 section 4.2 (rules); JCGM 106:2012 section 7 (probability).
    """
    statement = verdict(value, coverage_factor(dof) * std_uncertainty, limit, checked_rule(rule))
    if limit is None:
        return Decision(statement, None)
    return Decision(statement, conformance_probability(value, std_uncertainty, *bounds(limit), dof))


def checked_rule(rule: object) -> str:
    """Return the rule itself, if it is one.

    Args:    rule: what a campaign names.
    Returns: the rule.
    Raises:  FitError B-FIT-041 for an unknown rule.
    Source:  docs/method-uncertainty.md.
    """
    if rule in RULES:
        return str(rule)
    raise FitError("B-FIT-041", f"unknown decision rule {rule!r}", next_step=f"use one of: {', '.join(RULES)}")


def conformance_probability(
    value: float, std_uncertainty: float, lower: float, upper: float, dof: float = math.inf
) -> float:
    """Return probability that the true value lies between two limits, either of which may be infinite.

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
    if math.isinf(dof) and nearer > _CERTAIN:
        return 1.0
    return float(1.0 - _tail(nearer, dof) - _tail(farther, dof))


def _tail(distance: float, dof: float) -> float:
    """Return probability beyond ``distance`` standard uncertainties, from the tail, where 1 - p would lose digits."""
    from scipy import special

    return float(special.ndtr(-distance) if math.isinf(dof) else special.stdtr(dof, -distance))


def chance_of_pass(spread: float, std_uncertainty: float, limits: tuple[float, float], rule: str = NON_BINARY) -> float:
    """Return the probability that a unit nobody has measured yet gets the verdict "pass".

    Args:    spread: standard deviation of the true values of such units, about the middle of both limits, which are
             finite.   std_uncertainty: of the measurement, known beforehand.   rule: see ``verdict``.
    Returns: probability; the measured values are normal with the variance of both.
    Raises:  nothing; ``checked_rule`` refuses an unknown rule.
    Source:  JCGM 106:2012 section 9.5 (before a measurement, the acceptance interval is integrated over the values that
             may be measured); ILAC-G8:09/2019 section 4.2 (acceptance intervals of the rules).
    """
    guard = 0.0 if rule == SIMPLE else coverage_factor() * std_uncertainty
    half = (limits[1] - limits[0]) / 2.0 - guard
    scatter = math.hypot(spread, std_uncertainty)
    if half < 0.0:
        return 0.0
    return math.erf(half / scatter / math.sqrt(2.0)) if scatter else 1.0


def clopper_pearson(successes: int, trials: int, probability: float = 0.95) -> tuple[float, float]:
    """Return exact two-sided interval of a proportion of which ``successes`` of ``trials`` were counted.

    Args:    successes, trials: counts.   probability: of the interval, at least; it covers more for few trials.
    Returns: low, high, each 0 to 1; (0, 1) without trials.
    Raises:  ValueError unless 0 <= successes <= trials.
    Source:  C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404; the limits are quantiles of beta distributions.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} of {trials} is no proportion")
    from scipy import special

    beyond, failures = (1.0 - probability) / 2.0, trials - successes
    low = float(special.betaincinv(successes, failures + 1, beyond)) if successes else 0.0
    high = float(special.betaincinv(successes + 1, failures, 1.0 - beyond)) if failures else 1.0
    return low, high
