"""What the tables of a report say: amounts, limits, what is refused, missing or not counted, and what was predicted."""

from dataclasses import replace
from typing import Any

import pytest
from report_sample import estimate_entry, small_model, unsound

from bench import analysis
from bench.analysis import documents, estimates_of
from bench.model.systems import is_size
from bench.report import Report
from bench.report.estimate_tables import channel_table, coverage_table, other_table, pivot_tables, value_text
from bench.report.first import first_page
from bench.report.first.results import main_rows
from bench.report.model import ReportModel
from bench.report.sections import prompt_table, sections_of, summary_table
from bench.report.tables import words_of
from bench.report.verdict_tables import agreement_parts, verdict_table
from bench.session.view import SessionView, model_of
from bench.systems.af_converter.wording import say

ENGLISH, KOREAN = words_of("en"), words_of("ko")
PLAIN: dict[str, Any] = {"session": "s", "campaign": "scale_factor", "uut": {}, "quality": {}, "provenance": {}}
SENSOR = say("component.sensor")


def model(*estimates: dict[str, Any], campaign: str = "scale_factor", **more: Any) -> ReportModel:
    return ReportModel(title="T", results={**PLAIN, "campaign": campaign, "estimates": list(estimates)}, **more)


def offset(quantity: str, value: float | None, expanded: float = 0.0, **more: Any) -> dict[str, Any]:
    unit = "ppm" if quantity == "time_offset_drift" else "s"
    found = estimate_entry(quantity, unit, 0.0, expanded, method="augmented_loose")
    return (unsound(found, "refused") if value is None else found | {"value": value}) | more


def wrong(item: str, count: float, unit: str) -> dict[str, Any]:
    verdict = "fail" if count else "pass"
    judged = {"limit": 0.0, "verdict": verdict, "conformance_probability": 0.0 if count else 1.0}
    return estimate_entry(f"{item}_wrong", "1", count, 0.0) | {"conditions": {"unit": unit}} | judged


@pytest.mark.parametrize(
    ("limits", "size", "text"),
    [
        ((-10.0, 10.0), False, "± 10"),
        ((-10.0, 10.0), True, "≤ 10"),
        ((4.0, 5.0), True, "4 to 5"),
        ((0.0, 0.0), True, "0"),
    ],
)
def test_what_cannot_be_negative_has_an_upper_limit(limits: tuple[float, float], size: bool, text: str) -> None:
    assert analysis.limits_text(limits, size=size) == text


def test_the_table_of_the_verdicts_tells_a_size_from_a_difference() -> None:
    declared = [name for name in ("time_offset_uncertainty", "stamps_difference") if is_size("egi_offset", name)]
    assert declared == ["time_offset_uncertainty"]
    assert not is_size("nobody's", "time_offset_uncertainty")
    judged = {"verdict": "pass", "conformance_probability": None}
    width = offset("time_offset_uncertainty", 7.5e-3, limit=10e-3, **judged)
    difference = offset("stamps_difference", -3e-3, 8e-3, limit=5e-3, **judged)
    table = verdict_table(model(width, difference, campaign="time_sync"), ENGLISH)
    assert [row[3:5] for row in table.rows] == [("≤ 10", "ms"), ("± 5", "ms")]


def test_the_unit_that_failed_stands_for_its_item_where_nothing_may_be_wrong() -> None:
    units = [wrong("memory", count, f"U-{number}") for number, count in enumerate((0.0, 2.0, 1.0))]
    table = verdict_table(model(*units), ENGLISH)
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
    table = prompt_table(model(prompts=(prompt,)), KOREAN)
    said = tuple(text.replace("\u00a0", " ") for text in table.rows[0][1:])
    assert said == ("Set to 65 °C?", allowed, answer, KOREAN("by.simulation"))


def test_a_value_without_uncertainty_has_four_digits_and_whole_numbers_all() -> None:
    (bare,) = estimates_of({"estimates": [estimate_entry("observability", "1", 0.000388125, 0.0)]})
    for value, shown in ((0.000388125, "0.0003881"), (521.454, "521.5"), (12345.0, "12345")):
        assert value_text(bare.model_copy(update={"value": value})) == shown


def test_a_refused_value_has_no_unit() -> None:
    told = model(offset("time_offset", None), offset("time_offset_from_stamps", 9.7e-3, 2.8e-3), campaign="time_sync")
    table = other_table(told, ENGLISH)
    assert [row[2:] for row in table.rows] == [("refused", "–"), ("9.7 ± 2.8", "ms")]


