"""Coverage factor and verdicts with a guard band.

Source: JCGM 100:2008 annex G (coverage); ILAC-G8:09/2019 section 4.2 (non-binary statement, guard band w = U).
"""

from __future__ import annotations

import math
from functools import cache

from scipy import special


@cache
def coverage_factor(dof: float = math.inf, probability: float = 0.95) -> float:
    """Two-sided coverage factor: Student's t for ``dof`` degrees of freedom, the normal one for infinity.

    Source: JCGM 100:2008 table G.2.
    """
    upper = 0.5 + probability / 2
    if math.isinf(dof):
        return float(special.ndtri(upper))
    return float(special.stdtrit(dof, upper))


def verdict(value: float, expanded_uncertainty: float, limit: float | None) -> str:
    """Judge |value| against a symmetric limit with the guard band w = U; all three in one unit.

    Returns: "pass" below limit - U, "conditional_pass" up to the limit, "conditional_fail" up to limit + U, "fail"
             above; "none" without a limit. A value that is not finite fails.
    Source:  ILAC-G8:09/2019 section 4.2.3.
    """
    if limit is None:
        return "none"
    size = abs(value)
    if size <= limit - expanded_uncertainty:
        return "pass"
    if size <= limit:
        return "conditional_pass"
    return "conditional_fail" if size <= limit + expanded_uncertainty else "fail"
