"""The style of figures: colours safe on white, small multiples, and SVG that is the same bytes for the same numbers."""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager

from bench.analysis import Estimate
from bench.report.fonts import families, in_first_font, korean_files

# Five hues of Okabe-Ito and Tol with a contrast of at least 3:1 on white; markers carry the same meaning.
INK = "#1a1a1a"
BLUE, GREEN, VERMILION, WINE = "#0072B2", "#009E73", "#D55E00", "#882255"
PALETTE = (BLUE, VERMILION, GREEN, WINE, INK)
MARKERS = ("o", "s", "^", "D", "v")
GREY = "#767676"

_RC: Any = {
    "font.family": ["sans-serif", *families()[1:]],
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,  # a tick is a value, not what is to be added to one above the axis
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.2,
    "svg.fonttype": "none",
    "svg.image_inline": True,
    "path.simplify": True,
}
_ID = re.compile(r'\bid="([^"]+)"')
_REFERENCE = re.compile(r'(url\(#|href="#)([^")]+)')
_SIZE = re.compile(r'(<svg\b[^>]*?) width="[^"]*"', re.DOTALL)
_HEIGHT = re.compile(r'(<svg\b[^>]*?) height="[^"]*"', re.DOTALL)
_COLUMNS = 2
_WIDTH_in, _ROW_in = 7.2, 1.85
_LEFT_in, _RIGHT_in = 0.8, 0.07  # beside a panel: its label and numbers; a number that sticks out
_ABOVE_in = 0.28  # the title of a panel
_BELOW_in = 0.45  # its numbers and label
_LEGEND_in, _LEGEND_ROW_in = 0.3, 0.18  # a legend of one row, and each row more
_LABEL_in = 0.62  # from the panel to its label; numbers of eight characters fit between


for _file in korean_files():
    fontManager.addfont(_file)


@contextmanager
def drawing() -> Iterator[None]:
    """Matplotlib with the defaults of the report only, whatever the settings of the machine."""
    with mpl.rc_context(), warnings.catch_warnings():
        # a figure keeps its texts as texts: who reads it has the letters, though this machine cannot measure them
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        yield


def look(index: int) -> dict[str, Any]:
    """Return colour and marker of the ``index``-th member of a series."""
    cycle = index // len(PALETTE)
    return {
        "color": PALETTE[index % len(PALETTE)],
        "marker": MARKERS[(index + cycle) % len(MARKERS)],
    }


def svg_text(figure: Figure, name: str) -> str:
    """Return the figure as a complete SVG document; no date, no version, and the same ids for the same drawing."""
    with mpl.rc_context({"svg.hashsalt": name}):
        FigureCanvasSVG(figure)
        sheet = io.StringIO()
        figure.savefig(sheet, format="svg", metadata={"Date": None, "Creator": None})
    text = sheet.getvalue()
    if in_first_font(text):  # the same bytes whether or not another font is installed
        for family in families()[1:]:
            text = text.replace(f", '{family}'", "")
    text = _ID.sub(lambda match: f'id="{name}-{match[1]}"', text)
    return _REFERENCE.sub(lambda match: f"{match[1]}{name}-{match[2]}", text)


def inline_svg(figure: Figure, name: str) -> str:
    """Return the figure as an ``<svg>`` element that scales with the page."""
    text = svg_text(figure, name)
    text = text[text.index("<svg") :]
    return _HEIGHT.sub(r"\1", _SIZE.sub(r'\1 width="100%"', text, count=1), count=1).strip()


def panels_of(titles: Sequence[str], below_in: float = _BELOW_in, legend_rows: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure with a titled panel for each title, all of one size, and room for rows of a legend above them.

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
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(name, handle)
    if len(handles) >= least:
        names = list(handles)
        laid_out = figure.get_layout_engine() is not None  # then it makes room; else the room is there
        place: Literal["outside upper center", "upper center"] = "outside upper center" if laid_out else "upper center"
        figure.legend(list(handles.values()), names, loc=place, ncols=min(columns, len(names)))


def channels_of(rows: Iterable[Estimate]) -> list[tuple[Any, str]]:
    """Return number and kind of every channel in some estimates, by number."""
    kinds = {row.conditions["channel"]: row.conditions.get("kind", "") for row in rows}
    return sorted(kinds.items())
