"""How sure a proportion is that was counted."""

from __future__ import annotations

from scipy import special


def clopper_pearson(successes: int, trials: int, probability: float = 0.95) -> tuple[float, float]:
    """Exact two-sided interval of a proportion of which ``successes`` of ``trials`` were counted.

    Args:    successes, trials: counts.   probability: of the interval, at least; it covers more for few trials.
    Returns: low, high, each 0 to 1; (0, 1) without trials.
    Raises:  ValueError unless 0 <= successes <= trials.
    Source:  C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404; the limits are quantiles of beta distributions.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} of {trials} is no proportion")
    beyond, failures = (1.0 - probability) / 2.0, trials - successes
    low = float(special.betaincinv(successes, failures + 1, beyond)) if successes else 0.0
    high = float(special.betaincinv(successes + 1, failures, 1.0 - beyond)) if failures else 1.0
    return low, high
