"""Drift of a unit over its calibrations, and its control charts: one panel per parameter or series."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bench.analysis import Floats
from bench.report.plots.style import BLUE, GREY, INK, VERMILION, drawing, svg_text

FORMATS = (".svg", ".png")
MOST_PANELS = 12
_PANELS_PER_ROW = 3
_LEAST_YEARS = 2.0  # to each side of calibrations that were made at one time
_WATERMARK = "SIMULATED — not a calibration"
_LINE_POINTS = 60
P = TypeVar("P")


@dataclass(frozen=True)
class Panel:
    """One parameter; arrays (m,) in order of time, ``line`` and ``line_expanded`` (k,) at ``line_year``."""

    title: str
    unit: str
    year: Floats
    value: Floats
    expanded: Floats
    line_year: Floats
    line: Floats
    line_expanded: Floats
    action_sigma: float = math.nan  # distance of the action limits (3 sigma) from the line
    low: float = -math.inf
    high: float = math.inf
    outside: NDArray[np.bool_] | None = None


def line_years(first: float, last: float) -> Floats:
    """Return where a drift line is drawn."""
    return np.linspace(first, last, _LINE_POINTS)


def plot_history(panels: Sequence[Panel], title: str, simulated: bool, path: Path) -> None:
    """Draw at most ``MOST_PANELS`` panels into a .svg or .png file; the same panels give the same bytes."""
    with drawing():
        save_history(figure_of(panels, title, _draw, 0.8), simulated, path)


def figure_of(panels: Sequence[P], title: str, draw: Callable[[Axes, P], None], more_in: float) -> Figure:
    """Return a figure of at most ``MOST_PANELS`` panels; ``more_in``: its height beside them, inch."""
    shown = panels[:MOST_PANELS]
    columns = min(_PANELS_PER_ROW, len(shown)) or 1
    rows = math.ceil(len(shown) / columns) or 1
    figure = Figure(figsize=(3.4 * columns + 0.4, 2.3 * rows + more_in), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).flat
    for axes, panel in zip(grid, shown, strict=False):
        draw(axes, panel)
        axes.set_xlabel("Year")
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.locator_params(axis="x", nbins=5, integer=True)
    for axes in list(grid)[len(shown) :]:
        axes.set_axis_off()
    figure.suptitle(title, fontsize=9.5)
    return figure


def save_history(figure: Figure, simulated: bool, path: Path) -> None:
    """Write a figure of the history as .svg or .png, marked where it shows simulated calibrations."""
    if simulated:
        figure.text(0.5, 0.5, _WATERMARK, rotation=25, ha="center", va="center", fontsize=26, color=GREY, alpha=0.4)
    if path.suffix == ".svg":
        path.write_text(svg_text(figure, "history"), encoding="utf-8")
    else:
        FigureCanvasAgg(figure)
        figure.savefig(path, dpi=150, metadata={"Software": None})


def _draw(axes: Axes, panel: Panel) -> None:
    axes.errorbar(panel.year, panel.value, yerr=panel.expanded, fmt="none", ecolor=BLUE, elinewidth=0.6, alpha=0.5)
    axes.plot(panel.year, panel.value, linestyle="none", marker="o", color=BLUE)
    if panel.outside is not None and panel.outside.any():
        out = panel.outside
        axes.plot(panel.year[out], panel.value[out], linestyle="none", marker="s", color=VERMILION)
    if panel.line.size:
        low, high = panel.line - panel.line_expanded, panel.line + panel.line_expanded
        axes.fill_between(panel.line_year, low, high, color=INK, alpha=0.15, linewidth=0.0)
        axes.plot(panel.line_year, panel.line, color=INK)
        for sign in (-1.0, 1.0):
            axes.plot(panel.line_year, panel.line + sign * panel.action_sigma, color=GREY, linestyle=(0, (4, 2)))
    for limit in filter(math.isfinite, (panel.low, panel.high)):
        axes.axhline(limit, color=VERMILION, linewidth=0.9)
    middle, span = float(panel.year[0] + panel.year[-1]) / 2.0, float(panel.year[-1] - panel.year[0])
    if span == 0.0:
        axes.set_xlim(middle - _LEAST_YEARS, middle + _LEAST_YEARS)
    axes.set_title(panel.title)
    axes.set_ylabel(panel.unit)


@dataclass(frozen=True)
class ControlPanel:
    """One series; arrays (n,) in order of time, statistics over their limits, NaN in the first phase but for scores."""

    title: str
    year: Floats
    score: Floats
    ewma: Floats
    cusum_up: Floats
    cusum_down: Floats
    judged: NDArray[np.bool_]
    signals: NDArray[np.bool_]


def plot_control(panels: Sequence[ControlPanel], title: str, simulated: bool, path: Path) -> None:
    """Draw at most ``MOST_PANELS`` panels into a .svg or .png file; the same panels give the same bytes."""
    with drawing():
        figure = figure_of(panels, title, _draw_control, 1.2)
        if panels:
            handles, labels = figure.axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        save_history(figure, simulated, path)


def _draw_control(axes: Axes, panel: ControlPanel) -> None:
    first = ~panel.judged
    axes.plot(panel.year[first], panel.score[first], "o", color=GREY, label="first phase")
    axes.plot(panel.year[~first], panel.score[~first], "o", color=BLUE, label="Shewhart")
    axes.plot(panel.year, panel.ewma, color=INK, label="EWMA")
    axes.plot(panel.year, panel.cusum_up, color=BLUE, linestyle=(0, (4, 2)), label="CUSUM")
    axes.plot(panel.year, panel.cusum_down, color=BLUE, linestyle=(0, (4, 2)))
    for limit in (-1.0, 1.0):
        axes.axhline(limit, color=VERMILION, linewidth=0.9, label="limit" if limit > 0.0 else None)
    at = panel.signals
    worst = np.nanmax(np.abs([panel.score, panel.ewma, panel.cusum_up, panel.cusum_down]), axis=0, initial=0.0)
    axes.plot(panel.year[at], np.zeros(int(at.sum())), "s", color=VERMILION, label="signal")
    axes.set_ylim(-1.15 * max(1.0, worst.max()), 1.15 * max(1.0, worst.max()))
    axes.set_title(panel.title)
    axes.set_ylabel("Statistic / limit")
