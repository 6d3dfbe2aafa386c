"""Figures that an analysis describes as plain documents: curves, points, bands, images; alone or as panels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from bench.report.figures import thin
from bench.report.multiples import legend_of, panels_of
from bench.report.style import Picture, drawing, inline_svg, look
from bench.report.tables import label, sentence

_LINE_STYLES = ("-", (0, (4, 2)), (0, (1, 1.2)), (0, (6, 2, 1, 2)))
_LEGEND_COLUMNS = 4
_FEW_DECADES = 100.0
_FEW = 60  # points that are drawn with markers one can tell apart
Document = Mapping[str, Any]


def analysis_pictures(documents: Sequence[Document]) -> list[Picture]:
    """One picture per group of figures, in the order of first use; a figure without a group stands alone.

    Args: documents: ``figures`` of an Analysis (bench.analysis.analysis), without any drawing done to them.
    """
    groups: dict[str, list[Document]] = {}
    for index, document in enumerate(documents):
        groups.setdefault(str(document.get("group") or f"figure {index + 1}"), []).append(document)
    return [_picture(f"graph{number}", group) for number, group in enumerate(groups.values(), 1)]


def _picture(name: str, group: Sequence[Document]) -> Picture:
    with drawing():
        figure, panels = _panels(group)
        for axes, document in zip(panels, group, strict=True):
            _draw(axes, document)
        legend_of(figure, panels, columns=_LEGEND_COLUMNS, least=2)
        svg = inline_svg(figure, name)
    titles = ", ".join(str(document["title"]) for document in group)
    captions = dict.fromkeys(str(document.get("caption", "")) for document in group)
    return Picture(name, svg, " ".join(sentence(text) for text in captions if text), f"{titles}.")


def _panels(group: Sequence[Document]) -> tuple[Figure, list[Axes]]:
    titles = [str(document["title"]) for document in group]
    if len(titles) > 1:
        names = {str(series["label"]) for document in group for series in document["series"]}
        return panels_of(titles, legend_rows=-(-len(names) // _LEGEND_COLUMNS) if len(names) > 1 else 0)
    figure = Figure(figsize=(7.2, 5.4 if group[0].get("equal") else 3.3), layout="constrained")
    axes = figure.subplots()
    axes.set_title(titles[0], loc="left")
    return figure, [axes]


def _draw(axes: Axes, document: Document) -> None:
    if document.get("equal"):  # a circle is to look like one
        axes.set_aspect("equal", adjustable="datalim")
    for index, series in enumerate(document["series"]):
        _draw_series(axes, series, index)
    axes.set_xlabel(label(str(document["x_label"])))
    axes.set_ylabel(label(str(document["y_label"])))
    if document.get("x_log"):
        axes.set_xscale("log")
        _mark_decades(axes.xaxis)
    if document.get("y_log"):
        axes.set_yscale("log")
        _mark_decades(axes.yaxis)


def _mark_decades(axis: Axis) -> None:
    """Numbers at powers of ten, over less than two decades at 1, 2 and 5 of each: there is room for no more."""
    low, high = axis.get_view_interval()
    if high < _FEW_DECADES * low:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _draw_series(axes: Axes, series: Document, index: int) -> None:
    x = np.asarray(series["x"], np.float64)
    name, style, seen = str(series["label"]), series.get("style", "line"), look(index)
    colour = seen["color"]
    if style == "band":
        axes.fill_between(x, series["low"], series["high"], color=colour, alpha=0.18, linewidth=0.0, label=name)
        return
    y = np.asarray(series["y"], np.float64)
    if style == "image":  # x, y: its spans; z (y, x): the lowest is white
        span = (x[0], x[-1], y[0], y[-1])
        axes.imshow(series["z"], extent=span, origin="lower", aspect="auto", cmap="Greys", interpolation="nearest")
        axes.grid(visible=False)
        return
    if style == "points":
        few = len(x) <= _FEW
        if "low" in series:
            reach = np.abs(np.stack((y - np.asarray(series["low"]), np.asarray(series["high"]) - y)))
            axes.errorbar(x, y, reach, linestyle="none", linewidth=0.7, capsize=2.0, label=name, **seen)
        else:
            axes.plot(x, y, linestyle="none", markersize=3.2 if few else 1.4, label=name, **seen)
        return
    if np.all(np.diff(x) >= 0):
        x, y = thin(x, y)
    axes.plot(x, y, color=colour, linestyle=_LINE_STYLES[index % len(_LINE_STYLES)], label=name)
