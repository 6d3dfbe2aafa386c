"""What a reader of a report meets behind its first page: amounts as people write them, words of one language, whole
tables, no page for the end alone, and what makes all of it uncertain on the first page.
"""

from __future__ import annotations

import io
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from report_sample import estimate, small_model

from bench import analysis
from bench.model.texts import told
from bench.model.titles import quantity_title
from bench.report import Report, RunStory
from bench.report.document import MOST_WHOLE, document_files
from bench.report.estimate_tables import channel_table, components_table, conditions_text, pivot_tables
from bench.report.first import first_page
from bench.report.model import ReportModel, Surrounding
from bench.report.run_tables import environment_table, prompt_table, provenance, standards_table, summary_table
from bench.report.sections import Section
from bench.report.tables import Table, named, pairs_table, role_of, words_of
from bench.report.verdict_tables import overall_verdict, verdict_table
from bench.session.view import SessionView, model_of
from bench.session.wording import say as of_session
from bench.systems.af_converter.wording import kind_name, say

ENGLISH, KOREAN = words_of("en"), words_of("ko")
ROWS = (63, 64)  # with the end in the flow of the text a page more
PLAIN: dict[str, Any] = {"session": "s", "campaign": "scale_factor", "uut": {}, "quality": {}, "provenance": {}}


def model(*estimates: dict[str, Any], **more: Any) -> ReportModel:
    return ReportModel(title="T", results={**PLAIN, "estimates": list(estimates)}, **more)


def answered(value: float, unit: str, **bounds: float) -> tuple[str, ...]:
    prompt = {"step": 1, "text": "Set to 65 degC?", "value": value, "unit": unit, "by": "simulation", **bounds}
    table = prompt_table(model(prompts=(prompt,)), KOREAN)
    assert table is not None
    return tuple(text.replace("\u00a0", " ") for text in table.rows[0][1:])


@pytest.mark.parametrize(
    ("value", "unit", "bounds", "allowed", "answer"),
    [
        (0.5, "ohm", {"high": 0.5}, "≤ 0.5 Ω", "0.5 Ω"),
        (2.5e6, "ohm", {"low": 1e6}, "≥ 1 MΩ", "2.5 MΩ"),
        (360_000.0, "s", {"low": 3600.0, "high": 3.6e7}, "≥ 1 h, ≤ 10\u202f000 h", "100 h"),
        (90.0, "s", {}, "–", "90 s"),
        (-23.0, "degC", {}, "–", "−23 °C"),
        (3.0, "", {}, "–", "3"),
    ],
)
def test_an_answer_is_an_amount(value: float, unit: str, bounds: dict[str, float], allowed: str, answer: str) -> None:
    assert answered(value, unit, **bounds) == ("Set to 65 °C?", allowed, answer, KOREAN("by.simulation"))


def test_components_are_in_the_language_of_the_reader() -> None:
    part = {"kind": kind_name("gyro"), "quantity": "dsf_n, bias", "component": say("component.gain"),
            "distribution": say("budget.normal"), "std_uncertainty_ppm": 10.04}  # fmt: skip
    table = components_table(model(components=(part,)), KOREAN)
    assert table is not None
    assert table.rows == (("자이로스코프", "환산계수 오차 N, 바이어스", "교정기 이득, 모든 행에 공통", "정규", "10"),)


def test_a_code_name_is_found_before_a_particle() -> None:
    def title(name: str) -> str:
        return quantity_title("scale_factor", name, "ko")

    assert named("1 ppm은 dsf_n의 1 ppm, tc2의 2 %", title) == "1 ppm은 환산계수 오차 N의 1 ppm, 2차 온도 계수의 2 %"


def test_roles_places_and_conditions_have_words() -> None:
    rooms = (Surrounding("logger 101", np.zeros(1), np.zeros(1), True), Surrounding("own 7", np.zeros(1), np.zeros(1)))
    standards = {"rail_dmm": {"model": "34401A"}, "my_clock": {"model": "X"}}
    told = model(standards=standards, run=RunStory(surroundings=rooms))
    places, register = environment_table(told, KOREAN), standards_table(told, KOREAN)
    assert places is not None
    assert register is not None
    assert [row[0] for row in places.rows] == ["실험실 공기 (기록계 101)", "own 7"]
    assert [row[0] for row in register.rows] == ["my clock", "전원선 멀티미터"]
    where = {"temperature_degC": 20.0, "repeat": 1, "compensation": say("compensation.sensor")}
    assert conditions_text(KOREAN, where) == "설정 온도 20\u00a0°C, 반복 1, 보상 장치 센서에 대한 다항식"


def test_names_of_code_stay_whole_and_others_are_words() -> None:
    pairs = provenance({"simulated": True, "plan_sha256": "0", "links": {"port_a": "f"}}, ENGLISH)
    table = pairs_table("c", ("a", "b"), pairs)
    assert table is not None
    assert table.rows == (("simulated", "yes"), ("SHA-256 of the plan", "0"), ("links.port_a", "f"))


def test_the_rule_is_told_in_words() -> None:
    judged = estimate("dsf_n", "ppm", 1.0, 0.5, channel=1) | {"limit": 2.0, "verdict": "pass"}
    ruled = replace(model(judged), results={**PLAIN, "estimates": [judged], "decision_rule": "guard_band"})
    table = verdict_table(ruled, ENGLISH)
    assert table is not None
    assert "Decision rule: guarded acceptance." in table.caption


