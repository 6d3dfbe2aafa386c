"""Small multiples: one panel per channel, one legend for all."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

_COLUMNS = 2
_WIDTH_in, _ROW_in = 7.2, 1.85
_LEFT_in, _RIGHT_in = 0.8, 0.07  # beside a panel: its label and numbers; a number that sticks out
_ABOVE_in = 0.28  # the title of a panel
_BELOW_in = 0.45  # its numbers and label
_LEGEND_in, _LEGEND_ROW_in = 0.3, 0.18  # a legend of one row, and each row more
_LABEL_in = 0.62  # from the panel to its label; numbers of eight characters fit between


def panels_of(titles: Sequence[str], below_in: float = _BELOW_in, legend_rows: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure with a titled panel for each title, all of one size, and room for the rows of a legend above them.

    ``below_in``: room for numbers and label below a panel, inch.

    Places are given, not found by trial: to lay out ten panels takes longer than to draw them.
    """
    rows = math.ceil(len(titles) / _COLUMNS)
    height_in = rows * _ROW_in + (_LEGEND_in + _LEGEND_ROW_in * (legend_rows - 1) if legend_rows else 0.0)
    figure = Figure(figsize=(_WIDTH_in, height_in))
    wide_in = _WIDTH_in / _COLUMNS - _LEFT_in - _RIGHT_in
    high_in = _ROW_in - _ABOVE_in - below_in
    panels = []
    for index, title in enumerate(titles):
        row, column = divmod(index, _COLUMNS)
        left_in = column * _WIDTH_in / _COLUMNS + _LEFT_in
        bottom_in = (rows - row - 1) * _ROW_in + below_in
        place = (left_in / _WIDTH_in, bottom_in / height_in, wide_in / _WIDTH_in, high_in / height_in)
        axes = figure.add_axes(place)
        axes.yaxis.set_label_coords(-_LABEL_in / wide_in, 0.5)
        axes.set_title(title, loc="left")
        panels.append(axes)
    return figure, panels


def legend_of(figure: Figure, panels: Iterable[Axes], columns: int = 5, least: int = 1) -> None:
    """One legend for all panels: an entry per label, as the first panel that has it draws it; none below ``least``."""
    found: dict[str, Any] = {}
    for axes in panels:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    if len(found) >= least:
        names = list(found)
        laid_out = figure.get_layout_engine() is not None  # then it makes room; else the room is there
        place: Literal["outside upper center", "upper center"] = "outside upper center" if laid_out else "upper center"
        figure.legend(list(found.values()), names, loc=place, ncols=min(columns, len(names)))


def channels_of(rows: Iterable[Mapping[str, Any]]) -> list[tuple[Any, str]]:
    """Return number and kind of every channel in some estimates, by number."""
    found = {row["conditions"]["channel"]: row["conditions"].get("kind", "") for row in rows}
    return sorted(found.items())
