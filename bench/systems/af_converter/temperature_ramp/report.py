"""Figures and tables of an imported temperature ramp."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import Figure, Floats, Table, series
from bench.systems.af_converter.estimators.drift_ramp import BRANCH, Blocks
from bench.systems.af_converter.estimators.hysteresis.fit import LAG
from bench.systems.af_converter.temperature_ramp.fits import RampColumns, ReadingFit

_DRAWN = 800  # points of a curve


def figures(columns: RampColumns, blocks: Blocks, fits: Sequence[ReadingFit]) -> list[Figure]:
    """Programme, branches against temperature, up minus down, and residuals against time."""
    drawn = [_programme(columns)]
    for fit in fits:
        drawn += [_branches(fit, columns, blocks), _differences(fit, columns), _residuals(fit, columns, blocks)]
    return drawn


def _programme(columns: RampColumns) -> Figure:
    thin = slice(None, None, max(1, columns.t_s.size // _DRAWN))
    hours = columns.t_s[thin] / 3600.0
    parts = [series("programme", hours, columns.programme_degC[thin], "line")] if columns.has_set_point else []
    parts.append(series("sensor", hours, columns.temperature_degC[thin], "line"))
    corners = [(segment.start_s, segment.start_degC) for segment in columns.segments]
    corners.append((columns.segments[-1].end_s, columns.segments[-1].end_degC))
    at = np.array(corners)
    parts.append(series("corners found", at[:, 0] / 3600.0, at[:, 1], "points"))
    return Figure("Temperature programme", "Ramps and holds as found.", "time / h", "temperature / °C", parts)


def _branches(fit: ReadingFit, columns: RampColumns, blocks: Blocks) -> Figure:
    direction, temperature = blocks.mean(columns.branch.astype(np.float64)), blocks.mean(columns.temperature_degC)
    parts = [
        series(label, temperature[direction == sign], fit.readings[direction == sign], "points")
        for label, sign in (("up", 1), ("down", -1), ("hold", 0))
    ]
    caption = "Block means against the temperature of the sensor; nothing taken away."
    return Figure(f"{fit.name} up and down", caption, "temperature / °C", f"reading / {columns.unit}", parts)


def _differences(fit: ReadingFit, columns: RampColumns) -> Figure:
    parts = [
        series(
            sensor,
            np.array([difference.temperature_degC for difference in differences]),
            np.array([difference.value for difference in differences]),
            "line",
        )
        for sensor, differences in fit.differences.items()
    ]
    left, std, _ = fit.drift.estimate(BRANCH)
    caption = (
        f"Read off at equal temperature of each sensor. With the drift taken away {left:.2f} ± {2 * std:.2f} "
        f"{columns.unit} are left."
    )
    label = f"up minus down / {columns.unit}"
    return Figure(f"{fit.name} up minus down", caption, "temperature / °C", label, parts)


def _residuals(fit: ReadingFit, columns: RampColumns, blocks: Blocks) -> Figure:
    hours = blocks.middle_s / 3600.0
    parts = [series("drift and up/down term", hours, fit.drift.residual, "line")]
    if fit.joint is not None:
        parts.append(series("lag and hysteresis", hours, fit.joint.fit.residual, "line"))
    caption = "What each model leaves over: it is alike for hours, which the intervals take into account."
    return Figure(f"{fit.name} residuals", caption, "time / h", f"residual / {columns.unit}", parts)


def tables(columns: RampColumns, fits: Sequence[ReadingFit]) -> list[Table]:
    """Segments, their totals, up minus down by sensor, and what the models leave."""
    return [_segments(columns), _totals(columns), *(_by_sensor(fit, columns) for fit in fits), _left(columns, fits)]


def _segments(columns: RampColumns) -> Table:
    rows = [
        [segment.kind,
         *(round(float(x), 3) + 0.0 for x in (segment.start_s / 3600.0, segment.length_h, segment.rate_degC_h)),
         round(segment.start_degC, 2), round(segment.end_degC, 2)]
        for segment in columns.segments
    ]  # fmt: skip
    headers = ["kind", "start / h", "length / h", "rate / (°C/h)", "from / °C", "to / °C"]
    return Table("Ramps and holds", "As found in the log.", headers, rows)


def _totals(columns: RampColumns) -> Table:
    rows = []
    for kind in ("up", "hold", "down"):
        lengths = [segment.length_h for segment in columns.segments if segment.kind == kind]
        rows.append([kind, len(lengths), round(float(sum(lengths)), 3)])
    return Table("Time up, holding and down", "", ["kind", "pieces", "hours"], rows)


def _by_sensor(fit: ReadingFit, columns: RampColumns) -> Table:
    by_sensor = {
        sensor: {difference.temperature_degC: round(difference.value, 2) for difference in many}
        for sensor, many in fit.differences.items()
    }
    temperatures = sorted({at for many in by_sensor.values() for at in many})
    rows = [[at, *(many.get(at, "–") for many in by_sensor.values())] for at in temperatures]
    rows.append(["after drift", *(round(fit.after_drift[name].estimate(BRANCH)[0], 2) for name in by_sensor)])
    caption = (
        f"Up minus down at equal temperature, {columns.unit}, by the sensor taken for it; last row: what is left "
        "beside cubic in temperature and quadratic in time."
    )
    title = f"{fit.name}: up minus down"
    return Table(title, caption, ["temperature / °C", *by_sensor], rows)


def _left(columns: RampColumns, fits: Sequence[ReadingFit]) -> Table:
    rows: list[list[Any]] = []
    for fit in fits:
        rows.append([fit.name, "drift: up minus down", *_rounded(*fit.drift.estimate(BRANCH)[:2], fit.drift.residual)])
        if fit.joint is not None:
            lag_min = fit.joint.fit.value(LAG) / 60.0
            model = f"joint: falling minus rising, lag {lag_min:.0f} min"
            rows.append([fit.name, model, *_rounded(*fit.joint.width, fit.joint.fit.residual)])
    unit = columns.unit
    headers = ["reading", "model", f"branches apart / {unit}", f"std / {unit}", f"residual rms / {unit}"]
    caption = "The up/down term against a lag behind the sensor: the one with less left over describes the unit better."
    return Table("What is left between the branches", caption, headers, rows)


def _rounded(value: float, std: float, residual: Floats) -> list[float]:
    return [round(number, 3) for number in (value, std, float(np.sqrt(np.mean(residual**2))))]
