"""Figures of an analysis, drawn: curves, points, bands, images; alone or as panels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from bench import analysis
from bench.report.model import Picture
from bench.report.plots.figures import thin
from bench.report.plots.style import drawing, inline_svg, legend_of, look, panels_of
from bench.report.tables import Title, label, named, sentence, spaced

_LINE_STYLES = ("-", (0, (4, 2)), (0, (1, 1.2)), (0, (6, 2, 1, 2)))
_LEGEND_COLUMNS = 4
_DECADE, _FEW_DECADES = 10.0, 100.0
_FEW_TICKS = 5
_FEW = 60  # points that are drawn with markers one can tell apart


def analysis_pictures(figures: Sequence[analysis.Figure], title: Title = spaced) -> list[Picture]:
    """Draw one picture per group of figures, in the order of first use; a figure without a group stands alone.

    ``title``: of quantities that their texts name.
    """
    groups: dict[str, list[analysis.Figure]] = {}
    for index, figure in enumerate(figures):
        groups.setdefault(figure.group or f"figure {index + 1}", []).append(_for_people(figure, title))
    return [_picture(f"graph{number}", group) for number, group in enumerate(groups.values(), 1)]


def _for_people(figure: analysis.Figure, title: Title) -> analysis.Figure:
    return replace(
        figure,
        title=named(figure.title, title),
        caption=named(figure.caption, title),
        x_label=named(figure.x_label, title),
        y_label=named(figure.y_label, title),
        series=[replace(series, label=named(series.label, title)) for series in figure.series],
    )


def _picture(name: str, group: Sequence[analysis.Figure]) -> Picture:
    with drawing():
        drawn, panels = _panels(group)
        for axes, figure in zip(panels, group, strict=True):
            _draw(axes, figure)
        legend_of(drawn, panels, columns=_LEGEND_COLUMNS, least=2)
        svg = inline_svg(drawn, name)
    titles = ", ".join(figure.title for figure in group)
    captions = dict.fromkeys(figure.caption for figure in group)
    return Picture(name, svg, " ".join(sentence(text) for text in captions if text), f"{titles}.")


def _panels(group: Sequence[analysis.Figure]) -> tuple[Figure, list[Axes]]:
    titles = [figure.title for figure in group]
    if len(titles) > 1:
        names = {series.label for figure in group for series in figure.series}
        return panels_of(titles, legend_rows=-(-len(names) // _LEGEND_COLUMNS) if len(names) > 1 else 0)
    drawn = Figure(figsize=(7.2, 5.4 if group[0].equal else 3.3), layout="constrained")
    axes = drawn.subplots()
    axes.set_title(titles[0], loc="left")
    return drawn, [axes]


def _draw(axes: Axes, figure: analysis.Figure) -> None:
    if figure.equal:  # a circle is to look like one
        axes.set_aspect("equal", adjustable="datalim")
    for index, series in enumerate(figure.series):
        _draw_series(axes, series, index)
    axes.set_xlabel(label(figure.x_label))
    axes.set_ylabel(label(figure.y_label))
    if figure.x_log:
        axes.set_xscale("log")
        _mark_decades(axes.xaxis)
    if figure.y_log:
        axes.set_yscale("log")
        _mark_decades(axes.yaxis)


def _mark_decades(axis: Axis) -> None:
    """Numbers at powers of ten, over less than two decades at 1, 2 and 5 of each: there is room for no more.

    Within a decade at even steps: between 0.9 and 1.1 a single power of ten would stand alone.
    """
    low, high = axis.get_view_interval()
    if high < _FEW_DECADES * low:
        within = high < _DECADE * low
        axis.set_major_locator(MaxNLocator(_FEW_TICKS) if within else LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _draw_series(axes: Axes, series: analysis.Series, index: int) -> None:
    x = np.asarray(series.x, np.float64)
    name, style, seen = series.label, series.style, look(index)
    colour = seen["color"]
    if style == "band":
        axes.fill_between(x, series.low or [], series.high or [], color=colour, alpha=0.18, linewidth=0.0, label=name)
        return
    y = np.asarray(series.y, np.float64)
    if style == "image":  # x, y: its spans; z (y, x): the lowest is white
        span = (x[0], x[-1], y[0], y[-1])
        axes.imshow(series.z or [], extent=span, origin="lower", aspect="auto", cmap="Greys", interpolation="nearest")
        axes.grid(visible=False)
        return
    if style == "points":
        few = len(x) <= _FEW
        if series.low is not None and series.high is not None:
            reach = np.abs(np.stack((y - np.asarray(series.low), np.asarray(series.high) - y)))
            axes.errorbar(x, y, reach, linestyle="none", linewidth=0.7, capsize=2.0, label=name, **seen)
        else:
            axes.plot(x, y, linestyle="none", markersize=3.2 if few else 1.4, label=name, **seen)
        return
    if np.all(np.diff(x) >= 0):
        x, y = thin(x, y)
    axes.plot(x, y, color=colour, linestyle=_LINE_STYLES[index % len(_LINE_STYLES)], label=name)
