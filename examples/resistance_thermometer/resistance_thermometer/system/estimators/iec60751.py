"""The relation between resistance and temperature of industrial platinum thermometers, and their tolerance classes.

Source: IEC 60751:2022, sections 4.2 (interpolation equations, coefficients) and 5.1 (tolerance classes).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
LOWEST_DEGC, HIGHEST_DEGC = -200.0, 850.0
_STEPS = 20  # of Newton's method, which needs four


@dataclass(frozen=True)
class Curve:
    """Resistance over that at 0 degC: 1 + a t + b t^2 + c (t - 100) t^3, the last term below 0 degC only.

    ``a`` in 1/degC, ``b`` in 1/degC^2, ``c`` in 1/degC^4.
    """

    a: float = 3.9083e-3
    b: float = -5.775e-7
    c: float = -4.183e-12


IEC_60751 = Curve()


@dataclass(frozen=True)
class Tolerance:
    """Largest deviation of a class: ``at_zero_degC`` + ``per_degC`` |t|."""

    at_zero_degC: float
    per_degC: float

    def degC(self, t_degC: float) -> float:
        """Return the largest deviation at a temperature, degC."""
        return self.at_zero_degC + self.per_degC * abs(t_degC)


CLASSES: Mapping[str, Tolerance] = {"A": Tolerance(0.15, 0.002), "B": Tolerance(0.30, 0.005)}


def cold_term(t_degC: ArrayLike) -> Array:
    """Return what the coefficient c is multiplied by: (t - 100) t^3 below 0 degC, else 0.

    Args:    t_degC: temperatures, any shape.
    Returns: the same shape, degC^4.
    Raises:  nothing.
    Source:  IEC 60751:2022, section 4.2.
    """
    t = np.asarray(t_degC, np.float64)
    return np.where(t < 0.0, (t - 100.0) * t**3, 0.0)


def ratio(t_degC: ArrayLike, curve: Curve = IEC_60751) -> Array:
    """Return the resistance at temperatures over that at 0 degC.

    Args:    t_degC: temperatures, any shape.   curve: coefficients, those of the standard if left out.
    Returns: the same shape.
    Raises:  nothing.
    Source:  IEC 60751:2022, section 4.2.
    """
    t = np.asarray(t_degC, np.float64)
    return np.asarray(1.0 + curve.a * t + curve.b * t**2 + curve.c * cold_term(t))


def slope_per_degC(t_degC: ArrayLike, curve: Curve = IEC_60751) -> Array:
    """Return the derivative of the ratio by the temperature, 1/degC.

    Args:    t_degC: temperatures, any shape.   curve: coefficients, those of the standard if left out.
    Returns: the same shape, 1/degC.
    Raises:  nothing.
    Source:  IEC 60751:2022, section 4.2, differentiated.
    """
    t = np.asarray(t_degC, np.float64)
    cold = np.where(t < 0.0, 4.0 * t**3 - 300.0 * t**2, 0.0)
    return np.asarray(curve.a + 2.0 * curve.b * t + curve.c * cold)


def temperature_degC(of_ratio: ArrayLike, curve: Curve = IEC_60751) -> Array:
    """Return the temperatures at which the ratio has these values; NaN outside of -200 to 850 degC.

    Args:    of_ratio: resistance over that at 0 degC, any shape.   curve: coefficients, as above.
    Returns: the same shape, degC.
    Raises:  nothing.
    Source:  IEC 60751:2022, section 4.2, inverted by Newton's method.
    """
    wanted = np.asarray(of_ratio, np.float64)
    inside = (wanted >= ratio(LOWEST_DEGC, curve)) & (wanted <= ratio(HIGHEST_DEGC, curve))
    t = np.where(inside, (wanted - 1.0) / curve.a, 0.0)
    for _ in range(_STEPS):
        t = np.clip(t - (ratio(t, curve) - wanted) / slope_per_degC(t, curve), LOWEST_DEGC, HIGHEST_DEGC)
    return np.asarray(np.where(inside, t, np.nan))
