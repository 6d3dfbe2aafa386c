"""Figures of the page as Bokeh models: built here, drawn by BokehJS in the browser, filled there as data arrive.

The models carry no callback and no code. Axes have tickers and labels that the page sets (UTC, local or elapsed time),
and no level of detail: BokehJS would leave out readings while a figure is dragged.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from bokeh.embed import json_item
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    FixedTicker,
    Grid,
    Line,
    LinearAxis,
    PanTool,
    Plot,
    Quad,
    Range1d,
    Segment,
    Span,
    Text,
    WheelZoomTool,
)

DASHES: tuple[tuple[int, ...], ...] = ((), (7, 4))
CURVES = 10


@dataclass(frozen=True)
class Palette:
    """Colours of one theme; every hue has a contrast of at least 3:1 on the card.

    Source: WCAG 2.2, success criterion 1.4.11.
    """

    card: str
    ink: str
    soft: str
    grid: str
    now: str
    hues: tuple[str, ...]


# Blue, orange, green, purple and yellow after Okabe and Ito, moved in lightness until each stands out from its card and
# any two are told apart by people who do not see red, green or blue (tests/unit/web/test_pages.py has the rule).
PALETTES = {
    "dark": Palette(
        card="#171d24",
        ink="#e8edf2",
        soft="#a3b0bd",
        grid="#2b343e",
        now="#ff6b6b",
        hues=("#3f93dd", "#e08214", "#2fe39a", "#d49bc0", "#fff26a"),
    ),
    "light": Palette(
        card="#ffffff",
        ink="#1a1f24",
        soft="#55606b",
        grid="#dfe4e8",
        now="#c1121f",
        hues=("#0b78b8", "#cf5a10", "#015a3c", "#8a1a66", "#4f4801"),
    ),
}


def looks() -> list[dict[str, Any]]:
    """Return hue and dash of each curve: five hues drawn through, the same five dashed."""
    hues = len(PALETTES["dark"].hues)
    return [{"hue": index % hues, "dash": list(DASHES[index // hues])} for index in range(CURVES)]


def line_plot(name: str, unit: str, curves: int, *, zoom: bool = False) -> Plot:
    """Return an empty figure with as many curves as asked for, each with a source ``curve-<index>`` of columns t and y.

    A curve runs through the least and the greatest value of each bucket of time; NaN parts it.

    Args: unit: of the vertical axis, as text; zoom: drag and wheel change the time range.
    """
    plot = Plot(
        name=name,
        x_range=Range1d(0.0, 1.0, name="x"),
        y_range=Range1d(0.0, 1.0, name="y"),
        sizing_mode="stretch_both",
        toolbar_location=None,
        min_border_left=66,
        min_border_right=6,
        min_border_top=6,
        lod_threshold=None,
        outline_line_color=None,
        background_fill_alpha=0.0,
        border_fill_alpha=0.0,
    )
    time_axis = LinearAxis(name="time", ticker=FixedTicker(name="time-ticks", ticks=[]), axis_label=" ")
    value_axis = LinearAxis(name="value", ticker=FixedTicker(name="value-ticks", ticks=[]), axis_label=unit)
    for axis in (time_axis, value_axis):
        axis.axis_label_text_font_style = "normal"
        axis.axis_line_alpha = 0.5
        axis.minor_tick_line_color = None
        axis.major_tick_in = 0
    plot.add_layout(time_axis, "below")
    plot.add_layout(value_axis, "left")
    plot.add_layout(Grid(name="time-grid", dimension=0, ticker=time_axis.ticker))
    plot.add_layout(Grid(name="value-grid", dimension=1, ticker=value_axis.ticker))
    for index in range(curves):
        source = ColumnDataSource({"t": [], "y": []}, name=f"curve-{index}")
        plot.add_glyph(source, Line(x="t", y="y", line_width=1.4, name=f"line-{index}"))
    for mark in ("now", "cursor"):
        span = Span(name=mark, dimension="height", location=None, line_width=1, line_dash="solid", level="overlay")
        plot.add_layout(span)
    if zoom:
        _add_zoom(plot)
    return plot


def temperature_plot() -> Plot:
    """Return the figure of temperatures: plan, air and unit; bands of soaks behind them, limits with their names.

    Sources: ``bands`` of columns t0, t1, low, high; ``limits`` of t0, t1, y, and text with its place ``at``.
    """
    plot = line_plot("temperature", "°C", 3)
    bands = ColumnDataSource({"t0": [], "t1": [], "low": [], "high": []}, name="bands")
    limits = ColumnDataSource({"t0": [], "t1": [], "y": [], "at": [], "text": []}, name="limits")
    band = Quad(left="t0", right="t1", bottom="low", top="high", line_color=None, fill_alpha=0.22, name="band")
    plot.add_glyph(bands, band, level="underlay")
    plot.add_glyph(limits, Segment(x0="t0", x1="t1", y0="y", y1="y", line_dash=[2, 4], name="limit"))
    words = Text(x="at", y="y", text="text", x_offset=-4, y_offset=-2, text_align="right", name="limit-text")
    plot.add_glyph(limits, words)
    return plot


def _add_zoom(plot: Plot) -> None:
    drag, wheel = BoxZoomTool(dimensions="width"), WheelZoomTool(dimensions="width")
    plot.add_tools(drag, wheel, PanTool(dimensions="width"))
    plot.toolbar.active_drag = drag
    plot.toolbar.active_scroll = wheel


def run_figures(state: dict[str, Any]) -> dict[str, Any]:
    """Return figures of a run from its state document: graphs, temperature, history, and their look in both themes."""
    graphs = state.get("graphs") or []
    return _figures(tuple((str(graph["unit"]), min(CURVES, len(graph["signals"]))) for graph in graphs))


@lru_cache(maxsize=32)
def _figures(graphs: tuple[tuple[str, int], ...]) -> dict[str, Any]:
    """Return figures for graphs of given units and numbers of curves; making them takes a quarter of a second."""
    plots = [line_plot(f"graph-{index}", unit, curves) for index, (unit, curves) in enumerate(graphs)]
    most = max((curves for _, curves in graphs), default=1)
    return {
        "graphs": [json_item(plot) for plot in plots],
        "temperature": json_item(temperature_plot()),
        "history": json_item(line_plot("history", " ", most, zoom=True)),
        "palettes": {name: vars(palette) for name, palette in PALETTES.items()},
        "looks": looks(),
    }
