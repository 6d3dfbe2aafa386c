"""Figures as eyes see them: no text on another, none cut off, every axis with a unit, legible on A4."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import report_boxes
from matplotlib.figure import Figure
from report_boxes import axis_labels, collisions, flaws, outside, text_boxes
from report_sample import sample_model

from bench.report import Report
from bench.report.graphs import analysis_pictures


def test_figures_of_a_scale_factor_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    figures = report_boxes.recorded_figures(monkeypatch)
    sections = Report(sample_model()).sections
    assert len(figures) == sum(len(section.pictures) for section in sections) == 7
    assert [flaws(figure) for figure in figures] == [[]] * len(figures)


def ramp_documents() -> list[dict[str, Any]]:
    """Like those of the bias campaign: loops, residuals, widths with a band, Allan deviations, an oscillator."""
    rng = np.random.default_rng(5)
    degC = np.linspace(-10.0, 50.0, 120)
    documents: list[dict[str, Any]] = []
    for group, x_label, y_label in (
        ("loops", "lagged temperature, degC", "bias, nA"),
        ("residuals", "time, h", "residual, nA"),
        ("widths", "temperature, degC", "width, nA"),
    ):
        for channel in range(1, 11):
            y = (10.0 ** (channel % 5 - 2)) * rng.normal(0.0, 1.0, degC.size).cumsum()
            series = [
                {"label": "measured, up", "x": degC.tolist(), "y": y.tolist(), "style": "points"},
                {"label": "fit, rising", "x": degC.tolist(), "y": (y + 1.0).tolist(), "style": "line"},
                {"label": "95 %", "x": degC.tolist(), "low": (y - 2).tolist(), "high": (y + 2).tolist()}
                | {"style": "band"},
            ]
            documents.append({"title": f"channel {channel}", "caption": "What it shows.", "group": group} | {
                "x_label": x_label, "y_label": y_label, "series": series})  # fmt: skip
    tau = [100.0 * 2**power for power in range(9)]
    for channel in range(1, 11):
        deviation = [0.1 * 1.3 ** (power * (channel % 4)) for power in range(9)]
        ends = {"low": [0.8 * one for one in deviation], "high": [1.4 * one for one in deviation]}
        measured = {"label": "measured", "x": tau, "y": deviation, "style": "points"} | ends
        documents.append({"title": f"channel {channel}", "x_label": "averaging time, s", "group": "Allan"} | {
            "y_label": "Allan deviation, nA", "x_log": True, "y_log": True, "series": [measured]})  # fmt: skip
    return documents


def test_figures_of_a_bias_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    figures = report_boxes.recorded_figures(monkeypatch)
    assert len(analysis_pictures(ramp_documents())) == len(figures) == 4
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
