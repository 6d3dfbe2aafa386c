"""The report page: self-contained, the same bytes for the same numbers, never too proud; its figures and tables."""

import dataclasses
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
from report_sample import estimate_entry, sample_model, sample_results, small_model, unsound

from bench import analysis
from bench.analysis import Figure, Material, Table, documents, estimates_of, series
from bench.model.systems import is_size
from bench.report import Report, report_model
from bench.report.estimate_tables import (
    channel_table,
    coefficient_table,
    coverage_table,
    other_table,
    pivot_tables,
    value_text,
)
from bench.report.first import first_page
from bench.report.first.results import main_rows
from bench.report.model import ReportModel
from bench.report.plots.currents import level_errors
from bench.report.sections import prompt_table, sections_of, summary_table
from bench.report.tables import words_of
from bench.report.verdict_tables import agreement_parts, verdict_table
from bench.session.view import SessionView, model_of
from bench.systems.af_converter.scale_factor.analysis import analyse
from bench.systems.af_converter.wording import say

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
    assert " ".join(cell for row in outline.rows for cell in row).count("−400 ± 10") == 50
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
    assert len(model.residuals) == 10 * 5 * 12
    assert all(one.current_A for one in model.residuals)  # at zero current there is none in ppm
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


def test_what_comes_from_a_file_is_escaped(plain: ReportModel) -> None:
    nasty = replace(plain, title="<b>x</b>", notes=("<script>alert(1)</script>",))
    text = Report(nasty).html()
    assert "<script" not in text
    assert "&lt;b&gt;x&lt;/b&gt;" in text


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


def test_figures_tables_and_odd_notes_of_an_analysis_are_in_the_report() -> None:
    table = Table("Budget", "Channel 1.", ["component", "u / ppm"], [["gain", 10.0], ["E_n", -0.0151768]])
    drawn = Figure("Bias of channel 1", "", "T / °C", "bias / nA", [series("up", [0.0, 1.0], [1.0, 2.0])])
    page = Report(replace(small_model(), figures=(drawn,), tables=(table,))).html()
    for text in ("Bias of channel 1", "Budget. Channel 1.", ">gain</th><td>10.00</td>", ">E_n</th><td>−0.01518</td>"):
        assert text in page
    seen = analysis.Evidence("odd", "It is odd.", 1.0, 1e-9, move=0.0)
    found = analysis.Analysis("scale_factor", "gls", {}, [], evidence=[seen], notes=["A note."])
    manifest = {"session": "s", "planned": {"prepare_s": 0.0}, "campaign": {"analysis": "scale_factor"}}
    made = model_of(SessionView(manifest, [], {}, ""), PLAIN, found)
    assert list(made.notes[:2]) == ["It is odd.", "A note."]


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


ENGLISH, KOREAN = words_of("en"), words_of("ko")
PLAIN: dict[str, Any] = {"session": "s", "campaign": "scale_factor", "uut": {}, "quality": {}, "provenance": {}}
SENSOR = say("component.sensor")


def modelled(*estimates: dict[str, Any], campaign: str = "scale_factor", **more: Any) -> ReportModel:
    return ReportModel(title="T", results={**PLAIN, "campaign": campaign, "estimates": list(estimates)}, **more)


def offset(quantity: str, value: float | None, expanded: float = 0.0, **more: Any) -> dict[str, Any]:
    unit = "ppm" if quantity == "time_offset_drift" else "s"
    found = estimate_entry(quantity, unit, 0.0, expanded, method="augmented_loose")
    return (unsound(found, "refused") if value is None else found | {"value": value}) | more


def wrong(item: str, count: float, unit: str) -> dict[str, Any]:
    verdict = "fail" if count else "pass"
    judged = {"limit": 0.0, "verdict": verdict, "conformance_probability": 0.0 if count else 1.0}
    return estimate_entry(f"{item}_wrong", "1", count, 0.0) | {"conditions": {"unit": unit}} | judged


def test_the_table_of_the_verdicts_tells_a_size_from_a_difference() -> None:
    declared = [name for name in ("time_offset_uncertainty", "stamps_difference") if is_size("egi_offset", name)]
    assert declared == ["time_offset_uncertainty"]
    assert not is_size("nobody's", "time_offset_uncertainty")
    judged = {"verdict": "pass", "conformance_probability": None}
    width = offset("time_offset_uncertainty", 7.5e-3, limit=10e-3, **judged)
    difference = offset("stamps_difference", -3e-3, 8e-3, limit=5e-3, **judged)
    table = verdict_table(modelled(width, difference, campaign="time_sync"), ENGLISH)
    assert [row[3:5] for row in table.rows] == [("≤ 10", "ms"), ("± 5", "ms")]
    assert [analysis.limits_text(limits, size=True) for limits in ((4.0, 5.0), (0.0, 0.0))] == ["4 to 5", "0"]


