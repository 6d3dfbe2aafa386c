"""The air of the laboratory over the run, on a scale of its own."""

from __future__ import annotations

from matplotlib.figure import Figure

from bench.model.texts import Texts
from bench.report.figures import thin
from bench.report.model import ReportModel
from bench.report.style import Picture, drawing, inline_svg, look

_LEAST_SPAN_degC = 2.0


def surroundings_picture(model: ReportModel, words: Texts) -> Picture | None:
    """Temperature of the laboratory against time from hour 0; None if it was not logged."""
    shown = [one for one in model.run.surroundings if one.laboratory and one.t_s.size]
    if not shown:
        return None
    with drawing():
        figure = Figure(figsize=(7.2, 1.9), layout="constrained")
        axes = figure.subplots()
        for index, one in enumerate(shown):
            t_s, degC = thin(one.t_s, one.degC)
            axes.plot(t_s / 3600.0, degC, label=words("environment.laboratory", channel=one.name), **look(index))
        low, high = axes.get_ylim()
        short = max(0.0, _LEAST_SPAN_degC - (high - low)) / 2.0
        axes.set_ylim(low - short, high + short)
        axes.set_xlabel(words("axis.time", unit="h"))
        axes.set_ylabel(words("axis.temperature"))
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        axes.margins(x=0.01)
        svg = inline_svg(figure, "surroundings")
    return Picture("surroundings", svg, words("environment.caption"), words("environment.description"))
