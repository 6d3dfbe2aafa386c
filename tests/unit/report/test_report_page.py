"""The report page: self-contained, the same bytes for the same numbers, and never too proud; what its figures draw."""

import dataclasses
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
from report_sample import estimate_entry, sample_model, sample_results, small_model

from bench.analysis import Figure, Material, Table, series
from bench.report import Report, report_model
from bench.report.estimate_tables import coefficient_table
from bench.report.model import ReportModel
from bench.report.plots.currents import level_errors
from bench.report.tables import words_of
from bench.report.verdict_tables import verdict_counts
from bench.systems.af_converter.scale_factor.analysis import analyse

WATERMARK = "SIMULATED — not a calibration"
SEED, LEVEL_A, FEWER = 4, 1e-2, 1e-3


class Outline(HTMLParser):
    """Collects ids, references and the text of table cells."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.references: list[str] = []
        self.rows: list[list[str]] = []
        self._in_cell = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [value for name, value in attrs if name == "id" and value]
        self.references += [value for name, value in attrs if name in {"href", "xlink:href"} and value]
        if tag == "tr":
            self.rows.append([])
        if tag in {"td", "th"}:
            self.rows[-1].append("")
            self._in_cell = True

    def handle_endtag(self, tag: str) -> None:
        self._in_cell = self._in_cell and tag not in {"td", "th"}

    def handle_data(self, data: str) -> None:
        if self._in_cell:
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def model() -> ReportModel:
    return sample_model()


@pytest.fixture(scope="module")
def page(model: ReportModel) -> str:
    return Report(model).html()


@pytest.fixture(scope="module")
def outline(page: str) -> Outline:
    return Outline(page)


@pytest.fixture(scope="module")
def small() -> ReportModel:
    return small_model()


@pytest.fixture(scope="module")
def small_page(small: ReportModel) -> str:
    return Report(small).html()


@pytest.fixture(scope="module")
def plain() -> ReportModel:
    """A report without any figure: what is not drawn is quick."""
    results = {"session": "s", "campaign": "c", "uut": {}, "estimates": [], "quality": {}, "provenance": {}}
    return ReportModel(title="Empty", results=results)


def by_key(value: Any) -> Any:
    """The same document with the keys of every mapping in order of the alphabet, as a session stores them."""
    if isinstance(value, dict):
        return {key: by_key(value[key]) for key in sorted(value)}
    return [by_key(one) for one in value] if isinstance(value, list | tuple) else value


def test_same_numbers_same_bytes_whatever_the_order_of_keys_and_others_with_another(
    small: ReportModel, small_page: str
) -> None:
    stored = {name: by_key(getattr(small, name)) for name in ("campaign", "standards", "identities")}
    listed = {name: tuple(by_key(one) for one in getattr(small, name)) for name in ("prompts", "components")}
    origin = {name: by_key(value) for name, value in small.origin.items()}
    assert Report(replace(small, origin=origin, **stored, **listed)).html() == small_page
    first, *others = small.results["estimates"]
    results = {**small.results, "estimates": [{**first, "value": first["value"] + 1.0}, *others]}
    assert Report(replace(small, results=results)).html() != small_page


def test_page_needs_nothing_else(page: str, outline: Outline) -> None:
    assert "<script" not in page
    assert not re.search(r"url\((?!#)", page)
    assert not re.search(r"<(?:img|link|iframe|object)\b", page)
    assert all(reference.startswith("#") for reference in outline.references)
    assert {reference[1:] for reference in outline.references} <= set(outline.ids)
    assert len(outline.ids) == len(set(outline.ids))
    assert "dc:date" not in page


def test_table_shows_ppm_microampere_and_the_unit_of_the_sensor(model: ReportModel, outline: Outline) -> None:
    estimate = model.estimates("dsf_n")[0]
    row = next(row for row in outline.rows if row[:2] == ["1", "−10.0"])
    headers = next(row for row in outline.rows if row[:2] == ["channel", "set / °C"])
    shown = {name: value.replace("−", "-").replace("\u202f", "") for name, value in zip(headers, row, strict=True)}
    assert shown["N / ppm"] == f"{estimate.value:.0f} ± 20"
    assert float(shown["N / µA"]) == pytest.approx(estimate.value * 1e-6 * 0.299e6, abs=0.06)
    assert float(shown["N / deg/s"]) == pytest.approx(estimate.value * 1e-6 * 83.0, abs=6e-5)
    assert shown["rows"] == "14"
    accelerometer = [row for row in outline.rows if row[:2] == ["channel", "set / °C"]][1]
    assert "N / g" in accelerometer


def test_every_estimate_has_its_place(model: ReportModel, outline: Outline) -> None:
    quantities = {row["quantity"] for row in model.results["estimates"]}
    assert quantities == {
        *("dsf_n", "dsf_p", "dsf_asymmetry", "bias", "dsf_n_drift", "master_clock_error"),
        *(f"{quantity}_tc{order}" for quantity in ("dsf_n", "dsf_p", "bias") for order in range(3)),
    }
    text = " ".join(cell for row in outline.rows for cell in row)
    assert text.count("−400 ± 10") == 50
    assert ["10", "Scale-factor error P / ppm", "100.0 ± 2.0", "8.00 ± 0.16", "0.03000 ± 0.00060"] in outline.rows
    assert ["10", "Bias / nA", "100.0 ± 1.0", "8.000 ± 0.080", "0.03000 ± 0.00030"] in outline.rows
    heads = (["Scale-factor error N / ppm"], ["Scale-factor error P / ppm"], ["Bias / nA"])
    assert sum(1 for row in outline.rows if row[1:2] in heads and len(row) == 5) == 30
    drift = "channel 1, gyro, repeat 1"  # the set temperature of all is in the caption
    assert ["Scale-factor error N, change between repeats", drift, "0.3 ± 2.1", "ppm"] in outline.rows
    assert ["Master-clock error", "–", "1.500 ± 0.010", "ppm"] in outline.rows


def test_flags_are_counted_and_provenance_is_named(model: ReportModel, outline: Outline) -> None:
    assert model.counts.by_flag == {"lost": 1, "retaken": 1}
    assert (model.counts.records, model.counts.flagged) == (765, 1)
    due = [["flag lost", "1"], ["frames lost", "2"], ["SHA-256 of the plan", "ab" * 32]]
    due += [["software.packages.numpy", "2.4"], ["calibrator", "FLUKE", "5720A"]]
    assert [row for row in due if row not in outline.rows] == []


def test_standards_show_what_was_applied_and_what_was_overdue(small: ReportModel, plain: ReportModel) -> None:
    standard = small.standards["calibrator"]
    register = {
        "calibrator": {**standard, "corrections": [{"range_A": 2.2e-4, "gain": 1e-6}]},
        "meter": {**standard, "due": "1999-12-25"},
        "counter": {"due": "soon"},
    }
    rows = Outline(Report(replace(plain, standards=register, started_utc=small.started_utc)).html()).rows
    found = {row[0]: row for row in rows if len(row) == 8}
    assert found["calibrator"][1:6] == ["5720A", "SIM-5720", "SIM-0001", "1999-11-01", "2000-11-01"]
    assert found["calibrator"][6:] == ["305", "range / A 0.00022, gain 1·10⁻⁶"]
    assert found["meter"][6] == "overdue by 7 days"
    assert (found["counter"][5], found["counter"][6]) == ("soon", "–")


@pytest.mark.parametrize(("simulated", "marked"), [(True, True), (None, True), (False, False)])
def test_simulated_is_said_unless_provenance_denies_it(
    small: ReportModel, simulated: bool | None, marked: bool
) -> None:
    results = {**small.results, "provenance": {} if simulated is None else {"simulated": simulated}}
    text = Report(ReportModel(title="T", results=results)).html()
    assert (text.count(WATERMARK) >= 3) is marked
    assert (WATERMARK in text) is marked


@pytest.mark.parametrize(
    ("verdicts", "kind", "words"),
    [
        (["none", "none"], "none", "Not judged"),
        (["pass", "none"], "good", "1 pass"),
        (["pass", "fail"], "bad", "1 fail, 1 pass"),
        (["pass", "conditional_fail"], "bad", "1 conditional fail, 1 pass"),
        (["pass", "conditional_pass"], "warn", "1 conditional pass, 1 pass"),
    ],
)
def test_verdict(verdicts: list[str], kind: str, words: str) -> None:
    results = sample_results()
    results["estimates"] = results["estimates"][:2]
    for row, verdict in zip(results["estimates"], verdicts, strict=True):
        row["verdict"], row["limit"] = verdict, 100.0
    model = ReportModel(title="T", results=results)
    text = Report(model).html()
    assert f'class="verdict {kind}"' in text
    assert words in text
    assert sum(verdict_counts(model).values()) == sum(verdict != "none" for verdict in verdicts)


def test_what_comes_from_a_file_is_escaped(plain: ReportModel) -> None:
    nasty = replace(plain, title="<b>x</b>", notes=("<script>alert(1)</script>",))
    text = Report(nasty).html()
    assert "<script" not in text
    assert "&lt;b&gt;x&lt;/b&gt;" in text


def test_zero_current_has_no_residual_in_ppm(model: ReportModel) -> None:
    assert len(model.residuals) == 10 * 5 * 12
    assert all(one.current_A for one in model.residuals)


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
    model = report_model({"estimates": found.estimates}, (), (), {}, 0.0, found.residuals)
    errors = {one.current_A: ppm for one, ppm in level_errors(model)}
    assert len(errors) == 12
    for sign in (1.0, -1.0):
        others = [ppm for current_A, ppm in errors.items() if current_A * sign > LEVEL_A]
        assert errors[sign * LEVEL_A] - np.mean(others) == pytest.approx(1e6 * FEWER, rel=0.1)


def test_figures_and_tables_of_an_analysis_are_in_the_page() -> None:
    table = Table("Budget", "Channel 1.", ["component", "u / ppm"], [["gain", 10.0], ["E_n", -0.0151768]])
    drawn = Figure("Bias of channel 1", "", "T / °C", "bias / nA", [series("up", [0.0, 1.0], [1.0, 2.0])])
    page = Report(replace(small_model(), figures=(drawn,), tables=(table,))).html()
    for text in ("Bias of channel 1", "Budget. Channel 1.", ">gain</th><td>10.00</td>", ">E_n</th><td>−0.01518</td>"):
        assert text in page


@pytest.mark.parametrize("probability", [0.99999, 1.0])
def test_a_probability_is_never_rounded_up_to_certainty(probability: float) -> None:
    model = small_model()
    judged = estimate_entry("bias_residual", "A", 1e-9, 2e-10, channel=1, kind="gyro")
    judged |= {"limit": 24e-9, "verdict": "pass", "conformance_probability": probability}
    results = {**model.results, "estimates": [judged, {**judged, "value": -5e-9}], "decision_rule": "non_binary"}
    page = Report(replace(model, results=results)).html()
    assert "&gt; 99.99 %" in page
    assert "−5.00 ± 0.20" in page  # the one nearer to the limit stands for the channel


def test_a_coefficient_without_constant_shows_the_value_at_its_reference_temperature() -> None:
    estimates = [
        estimate_entry("bias", "A", 368e-9, 1e-10, channel=1, temperature_degC=-10.0),
        estimate_entry("bias", "A", 436.57e-9, 1e-10, channel=1, temperature_degC=20.0),
        estimate_entry("bias_tc1", "A/degC", 2.1e-9, 1e-10, channel=1, reference_temperature_degC=20.0),
    ]
    model = small_model()
    table = coefficient_table(replace(model, results={**model.results, "estimates": estimates}), words_of("en"))
    assert table.rows == (("1", "Bias / nA", "436.57 ± 0.10", "2.10 ± 0.10"),)