def test_the_unit_that_failed_stands_for_its_item_where_nothing_may_be_wrong() -> None:
    units = [wrong("memory", count, f"U-{number}") for number, count in enumerate((0.0, 2.0, 1.0))]
    table = verdict_table(modelled(*units), ENGLISH)
    row = dict(zip(table.headers, table.rows[0], strict=True))
    assert row["worst: value ± U"] == "2"
    assert row["conformance"] == "–"  # no uncertainty, no probability
    assert row["verdicts"] == "2 fail, 1 pass"


def test_the_first_page_says_that_a_run_has_not_ended_and_that_its_recording_is_damaged() -> None:
    whole = small_model()
    cut = replace(whole, results={**whole.results, "incomplete": True}, run=replace(whole.run, damage=3))
    assert first_page(whole, None, ENGLISH).doubt == ()
    said = first_page(cut, None, ENGLISH).doubt
    assert said[0] == ENGLISH("doubt.incomplete")
    assert "at 3 places" in said[1]


@pytest.mark.parametrize(
    ("value", "unit", "bounds", "allowed", "answer"),
    [
        (0.5, "ohm", {"high": 0.5}, "≤ 0.5 Ω", "0.5 Ω"),
        (2.5e6, "ohm", {"low": 1e6}, "≥ 1 MΩ", "2.5 MΩ"),
        (360_000.0, "s", {"low": 3600.0, "high": 3.6e7}, "≥ 1 h, ≤ 10\u202f000 h", "100 h"),
        (-23.0, "degC", {}, "–", "−23 °C"),
        (3.0, "", {}, "–", "3"),
    ],
)
def test_an_answer_is_an_amount(value: float, unit: str, bounds: dict[str, float], allowed: str, answer: str) -> None:
    prompt = {"step": 1, "text": "Set to 65 degC?", "value": value, "unit": unit, "by": "simulation", **bounds}
    table = prompt_table(modelled(prompts=(prompt,)), KOREAN)
    said = tuple(text.replace("\u00a0", " ") for text in table.rows[0][1:])
    assert said == ("Set to 65 °C?", allowed, answer, KOREAN("by.simulation"))


def test_a_value_without_uncertainty_has_four_digits_and_whole_numbers_all() -> None:
    (bare,) = estimates_of({"estimates": [estimate_entry("observability", "1", 0.000388125, 0.0)]})
    for value, shown in ((0.000388125, "0.0003881"), (521.454, "521.5"), (12345.0, "12345")):
        assert value_text(bare.model_copy(update={"value": value})) == shown


def test_a_refused_value_has_no_unit() -> None:
    told = modelled(
        offset("time_offset", None), offset("time_offset_from_stamps", 9.7e-3, 2.8e-3), campaign="time_sync"
    )
    table = other_table(told, ENGLISH)
    assert [row[2:] for row in table.rows] == [("refused", "–"), ("9.7 ± 2.8", "ms")]


def test_a_main_quantity_that_only_another_method_gives_is_shown() -> None:
    tight = offset("time_offset", 9.4e-3, 3.6e-3, conditions={"method": "augmented_tight"})
    drift = offset("time_offset_drift", -4.3, 1.1, conditions={"method": "stamps"})
    chosen = offset("time_offset", 6.6e-3, 7.5e-3)
    told = modelled(tight, drift, chosen, campaign="time_sync", main=("time_offset", "time_offset_drift"))
    told = replace(told, results={**told.results, "method": "augmented_loose"})
    assert documents(main_rows(told)) == [chosen, drift]


def test_values_that_a_further_condition_tells_apart_all_stand_in_the_tables() -> None:
    """The leakage of a switch is known for both polarities; of equal channel and temperature none may hide another."""
    at = [(channel, polarity) for channel in (1, 2) for polarity in (1, -1)]
    rows = []
    for channel, polarity in at:
        where = {"channel": channel, "polarity": polarity}
        leak_nA, lag_min = 10.0 * channel + polarity, 5.0 * channel + polarity
        rows.append(estimate_entry("switch_leakage", "nA", leak_nA, 1.0, **where, temperature_degC=20.0))
        rows.append(estimate_entry("thermal_lag", "min", lag_min, 1.0, **where))
    assert [table.rows for table in pivot_tables(modelled(*rows), ENGLISH)] == [
        (("1", "11.0 ± 1.0"), ("2", "21.0 ± 1.0")),
        (("1", "9.0 ± 1.0"), ("2", "19.0 ± 1.0")),
    ]
    by_channel = channel_table(modelled(*rows), ENGLISH)
    assert by_channel.rows == (("1", "6.0 ± 1.0", "4.0 ± 1.0"), ("2", "11.0 ± 1.0", "9.0 ± 1.0"))


def test_what_has_no_uncertainty_has_no_row_of_zeros_under_uncertainty() -> None:
    table = coverage_table(
        modelled(wrong("cpu", 0.0, "U-1"), estimate_entry("supply_voltage", "V", 5.0, 0.01)), ENGLISH
    )
    assert [row[0] for row in table.rows] == ["supply voltage"]


