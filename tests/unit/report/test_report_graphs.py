"""Figures and tables of an analysis come out in the page, complete and the same each time."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
from report_sample import small_model

from bench.analysis import Figure, Table, band, series
from bench.report import Report
from bench.report.estimate_tables import coefficient_table
from bench.report.plots.graphs import analysis_pictures
from bench.report.words import words_of


def figure(title: str, **more: Any) -> Figure:
    parts = [
        series("up", [0.0, 1.0, 2.0], [1.0, 2.0, 4.0]),
        series("readings", [0.0, 1.0], [1.1, 2.2], "points", low=[1.0, 2.0], high=[1.2, 2.4]),
        band("95 %", [0.0, 2.0], [0.5, 3.0], [1.5, 5.0]),
    ]
    return replace(Figure(title, "What it shows.", "T / °C", "bias / nA", parts), **more)


def texts(svg: str) -> list[str]:
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_a_group_is_one_picture_with_a_panel_per_figure() -> None:
    pictures = analysis_pictures(
        [figure("channel 1", group="bias"), figure("alone"), figure("channel 2", group="bias")]
    )
    assert [picture.description for picture in pictures] == ["channel 1, channel 2.", "alone."]
    words = texts(pictures[0].svg)
    assert {"channel 1", "channel 2", "T / °C", "bias / nA"} <= set(words)
    assert [words.count(label) for label in ("up", "readings", "95 %")] == [1, 1, 1]  # one legend for all panels
    assert pictures[0].caption == "What it shows."


def test_logarithmic_axes() -> None:
    deviation = [series("adev", [1.0, 10.0, 100.0], [1e-3, 1e-2, 1e-1])]
    linear, logarithmic = (
        analysis_pictures([figure("Allan", x_log=log, y_log=log, series=deviation)])[0].svg for log in (False, True)
    )
    assert "20" in texts(linear)
    assert "20" not in texts(logarithmic)


def test_error_bars_reach_from_low_to_high_only() -> None:
    bars = [series("r", [1.0], [5.0], "points", low=[5.0], high=[9.0])]
    plain = [series("r", [1.0], [5.0], "points")]
    with_bars, without = (analysis_pictures([figure("f", series=one)])[0].svg for one in (bars, plain))
    assert len(with_bars) > len(without)


def test_figures_and_tables_are_in_the_page_and_the_bytes_repeat() -> None:
    rows = [["gain", 10.0], ["E_n", -0.0151768]]
    table = Table("Budget", "Channel 1.", ["component", "u / ppm"], rows)
    model = replace(small_model(), figures=(figure("Bias of channel 1"),), tables=(table,))
    page = Report(model).html()
    assert "Bias of channel 1" in page
    assert "Budget. Channel 1." in page
    assert ">gain</th><td>10.00</td>" in page
    assert ">E_n</th><td>−0.01518</td>" in page
    assert page == Report(model).html()


@pytest.mark.parametrize("probability", [0.99999, 1.0])
def test_a_probability_is_never_rounded_up_to_certainty(probability: float) -> None:
    model = small_model()
    judged = {
        "quantity": "bias_residual",
        "unit": "A",
        "value": 1e-9,
        "std_uncertainty": 1e-10,
        "coverage_factor": 2.0,
        "expanded_uncertainty": 2e-10,
        "conditions": {"channel": 1, "kind": "gyro"},
        "n": 1,
        "dropped": 0,
        "limit": 24e-9,
        "verdict": "pass",
        "conformance_probability": probability,
    }
    results = {**model.results, "estimates": [judged, {**judged, "value": -5e-9}], "decision_rule": "non_binary"}
    page = Report(replace(model, results=results)).html()
    assert "&gt; 99.99 %" in page
    assert "−5.00 ± 0.20" in page  # the one nearer to the limit stands for the channel
    assert "2 pass" in page
    assert "Decision rule: non binary" in page


def test_a_coefficient_without_constant_shows_the_value_at_its_reference_temperature() -> None:
    def entry(quantity: str, unit: str, value: float, **where: Any) -> dict[str, Any]:
        return {"quantity": quantity, "unit": unit, "value": value, "expanded_uncertainty": 1e-10, "conditions": where}

    estimates = [
        entry("bias", "A", 368e-9, channel=1, temperature_degC=-10.0),
        entry("bias", "A", 436.57e-9, channel=1, temperature_degC=20.0),
        entry("bias_tc1", "A/degC", 2.1e-9, channel=1, reference_temperature_degC=20.0),
    ]
    model = small_model()
    table = coefficient_table(replace(model, results={**model.results, "estimates": estimates}), words_of("en"))
    assert table is not None
    assert table.rows == (("1", "bias / nA", "436.57 ± 0.10", "2.10 ± 0.10"),)
