"""Plain readings: how well they repeat, and the polynomials that the sequence asks for.

The means of all values and their verdicts are made for every analysis alike (``bench.analysis``).

Source: JCGM 100:2008 section 4.2 (pooled scatter); docs/decisions/0031.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis import Analysis, Estimate, Estimates, Material, Value, check_method, estimate, values_of
from bench.maths.variances import of_variances
from bench.model.errors import FitError
from bench.systems.readings.fits import estimates_of, evidence_of, fits_of
from bench.systems.readings.report import fit_figures, fit_table
from bench.systems.readings.wording import say

METHODS: tuple[str, ...] = ("polynomial",)


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return repeatability of each quantity, and the fits.

    Raises: FitError B-FIT-004 for an unknown method, B-FIT-160 if nothing was read.
    """
    check_method(method, METHODS)
    values = values_of(material)
    if not values:
        cure = "look at the readings of the session: 'bench export SESSION'"
        raise FitError("B-FIT-160", "no reading of the session has a value", next_step=cure)
    fits = fits_of(material.campaign, values)
    return Analysis(
        campaign="readings",
        method=method,
        uut=dict(material.campaign.get("uut", {"model": "", "serial": ""})),
        estimates=[*repeatabilities(values), *(entry for fit in fits for entry in estimates_of(fit))],
        evidence=[check for fit in fits for check in evidence_of(fit)],
        missing=[say("fit.refused", title=fit.title, why=fit.refused) for fit in fits if fit.refused],
        figures=[figure for fit in fits for figure in fit_figures(fit)],
        tables=[fit_table(fit) for fit in fits],
    )


def repeatabilities(values: Sequence[Value]) -> Estimates:
    """Return the standard deviation of one reading of each quantity, pooled over all its conditions.

    Its uncertainty and its interval are those of the root of a variance with so many degrees of freedom.
    """
    entries = []
    for name in dict.fromkeys(value.quantity for value in values):
        repeated = [value for value in values if value.quantity == name and value.n > 1]
        if repeated:
            squares = sum((value.n - 1) * value.scatter**2 for value in repeated)
            count = sum(value.n for value in repeated)
            pooled = float(np.sqrt(squares / (count - len(repeated))))
            free = sum(value.dof_a for value in repeated)
            entries.append(_repeatability(f"{name}_repeatability", repeated[0].unit, pooled, free, count))
    return entries


def _repeatability(name: str, unit: str, pooled: float, free: float, count: int) -> Estimate:
    std, half = of_variances(np.sqrt, free)
    return estimate(name, unit, pooled, std * pooled, {}, n=count, dof=free, factor=half / std)
