"""Estimates of a thermometer: its deviations, judged against its class, and the coefficients of its own curve."""

from __future__ import annotations

from typing import Any

from bench.analysis import Estimates, estimate

from resistance_thermometer.system.comparison import Comparison
from resistance_thermometer.system.estimators.callendar import NAMES

_UNITS = {
    "r0": ("ohm", 1.0), "cvd_a": ("ppm/degC", 1e6), "cvd_b": ("ppm/degC2", 1e6), "cvd_c": ("ppm/degC4", 1e6),
}  # fmt: skip


def estimates_of(comparison: Comparison) -> Estimates:
    """Return the deviation at every set-point, and the coefficients unless they are refused."""
    return [*_coefficients(comparison), *_deviations(comparison)]


def place_of(comparison: Comparison) -> dict[str, Any]:
    """Return the conditions that say which thermometer it is."""
    return {"unit": comparison.thermometer.serial, "channel": comparison.thermometer.channel}


def _coefficients(comparison: Comparison) -> Estimates:
    fit = comparison.fit
    if fit is None or comparison.refused:
        return []
    counted = {"n": sum(comparison.n), "dropped": sum(comparison.dropped)}
    made = []
    for name, value, std in zip(NAMES, fit.values, fit.std, strict=False):
        unit, factor = _UNITS[name]
        made.append(estimate(name, unit, factor * value, factor * std, place_of(comparison), **counted))
    return made


def _deviations(comparison: Comparison) -> Estimates:
    tolerance = comparison.thermometer.tolerance
    columns = (comparison.setpoint_degC, comparison.t_degC, comparison.deviation_degC, comparison.std_degC)
    rows = zip(*columns, comparison.n, comparison.dropped, strict=True)
    return [
        estimate(
            "deviation", "degC", deviation, std, place_of(comparison) | {"temperature_degC": float(setpoint)},
            n=n, dropped=dropped, limit=round(tolerance.degC(float(t_degC)), 3),
        )
        for setpoint, t_degC, deviation, std, n, dropped in rows
    ]  # fmt: skip