def test_a_main_quantity_that_only_another_method_gives_is_shown() -> None:
    tight = offset("time_offset", 9.4e-3, 3.6e-3, conditions={"method": "augmented_tight"})
    drift = offset("time_offset_drift", -4.3, 1.1, conditions={"method": "stamps"})
    chosen = offset("time_offset", 6.6e-3, 7.5e-3)
    told = model(tight, drift, chosen, campaign="time_sync", main=("time_offset", "time_offset_drift"))
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
    assert [table.rows for table in pivot_tables(model(*rows), ENGLISH)] == [
        (("1", "11.0 ± 1.0"), ("2", "21.0 ± 1.0")),
        (("1", "9.0 ± 1.0"), ("2", "19.0 ± 1.0")),
    ]
    by_channel = channel_table(model(*rows), ENGLISH)
    assert by_channel.rows == (("1", "6.0 ± 1.0", "4.0 ± 1.0"), ("2", "11.0 ± 1.0", "9.0 ± 1.0"))


def test_what_has_no_uncertainty_has_no_row_of_zeros_under_uncertainty() -> None:
    table = coverage_table(model(wrong("cpu", 0.0, "U-1"), estimate_entry("supply_voltage", "V", 5.0, 0.01)), ENGLISH)
    assert [row[0] for row in table.rows] == ["supply voltage"]


def counted(quality: dict[str, int], frame_sha256: str) -> set[str]:
    told = model(estimate_entry("bias", "A", 1.0, 0.1))
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
    told = model(wrong("cpu", 0.0, "U-1"), tables=(leading, replace(leading, title="Samples", lead=False)))
    sections = {one.name: [table.caption for table in one.tables] for one in sections_of(told, ENGLISH)}
    assert list(sections)[:3] == ["summary", "results", "verdicts"]
    assert (sections["results"], sections["explanations"]) == (["Units tested"], ["Samples"])
    assert Report(told).html().count("<caption><span>Units tested</span></caption>") == 1


def test_what_no_data_can_show_is_a_chapter_of_its_own() -> None:
    taken = {"code": "calibrator_gain", "taken_for_granted": "The gain is right.", "unseen": "Any size.",
             "effect": "One to one.", "shown_by": "A check standard.", "quantities": []}  # fmt: skip
    told = model(wrong("cpu", 0.0, "U-1"))
    assert "assumptions" not in {section.name for section in sections_of(told, ENGLISH)}
    named = replace(told, results={**told.results, "assumptions": [taken]})
    (section,) = [section for section in sections_of(named, ENGLISH) if section.name == "assumptions"]
    assert section.tables[0].rows == (("The gain is right.", "Any size.", "One to one.", "A check standard."),)


def test_what_is_odd_and_moves_nothing_is_a_note_of_the_report_as_of_the_results() -> None:
    seen = analysis.Evidence("odd", "It is odd.", 1.0, 1e-9, move=0.0)
    found = analysis.Analysis("scale_factor", "gls", {}, [], evidence=[seen], notes=["A note."])
    manifest = {"session": "s", "planned": {"prepare_s": 0.0}, "campaign": {"analysis": "scale_factor"}}
    made = model_of(SessionView(manifest, [], {}, ""), PLAIN, found)
    assert list(made.notes[:2]) == ["It is odd.", "A note."]


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


def test_what_is_not_as_predicted_is_named_with_the_error_that_explains_it() -> None:
    said, table = agreement_parts(model(*ACHIEVED, predicted=tuple(PREDICTED)), ENGLISH)
    assert table.rows[0] == ("Scale-factor error N", "ppm", "2 of 3", "20 to 22", "20 to 22", "1.00 to 1.01")
    assert table.rows[2] == ("Bias", "nA", "1", "8.0", "12", "1.50")
    by_sensor, by_nothing, below = said
    assert all(words in by_sensor for words in (SENSOR, "Scale-factor asymmetry (1 of 1, up to 1.67 times)"))
    assert "Bias (1 of 1, up to 1.50 times)" in by_nothing
    assert "coefficient of first order (1 of 1, down to 0.80 times)" in below


def test_without_a_prediction_there_is_no_such_chapter() -> None:
    assert agreement_parts(model(*ACHIEVED), ENGLISH) == ((), None)
    assert "agreement" not in {section.name for section in sections_of(model(*ACHIEVED), ENGLISH)}
    chapters = sections_of(model(*ACHIEVED, predicted=tuple(PREDICTED)), ENGLISH)
    (chapter,) = [section for section in chapters if section.name == "agreement"]
    assert (chapter.annex, len(chapter.paragraphs)) == ("A", 3)
