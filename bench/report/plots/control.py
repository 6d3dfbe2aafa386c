"""Control charts: one panel per series, the statistics of all three charts in parts of their limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from bench.analysis import Floats
from bench.report.plots.history import figure_of, save_history
from bench.report.plots.style import BLUE, GREY, INK, VERMILION, drawing


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
        figure = figure_of(panels, title, _draw, 1.2)
        if panels:
            handles, labels = figure.axes[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        save_history(figure, simulated, path)


def _draw(axes: Axes, panel: ControlPanel) -> None:
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
