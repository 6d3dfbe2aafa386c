"""Figures and tables of an imported temperature ramp."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.systems.af_converter.estimators.drift_ramp import BRANCH, Blocks
from bench.systems.af_converter.estimators.hysteresis.fit import LAG
from bench.systems.af_converter.temperature_ramp.columns import RampColumns

if TYPE_CHECKING:
    from bench.systems.af_converter.temperature_ramp.fits import ReadingFit

Floats = NDArray[np.float64]
Documents = list[dict[str, Any]]
_DRAWN = 800  # points of a curve


def figures(columns: RampColumns, blocks: Blocks, fits: Sequence[ReadingFit]) -> Documents:
    """Programme, branches against temperature, up minus down, and residuals against time."""
    found = [_programme(columns)]
    for fit in fits:
        found += [_branches(fit, columns, blocks), _differences(fit, columns), _residuals(fit, columns, blocks)]
    return found


def _programme(columns: RampColumns) -> dict[str, Any]:
    thin = slice(None, None, max(1, columns.t_s.size // _DRAWN))
    hours = columns.t_s[thin] / 3600.0
    series = [_series("programme", hours, columns.programme_degC[thin], "line")] if columns.has_set_point else []
    series.append(_series("sensor", hours, columns.temperature_degC[thin], "line"))
    corners = [(one.start_s, one.start_degC) for one in columns.segments]
    corners.append((columns.segments[-1].end_s, columns.segments[-1].end_degC))
    at = np.array(corners)
    series.append(_series("corners found", at[:, 0] / 3600.0, at[:, 1], "points"))
    return _figure("Temperature programme", "Ramps and holds as found.", "time / h", "temperature / °C", series)


def _branches(fit: ReadingFit, columns: RampColumns, blocks: Blocks) -> dict[str, Any]:
    direction, temperature = blocks.mean(columns.branch.astype(np.float64)), blocks.mean(columns.temperature_degC)
    series = [
        _series(label, temperature[direction == sign], fit.readings[direction == sign], "points")
        for label, sign in (("up", 1), ("down", -1), ("hold", 0))
    ]
    caption = "Block means against the temperature of the sensor; nothing taken away."
    return _figure(f"{fit.name} up and down", caption, "temperature / °C", f"reading / {columns.unit}", series)


def _differences(fit: ReadingFit, columns: RampColumns) -> dict[str, Any]:
    series = [
        _series(
            sensor, np.array([one.temperature_degC for one in found]), np.array([one.value for one in found]), "line"
        )
        for sensor, found in fit.differences.items()
    ]
    left, std, _ = fit.drift.estimate(BRANCH)
    caption = (
        f"Read off at equal temperature of each sensor. With the drift taken away {left:.2f} ± {2 * std:.2f} "
        f"{columns.unit} are left."
    )
    label = f"up minus down / {columns.unit}"
    return _figure(f"{fit.name} up minus down", caption, "temperature / °C", label, series)


def _residuals(fit: ReadingFit, columns: RampColumns, blocks: Blocks) -> dict[str, Any]:
    hours = blocks.middle_s / 3600.0
    series = [_series("drift and up/down term", hours, fit.drift.residual, "line")]
    if fit.joint is not None:
        series.append(_series("lag and hysteresis", hours, fit.joint.fit.residual, "line"))
    caption = "What each model leaves over: it is alike for hours, which the intervals take into account."
    return _figure(f"{fit.name} residuals", caption, "time / h", f"residual / {columns.unit}", series)


def _series(label: str, x: Floats, y: Floats, style: str) -> dict[str, Any]:
    return {"label": label, "x": x.tolist(), "y": y.tolist(), "style": style}


def _figure(title: str, caption: str, x_label: str, y_label: str, series: Documents) -> dict[str, Any]:
    return {"title": title, "caption": caption, "x_label": x_label, "y_label": y_label, "series": series}


def tables(columns: RampColumns, fits: Sequence[ReadingFit]) -> Documents:
    """Segments, their totals, up minus down by sensor, and what the models leave."""
    return [_segments(columns), _totals(columns), *(_by_sensor(fit, columns) for fit in fits), _left(columns, fits)]


def _segments(columns: RampColumns) -> dict[str, Any]:
    rows = [
        [one.kind, *(round(float(x), 3) + 0.0 for x in (one.start_s / 3600.0, one.length_h, one.rate_degC_h)),
         round(one.start_degC, 2), round(one.end_degC, 2)]
        for one in columns.segments
    ]  # fmt: skip
    headers = ["kind", "start / h", "length / h", "rate / (°C/h)", "from / °C", "to / °C"]
    return {"title": "Ramps and holds", "caption": "As found in the log.", "headers": headers, "rows": rows}


def _totals(columns: RampColumns) -> dict[str, Any]:
    rows = []
    for kind in ("up", "hold", "down"):
        lengths = [one.length_h for one in columns.segments if one.kind == kind]
        rows.append([kind, len(lengths), round(float(sum(lengths)), 3)])
    return {"title": "Time up, holding and down", "caption": "", "headers": ["kind", "pieces", "hours"], "rows": rows}


def _by_sensor(fit: ReadingFit, columns: RampColumns) -> dict[str, Any]:
    found = {
        sensor: {one.temperature_degC: round(one.value, 2) for one in many} for sensor, many in fit.differences.items()
    }
    temperatures = sorted({at for many in found.values() for at in many})
    rows = [[at, *(many.get(at, "–") for many in found.values())] for at in temperatures]
    rows.append(["after drift", *(round(fit.after_drift[name].estimate(BRANCH)[0], 2) for name in found)])
    caption = (
        f"Up minus down at equal temperature, {columns.unit}, by the sensor taken for it; last row: what is left "
        "beside cubic in temperature and quadratic in time."
    )
    title = f"{fit.name}: up minus down"
    return {"title": title, "caption": caption, "headers": ["temperature / °C", *found], "rows": rows}


def _left(columns: RampColumns, fits: Sequence[ReadingFit]) -> dict[str, Any]:
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
    return {"title": "What is left between the branches", "caption": caption, "headers": headers, "rows": rows}


def _rounded(value: float, std: float, residual: Floats) -> list[float]:
    return [round(one, 3) for one in (value, std, float(np.sqrt(np.mean(residual**2))))]
