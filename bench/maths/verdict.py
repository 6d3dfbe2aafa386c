"""Coverage factor, and verdicts by the decision rules of a campaign.

Source: JCGM 100:2008 annex G (coverage); ILAC-G8:09/2019 section 4.2 (simple acceptance, guard band, non-binary).
"""

from __future__ import annotations

import math
from functools import cache

SIMPLE, GUARD_BAND, NON_BINARY = "simple", "guard_band", "non_binary"
RULES = (SIMPLE, GUARD_BAND, NON_BINARY)
_NORMAL_95 = 1.959963984540054  # two-sided; known without scipy, which takes longer to load than a history to compare


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
    from scipy import special

    upper = 0.5 + probability / 2
    if math.isinf(dof):
        return float(special.ndtri(upper))
    return float(special.stdtrit(dof, upper))


def verdict(value: float, expanded_uncertainty: float, limit: float | None, rule: str = NON_BINARY) -> str:
    """Judge |value| against a symmetric limit; guard band w = U, all three in one unit.

    Args:    rule: "simple": "pass" up to the limit, else "fail"; "guard_band": "pass" up to limit - U, else "fail";
             "non_binary": "pass" up to limit - U, "conditional_pass" up to the limit, "conditional_fail" up to
             limit + U, else "fail".
    Returns: the verdict; "none" without a limit. A value that is not finite fails, and so does one whose uncertainty
             is not known (NaN).
    Raises:  nothing; ``bench.maths.decision.checked_rule`` refuses an unknown rule.
    Source:  ILAC-G8:09/2019 sections 4.2.1 to 4.2.3.
    """
    if limit is None:
        return "none"
    if math.isnan(expanded_uncertainty):
        return "fail"
    size = abs(value)
    accepted = limit if rule == SIMPLE else limit - expanded_uncertainty
    if size <= accepted:
        return "pass"
    if rule != NON_BINARY:
        return "fail"
    if size <= limit:
        return "conditional_pass"
    return "conditional_fail" if size <= limit + expanded_uncertainty else "fail"
