"""Figures of a report: deviations inside the tolerance bands, and what the fitted curves leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from bench.analysis import Figure, Floats, Series, band, series
from bench.maths.verdict import coverage_factor

from resistance_thermometer.system.comparison import Comparison, slope_ohm_degC
from resistance_thermometer.system.estimators.iec60751 import CLASSES

_CURVE_POINTS = 121


def figures_of(comparisons: Sequence[Comparison]) -> list[Figure]:
    """Return the figures; none if nothing was compared."""
    drawn = [comparison for comparison in comparisons if comparison.t_degC.size]
    return [_deviations(drawn), _residuals(drawn)] if drawn else []


def _deviations(comparisons: Sequence[Comparison]) -> Figure:
    low = min(float(comparison.t_degC.min()) for comparison in comparisons)
    high = max(float(comparison.t_degC.max()) for comparison in comparisons)
    t_degC = np.linspace(low, high, _CURVE_POINTS)
    drawn = []
    for name in sorted(CLASSES, reverse=True):
        limit = np.array([CLASSES[name].degC(t) for t in t_degC])
        drawn.append(band(f"class {name}", t_degC, -limit, limit))
    drawn += [_points(comparison, comparison.deviation_degC) for comparison in comparisons]
    widest = max(float(comparison.std_degC.max()) for comparison in comparisons)
    caption = (
        "Deviation from IEC 60751, and what each class allows; every value is uncertain by at most "
        f"{coverage_factor() * widest:.3f} degC (95 %), most of it the same for all."
    )
    return Figure("Deviations", caption, "temperature / °C", "deviation / °C", drawn)


def _residuals(comparisons: Sequence[Comparison]) -> Figure:
    drawn = []
    for comparison in comparisons:
        if comparison.fit is not None:
            slope = slope_ohm_degC(comparison.thermometer, comparison.t_degC)
            drawn.append(_points(comparison, 1e3 * comparison.fit.residual_ohm / slope))
    caption = "What the Callendar-Van Dusen equation of each thermometer leaves: no course over temperature is due."
    return Figure("Residuals of the fit", caption, "temperature / °C", "residual / mK", drawn)


def _points(comparison: Comparison, y: Floats) -> Series:
    return series(comparison.thermometer.serial, comparison.t_degC, y, "points")
