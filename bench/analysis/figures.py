"""Figures and tables of an analysis before any drawing: plain numbers and words, with their axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Style = Literal["line", "points", "band", "image"]
_DRAWN = 600  # points of a thinned curve


@dataclass(frozen=True)
class Series:
    """One curve, cloud of points, band or image.

    ``low``, ``high``: ends of the interval of each point; of a band, which has no ``y``.   ``z`` (y, x): of an image,
    whose ``x`` and ``y`` span its axes.
    """

    label: str
    x: list[float]
    y: list[float]
    style: Style
    low: list[float] | None = None
    high: list[float] | None = None
    z: list[list[float]] | None = None


@dataclass(frozen=True)
class Figure:
    """A figure with its axes; those of one ``group`` are panels of one picture, ``equal``: both axes to one scale."""

    title: str
    caption: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    group: str = ""
    x_log: bool = False
    y_log: bool = False
    equal: bool = False


def series(label: str, x: Any, y: Any, style: Style = "line", *, low: Any = None, high: Any = None) -> Series:
    """Return every value as drawn; ``low`` and ``high`` are the interval of each point."""
    return Series(label, _plain(x), _plain(y), style, *(None if end is None else _plain(end) for end in (low, high)))


def curve(label: str, x: Any, y: Any, style: Style = "line") -> Series:
    """Return a series thinned to what can be seen."""
    step = max(1, len(x) // _DRAWN)
    return series(label, x[::step], y[::step], style)


def band(label: str, x: Any, low: Any, high: Any) -> Series:
    """Return the area between two curves."""
    return series(label, x, [], "band", low=low, high=high)


def picture(x: Any, y: Any, z: Any) -> Series:
    """Return an image, ``z`` (y, x), over the span of its axes."""
    return Series("", _span(x), _span(y), "image", z=_plain(z))


def _span(axis: Any) -> list[float]:
    return [float(axis[0]), float(axis[-1])]


def _plain(values: Any) -> Any:
    return np.asarray(values).tolist()


@dataclass(frozen=True)
class Table:
    """A table with its caption; ``prose``: its cells are words, ``lead``: it is read first."""

    title: str
    caption: str
    headers: Sequence[str]
    rows: Sequence[Sequence[Any]]
    prose: bool = False
    lead: bool = False


def worded_table(
    say: Callable[..., str],
    name: str,
    headers: Sequence[str],
    rows: Sequence[Sequence[Any]],
    /,
    *,
    prose: bool = False,
    lead: bool = False,
    **fields: object,
) -> Table:
    """Return a table with its title and caption in the words of a catalogue; ``fields``: of both."""
    title, caption = say(f"{name}.title", **fields), say(f"{name}.caption", **fields)
    return Table(title, caption, headers, rows, prose, lead)


def worded_figure(
    say: Callable[..., str],
    name: str,
    axes: tuple[str, str],
    parts: Sequence[Series],
    /,
    *,
    group: str = "",
    logarithmic: str = "",
    equal: bool = False,
    **fields: object,
) -> Figure:
    """Return a figure with its title and caption in the words of a catalogue, and the axes by their keys there.

    ``logarithmic``: "x", "y" or "xy".   ``fields``: of all four texts.
    """
    title, caption, x, y = (say(key, **fields) for key in (f"{name}.title", f"{name}.caption", *axes))
    return Figure(title, caption, x, y, parts, group, "x" in logarithmic, "y" in logarithmic, equal)
