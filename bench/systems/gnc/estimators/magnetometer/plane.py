"""Both methods for two magnetometer axes turned about the third: the paper's extremes and the ellipse, side by side.

Source: GNC paper (001) section 4.2 2); ``estimators.magnetometer.ellipse``, ``estimators.magnetometer.extremes``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.gnc.estimators.magnetometer.ellipse import EllipseFit, PlaneParameters, fit_ellipse
from bench.systems.gnc.estimators.magnetometer.extremes import ExtremesFit, fit_extremes
from bench.systems.gnc.estimators.roll import RollUncertainty, roll_deg, roll_uncertainty

Array = NDArray[np.float64]
EXTREMES, ELLIPSE = "extremes", "ellipse"


@dataclass(frozen=True)
class PlaneComparison:
    """Both methods on the same readings.

    Attributes:
        ellipse, extremes: the fits.   roll: uncertainty of the roll angle by method.
        roll_difference_deg: (rms, largest) of roll by extremes minus roll by ellipse over the readings.
        score: (5,) difference of the parameters over its standard uncertainty, in the order of
            ``bench.systems.gnc.estimators.magnetometer.ellipse.PARAMETERS``.
    """

    ellipse: EllipseFit
    extremes: ExtremesFit
    roll: dict[str, RollUncertainty]
    roll_difference_deg: tuple[float, float]
    score: Array

    @property
    def by_method(self) -> dict[str, PlaneParameters]:
        """Parameters under the names that results carry: "extremes", "ellipse"."""
        return {EXTREMES: self.extremes.parameters, ELLIPSE: self.ellipse.parameters}


def compare_methods(x_out: Array, y_out: Array) -> PlaneComparison:
    """Fit the readings of a rotation by both methods.

    Args:    x_out, y_out: (n,), same unit, gaps left out.
    Returns: PlaneComparison.
    Raises:  FitError B-FIT-090, B-FIT-091 as ``ellipse.fit_ellipse``: readings that do not determine the
             ellipse have no extremes either.
    Source:  see the head of this file.
    """
    ellipse = fit_ellipse(x_out, y_out)
    extremes = fit_extremes(x_out, y_out, ellipse)
    both = {EXTREMES: extremes.parameters, ELLIPSE: ellipse.parameters}
    rolls = {name: roll_deg(*one.corrected(x_out, y_out)) for name, one in both.items()}
    difference = (rolls[EXTREMES] - rolls[ELLIPSE] + 180.0) % 360.0 - 180.0
    apart = extremes.parameters.values - ellipse.parameters.values
    return PlaneComparison(
        ellipse=ellipse,
        extremes=extremes,
        roll={name: roll_uncertainty(one, ellipse.noise) for name, one in both.items()},
        roll_difference_deg=(float(np.sqrt(np.mean(difference**2))), float(np.abs(difference).max())),
        score=apart / np.hypot(extremes.parameters.std, ellipse.parameters.std),
    )
