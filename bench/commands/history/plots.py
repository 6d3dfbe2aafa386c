"""The figures of ``bench history compare --plot`` and ``charts --plot``: a panel per parameter or series."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bench.model.errors import InputError
from bench.report import plots
from bench.session.output import writing
from bench.store import Comparison, ParameterHistory, charts

FORMATS = (".svg", ".png")
MOST_PANELS = 12
_PANELS_PER_ROW = 3
_LEAST_YEARS = 2.0  # to each side of calibrations that were made at one time
_WATERMARK = "SIMULATED — not a calibration"
_LINE_POINTS = 60
_EPOCH_YEAR = 1970.0
Shown = TypeVar("Shown")


def draw(comparison: Comparison, path: Path) -> None:
    """Draw the parameters with the clearest drift into a .svg or .png file; the same ones give the same bytes.

    Raises: InputError B-CLI-007 for another file, or one that cannot be written.
    """
    series, histories = comparison.series, sorted(comparison.parameters, key=_clearest)
    title = f"{' '.join(series.uut)}: {len(series.calibrations)} calibrations, clearest drift first"
    simulated = bool(series.calibrations[-1]["simulated"])
    _write(path, histories, f"{title}{_left_out(histories, 'parameters')}", _draw_history, simulated)


def draw_charts(subject: charts.ChartedSubject, path: Path) -> None:
    """Draw the charts with signals first; as ``draw``."""
    shown = sorted(subject.shown, key=lambda series: not series.signals)
    title = f"{subject.name}: run length {subject.run_length:g} for {len(subject.series)} series together"
    _write(path, shown, f"{title}{_left_out(shown, 'series')}", _draw_chart, subject.simulated, with_legend=True)


def _left_out(shown: Sequence[object], what: str) -> str:
    left = len(shown) - MOST_PANELS
    return f", {left} more {what} not drawn" if left > 0 else ""


def _clearest(history: ParameterHistory) -> float:
    """Return drift over its standard uncertainty, the largest first; what has no line comes last."""
    return 0.0 if history.line is None else -abs(history.line.rate) / history.line.rate_std


def _write(
    path: Path,
    shown: Sequence[Shown],
    title: str,
    draw_one: Callable[[Axes, Shown], None],
    simulated: bool,
    with_legend: bool = False,
) -> None:
    """Write a figure of at most ``MOST_PANELS`` panels, marked where it shows simulated calibrations."""
    if path.suffix not in FORMATS:
        raise InputError("B-CLI-007", "is neither .svg nor .png", where=path, next_step="name such a file")
    shown = shown[:MOST_PANELS]
    columns = min(_PANELS_PER_ROW, len(shown)) or 1
    rows = math.ceil(len(shown) / columns) or 1
    with writing(path), plots.drawing():
        path.parent.mkdir(parents=True, exist_ok=True)
        size_in = (3.4 * columns + 0.4, 2.3 * rows + (1.2 if with_legend else 0.8))
        figure = Figure(figsize=size_in, layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False).flat
        for axes, one in zip(grid, shown, strict=False):
            draw_one(axes, one)
            axes.set_xlabel("Year")
            axes.ticklabel_format(axis="x", useOffset=False)
            axes.locator_params(axis="x", nbins=5, integer=True)
        for axes in list(grid)[len(shown) :]:
            axes.set_axis_off()
        figure.suptitle(title, fontsize=9.5)
        if with_legend and shown:
            handles, labels = figure.axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        if simulated:
            figure.text(
                0.5, 0.5, _WATERMARK, rotation=25, ha="center", va="center", fontsize=26, color=plots.GREY, alpha=0.4
            )
        if path.suffix == ".svg":
            path.write_text(plots.svg_text(figure, "history"), encoding="utf-8")
        else:
            FigureCanvasAgg(figure)
            figure.savefig(path, dpi=150, metadata={"Software": None})


def _draw_history(axes: Axes, history: ParameterHistory) -> None:
    """Draw the values of a parameter with U, its line since the last adjustment with action limits, and its limits."""
    unit = history.parameter.unit
    nano = unit == "A" or unit.startswith("A/")
    scale = 1e9 if nano else 1.0
    year, value = history.t_year + _EPOCH_YEAR, scale * history.value
    expanded = scale * history.factor * history.std
    axes.errorbar(year, value, yerr=expanded, fmt="none", ecolor=plots.BLUE, elinewidth=0.6, alpha=0.5)
    axes.plot(year, value, linestyle="none", marker="o", color=plots.BLUE)
    out = np.isin(history.rows, history.outside)
    if out.any():
        axes.plot(year[out], value[out], linestyle="none", marker="s", color=plots.VERMILION)
    if history.line:
        since = history.t_year[history.level == history.level[-1]]
        at = np.linspace(since[0], since[-1], _LINE_POINTS)
        line, reach = scale * history.line.at(at), scale * history.line.factor * history.line.std_at(at)
        axes.fill_between(at + _EPOCH_YEAR, line - reach, line + reach, color=plots.INK, alpha=0.15, linewidth=0.0)
        axes.plot(at + _EPOCH_YEAR, line, color=plots.INK)
        action = 3.0 * scale * history.chart.sigma if history.chart else math.nan
        for sign in (-1.0, 1.0):
            axes.plot(at + _EPOCH_YEAR, line + sign * action, color=plots.GREY, linestyle=(0, (4, 2)))
    for limit in filter(math.isfinite, (scale * history.low, scale * history.high)):
        axes.axhline(limit, color=plots.VERMILION, linewidth=0.9)
    middle, span = float(year[0] + year[-1]) / 2.0, float(year[-1] - year[0])
    if span == 0.0:
        axes.set_xlim(middle - _LEAST_YEARS, middle + _LEAST_YEARS)
    axes.set_title(history.parameter.label)
    axes.set_ylabel(f"n{unit}" if nano else unit)


def _draw_chart(axes: Axes, series: charts.ChartedSeries) -> None:
    """Draw the statistics of a series over their limits; in the first phase there are scores alone."""
    unjudged, limits, lines = np.full(series.first, np.nan), series.limits, series.charts
    year, score = series.t_year + _EPOCH_YEAR, series.score / limits.shewhart
    ewma = np.append(unjudged, lines.ewma / limits.ewma)
    up, down = (np.append(unjudged, line / limits.cusum) for line in (lines.cusum_up, lines.cusum_down))
    axes.plot(year[: series.first], score[: series.first], "o", color=plots.GREY, label="first phase")
    axes.plot(year[series.first :], score[series.first :], "o", color=plots.BLUE, label="Shewhart")
    axes.plot(year, ewma, color=plots.INK, label="EWMA")
    axes.plot(year, up, color=plots.BLUE, linestyle=(0, (4, 2)), label="CUSUM")
    axes.plot(year, down, color=plots.BLUE, linestyle=(0, (4, 2)))
    for limit in (-1.0, 1.0):
        axes.axhline(limit, color=plots.VERMILION, linewidth=0.9, label="limit" if limit > 0.0 else None)
    at = np.isin(np.arange(score.size), [place for _, place, _ in series.signals])
    worst = np.nanmax(np.abs([score, ewma, up, down]), axis=0, initial=0.0)
    axes.plot(year[at], np.zeros(int(at.sum())), "s", color=plots.VERMILION, label="signal")
    axes.set_ylim(-1.15 * max(1.0, worst.max()), 1.15 * max(1.0, worst.max()))
    axes.set_title(series.label)
    axes.set_ylabel("Statistic / limit")
