"""The coefficients of one thermometer, from its resistance at several temperatures, by generalised least squares.

The equation is linear in R0, R0 a, R0 b and R0 c, so nothing is iterated; ratios and their covariance follow. The
coefficient c acts below 0 degC only: where the data do not tell it, it is held at the value of the standard.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bench.maths.least_squares import LinearFit, solve
from bench.model.errors import FitError
from numpy.typing import NDArray
from scipy import special

from resistance_thermometer.system.estimators.iec60751 import IEC_60751, cold_term

Array = NDArray[np.float64]
NAMES = ("r0", "cvd_a", "cvd_b", "cvd_c")
HELD = 3  # parameters that are fitted where c is held
FEWEST = 4  # points: one more than there are parameters, or the residuals would say nothing
_COLD_POINTS = 2  # below 0 degC, for c
_MOST_OF_C = 0.5  # largest standard uncertainty of c that tells it, of its value in the standard
IMPROBABLE = 1e-3


@dataclass(frozen=True)
class CallendarFit:
    """Coefficients of one thermometer: R0 in ohm, a in 1/degC, b in 1/degC^2, and c in 1/degC^4 if it was fitted.

    ``values`` and ``covariance`` are (3,), (3, 3) or (4,), (4, 4); ``residual_ohm`` is (m,); ``cold_std_per_degC4`` is
    the standard uncertainty that c would have, infinite if nothing was measured below 0 degC.
    """

    values: Array
    covariance: Array
    residual_ohm: Array
    chi2: float
    dof: int
    cold_std_per_degC4: float

    @property
    def std(self) -> Array:
        """Standard uncertainties of the values."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def probability(self) -> float:
        """That residuals as large as these come by chance."""
        return float(special.chdtrc(self.dof, self.chi2))


def fit_callendar(t_degC: Array, resistance_ohm: Array, covariance_ohm2: Array) -> CallendarFit:
    """Fit the Callendar-Van Dusen equation to one thermometer.

    Args:    t_degC: true temperatures, (m,).   resistance_ohm: (m,).   covariance_ohm2: of resistance and temperature
             together, seen in the resistance, (m, m).
    Returns: CallendarFit; c is fitted if two points lie below 0 degC and its uncertainty is below half of the value of
             the standard, else it is held there.
    Raises:  FitError RT-FIT-001 for fewer than four points; B-FIT-001 if they do not determine the parameters.
    Source:  IEC 60751:2022, section 4.2; JCGM 102:2011, section 6.3.1 (ratios of parameters).
    """
    if t_degC.size < FEWEST:
        raise FitError(
            "RT-FIT-001",
            f"{t_degC.size} temperatures do not test three coefficients",
            next_step=f"record at {FEWEST} temperatures or more",
        )
    cold = cold_term(t_degC)
    free = np.column_stack([np.ones_like(t_degC), t_degC, t_degC**2, cold])
    cold_std = np.inf
    if np.count_nonzero(cold) >= _COLD_POINTS:
        fit = solve(free, resistance_ohm, covariance_ohm2, NAMES)
        values, covariance = _ratios(fit)
        cold_std = float(np.sqrt(covariance[3, 3]))
        if cold_std <= _MOST_OF_C * abs(IEC_60751.c) and fit.dof > 0:
            return CallendarFit(values, covariance, fit.residual, fit.chi2, fit.dof, cold_std)
    held = free[:, :HELD].copy()
    held[:, 0] += IEC_60751.c * cold
    fit = solve(held, resistance_ohm, covariance_ohm2, NAMES[:HELD])
    return CallendarFit(*_ratios(fit), fit.residual, fit.chi2, fit.dof, cold_std)


def _ratios(fit: LinearFit) -> tuple[Array, Array]:
    """Return R0 and the coefficients over R0, with their covariance."""
    first = fit.parameters[0]
    values = np.concatenate([[first], fit.parameters[1:] / first])
    jacobian = np.eye(values.size) / first
    jacobian[0, 0] = 1.0
    jacobian[1:, 0] = -values[1:] / first
    return values, jacobian @ fit.covariance @ jacobian.T
