"""What a report says of a limit, of a value that is not stated, of a part of a campaign and of assumed sizes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bench.analysis import Table, limits_text
from bench.model.systems import is_size
from bench.report import RunStory, TemperatureTrace
from bench.report.estimate_tables import other_table
from bench.report.first.results import main_rows, shown_results
from bench.report.first.statements import environment
from bench.report.model import ReportModel
from bench.report.tables import analysis_tables, words_of
from bench.report.verdict_tables import assumption_table, doubt_paragraphs, overall_verdict, verdict_table

ENGLISH, KOREAN = words_of("en"), words_of("ko")
LOOSE = {"method": "augmented_loose"}


def offset(quantity: str, value: float | None, expanded: float = 0.0, **more: Any) -> dict[str, Any]:
    unit = "ppm" if quantity == "time_offset_drift" else "s"
    return {"quantity": quantity, "unit": unit, "value": value, "std_uncertainty": expanded / 1.96, "n": 1,
            "coverage_factor": 1.96, "expanded_uncertainty": expanded, "conditions": LOOSE, "dropped": 0, "limit": None,
            "verdict": "none", "quality": "sound" if value is not None else "refused", **more}  # fmt: skip


def model(*estimates: dict[str, Any], incomplete: bool = False, **more: Any) -> ReportModel:
    results = {"session": "s", "campaign": "time_sync", "method": "augmented_loose", "uut": {}, "quality": {},
               "provenance": {}, "estimates": list(estimates), "incomplete": incomplete}  # fmt: skip
    assumed = {"code": "one_place", "taken_for_granted": "t", "unseen": "u", "effect": "e", "shown_by": "s"}
    return ReportModel(title="T", results={**results, "assumptions": [assumed]}, **more)


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
    assert limits_text(limits, size=size) == text


def test_sizes_are_declared() -> None:
    declared = [name for name in ("time_offset_uncertainty", "stamps_difference") if is_size("egi_offset", name)]
    assert declared == ["time_offset_uncertainty"]
    assert is_size("rlg_lock_in", "alignment_time")
    assert not is_size("nobody's", "alignment_time")


def test_the_table_of_the_verdicts_tells_a_size_from_a_difference() -> None:
    judged = {"verdict": "pass", "conformance_probability": None}
    width = offset("time_offset_uncertainty", 7.5e-3, limit=10e-3, **judged)
    table = verdict_table(model(width, offset("stamps_difference", -3e-3, 8e-3, limit=5e-3, **judged)), ENGLISH)
    assert table is not None
    assert [row[3:5] for row in table.rows] == [("≤ 10", "ms"), ("± 5", "ms")]


def test_a_refused_value_has_no_unit() -> None:
    refused = offset("time_offset", None)
    told = model(refused, offset("time_offset_from_stamps", 9.7e-3, 2.8e-3))
    table = other_table(told, ENGLISH)
    assert table is not None
    assert [row[2:] for row in table.rows] == [("refused", "–"), ("9.7 ± 2.8", "ms")]
    shown = shown_results(model(refused, main=("time_offset",)), ENGLISH)
    assert shown.blocks[0].rows[0][0] == "Time offset"


def test_a_main_quantity_that_only_another_method_gives_is_shown() -> None:
    tight = offset("time_offset", 9.4e-3, 3.6e-3, conditions={"method": "augmented_tight"})
    drift = offset("time_offset_drift", -4.3, 1.1, conditions={"method": "stamps"})
    chosen = offset("time_offset", 6.6e-3, 7.5e-3)
    assert main_rows(model(tight, drift, chosen, main=("time_offset", "time_offset_drift"))) == [chosen, drift]


@pytest.mark.parametrize("words", [ENGLISH, KOREAN])
def test_a_unit_that_was_left_out_is_told_from_a_run_that_has_not_ended(words: Any) -> None:
    for left_out, key in ((False, "incomplete"), (True, "left_out")):
        told = model(incomplete=True, run=RunStory(left_out=left_out))
        assert overall_verdict(told, words) == ("none", words(f"verdicts.{key}"))
        assert doubt_paragraphs(told, words) == (words(f"doubt.{key}"),)
    assert doubt_paragraphs(model(run=RunStory(left_out=True)), words) == ()


def test_sizes_of_assumptions_say_what_they_were_worked_out_for() -> None:
    table = assumption_table(model(), ENGLISH)
    assert table is not None
    assert "a turn of 90 deg in 8 s at 100 m/s, whatever the motion was" in table.caption


@pytest.mark.parametrize(
    ("caption", "text"), [("all in ppm", "Of it. all in ppm."), ("", "Of it"), ("As said.", "Of it. As said.")]
)
def test_sentences_of_a_caption_end_with_a_full_stop(caption: str, text: str) -> None:
    assert analysis_tables([Table("Of it", caption, ["a"], [[1.0]])])[0].caption == text


def test_one_temperature_is_no_span() -> None:
    trace = TemperatureTrace(t_s=np.zeros(2), air_degC=np.array([22.9, 22.91]), unit_degC=np.array([23.1, 23.4]))
    assert environment(model(trace=trace), None, ENGLISH) == (
        "Air of the chamber: 22.9 °C. Item, by its own sensor: 23.1 to 23.4 °C."
    )
