"""Polynomial in temperature about a reference, for quantities measured at several temperatures.

Source: AF-converter paper section 3.3 (temperature coefficients); docs/decisions/0004.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats
from bench.maths.least_squares import solve
from bench.maths.tests import chi2_tail

_CHANCE = 0.05  # of what a polynomial leaves over: less is no noise, and the unit's own


@dataclass(frozen=True)
class TemperaturePolynomial:
    """value(T) = c0 + c1 (T - T_ref) + c2 (T - T_ref)^2, as far as the temperatures determine it.

    ``coefficients`` (d + 1,) in the unit of the values over degC^k; ``covariance`` (d + 1, d + 1) of the noise, or of
    what the polynomial leaves over where that is more, and of what the values share, of which ``effects`` (d + 1, j)
    are one sigma each. ``misfit`` (d + 1,): the first part, standard, with ``misfit_dof`` degrees of freedom; 0: noise.
    ``operator`` (d + 1, k) makes the coefficients of the values; ``residual`` (k,) value minus polynomial.
    """

    reference_degC: float
    coefficients: Floats
    covariance: Floats
    operator: Floats
    effects: Floats
    residual: Floats
    misfit: Floats
    misfit_dof: float

    def slope(self, temperature_degC: float) -> float:
        """d value / dT at a temperature, unit of the values per degC."""
        powers = self.coefficients[1:] * np.arange(1, self.coefficients.size)
        return float(np.polynomial.polynomial.polyval(temperature_degC - self.reference_degC, powers))

    def slope_std(self, temperature_degC: float) -> float:
        """Return standard uncertainty of ``slope``, unit of the values per degC."""
        order = np.arange(1, self.coefficients.size)
        gradient = order * (temperature_degC - self.reference_degC) ** (order - 1)
        return float(np.sqrt(gradient @ self.covariance[1:, 1:] @ gradient))

    def std_uncertainty(self, order: int) -> float:
        """Return standard uncertainty of the coefficient of (T - T_ref)^order."""
        return float(np.sqrt(self.covariance[order, order]))


def fit_temperature(
    temperature_degC: Floats, values: Floats, covariance: Floats, shared: Floats, reference_degC: float
) -> TemperaturePolynomial | None:
    """Fit a polynomial of degree 2, or less if there are fewer than three temperatures.

    What the values share does not enter the weights: it is all but the same at every temperature, and the last digits
    in which it differs would be read as knowledge about it from any curvature that a parabola cannot follow.

    Args:    temperature_degC: measured unit temperatures, (k,).   values: (k,).   covariance: (k, k) of their noise.
             shared: (k, j) one-sigma effects of j independent errors that the values share.   reference_degC: T_ref.
    Returns: TemperaturePolynomial, or None for fewer than two temperatures.
    Raises:  FitError B-FIT-001 if the temperatures are not distinct.
    Source:  AF-converter paper section 3.3; docs/decisions/0004.
    """
    degree = min(2, values.size - 1)
    if degree < 1:
        return None
    design = np.vander(temperature_degC - reference_degC, degree + 1, increasing=True)
    names = [f"temperature coefficient {order}" for order in range(degree + 1)]
    fit = solve(design, values, covariance, names)
    effects = fit.operator @ shared
    fits = fit.dof == 0 or chi2_tail(fit.chi2, fit.dof) > _CHANCE
    own = fit.covariance if fits else fit.covariance * (fit.chi2 / fit.dof)
    return TemperaturePolynomial(
        reference_degC=reference_degC,
        coefficients=fit.parameters,
        covariance=own + effects @ effects.T,
        operator=fit.operator,
        effects=effects,
        residual=fit.residual,
        misfit=np.sqrt(np.diag(own)),
        misfit_dof=0.0 if fits else float(fit.dof),
    )
