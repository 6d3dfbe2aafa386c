"""Functions of a quantity that a fit may take: what a measured value becomes, and the way back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.systems.readings.estimators.polynomial import Array, Points

ZERO_K = 273.15  # of the scale in degC


@dataclass(frozen=True)
class Function:
    """A function of a quantity, its slope, its inverse and the slope of that; of and to arrays (m,)."""

    of: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    back: Callable[[Array], Array]
    back_slope: Callable[[Array], Array]

    def points(self, points: Points) -> Points:
        """Return the function of measured points.

        Args:    points: of the quantity itself.
        Returns: mean and uncertainties of the function, each times the slope there; small against the curvature.
        Raises:  nothing.
        Source:  JCGM 100:2008 section 5.1.2 (law of propagation, first order).
        """
        slope = self.slope(points.mean)
        size = np.abs(slope)
        return replace(
            points,
            mean=self.of(points.mean),
            std=size * points.std,
            scatter=size * points.scatter,
            gain=slope * points.gain,
            floor=slope * points.floor,
        )


def function_of(name: str, unit: str) -> Function:
    """Return a function by its name: "log", "reciprocal" (of a temperature in degC in kelvin), or "" for none.

    Args:    name: of the function.   unit: of the quantity.
    Returns: Function.
    Raises:  KeyError for another name.
    Source:  docs/decisions/0031-values-without-programming.md.
    """
    zero = ZERO_K if unit == "degC" else 0.0
    return {
        "": Function(lambda x: x, np.ones_like, lambda y: y, np.ones_like),
        "log": Function(np.log, lambda x: 1.0 / x, np.exp, np.exp),
        "reciprocal": Function(
            lambda x: 1.0 / (x + zero), lambda x: -1.0 / (x + zero) ** 2,
            lambda y: 1.0 / y - zero, lambda y: -1.0 / y**2,
        ),
    }[name]  # fmt: skip
