"""How a figure looks: colours safe on white, and SVG that is the same bytes for the same numbers."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

# Five hues of Okabe-Ito and Tol with a contrast of at least 3:1 on white; markers carry the same meaning.
INK = "#1a1a1a"
BLUE, GREEN, VERMILION, WINE = "#0072B2", "#009E73", "#D55E00", "#882255"
PALETTE = (BLUE, VERMILION, GREEN, WINE, INK)
MARKERS = ("o", "s", "^", "D", "v")
GREY = "#767676"

_RC: Any = {
    "font.family": "sans-serif",
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


@dataclass(frozen=True)
class Picture:
    """A figure for a page: SVG text without prologue, a caption, and a sentence for readers who do not see it."""

    name: str
    svg: str
    caption: str
    description: str


@contextmanager
def drawing() -> Iterator[None]:
    """Matplotlib with the defaults of the report only, whatever the settings of the machine."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        yield


def look(index: int) -> dict[str, Any]:
    """Colour and marker of the ``index``-th member of a series."""
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
    text = _ID.sub(lambda found: f'id="{name}-{found[1]}"', text)
    return _REFERENCE.sub(lambda found: f"{found[1]}{name}-{found[2]}", text)


def inline_svg(figure: Figure, name: str) -> str:
    """Return the figure as an ``<svg>`` element that scales with the page."""
    text = svg_text(figure, name)
    text = text[text.index("<svg") :]
    return _HEIGHT.sub(r"\1", _SIZE.sub(r'\1 width="100%"', text, count=1), count=1).strip()