def counted(quality: dict[str, int], frame_sha256: str) -> set[str]:
    told = modelled(estimate_entry("bias", "A", 1.0, 0.1))
    results = {**told.results, "quality": quality, "provenance": {"frame_sha256": frame_sha256}}
    table = summary_table(replace(told, results=results), ENGLISH)
    return {"records", "frames", "frames lost", "frames bad"} & {row[0] for row in table.rows}


def test_nothing_is_counted_that_cannot_be() -> None:
    """A log has neither records nor frames, a bench without a link no frames; those that are due are counted at 0."""
    none = {"records": 0, "frames": 0, "frames_bad": 0, "frames_lost": 0}
    assert counted(none, "abc") == set()
    assert counted({**none, "records": 7}, "") == {"records"}
    assert counted({**none, "records": 7}, "abc") == {"records", "frames", "frames lost", "frames bad"}


def test_a_table_that_leads_stands_before_the_verdicts_and_once() -> None:
    leading = analysis.Table("Units tested", "", ["unit", "verdict"], [["U-1", "PASS"]], lead=True)
    told = modelled(wrong("cpu", 0.0, "U-1"), tables=(leading, replace(leading, title="Samples", lead=False)))
    sections = {one.name: [table.caption for table in one.tables] for one in sections_of(told, ENGLISH)}
    assert list(sections)[:3] == ["summary", "results", "verdicts"]
    assert (sections["results"], sections["explanations"]) == (["Units tested"], ["Samples"])
    assert Report(told).html().count("<caption><span>Units tested</span></caption>") == 1


def test_what_no_data_can_show_is_a_chapter_of_its_own() -> None:
    taken = {"code": "calibrator_gain", "taken_for_granted": "The gain is right.", "unseen": "Any size.",
             "effect": "One to one.", "shown_by": "A check standard.", "quantities": []}  # fmt: skip
    told = modelled(wrong("cpu", 0.0, "U-1"))
    assert "assumptions" not in {section.name for section in sections_of(told, ENGLISH)}
    named = replace(told, results={**told.results, "assumptions": [taken]})
    (section,) = [section for section in sections_of(named, ENGLISH) if section.name == "assumptions"]
    assert section.tables[0].rows == (("The gain is right.", "Any size.", "One to one.", "A check standard."),)


def stated(quantity: str, U: float | None, channel: int, sensor: float = 0.0, unit: str = "ppm") -> dict[str, Any]:
    common = {"common": {"standards": {}, "campaign": {SENSOR: sensor}}} if sensor else {}
    found = estimate_entry(quantity, unit, 1.0, U or 0.0, channel=channel)
    if U is None:
        return unsound(found)
    return found | {"std_uncertainty": U / 2.0, "coverage_factor": 2.0, **common}


PREDICTED = estimates_of({"estimates": [
    stated("dsf_n", 20.0, 1), stated("dsf_n", 22.0, 2), stated("dsf_n", 22.0, 3), stated("dsf_asymmetry", 0.6, 1),
    stated("bias", 8e-9, 1, unit="A"), stated("dsf_n_tc1", 0.1, 1),
]})  # fmt: skip
ACHIEVED = (
    stated("dsf_n", 20.2, 1), stated("dsf_n", 22.0, 2), stated("dsf_n", None, 3), stated("dsf_asymmetry", 1.0, 1, 0.4),
    stated("bias", 1.2e-8, 1, unit="A"), stated("dsf_n_tc1", 0.08, 1),
)  # fmt: skip


def test_what_is_not_as_predicted_is_named_with_what_explains_it_and_nothing_without_a_prediction() -> None:
    said, table = agreement_parts(modelled(*ACHIEVED, predicted=tuple(PREDICTED)), ENGLISH)
    assert table.rows[0] == ("Scale-factor error N", "ppm", "2 of 3", "20 to 22", "20 to 22", "1.00 to 1.01")
    assert table.rows[2] == ("Bias", "nA", "1", "8.0", "12", "1.50")
    by_sensor, by_nothing, below = said
    assert all(words in by_sensor for words in (SENSOR, "Scale-factor asymmetry (1 of 1, up to 1.67 times)"))
    assert "Bias (1 of 1, up to 1.50 times)" in by_nothing
    assert "coefficient of first order (1 of 1, down to 0.80 times)" in below
    assert agreement_parts(modelled(*ACHIEVED), ENGLISH) == ((), None)
    assert "agreement" not in {section.name for section in sections_of(modelled(*ACHIEVED), ENGLISH)}
    chapters = sections_of(modelled(*ACHIEVED, predicted=tuple(PREDICTED)), ENGLISH)
    (chapter,) = [section for section in chapters if section.name == "agreement"]
    assert (chapter.annex, len(chapter.paragraphs)) == ("A", 3)
