"""Small multiples, one panel per channel: scale-factor error against temperature, and what the fit left over."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from bench.model.units import format_quantity
from bench.report.model import ReportModel, Residual
from bench.report.style import BLUE, GREY, VERMILION, Picture, drawing, inline_svg, look

_COLUMNS = 2
_SERIES = (
    ("dsf_n", "N (positive current)", BLUE, "o-", -1.0),
    ("dsf_p", "P (negative current)", VERMILION, "s--", 1.0),
)
_APART = 0.008  # of the span of temperatures, to each side
_LEAST_SPAN_degC = 1.0  # of the axis: a campaign at one temperature differs by hundredths between its records
_LINEAR_ppm = 1.0


def dsf_picture(model: ReportModel) -> Picture | None:
    """Scale-factor error N and P of every channel against temperature, with expanded-uncertainty bars."""
    channels = _channels(model.estimates("dsf_n") + model.estimates("dsf_p"))
    if not channels:
        return None
    warmth = [unit_temperature_degC(row["conditions"]) for row in model.estimates("dsf_n") + model.estimates("dsf_p")]
    span_degC = max(max(warmth) - min(warmth), _LEAST_SPAN_degC)
    middle_degC = (max(warmth) + min(warmth)) / 2.0
    apart_degC = _APART * span_degC
    with drawing():
        figure, panels = _panels([f"channel {number}, {kind}" for number, kind in channels])
        for (number, _), axes in zip(channels, panels, strict=True):
            for quantity, label, colour, drawn, side in _SERIES:
                rows = [row for row in model.estimates(quantity) if row["conditions"].get("channel") == number]
                _error_bars(axes, rows, label, colour, drawn, side * apart_degC)
            axes.set_xlim(middle_degC - 0.55 * span_degC, middle_degC + 0.55 * span_degC)
            axes.set_ylabel("Scale-factor error / ppm")
            axes.set_xlabel("Unit temperature / °C")
        _legend(figure, panels[0])
        svg = inline_svg(figure, "dsf")
    return Picture(
        "dsf",
        svg,
        "Scale-factor error against unit temperature; bars are expanded uncertainties (about 95 %); N and P "
        "are drawn a little apart so that both can be seen. Positive: more current per pulse.",
        "One panel per channel with the scale-factor errors N and P and their intervals at each temperature; "
        "the numbers are in the table of scale-factor errors.",
    )


def residual_picture(model: ReportModel) -> Picture | None:
    """Residuals in ppm of the level for every channel, level and temperature."""
    residuals = [one for one in model.residuals if one.current_A and math.isfinite(one.residual_ppm)]
    channels = sorted({(one.channel, one.kind) for one in residuals})
    if not channels:
        return None
    temperatures = sorted({one.temperature_degC for one in residuals})
    with drawing():
        figure, panels = _panels([f"channel {number}, {kind}" for number, kind in channels])
        for (number, _), axes in zip(channels, panels, strict=True):
            _residual_panel(axes, [one for one in residuals if one.channel == number], temperatures)
        _legend(figure, panels[0])
        svg = inline_svg(figure, "residuals")
    return Picture(
        "residuals",
        svg,
        f"Residuals of the fit per level, ppm of the level; linear between ±{_LINEAR_ppm:g} ppm, logarithmic outside.",
        "One panel per channel; horizontal axis the signed reference currents, vertical axis the residual in ppm, "
        "one marker per temperature.",
    )


def _panels(titles: Sequence[str]) -> tuple[Figure, list[Axes]]:
    rows = math.ceil(len(titles) / _COLUMNS)
    figure = Figure(figsize=(7.2, 0.5 + 1.75 * rows), layout="constrained")
    grid = figure.subplots(rows, _COLUMNS, squeeze=False)
    panels = list(grid.flat)
    for axes in panels[len(titles) :]:
        axes.remove()
    for axes, title in zip(panels, titles, strict=False):
        axes.set_title(title, loc="left")
    return figure, panels[: len(titles)]


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=max(1, len(labels)))


def _channels(rows: Sequence[Mapping[str, Any]]) -> list[tuple[Any, str]]:
    found = {row["conditions"]["channel"]: row["conditions"].get("kind", "") for row in rows}
    return sorted(found.items())


def _error_bars(
    axes: Axes, rows: Sequence[Mapping[str, Any]], label: str, colour: str, drawn: str, shift_degC: float
) -> None:
    temperature = [unit_temperature_degC(row["conditions"]) + shift_degC for row in rows]
    value = [row["value"] for row in rows]
    expanded = [row["expanded_uncertainty"] for row in rows]
    axes.errorbar(temperature, value, expanded, fmt=drawn, label=label, color=colour, linewidth=0.7, capsize=2.0)


def unit_temperature_degC(conditions: Mapping[str, Any]) -> float:
    """The measured temperature of the unit where there is one, else the set-point, degC."""
    measured = conditions.get("unit_temperature_degC")
    return float(conditions.get("temperature_degC", math.nan) if measured is None else measured)


def _residual_panel(axes: Axes, residuals: Sequence[Residual], temperatures: Sequence[float]) -> None:
    levels = sorted({one.current_A for one in residuals})
    place = {level: index for index, level in enumerate(levels)}
    width = 0.6 / max(1, len(temperatures))
    for index, temperature in enumerate(temperatures):
        chosen = [one for one in residuals if one.temperature_degC == temperature]
        shift = (index - (len(temperatures) - 1) / 2) * width
        axes.plot(
            [place[one.current_A] + shift for one in chosen],
            [one.residual_ppm for one in chosen],
            linestyle="none",
            label=f"{temperature:g} °C".replace("-", "−"),
            **look(index),
        )
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.set_yscale("symlog", linthresh=_LINEAR_ppm, linscale=0.8)
    limit = 3.0 * max(_LINEAR_ppm, *(abs(one.residual_ppm) for one in residuals))
    axes.set_ylim(-limit, limit)
    decades = [10.0**power for power in range(1 + math.floor(math.log10(limit)))]
    marks = decades[:: max(1, math.ceil(len(decades) / 2))]
    axes.set_yticks([-mark for mark in reversed(marks)] + [0.0, *marks])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    axes.minorticks_off()
    axes.set_xticks(range(len(levels)), [_signed(level) for level in levels], rotation=60)
    axes.set_ylabel("Residual / ppm")
    axes.set_xlabel("Reference current")


def _signed(current_A: float) -> str:
    text = format_quantity(abs(current_A), "A", 4).replace("u", "µ")
    return ("+" if current_A > 0 else "−") + text
