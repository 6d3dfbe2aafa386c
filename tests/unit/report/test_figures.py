"""Figures as eyes see them: no text on another, none cut off, every axis with a unit, legible on A4; what they draw."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import replace
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
import report_boxes
import report_sample
from matplotlib.figure import Figure as Drawing
from report_boxes import axis_labels, collisions, flaws, outside, text_boxes
from report_sample import sample_model, small_model

from bench.analysis import Figure, Material, Table, band, series
from bench.report import Report, report_model
from bench.report.estimate_tables import coefficient_table
from bench.report.plots import history as history_plot
from bench.report.plots import temperatures as temperature_plots
from bench.report.plots.currents import level_errors
from bench.report.plots.graphs import analysis_pictures
from bench.report.tables import words_of
from bench.systems.af_converter.scale_factor.analysis import analyse

SEED, LEVEL_A, FEWER = 4, 1e-2, 1e-3


@pytest.mark.slow
def test_figures_of_a_scale_factor_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    figures = report_boxes.recorded_figures(monkeypatch)
    sections = Report(sample_model()).sections
    assert len(figures) == sum(len(section.pictures) for section in sections) == 7
    assert [flaws(figure) for figure in figures] == [[]] * len(figures)


def ramp_figures() -> list[Figure]:
    """Like those of the bias campaign: loops, residuals, widths with a band, Allan deviations, an oscillator."""
    rng = np.random.default_rng(5)
    degC = np.linspace(-10.0, 50.0, 120)
    figures: list[Figure] = []
    for group, x_label, y_label in (
        ("loops", "lagged temperature, degC", "bias, nA"),
        ("residuals", "time, h", "residual, nA"),
        ("widths", "temperature, degC", "width, nA"),
    ):
        for channel in range(1, 7):  # three rows of panels, numbers of every size
            y = (10.0 ** (channel % 5 - 2)) * rng.normal(0.0, 1.0, degC.size).cumsum()
            parts = [
                series("measured, up", degC, y, "points"),
                series("fit, rising", degC, y + 1.0),
                band("95 %", degC, y - 2, y + 2),
            ]
            title = f"channel {channel}"
            figures.append(Figure(title, "What it shows.", x_label, y_label, parts, group=group))
    tau = [100.0 * 2**power for power in range(9)]
    for channel in range(1, 7):
        deviation = np.array([0.1 * 1.3 ** (power * (channel % 4)) for power in range(9)])
        measured = series("measured", tau, deviation, "points", low=0.8 * deviation, high=1.4 * deviation)
        axes = "averaging time, s", "Allan deviation, nA"
        figures.append(Figure(f"channel {channel}", "", *axes, [measured], group="Allan", x_log=True, y_log=True))
    return figures


@pytest.mark.slow
def test_figures_of_a_bias_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    figures = report_boxes.recorded_figures(monkeypatch)
    assert len(analysis_pictures(ramp_figures())) == len(figures) == 4
    assert [flaws(figure) for figure in figures] == [[]] * len(figures)


def test_the_check_sees_a_collision_a_cut_and_turned_texts() -> None:
    figure = Drawing(figsize=(4.0, 3.0))
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


def test_one_temperature_has_no_figure_against_temperature() -> None:
    model = report_sample.sample_model()
    rows = [row for row in model.results["estimates"] if row["conditions"].get("temperature_degC", 20.0) == 20.0]
    for row in rows:
        row["conditions"]["unit_temperature_degC"] = 20.004 + 1e-5 * row["conditions"].get("channel", 0)
    assert {row["quantity"] for row in rows} >= {"dsf_n", "dsf_p", "bias"}
    alone = replace(model, results={**model.results, "estimates": rows})
    drawn = (temperature_plots.dsf_picture, temperature_plots.asymmetry_picture, temperature_plots.bias_picture)
    assert [picture(alone, words_of("en")) for picture in drawn] == [None, None, None]


def test_calibrations_at_one_time_lie_in_the_middle_of_some_years() -> None:
    empty = np.empty(0)
    panel = history_plot.Panel(
        title="bias", unit="nA", year=np.full(3, 2000.0), value=np.arange(3.0), expanded=np.ones(3), line_year=empty,
        line=empty, line_expanded=empty, action_sigma=float("nan"), outside=np.zeros(3, bool),
    )  # fmt: skip
    axes = Drawing().subplots()
    history_plot._draw(axes, panel)
    assert axes.get_xlim() == (1998.0, 2002.0)
    axes.figure.draw_without_rendering()
    assert next(label.get_text() for label in axes.get_xticklabels()).startswith(("1998", "1999"))


@pytest.mark.parametrize("method", ["gls", "ols"])
def test_a_level_with_fewer_pulses_has_more_current_per_pulse(method: str) -> None:
    """All pulses of one level are made fewer by 1000 ppm: that level alone must say about 1000 ppm more than others."""
    switches = sim.Switches(calibrator_errors=False, noise=False, dsf_sigma_ppm=0.0, lag=False)
    campaign = sim.simulate(SEED, switches, {1: "gyro"}, temperatures=(20.0,))
    rows = []
    for row in campaign.rows:
        changed = row.window.conditions["current_A"] == LEVEL_A
        factor = 1.0 - FEWER if changed else 1.0
        rows.append(
            dataclasses.replace(row, sums=row.sums | {name: row.sums[name] * factor for name in ("npp", "ppp")})
        )
    found = analyse(Material(rows, campaign.campaign, campaign.standards), method)
    model = report_model({"estimates": found.estimates}, (), (), None, {}, residuals=found.residuals)
    errors = {one.current_A: ppm for one, ppm in level_errors(model)}
    assert len(errors) == 12
    for sign in (1.0, -1.0):
        others = [ppm for current_A, ppm in errors.items() if current_A * sign > LEVEL_A]
        assert errors[sign * LEVEL_A] - np.mean(others) == pytest.approx(1e6 * FEWER, rel=0.1)


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


@pytest.mark.parametrize("values", [(0.91, 1.02), (0.97, 0.99), (1.1, 8.0), (3.0, 25.0)])
def test_a_logarithmic_axis_has_several_numbers_however_short_it_is(values: tuple[float, float]) -> None:
    """A variance that stays between 0.91 and 1.02 once had the single number 1 beside it."""
    parts = [series("variance", [0.0, 1.0], values)]
    drawn = texts(analysis_pictures([Figure("f", "", "time, s", "variance, 1", parts, y_log=True)])[0].svg)
    along = ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]
    beside = [text for text in drawn[len(along) :] if re.fullmatch(r"[0-9.]+", text)]
    assert drawn[: len(along)] == along
    assert len(beside) >= 3
    assert all(values[0] / 1.1 < float(text) < values[1] * 1.1 for text in beside)


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
    assert "Decision rule: four statements, as on page 1" in page


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
    assert table.rows == (("1", "Bias / nA", "436.57 ± 0.10", "2.10 ± 0.10"),)
