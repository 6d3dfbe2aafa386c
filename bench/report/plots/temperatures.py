"""Estimates against the unit's temperature, one panel per channel: scale-factor errors, their asymmetry, bias."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.analysis import Estimate, is_sound
from bench.model.texts import Texts
from bench.report.estimate_tables import readable
from bench.report.model import Picture, ReportModel
from bench.report.plots.figures import thin
from bench.report.plots.style import (
    BLUE,
    VERMILION,
    channels_of,
    drawing,
    inline_svg,
    legend_of,
    look,
    panels_of,
)
from bench.report.tables import channel_title, place_of

_APART = 0.008  # of the span of temperatures, to each side
_LEAST_SPAN_degC = 1.0  # a campaign at one temperature differs by hundredths between its records
_LEAST_AIR_SPAN_degC = 2.0  # of the axis of the laboratory


@dataclass(frozen=True)
class _Series:
    quantity: str
    colour: str
    drawn: str
    side: float  # where it stands beside its temperature: -1, 0 or 1


def dsf_picture(model: ReportModel, words: Texts) -> Picture | None:
    """Return scale-factor error N and P of every channel against temperature, with expanded-uncertainty bars.

    None at one temperature: single dots say no more than their table.
    """
    series = (_Series("dsf_n", BLUE, "o-", -1.0), _Series("dsf_p", VERMILION, "s--", 1.0))
    return _picture(model, words, "dsf", series)


def asymmetry_picture(model: ReportModel, words: Texts) -> Picture | None:
    """Return scale-factor asymmetry N minus P of every channel against temperature."""
    return _picture(model, words, "asymmetry", (_Series("dsf_asymmetry", BLUE, "o-", 0.0),))


def bias_picture(model: ReportModel, words: Texts) -> Picture | None:
    """Return bias of every channel against temperature."""
    return _picture(model, words, "bias", (_Series("bias", BLUE, "o-", 0.0),))


def unit_temperature_degC(conditions: Mapping[str, Any]) -> float:
    """Return the measured temperature of the unit where there is one, else the set-point, degC."""
    measured = conditions.get("unit_temperature_degC")
    return float(conditions.get("temperature_degC", math.nan) if measured is None else measured)


def _picture(model: ReportModel, words: Texts, name: str, series: Sequence[_Series]) -> Picture | None:
    rows = {curve.quantity: _at_temperatures(model.estimates(curve.quantity)) for curve in series}
    everything = [row for group in rows.values() for row in group]
    channels = channels_of(everything)
    if not channels:
        return None
    warmth = [unit_temperature_degC(row.conditions) for row in everything]
    span_degC = max(warmth) - min(warmth)
    if span_degC < _LEAST_SPAN_degC:
        return None
    middle_degC = (max(warmth) + min(warmth)) / 2.0
    scale, unit = readable(everything)
    with drawing():
        doubted = {row.conditions["channel"] for row in everything if not is_sound(row)}
        titles = [_title(words, channel, channel[0] in doubted) for channel in channels]
        figure, panels = panels_of(titles, legend_rows=int(len(series) > 1))
        for (number, _), axes in zip(channels, panels, strict=True):
            for curve in series:
                chosen = [row for row in rows[curve.quantity] if row.conditions["channel"] == number]
                _error_bars(axes, chosen, curve, words, curve.side * _APART * span_degC, scale)
            axes.set_xlim(middle_degC - 0.55 * span_degC, middle_degC + 0.55 * span_degC)
            axes.set_ylabel(words(f"{name}.axis", unit=unit))
            axes.set_xlabel(words("axis.unit_temperature"))
        if len(series) > 1:
            legend_of(figure, panels)
        svg = inline_svg(figure, name)
    return Picture(name, svg, words(f"{name}.caption"), words(f"{name}.description"))


def _title(words: Texts, channel: tuple[Any, Any], doubted: bool) -> str:
    title = channel_title(words, *channel)
    return words("channel.doubtful", title=title) if doubted else title


def _at_temperatures(rows: Sequence[Estimate]) -> list[Estimate]:
    """Return estimates that belong to a channel and a temperature, repeats and refused ones left out."""
    return [row for row in rows if {"channel", "temperature_degC"} <= row.conditions.keys() and row.value is not None]


def _error_bars(
    axes: Axes, rows: Sequence[Estimate], curve: _Series, words: Texts, shift_degC: float, scale: float
) -> None:
    temperature = [unit_temperature_degC(row.conditions) + shift_degC for row in rows]
    value = [scale * row.value for row in rows]
    expanded = [scale * (row.expanded_uncertainty or 0.0) for row in rows]
    axes.errorbar(
        temperature, value, expanded, fmt=curve.drawn, label=words(f"series.{curve.quantity}"), color=curve.colour,
        linewidth=0.7, capsize=2.0,
    )  # fmt: skip


def surroundings_picture(model: ReportModel, words: Texts) -> Picture | None:
    """Return temperature of the laboratory against time from hour 0; None if it was not logged."""
    shown = [surrounding for surrounding in model.run.surroundings if surrounding.laboratory and surrounding.t_s.size]
    if not shown:
        return None
    with drawing():
        figure = Figure(figsize=(7.2, 1.9), layout="constrained")
        axes = figure.subplots()
        for index, surrounding in enumerate(shown):
            t_s, degC = thin(surrounding.t_s, surrounding.degC)
            place = place_of(words, surrounding.name)
            axes.plot(t_s / 3600.0, degC, label=words("environment.laboratory", channel=place), **look(index))
        low, high = axes.get_ylim()
        short = max(0.0, _LEAST_AIR_SPAN_degC - (high - low)) / 2.0
        axes.set_ylim(low - short, high + short)
        axes.set_xlabel(words("axis.time", unit="h"))
        axes.set_ylabel(words("axis.temperature"))
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        axes.margins(x=0.01)
        svg = inline_svg(figure, "surroundings")
    return Picture("surroundings", svg, words("environment.caption"), words("environment.description"))
