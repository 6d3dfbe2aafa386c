"""The panels of ``bench history compare --plot`` and ``bench history charts --plot``."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from bench.model.errors import InputError
from bench.report import plots
from bench.session.output import writing
from bench.store import Comparison, ParameterHistory, charts

_EPOCH_YEAR = 1970.0


def draw(comparison: Comparison, path: Path) -> None:
    """Draw the parameters with the clearest drift. Raises: InputError B-CLI-007 if the file cannot be written."""
    _require_format(path)
    histories = sorted(comparison.parameters, key=_clearest)[: plots.MOST_PANELS]
    series = comparison.series
    left = len(comparison.parameters) - len(histories)
    more = f", {left} more parameters not drawn" if left > 0 else ""
    title = f"{' '.join(series.uut)}: {len(series.calibrations)} calibrations, clearest drift first{more}"
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        plots.plot_history(
            [_panel(history) for history in histories], title, bool(series.calibrations[-1]["simulated"]), path
        )


def draw_charts(subject: charts.ChartedSubject, path: Path) -> None:
    """Draw the charts with signals first. Raises: InputError B-CLI-007 if the file cannot be written."""
    _require_format(path)
    shown = sorted(subject.shown, key=lambda series: not series.signals)[: plots.MOST_PANELS]
    left = len(subject.shown) - len(shown)
    more = f", {left} more series not drawn" if left > 0 else ""
    title = f"{subject.name}: run length {subject.run_length:g} for {len(subject.series)} series together{more}"
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        plots.plot_control([_control(series) for series in shown], title, subject.simulated, path)


def _control(series: charts.ChartedSeries) -> plots.ControlPanel:
    unjudged, limits, lines = np.full(series.first, np.nan), series.limits, series.charts
    places = np.arange(series.score.size)
    return plots.ControlPanel(
        title=series.label,
        year=series.t_year + _EPOCH_YEAR,
        score=series.score / limits.shewhart,
        ewma=np.append(unjudged, lines.ewma / limits.ewma),
        cusum_up=np.append(unjudged, lines.cusum_up / limits.cusum),
        cusum_down=np.append(unjudged, lines.cusum_down / limits.cusum),
        judged=places >= series.first,
        signals=np.isin(places, [place for _, place, _ in series.signals]),
    )


def _require_format(path: Path) -> None:
    if path.suffix not in plots.FORMATS:
        raise InputError("B-CLI-007", "is neither .svg nor .png", where=path, next_step="name such a file")


def _clearest(history: ParameterHistory) -> float:
    """Return drift over its standard uncertainty, the largest first; what has no line comes last."""
    return 0.0 if history.line is None else -abs(history.line.rate) / history.line.rate_std


def _panel(history: ParameterHistory) -> plots.Panel:
    empty = np.empty(0)
    since = history.t_year[history.level == history.level[-1]]  # the line is that since the last adjustment
    at = plots.line_years(since[0], since[-1]) if history.line else empty
    unit = history.parameter.unit
    nano = unit == "A" or unit.startswith("A/")
    scale = 1e9 if nano else 1.0
    return plots.Panel(
        title=history.parameter.label,
        unit=f"n{unit}" if nano else unit,
        year=history.t_year + _EPOCH_YEAR,
        value=scale * history.value,
        expanded=scale * history.factor * history.std,
        line_year=at + _EPOCH_YEAR,
        line=scale * history.line.at(at) if history.line else empty,
        line_expanded=scale * history.line.factor * history.line.std_at(at) if history.line else empty,
        action_sigma=3.0 * scale * history.chart.sigma if history.chart else math.nan,
        low=scale * history.low,
        high=scale * history.high,
        outside=np.isin(history.rows, history.outside),
    )
