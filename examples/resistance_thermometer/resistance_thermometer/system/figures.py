"""Figures of a report: deviations inside the tolerance bands, and what the fitted curves leave."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bench.maths.verdict import coverage_factor

from resistance_thermometer.system.comparison import Comparison, slope_ohm_degC
from resistance_thermometer.system.estimators.iec60751 import CLASSES

Documents = list[dict[str, Any]]
_CURVE_POINTS = 121


def figures_of(comparisons: Sequence[Comparison]) -> Documents:
    """Return the figures; none if nothing was compared."""
    drawn = [comparison for comparison in comparisons if comparison.t_degC.size]
    return [_deviations(drawn), _residuals(drawn)] if drawn else []


def _deviations(comparisons: Sequence[Comparison]) -> dict[str, Any]:
    low = min(float(comparison.t_degC.min()) for comparison in comparisons)
    high = max(float(comparison.t_degC.max()) for comparison in comparisons)
    t_degC = np.linspace(low, high, _CURVE_POINTS)
    series: Documents = []
    for name in sorted(CLASSES, reverse=True):
        limit = np.array([CLASSES[name].degC(t) for t in t_degC])
        series.append({"label": f"class {name}", "x": t_degC.tolist(), "style": "band",
                       "low": (-limit).tolist(), "high": limit.tolist()})  # fmt: skip
    for comparison in comparisons:
        series.append(_points(comparison, comparison.deviation_degC))
    widest = max(float(comparison.std_degC.max()) for comparison in comparisons)
    caption = (
        "Deviation from IEC 60751, and what each class allows; every value is uncertain by at most "
        f"{coverage_factor() * widest:.3f} degC (95 %), most of it the same for all."
    )
    return {"title": "Deviations", "caption": caption, "x_label": "temperature / °C", "y_label": "deviation / °C",
            "series": series}  # fmt: skip


def _residuals(comparisons: Sequence[Comparison]) -> dict[str, Any]:
    series = []
    for comparison in comparisons:
        if comparison.fit is not None:
            slope = slope_ohm_degC(comparison.thermometer, comparison.t_degC)
            series.append(_points(comparison, 1e3 * comparison.fit.residual_ohm / slope))
    caption = "What the Callendar-Van Dusen equation of each thermometer leaves: no course over temperature is due."
    return {"title": "Residuals of the fit", "caption": caption, "x_label": "temperature / °C",
            "y_label": "residual / mK", "series": series}  # fmt: skip


def _points(comparison: Comparison, y: Any) -> dict[str, Any]:
    label = comparison.thermometer.serial
    return {"label": label, "x": comparison.t_degC.tolist(), "y": np.asarray(y).tolist(), "style": "points"}
