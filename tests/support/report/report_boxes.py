"""Where the texts of a figure really lie: oriented boxes from matplotlib's own renderer, and which of them collide."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pytest
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray

from bench.report.plots.style import drawing
from bench.report.sheet import ROOM_pt

POINTS_PER_INCH, LEAST_pt = 72.0, 6.5
TOUCH_px = 0.5  # texts may come as near as this fraction of a pixel at 100 dots per inch


@dataclass(frozen=True)
class Box:
    text: str
    corners: NDArray[np.float64]  # (4, 2), pixel

    def meets(self, other: Box) -> bool:
        """Separating axes: two convex shapes are apart if the normal of one side tells them apart."""
        for shape in (self.corners, other.corners):
            for side in np.diff(np.vstack((shape, shape[:1])), axis=0):
                normal = np.array((-side[1], side[0])) / (np.hypot(*side) or 1.0)
                a, b = self.corners @ normal, other.corners @ normal
                if a.max() <= b.min() + TOUCH_px or b.max() <= a.min() + TOUCH_px:
                    return False
        return True


def recorded_figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Every figure that is saved from now on, in order."""
    found: list[Figure] = []
    plain = Figure.savefig

    def savefig(self: Figure, *words: object, **options: object) -> None:
        found.append(self)
        plain(self, *words, **options)

    monkeypatch.setattr(Figure, "savefig", savefig)
    return found


def text_boxes(figure: Figure) -> list[Box]:
    """Boxes of all texts that the figure draws, at 100 dots per inch."""
    with drawing():
        canvas = FigureCanvasAgg(figure)
        figure.set_dpi(100)
        figure.draw_without_rendering()  # lays everything out; nobody looks at the pixels
        return [_box(text, canvas) for text in _drawn(figure)]


def _drawn(figure: Figure) -> Iterator[Text]:
    ticks = {id(text) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for text in _all_labels(axis)}
    shown = {id(text) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for text in _in_view(axis)}
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and (id(text) not in ticks or id(text) in shown):
            yield text


def _all_labels(axis: Axis) -> list[Text]:
    ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
    return [label for tick in ticks for label in (tick.label1, tick.label2)]


def _in_view(axis: Axis) -> list[Text]:
    """Labels of the ticks between the ends of an axis; matplotlib keeps others and does not draw them."""
    low, high = sorted(axis.get_view_interval())
    reach = 1e-6 * (high - low)
    ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
    return [
        tick.label1 for tick in ticks if low - reach <= tick.get_loc() <= high + reach and tick.label1.get_visible()
    ]


def _box(text: Text, canvas: FigureCanvasAgg) -> Box:
    renderer = canvas.get_renderer()
    seen = text.get_window_extent(renderer)  # of a turned text: the box around it, which has the same middle
    turned = text.get_rotation()
    text.set_rotation(0.0)
    flat = text.get_window_extent(renderer)
    text.set_rotation(turned)
    half = np.array((flat.width, flat.height)) / 2.0
    signs = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1)))
    angle = np.radians(turned)
    turn = np.array(((np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))))
    middle = np.array(((seen.x0 + seen.x1) / 2.0, (seen.y0 + seen.y1) / 2.0))
    return Box(text.get_text(), middle + (signs * half) @ turn)


def collisions(boxes: list[Box]) -> list[tuple[str, str]]:
    """Pairs of texts that overlap."""
    ends = [(*box.corners.min(axis=0).tolist(), *box.corners.max(axis=0).tolist()) for box in boxes]
    return [
        (boxes[a].text, boxes[b].text)
        for a, b in combinations(range(len(boxes)), 2)
        if ends[a][0] < ends[b][2]
        and ends[b][0] < ends[a][2]
        and ends[a][1] < ends[b][3]
        and ends[b][1] < ends[a][3]
        and boxes[a].meets(boxes[b])
    ]


def outside(figure: Figure, boxes: list[Box]) -> list[str]:
    """Texts that reach beyond the edge of their figure."""
    width, height = figure.bbox.size
    return [
        box.text
        for box in boxes
        if box.corners.min() < -TOUCH_px
        or box.corners[:, 0].max() > width + TOUCH_px
        or box.corners[:, 1].max() > height + TOUCH_px
    ]


def flaws(figure: Figure) -> list[str]:
    """What an eye would object to on A4: collisions, cut texts, axes without a unit, type that is too small."""
    boxes = text_boxes(figure)
    found = [f"{one!r} on {other!r}" for one, other in collisions(boxes)]
    found += [f"{text!r} is cut off" for text in outside(figure, boxes)]
    found += [f"no unit in {text!r}" for text in axis_labels(figure) if " / " not in text]
    least_pt = least_size_pt(figure, figure.get_figwidth(), ROOM_pt / POINTS_PER_INCH)
    return found + ([f"type of {least_pt:.2f} pt"] if least_pt < LEAST_pt else [])


def least_size_pt(figure: Figure, drawn_in: float, printed_in: float) -> float:
    """Size of the smallest text when a figure of a width is printed with another one."""
    return min(text.get_fontsize() for text in _drawn(figure)) * printed_in / drawn_in


def axis_labels(figure: Figure) -> list[str]:
    """Labels of all axes that have numbers."""
    return [axis.get_label_text() for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) if _numbered(axis)]


def _numbered(axis: Axis) -> bool:
    """False for an axis of names, or one whose numbers its neighbour shows."""
    words = [text.get_text() for text in _in_view(axis)]
    return any(words) and not any(word[:1].isalpha() for word in words if not word.startswith("$"))
