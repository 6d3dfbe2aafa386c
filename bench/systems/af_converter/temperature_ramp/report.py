"""Figures and tables of an imported temperature ramp."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.analysis import Figure, Floats, Table, series
from bench.systems.af_converter.estimators.drift_ramp import BRANCH, Blocks
from bench.systems.af_converter.estimators.hysteresis.fit import LAG
from bench.systems.af_converter.temperature_ramp.fits import MEAN, RampColumns, ReadingFit
from bench.systems.af_converter.wording import say

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
    parts = (
        [series(say("log.programme.programme"), hours, columns.programme_degC[thin], "line")]
        if columns.has_set_point
        else []
    )
    parts.append(series(say("log.programme.sensor"), hours, columns.temperature_degC[thin], "line"))
    corners = [(segment.start_s, segment.start_degC) for segment in columns.segments]
    corners.append((columns.segments[-1].end_s, columns.segments[-1].end_degC))
    at = np.array(corners)
    parts.append(series(say("log.programme.corners"), at[:, 0] / 3600.0, at[:, 1], "points"))
    axes = say("log.axis.hours"), say("log.axis.temperature")
    return Figure(say("log.programme.title"), say("log.programme.caption"), *axes, parts)


def _branches(fit: ReadingFit, columns: RampColumns, blocks: Blocks) -> Figure:
    direction, temperature = blocks.mean(columns.branch.astype(np.float64)), blocks.mean(columns.temperature_degC)
    parts = [
        series(say(f"segment.{kind}"), temperature[direction == sign], fit.readings[direction == sign], "points")
        for kind, sign in (("up", 1), ("down", -1), ("hold", 0))
    ]
    title, axes = say("log.branches.title", name=fit.name), _against_temperature("reading", columns)
    return Figure(title, say("log.branches.caption"), *axes, parts)


def _against_temperature(what: str, columns: RampColumns) -> tuple[str, str]:
    return say("log.axis.temperature"), say(f"log.axis.{what}", unit=columns.unit)


def _sensor(name: str) -> str:
    """Return how a reader calls a sensor: by its name in the log, but for the mean of all."""
    return say("log.mean_sensor") if name == MEAN else name


def _differences(fit: ReadingFit, columns: RampColumns) -> Figure:
    parts = [
        series(
            _sensor(sensor),
            np.array([difference.temperature_degC for difference in differences]),
            np.array([difference.value for difference in differences]),
            "line",
        )
        for sensor, differences in fit.differences.items()
    ]
    left, std, _ = fit.drift.estimate(BRANCH)
    caption = say("log.differences.caption", left=left, U=2 * std, unit=columns.unit)
    axes = _against_temperature("difference", columns)
    return Figure(say("log.differences.title", name=fit.name), caption, *axes, parts)


def _residuals(fit: ReadingFit, columns: RampColumns, blocks: Blocks) -> Figure:
    hours = blocks.middle_s / 3600.0
    parts = [series(say("log.residuals.drift"), hours, fit.drift.residual, "line")]
    if fit.joint is not None:
        parts.append(series(say("log.residuals.joint"), hours, fit.joint.fit.residual, "line"))
    axes = say("log.axis.hours"), say("log.axis.residual", unit=columns.unit)
    return Figure(say("log.residuals.title", name=fit.name), say("log.residuals.caption"), *axes, parts)


def tables(columns: RampColumns, fits: Sequence[ReadingFit]) -> list[Table]:
    """Segments, their totals, up minus down by sensor, and what the models leave."""
    return [_segments(columns), _totals(columns), *(_by_sensor(fit, columns) for fit in fits), _left(columns, fits)]


def _segments(columns: RampColumns) -> Table:
    rows = [
        [say(f"segment.{segment.kind}"),
         *(round(float(x), 3) + 0.0 for x in (segment.start_s / 3600.0, segment.length_h, segment.rate_degC_h)),
         round(segment.start_degC, 2), round(segment.end_degC, 2)]
        for segment in columns.segments
    ]  # fmt: skip
    headers = _heads("kind", "start", "length", "rate", "from", "to")
    return Table(say("log.segments.title"), say("log.segments.caption"), headers, rows)


def _heads(*names: str) -> list[str]:
    return [say(f"log.head.{name}") for name in names]


def _totals(columns: RampColumns) -> Table:
    rows = []
    for kind in ("up", "hold", "down"):
        lengths = [segment.length_h for segment in columns.segments if segment.kind == kind]
        rows.append([say(f"segment.{kind}"), len(lengths), round(float(sum(lengths)), 3)])
    return Table(say("log.totals.title"), "", _heads("kind", "pieces", "hours"), rows)


def _by_sensor(fit: ReadingFit, columns: RampColumns) -> Table:
    by_sensor = {
        sensor: {difference.temperature_degC: round(difference.value, 2) for difference in many}
        for sensor, many in fit.differences.items()
    }
    temperatures = sorted({at for many in by_sensor.values() for at in many})
    rows = [[at, *(many.get(at, "–") for many in by_sensor.values())] for at in temperatures]
    rows.append(
        [say("log.by_sensor.after_drift"), *(round(fit.after_drift[name].estimate(BRANCH)[0], 2) for name in by_sensor)]
    )
    title, caption = say("log.by_sensor.title", name=fit.name), say("log.by_sensor.caption", unit=columns.unit)
    return Table(title, caption, [say("log.axis.temperature"), *map(_sensor, by_sensor)], rows)


def _left(columns: RampColumns, fits: Sequence[ReadingFit]) -> Table:
    rows: list[list[Any]] = []
    for fit in fits:
        rows.append([fit.name, say("log.left.drift"), *_rounded(*fit.drift.estimate(BRANCH)[:2], fit.drift.residual)])
        if fit.joint is not None:
            lag_min = fit.joint.fit.value(LAG) / 60.0
            model = say("log.left.joint", lag=lag_min)
            rows.append([fit.name, model, *_rounded(*fit.joint.width, fit.joint.fit.residual)])
    of_unit = [say(f"log.head.{name}", unit=columns.unit) for name in ("apart", "std", "rms")]
    return Table(say("log.left.title"), say("log.left.caption"), [*_heads("reading", "model"), *of_unit], rows)


def _rounded(value: float, std: float, residual: Floats) -> list[float]:
    return [round(number, 3) for number in (value, std, float(np.sqrt(np.mean(residual**2))))]
