"""Axes of campaigns at one temperature and of calibrations at one time: no offsets, no empty centuries."""

from __future__ import annotations

import numpy as np
import pytest
import report_sample
from matplotlib.figure import Figure

from bench.report.plots import history as history_plot
from bench.report.plots import temperatures as temperature_plots
from bench.report.words import words_of


def test_one_temperature_has_a_readable_axis(monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(temperature_plots, "inline_svg", lambda figure, name: figures.append(figure) or "")
    model = report_sample.sample_model()
    for row in model.estimates("dsf_n") + model.estimates("dsf_p"):
        row["conditions"]["unit_temperature_degC"] = 20.004 + 1e-5 * row["conditions"]["channel"]
    assert temperature_plots.dsf_picture(model, words_of("en")) is not None
    (figure,) = figures
    for axes in figure.axes:
        low, high = axes.get_xlim()
        assert high - low == pytest.approx(1.1)
        assert low < 20.004 < high
        axes.xaxis.get_major_formatter().set_locs(axes.get_xticks())
        assert axes.xaxis.get_major_formatter().get_offset() == ""


def test_calibrations_at_one_time_lie_in_the_middle_of_some_years() -> None:
    empty = np.empty(0)
    panel = history_plot.Panel(
        title="bias", unit="nA", year=np.full(3, 2000.0), value=np.arange(3.0), expanded=np.ones(3), line_year=empty,
        line=empty, line_expanded=empty, action_sigma=float("nan"), limit=float("nan"), outside=np.zeros(3, bool),
    )  # fmt: skip
    axes = Figure().subplots()
    history_plot._draw(axes, panel)
    assert axes.get_xlim() == (1998.0, 2002.0)
    axes.figure.draw_without_rendering()
    assert next(label.get_text() for label in axes.get_xticklabels()).startswith(("1998", "1999"))
