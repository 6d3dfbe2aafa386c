"""Figures that an analysis describes as plain documents: curves, points and bands, alone or as panels of a group."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.report.figures import thin
from bench.report.style import Picture, drawing, inline_svg, look
from bench.report.tables import label

_COLUMNS = 2
_LINE_STYLES = ("-", (0, (4, 2)), (0, (1, 1.2)), (0, (6, 2, 1, 2)))
_FEW = 60  # points that are drawn with markers one can tell apart
Document = Mapping[str, Any]


def analysis_pictures(documents: Sequence[Document]) -> list[Picture]:
    """One picture per group of figures, in the order of first use; a figure without a group stands alone.

    Args: documents: ``figures`` of an Analysis (bench.campaigns.analysis), without any drawing done to them.
    """
    groups: dict[str, list[Document]] = {}
    for index, document in enumerate(documents):
        groups.setdefault(str(document.get("group") or f"figure {index + 1}"), []).append(document)
    return [_picture(f"graph{number}", group) for number, group in enumerate(groups.values(), 1)]


def _picture(name: str, group: Sequence[Document]) -> Picture:
    with drawing():
        figure, panels = _panels(len(group))
        for axes, document in zip(panels, group, strict=True):
            _draw(axes, document)
        _legend(figure, panels)
        svg = inline_svg(figure, name)
    titles = ", ".join(str(document["title"]) for document in group)
    captions = dict.fromkeys(str(document.get("caption", "")) for document in group)
    return Picture(name, svg, " ".join(text for text in captions if text), f"{titles}.")


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    if count == 1:
        figure = Figure(figsize=(7.2, 3.3), layout="constrained")
        return figure, [figure.subplots()]
    rows = math.ceil(count / _COLUMNS)
    figure = Figure(figsize=(7.2, 0.5 + 2.0 * rows), layout="constrained")
    grid = list(figure.subplots(rows, _COLUMNS, squeeze=False).flat)
    for axes in grid[count:]:
        axes.remove()
    return figure, grid[:count]


def _draw(axes: Axes, document: Document) -> None:
    for index, series in enumerate(document["series"]):
        _draw_series(axes, series, index)
    axes.set_title(str(document["title"]), loc="left")
    axes.set_xlabel(label(str(document["x_label"])))
    axes.set_ylabel(label(str(document["y_label"])))
    if document.get("x_log"):
        axes.set_xscale("log")
    if document.get("y_log"):
        axes.set_yscale("log")


def _draw_series(axes: Axes, series: Document, index: int) -> None:
    x = np.asarray(series["x"], np.float64)
    name, style, seen = str(series["label"]), series.get("style", "line"), look(index)
    colour = seen["color"]
    if style == "band":
        axes.fill_between(x, series["low"], series["high"], color=colour, alpha=0.18, linewidth=0.0, label=name)
        return
    y = np.asarray(series["y"], np.float64)
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


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend for all panels: an entry per label, as its first panel draws it."""
    found: dict[str, Any] = {}
    for axes in panels:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    if len(found) > 1:
        figure.legend(list(found.values()), list(found), loc="outside upper center", ncols=min(4, len(found)))
