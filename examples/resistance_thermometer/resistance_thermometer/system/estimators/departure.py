"""Which single cause explains best how a thermometer departs from the curve of the standard.

Each cause has its own course over temperature: leads in series add the same resistance everywhere, another resistance
at 0 degC is proportional to the curve, and another alloy departs with the temperature itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bench.maths.least_squares import solve
from numpy.typing import NDArray

from resistance_thermometer.system.estimators.iec60751 import ratio

Array = NDArray[np.float64]
SERIES, NOMINAL, ALLOY = "series", "nominal", "alloy"


@dataclass(frozen=True)
class Departure:
    """The likeliest cause; ``size``: ohm in series, relative error of R0, or change of the coefficient a in 1/degC."""

    cause: str
    size: float
    chi2: float


def likeliest_departure(t_degC: Array, resistance_ohm: Array, covariance_ohm2: Array, nominal_ohm: float) -> Departure:
    """Return the cause that leaves the smallest residuals.

    Args:    t_degC: (m,).   resistance_ohm: (m,).   covariance_ohm2: (m, m).   nominal_ohm: at 0 degC.
    Returns: Departure.
    Raises:  FitError B-FIT-001, B-FIT-002 as ``bench.maths.least_squares.solve``.
    Source:  IEC 60751:2022, section 4.2; one-parameter fits by generalised least squares.
    """
    excess = resistance_ohm - nominal_ohm * ratio(t_degC)
    courses = {
        SERIES: np.ones_like(t_degC),
        NOMINAL: nominal_ohm * ratio(t_degC),
        ALLOY: nominal_ohm * t_degC,
    }
    found = []
    for cause, course in courses.items():
        fit = solve(course[:, None], excess, covariance_ohm2, (cause,))
        found.append(Departure(cause, float(fit.parameters[0]), fit.chi2))
    return min(found, key=lambda departure: departure.chi2)
