"""A calibrated triad of sensors: matrix, bias, their covariance, and what follows from them.

Sensor form ``N = S (input + ...)``, inverse form ``input = K N + ...``, K = S^-1. S is output per input, so its
diagonal minus one is the scale-factor error and its rest the cross coupling (row sensor, column axis), where N is in
the unit of the input.

Source: GNC module paper equations (1), (2); covariances by JCGM 102:2011 section 6.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
AXES = ("x", "y", "z")
_IMPROBABLE = 1e-3
_STEP = 1e-3  # of a standard uncertainty: the functions are nearly linear over that, and doubles resolve it


@dataclass(frozen=True)
class TriadFit:
    """Fit of a triad. Accelerometer: a = K N + bias; gyroscope: w = K N - bias, so N = S (w + bias).

    ``covariance`` is that of the nine elements of K, row by row, and then the three of the bias. ``dof`` are the
    degrees of freedom behind it (infinite where the noise was known). ``chi2`` is the weighted sum of squares of
    ``residual_dof`` independent residuals. ``inflated`` says that the residuals are larger than what was declared can
    explain and that the covariance was enlarged for it.
    """

    matrix: Array  # (3, 3) K, true input per indicated unit
    bias: Array  # (3,) unit of the input
    covariance: Array  # (12, 12)
    residual: Array  # (n, 3) unit of the input
    chi2: float
    residual_dof: int
    dof: float
    condition: float  # of the design with columns of unit length
    inflated: bool = False

    @cached_property
    def sensitivity(self) -> Array:
        """S = K^-1, (3, 3), indicated unit per input unit."""
        return np.asarray(np.linalg.inv(self.matrix))

    @cached_property
    def sensitivity_covariance(self) -> Array:
        """(9, 9) of S, row by row: dS = -S dK S, so the Jacobian is -(S kron S^T). Source: JCGM 102:2011 section 6."""
        jacobian = np.kron(self.sensitivity, self.sensitivity.T)
        return np.asarray(jacobian @ self.covariance[:9, :9] @ jacobian.T)

    @property
    def matrix_std(self) -> Array:
        """Standard uncertainty of K, (3, 3)."""
        return np.sqrt(self.covariance.diagonal()[:9]).reshape(3, 3)

    @property
    def bias_std(self) -> Array:
        """Standard uncertainty of the bias, (3,), unit of the input."""
        return np.sqrt(self.covariance.diagonal()[9:])

    @property
    def sensitivity_std(self) -> Array:
        """Standard uncertainty of S, (3, 3)."""
        return np.sqrt(self.sensitivity_covariance.diagonal()).reshape(3, 3)

    @property
    def scale_error_ppm(self) -> Array:
        """(3,) 1e6 (S_ii - 1): positive = more output per input."""
        return np.asarray(1e6 * (self.sensitivity.diagonal() - 1.0))

    @property
    def scale_error_std_ppm(self) -> Array:
        """Standard uncertainty of the scale-factor errors, (3,), ppm."""
        return np.asarray(1e6 * self.sensitivity_std.diagonal())

    @property
    def cross_coupling(self) -> Array:
        """(3, 3) S with a zero diagonal: row sensor, column axis of the input."""
        return np.asarray(self.sensitivity - np.diag(self.sensitivity.diagonal()))

    @property
    def cross_coupling_std(self) -> Array:
        """Standard uncertainty of the cross coupling, (3, 3), zero on the diagonal."""
        return np.asarray(self.sensitivity_std - np.diag(self.sensitivity_std.diagonal()))

    def apply(self, indicated: Array, *, bias_sign: int) -> Array:
        """K N + bias_sign * bias for (n, 3) indicated values; +1 for an accelerometer, -1 for a gyroscope."""
        return np.asarray(indicated @ self.matrix.T + bias_sign * self.bias)


def improbable(chi2: float, dof: int, below: float = _IMPROBABLE) -> bool:
    """Return whether a chi-square is less probable than 0.1 %, or ``below``: then something was larger than declared.

    Source: JCGM 100:2008 annex G.
    """
    from scipy import special

    return dof > 0 and float(special.chdtrc(dof, chi2)) < below


def propagate_inputs(function: Callable[[Array], Array], at: Array, covariance: Array) -> Array:
    """Return covariance of ``function`` of correlated inputs, by central differences.

    Args:    function: (k,) -> (p,).   at: (k,), where.   covariance: (k, k); an input of no variance is left out.
    Returns: (p, p).
    Raises:  nothing of its own.
    Source:  JCGM 102:2011 section 6.2.
    """
    std = np.sqrt(covariance.diagonal())
    columns = []
    for place in np.flatnonzero(std > 0):
        step = np.zeros(at.size)
        step[place] = std[place] * _STEP
        columns.append((function(at + step) - function(at - step)) / (2.0 * step[place]))
    if not columns:
        return np.zeros((function(at).size,) * 2)
    jacobian = np.stack(columns, axis=1)
    used = std > 0
    return np.asarray(jacobian @ covariance[np.ix_(used, used)] @ jacobian.T)
