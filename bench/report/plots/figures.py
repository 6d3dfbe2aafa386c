"""Figures of a timetable, planned and actual temperature above its lanes; and of what uncertainty costs in hours."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from bench.analysis import Floats
from bench.model.texts import ENGLISH, Texts
from bench.plan import Plan
from bench.report.model import Picture, TemperatureTrace, Timetable
from bench.report.plots.style import BLUE, GREEN, GREY, INK, VERMILION, WINE, drawing, inline_svg, svg_text
from bench.report.tables import words_of
from bench.report.timetable import timetable

_FILL = {"prepare": GREY, "finally": GREY, "soak": VERMILION, "measure": BLUE, "repeat": WINE}
_HATCH = {"prepare": "////", "finally": "////", "soak": "....", "repeat": "xxxx"}
_MOST_POINTS = 1500


def timetable_picture(table: Timetable, trace: TemperatureTrace, words: Texts) -> Picture | None:
    """Return temperature over time, planned and actual, with the lanes of the plan; None if nothing is to show."""
    if not table.bars and not _has_readings(trace):
        return None
    with drawing():
        figure = _timetable_figure(table, trace, "", words)
        svg = inline_svg(figure, "timetable")
    seen = "measured" if _has_readings(trace) else "planned" if table.planned_t_s.size else "lanes"
    return Picture("timetable", svg, words("timetable.caption"), words(f"timetable.description.{seen}"))


def _has_readings(trace: TemperatureTrace) -> bool:
    """Return whether anybody read a temperature; a bench without a chamber notes its environment without one."""
    return any(np.isfinite(curve).any() for curve in (trace.air_degC, trace.unit_degC))


def plot_timetable(plan: Plan, path_svg: Path) -> None:
    """Write the timetable of a compiled plan as an SVG file; the same plan gives the same bytes."""
    with drawing():
        figure = _timetable_figure(
            timetable(plan.steps, plan.prepare_s), TemperatureTrace(), plan.title, words_of(ENGLISH)
        )
        Path(path_svg).write_text(svg_text(figure, "timetable"), encoding="utf-8")


def _timetable_figure(table: Timetable, trace: TemperatureTrace, title: str, words: Texts) -> Figure:
    height = max(0.6, 0.17 * len(table.lanes))
    warm = bool(table.planned_t_s.size or _has_readings(trace))
    figure = Figure(figsize=(7.2, height + (2.5 if warm else 0.7)), layout="constrained")
    divisor, unit = _time_unit(table, trace)
    if warm:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, height))
        _draw_temperature(upper, table, trace, divisor, words)
    else:
        lower = figure.subplots()
    _draw_lanes(lower, table, divisor, words)
    lower.set_xlabel(words("axis.time", unit=unit))
    if title:
        figure.suptitle(title, fontsize=9.5)
    return figure


def _time_unit(table: Timetable, trace: TemperatureTrace) -> tuple[float, str]:
    ends = [bar.start_s + bar.duration_s for bar in table.bars] + list(trace.t_s[-1:])
    return (3600.0, "h") if max(ends, default=0.0) > 3 * 3600.0 else (60.0, "min")


def _draw_temperature(axes: Axes, table: Timetable, trace: TemperatureTrace, divisor: float, words: Texts) -> None:
    series = (
        (words("series.planned"), (table.planned_t_s, table.planned_degC), INK, (0, (4, 2))),
        (words("series.air"), thin(trace.t_s, trace.air_degC), BLUE, "-"),
        (words("series.unit"), thin(trace.t_s, trace.unit_degC), VERMILION, "-"),
    )
    for label, (t_s, degC), colour, dash in series:
        if t_s.size:
            above = 3 if colour == INK else 2
            axes.plot(t_s / divisor, degC, color=colour, linestyle=dash, label=label, zorder=above)
    if axes.lines:
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    axes.set_ylabel(words("axis.temperature"))
    axes.margins(x=0.01)


def _draw_lanes(axes: Axes, table: Timetable, divisor: float, words: Texts) -> None:
    lanes = table.lanes
    for bar in table.bars:
        axes.barh(
            lanes.index(bar.lane),
            bar.duration_s / divisor,
            left=bar.start_s / divisor,
            height=0.72,
            color=_FILL.get(bar.kind, GREEN),
            hatch=_HATCH.get(bar.kind),
            edgecolor="white",
            linewidth=0.0,
        )
    axes.set_yticks(range(len(lanes)), [_lane_name(lane, words) for lane in lanes])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)


def _lane_name(lane: str, words: Texts) -> str:
    name, _, number = lane.partition(" ")
    return words("channel", number=number) if name == "channel" else words.all.get(f"lane.{lane}", lane)


def thin(t_s: Floats, value: Floats, most: int = _MOST_POINTS) -> tuple[Floats, Floats]:
    """Drop NaN and keep the lowest and highest reading of each bucket, so that no excursion is lost.

    Args:    t_s, value: (n,) each; ``value`` may be empty.   most: points kept at most (a multiple of 2).
    Returns: (t_s, value), each (k,), k <= max(most, n finite up to most), in order of time.
    """
    if not value.size:
        return np.empty(0), np.empty(0)
    good = np.isfinite(value)
    t_s, value = t_s[good], value[good]
    if value.size <= most:
        return t_s, value
    edges = np.linspace(0, value.size, most // 2 + 1).astype(np.int64)
    keep: set[int] = set()
    for start, stop in pairwise(edges):
        part = value[start:stop]
        keep.update((int(start + part.argmin()), int(start + part.argmax())))
    index = np.array(sorted(keep))
    return t_s[index], value[index]


def plot_trade(name: str, points: Sequence[tuple[float, float]], today_h: float, path_svg: Path) -> None:
    """Write hours against the factor on all targets, (n, 2), as an SVG file; a line marks the given campaign."""
    with drawing():
        figure = Figure(figsize=(5.6, 3.4), layout="constrained")
        axes = figure.subplots()
        axes.axhline(today_h, color=INK, linewidth=0.9, linestyle="--", label=f"{name}, as given")
        axes.plot(*zip(*points, strict=True), color=BLUE, marker="o", label="shortest plan under the rules")
        axes.set_xscale("log")
        axes.set_xticks([factor for factor, _ in points])
        axes.get_xaxis().set_major_formatter(ScalarFormatter())
        axes.get_xaxis().set_minor_formatter(lambda *_: "")
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("expanded uncertainty over that of the targets")
        axes.set_ylabel("campaign in h")
        axes.legend()
        path_svg.write_text(svg_text(figure, "trade"), encoding="utf-8")
