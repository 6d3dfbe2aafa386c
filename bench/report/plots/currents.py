"""Scale-factor error and residual of every level, one panel per channel."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from bench.model.texts import Texts
from bench.report.model import Picture, ReportModel, Residual
from bench.report.plots.style import GREY, drawing, inline_svg, legend_of, look, panels_of
from bench.report.tables import channel_title

_LINEAR_ppm = 1.0
_mA = 1e3
_BELOW_in = 0.62  # numbers that stand steeply


def current_picture(model: ReportModel, words: Texts) -> Picture | None:
    """Return scale-factor error of every single level against its current."""
    errors = level_errors(model)
    if not errors:
        return None
    with drawing():
        svg = _current_svg(errors, words)
    return Picture("current", svg, words("current.caption"), words("current.description"))


def level_errors(model: ReportModel) -> list[tuple[Residual, float]]:
    """Return scale-factor error of every level in ppm: that of the fit and what the level alone says beyond it.

    A level with N (positive current) says ``dsf_n + residual``, one with P ``dsf_p - residual``: in the model of
    the scale-factor fit the residual of a negative current counts the other way.
    """
    fitted = {
        (quantity, row.conditions["channel"], row.conditions.get("temperature_degC")): float(row.value)
        for quantity in ("dsf_n", "dsf_p")
        for row in model.estimates(quantity)
        if "repeat" not in row.conditions and "channel" in row.conditions and row.value is not None
    }
    errors = []
    for residual in _residuals(model):
        sign = 1.0 if residual.current_A > 0 else -1.0
        dsf_ppm = fitted.get(("dsf_n" if sign > 0 else "dsf_p", residual.channel, residual.temperature_degC))
        if dsf_ppm is not None:
            errors.append((residual, dsf_ppm + sign * residual.residual_ppm))
    return errors


def _current_svg(errors: Sequence[tuple[Residual, float]], words: Texts) -> str:
    channels = sorted({(residual.channel, residual.kind) for residual, _ in errors})
    temperatures = sorted({residual.temperature_degC for residual, _ in errors})
    figure, panels = panels_of([channel_title(words, *channel) for channel in channels])
    for (number, _), axes in zip(channels, panels, strict=True):
        for index, temperature in enumerate(temperatures):
            drawn = {1.0: look(index), -1.0: look(index) | {"markerfacecolor": "white", "linestyle": (0, (3, 2))}}
            for sign, how in drawn.items():
                chosen = sorted(
                    (abs(residual.current_A) * _mA, error)
                    for residual, error in errors
                    if (residual.channel, residual.temperature_degC) == (number, temperature)
                    and residual.current_A * sign > 0
                )
                if chosen:
                    name = words("series.temperature", degC=_degC(temperature)) if sign > 0 else "_"
                    axes.plot(*zip(*chosen, strict=True), linewidth=0.6, label=name, **how)
        axes.set_xscale("log")
        axes.minorticks_off()
        axes.set_ylabel(words("dsf.axis", unit="ppm"))
        axes.set_xlabel(words("axis.current"))
    legend_of(figure, panels)
    return inline_svg(figure, "current")


def residual_picture(model: ReportModel, words: Texts) -> Picture | None:
    """Return residuals in ppm of the level for every channel, level and temperature."""
    residuals = _residuals(model)
    channels = sorted({(residual.channel, residual.kind) for residual in residuals})
    if not channels:
        return None
    temperatures = sorted({residual.temperature_degC for residual in residuals})
    with drawing():
        titles = [channel_title(words, *channel) for channel in channels]
        figure, panels = panels_of(titles, below_in=_BELOW_in)
        for (number, _), axes in zip(channels, panels, strict=True):
            _residual_panel(
                axes, [residual for residual in residuals if residual.channel == number], temperatures, words
            )
        legend_of(figure, panels)
        svg = inline_svg(figure, "residuals")
    caption = words("residuals.caption", linear=f"{_LINEAR_ppm:g}")
    return Picture("residuals", svg, caption, words("residuals.description"))


def _residuals(model: ReportModel) -> list[Residual]:
    return [residual for residual in model.residuals if residual.current_A and math.isfinite(residual.residual_ppm)]


def _residual_panel(axes: Axes, residuals: Sequence[Residual], temperatures: Sequence[float], words: Texts) -> None:
    levels = sorted({residual.current_A for residual in residuals})
    place = {level: index for index, level in enumerate(levels)}
    width = 0.6 / max(1, len(temperatures))
    for index, temperature in enumerate(temperatures):
        chosen = [residual for residual in residuals if residual.temperature_degC == temperature]
        shift = (index - (len(temperatures) - 1) / 2) * width
        axes.plot(
            [place[residual.current_A] + shift for residual in chosen],
            [residual.residual_ppm for residual in chosen],
            linestyle="none",
            label=words("series.temperature", degC=_degC(temperature)),
            **look(index),
        )
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    _symmetric_log(axes, 3.0 * max(_LINEAR_ppm, *(abs(residual.residual_ppm) for residual in residuals)))
    axes.set_xticks(range(len(levels)), [_signed_mA(level) for level in levels], rotation=60)
    axes.set_ylabel(words("residuals.axis"))
    axes.set_xlabel(words("axis.current"))


def _symmetric_log(axes: Axes, limit_ppm: float) -> None:
    axes.set_yscale("symlog", linthresh=_LINEAR_ppm, linscale=0.8)
    axes.set_ylim(-limit_ppm, limit_ppm)
    first = 0 if limit_ppm <= 100.0 else 1  # a mark at 1 would stand on the one at 0
    decades = [10.0**power for power in range(first, 1 + math.floor(math.log10(limit_ppm)))]
    marks = decades[:: max(1, math.ceil(len(decades) / 2))]
    axes.set_yticks([-mark for mark in reversed(marks)] + [0.0, *marks])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}".replace("-", "−")))
    axes.minorticks_off()


def _degC(temperature_degC: float) -> str:
    return f"{temperature_degC:g}".replace("-", "−")


def _signed_mA(current_A: float) -> str:
    return ("+" if current_A > 0 else "−") + f"{abs(current_A) * _mA:.4g}"