def test_the_first_page_says_that_a_run_has_not_ended_and_that_its_recording_is_damaged() -> None:
    whole = small_model()
    cut = replace(whole, results={**whole.results, "incomplete": True}, run=replace(whole.run, damage=3))
    assert first_page(whole, None, ENGLISH).doubt == ()
    said = first_page(cut, None, ENGLISH).doubt
    assert said[0] == ENGLISH("doubt.incomplete")
    assert "at 3 places" in said[1]
    unjudged = replace(cut, results={**cut.results, "estimates": []})
    assert overall_verdict(unjudged, ENGLISH) == ("none", ENGLISH("verdicts.incomplete"))


def test_short_tables_stay_whole() -> None:
    tables = tuple(
        Table("c", ("n", "value"), (("1", "2"),) * count, prose=prose)
        for count, prose in ((MOST_WHOLE, False), (MOST_WHOLE + 1, False), (3, True))
    )
    files = document_files(model(), [Section("x", "X", tables=tables)], ENGLISH)
    (chapter,) = json.loads(files["report.json"])["chapters"]
    assert [table["whole"] for table in chapter["tables"]] == [True, False, False]


def body_of(page: bytes) -> np.ndarray[Any, Any]:
    """Return where a page is dark between its header and its foot."""
    grey = imread(io.BytesIO(page))[..., :3].mean(axis=2)
    return np.asarray(grey[int(0.06 * len(grey)) : int(0.9 * len(grey))] < 0.6)


@pytest.mark.parametrize("rows", ROWS)
def test_no_page_is_for_the_end_alone(rows: int) -> None:
    """Tables that end just before the foot of a page."""
    readings = analysis.Table("Readings", "", ["n", "value"], [[number, 0] for number in range(rows)])
    pages = Report(ReportModel(title="T", results={**PLAIN, "estimates": []}, tables=(readings,))).pages(40.0)
    assert body_of(pages[-1]).any(axis=1).sum() > 5


def test_what_is_odd_and_moves_nothing_is_a_note_of_the_report_as_of_the_results() -> None:
    seen = analysis.Evidence("odd", "It is odd.", 1.0, 1e-9, move=0.0)
    found = analysis.Analysis("scale_factor", "gls", {}, [], evidence=[seen], notes=["A note."])
    manifest = {"session": "s", "planned": {"prepare_s": 0.0}, "campaign": {"analysis": "scale_factor"}}
    made = model_of(SessionView(manifest, [], {}, ""), PLAIN, found)
    assert list(made.notes[:2]) == ["It is odd.", "A note."]


def test_what_is_not_sound_is_said_in_the_language_of_the_reader() -> None:
    unsound = {"quality": "doubtful", "reasons": [], "expanded_uncertainty": None, "std_uncertainty": None}
    doubtful = estimate("bias", "nA", 3.0, 1.0, item="x") | unsound
    refused = estimate("random_walk", "nA", 3.0, 1.0, item="x") | unsound | {"quality": "refused", "value": None}
    page = Report(model(doubtful, refused), "ko").html()
    assert "<td>3 (의심)</td>" in page
    assert "<td>기각</td>" in page


def test_values_that_a_further_condition_tells_apart_all_stand_in_the_tables() -> None:
    """The leakage of a switch is known for both polarities; of equal channel and temperature none may hide another."""
    at = [(channel, polarity) for channel in (1, 2) for polarity in (1, -1)]
    leaks = [
        estimate(
            "switch_leakage",
            "nA",
            10.0 * channel + polarity,
            1.0,
            channel=channel,
            temperature_degC=20.0,
            polarity=polarity,
        )
        for channel, polarity in at
    ]
    once = [
        estimate("thermal_lag", "min", 5.0 * channel + polarity, 1.0, channel=channel, polarity=polarity)
        for channel, polarity in at
    ]
    told = model(*leaks, *once)
    tables = pivot_tables(told, ENGLISH)
    assert [table.caption.partition(":")[0] for table in tables] == [
        f"Leakage current of the open switch, polarity {sign}1 / nA" for sign in ("", "−")
    ]
    assert [table.rows for table in tables] == [
        (("1", "11.0 ± 1.0"), ("2", "21.0 ± 1.0")),
        (("1", "9.0 ± 1.0"), ("2", "19.0 ± 1.0")),
    ]
    by_channel = channel_table(told, ENGLISH)
    assert by_channel is not None
    assert by_channel.rows == (("1", "6.0 ± 1.0", "4.0 ± 1.0"), ("2", "11.0 ± 1.0", "9.0 ± 1.0"))


def counted(quality: dict[str, int], frame_sha256: str) -> set[str]:
    told = model(estimate("bias", "A", 1.0, 0.1))
    results = {**told.results, "quality": quality, "provenance": {"frame_sha256": frame_sha256}}
    table = summary_table(replace(told, results=results), ENGLISH)
    assert table is not None
    return {"records", "frames", "frames lost", "frames bad"} & {row[0] for row in table.rows}


def test_nothing_is_counted_that_cannot_be() -> None:
    """A log has neither records nor frames, a bench without a link no frames; those that are due are counted at 0."""
    none = {"records": 0, "frames": 0, "frames_bad": 0, "frames_lost": 0}
    assert counted(none, "abc") == set()
    assert counted({**none, "records": 7}, "") == {"records"}
    assert counted({**none, "records": 7}, "abc") == {"records", "frames", "frames lost", "frames bad"}


def test_what_a_stopped_run_left_is_said_in_korean() -> None:
    said = told(of_session("segment.no_end", name="session.0001.mcap"), "ko")
    assert said.startswith("session.0001.mcap의 끝")
    assert [role_of(KOREAN, f"lock_in_{number}") for number in (1, 2)] == ["록인 증폭기 1", "록인 증폭기 2"]
