"""Temperatures: planned, air and unit, and the unit over the last hour as a small plot."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from typing import Any

from rich.text import Text

from bench.tui.folding import folded, joined
from bench.tui.look import Look, duration
from bench.tui.plot import Range, axis, dots_across, plot
from bench.tui.tables import titled
from bench.tui.watch import AIR, UNIT, Seen

PLOT_ROWS = 3
PLOT_COLUMNS = 60


def temperature(seen: Seen, look: Look) -> list[Text]:
    """Return one line of values and the plot."""
    document = seen.document
    planned = planned_degC(document.get("timetable") or {}, document.get("t_utc_s"))
    values = {"planned": planned, "air": seen.last.get(AIR), "unit": seen.last.get(UNIT)}
    parts = [look.texts(f"temperature.{name}", value=look.degC(value)) for name, value in values.items()]
    lines = joined([f"  {parts[0]}", *parts[1:]], look.width)
    return titled(look, "section.temperature", [*lines, *_plot(seen, look)])


def _plot(seen: Seen, look: Look) -> list[Text]:
    braille = look.glyphs.braille
    columns = min(PLOT_COLUMNS, look.width - 2)
    ranges = seen.trend.ranges(dots_across(columns, braille))
    known: list[Range] = [one for one in ranges if one is not None]
    if not known:
        return [Text(f"  {look.texts('plot.empty')}")]
    low, high = axis(ranges)
    span = duration(seen.trend.span_s)
    caption = look.texts("plot.caption", span=span, low=f"{low:.2f}", high=f"{high:.2f}")
    rows = [Text(f"  {line}", style="green") for line in plot(ranges, PLOT_ROWS, braille)]
    return [*rows, *folded(caption, look.width, first="  ")]


def planned_degC(timetable: Mapping[str, Any], t_utc_s: float | None) -> float | None:
    """Planned temperature at a moment, degC, between the corners of the polyline; None outside of it."""
    times, values = timetable.get("t_utc_s") or [], timetable.get("temperature_degC") or []
    if t_utc_s is None or len(times) != len(values) or not times or not times[0] <= t_utc_s <= times[-1]:
        return None
    after = min(bisect_right(times, t_utc_s), len(times) - 1)
    before = max(0, after - 1)
    span = times[after] - times[before]
    share = (t_utc_s - times[before]) / span if span > 0 else 0.0
    return float(values[before] + share * (values[after] - values[before]))
