"""Tables and figures of bias, stability and repeatability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.analysis import Figure, Table, curve
from bench.maths.allan import allan_deviation
from bench.systems.gnc.estimators.bias_stability import AVERAGE_s, BiasStability
from bench.systems.gnc.rows import AXES

_ROWS = (
    ("gyro bias stability, deg/h", "gyro_bias_stability"),
    ("accelerometer bias stability, mg", "accel_bias_stability"),
    ("gyro bias repeatability, deg/h", "gyro_bias_repeatability"),
    ("accelerometer bias repeatability, mg", "accel_bias_repeatability"),
)
_FACTORS = {"gyro": (3600.0, "deg/h"), "accelerometer": (1e3, "mg")}


def table_2(estimates: Sequence[Mapping[str, Any]]) -> Table:
    """Table 2 of the paper for all axes (it prints X only): value and expanded uncertainty."""
    rows = [[text, *(_cell(estimates, quantity, axis) for axis in AXES)] for text, quantity in _ROWS]
    caption = (
        "Standard deviation of 360 means of 10 s in 1 h; of the means of six windows of 10 min. The repeatability has "
        "no limit and is not judged."
    )
    headers = ["quantity", *AXES]
    title = "Table 2: stability and repeatability"
    return Table(title, caption, headers, rows, lead=True)


def bias_table(estimates: Sequence[Mapping[str, Any]]) -> Table:
    """Bias of each axis."""
    names = (("gyro bias, deg/h", "gyro_bias", 1.0), ("accelerometer bias, mg", "accel_bias", 1e3))
    rows = [[text, *(_cell(estimates, quantity, axis, factor) for axis in AXES)] for text, quantity, factor in names]
    caption = (
        "Gyro: 3 min at rest, the Earth's rate taken off, w = K N - bias. Accelerometer: by a flip, a = K N + bias."
    )
    return Table("Bias", caption, ["quantity", *AXES], rows, lead=True)


def _cell(estimates: Sequence[Mapping[str, Any]], quantity: str, axis: str, factor: float = 1.0) -> str:
    for estimate in estimates:
        if estimate["quantity"] == quantity and estimate["conditions"].get("axis") == axis:
            value, wide = factor * estimate["value"], factor * estimate["expanded_uncertainty"]
            places = max(0, min(9, 1 - int(np.floor(np.log10(wide))))) if wide > 0 else 4
            return f"{value:.{places}f} ± {wide:.{places}f}"
    return "not tested"


def bias_figures(stabilities: Mapping[tuple[str, str], BiasStability]) -> list[Figure]:
    """Means of 10 s over the hour, and their Allan deviation."""
    figures = []
    for kind, (factor, unit) in _FACTORS.items():
        by_axis = {axis: stabilities[kind, axis] for axis in AXES if (kind, axis) in stabilities}
        if by_axis:
            figures += [_means(kind, factor, unit, by_axis), _allan(kind, factor, unit, by_axis)]
    return figures


def _means(kind: str, factor: float, unit: str, by_axis: Mapping[str, BiasStability]) -> Figure:
    series = [
        curve(
            axis,
            np.arange(0.5, stability.averages.size, dtype=np.float64) * AVERAGE_s / 60.0,
            factor * (stability.averages - stability.mean),
            "line",
        )
        for axis, stability in by_axis.items()
    ]
    title = f"{kind.capitalize()}: means of 10 s"
    return Figure(title, "About the mean of the hour.", "time, min", f"mean, {unit}", series)


def _allan(kind: str, factor: float, unit: str, by_axis: Mapping[str, BiasStability]) -> Figure:
    series = []
    for axis, stability in by_axis.items():
        curve_of = allan_deviation(factor * stability.averages, AVERAGE_s)
        series.append(curve(axis, curve_of.tau_s, curve_of.deviation, "line"))
    title = f"{kind.capitalize()}: Allan deviation"
    return Figure(
        title, "Of the means of 10 s.", "averaging time, s", f"Allan deviation, {unit}", series, x_log=True, y_log=True
    )
