"""Figures as eyes see them: no text on another, none cut off, every axis with a unit, legible on A4."""

from __future__ import annotations

import numpy as np
import pytest
import report_boxes
from matplotlib.figure import Figure
from report_boxes import axis_labels, collisions, flaws, outside, text_boxes
from report_sample import sample_model

from bench import analysis
from bench.analysis import band, series
from bench.report import Report
from bench.report.plots.graphs import analysis_pictures


def test_figures_of_a_scale_factor_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    figures = report_boxes.recorded_figures(monkeypatch)
    sections = Report(sample_model()).sections
    assert len(figures) == sum(len(section.pictures) for section in sections) == 7
    assert [flaws(figure) for figure in figures] == [[]] * len(figures)


def ramp_figures() -> list[analysis.Figure]:
    """Like those of the bias campaign: loops, residuals, widths with a band, Allan deviations, an oscillator."""
    rng = np.random.default_rng(5)
    degC = np.linspace(-10.0, 50.0, 120)
    figures: list[analysis.Figure] = []
    for group, x_label, y_label in (
        ("loops", "lagged temperature, degC", "bias, nA"),
        ("residuals", "time, h", "residual, nA"),
        ("widths", "temperature, degC", "width, nA"),
    ):
        for channel in range(1, 11):
            y = (10.0 ** (channel % 5 - 2)) * rng.normal(0.0, 1.0, degC.size).cumsum()
            parts = [
                series("measured, up", degC, y, "points"),
                series("fit, rising", degC, y + 1.0),
                band("95 %", degC, y - 2, y + 2),
            ]
            title = f"channel {channel}"
            figures.append(analysis.Figure(title, "What it shows.", x_label, y_label, parts, group=group))
    tau = [100.0 * 2**power for power in range(9)]
    for channel in range(1, 11):
        deviation = np.array([0.1 * 1.3 ** (power * (channel % 4)) for power in range(9)])
        measured = series("measured", tau, deviation, "points", low=0.8 * deviation, high=1.4 * deviation)
        axes = "averaging time, s", "Allan deviation, nA"
        figures.append(
            analysis.Figure(f"channel {channel}", "", *axes, [measured], group="Allan", x_log=True, y_log=True)
        )
    return figures


def test_figures_of_a_bias_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    figures = report_boxes.recorded_figures(monkeypatch)
    assert len(analysis_pictures(ramp_figures())) == len(figures) == 4
    assert [flaws(figure) for figure in figures] == [[]] * len(figures)


def test_the_check_sees_a_collision_a_cut_and_turned_texts() -> None:
    figure = Figure(figsize=(4.0, 3.0))
    figure.text(0.5, 0.5, "one word")
    figure.text(0.52, 0.5, "another")
    figure.text(0.99, 0.1, "cut off")
    for index in range(8):  # steep neighbours: the boxes around them overlap, they themselves do not
        figure.text(0.1 + 0.045 * index, 0.8, "−0.0003", rotation=60, size=7.0)
    boxes = text_boxes(figure)
    assert collisions(boxes) == [("one word", "another")]
    assert outside(figure, boxes) == ["cut off"]
    axes = figure.subplots()
    axes.set_xlabel("Current")
    assert "no unit in 'Current'" in flaws(figure)
    assert axis_labels(figure) == ["Current", ""]
