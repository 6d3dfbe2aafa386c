"""study.json and its page from results made by formula: every tolerance can fail, and nothing else fails with it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sync_study_results import changed, made_results

from bench.report.document import study_html
from bench.systems.time_sync.study.document import study_chapters, study_document, study_json
from bench.systems.time_sync.study.study import (
    AUGMENTED,
    BASE,
    ERRORLESS,
    LOOSE,
    TIGHT,
    UNAUGMENTED,
    RECOVERED_ms,
    Results,
    StudyOptions,
)

OPTIONS = StudyOptions()
SOUND = made_results(OPTIONS)


def failed(found: Results, options: StudyOptions = OPTIONS) -> set[str]:
    document = study_document(options, found, "test")
    return {one["quantity"] for one in document["estimates"] if one["verdict"] == "fail"}


def scaled(name: str, factor: float, axis: int = 0) -> Callable[[Any, Any], Any]:
    def change(arrays: Any, result: Any) -> Any:
        values = arrays[name].copy()
        values[..., axis] *= factor
        return {**arrays, name: values}

    return change


def times(factor: float) -> Callable[[Any, Any], Any]:
    return lambda values, _: values * factor


def by_offset(slope: float, augmented: bool) -> Callable[[Any, Any], Any]:
    """Add something that grows with the offset, to the groups with or without the state."""

    def change(values: Any, result: Any) -> Any:
        return values + np.array([[slope * one.offset_s * (one.augmented == augmented)] for one in result.groups])

    return change


def test_what_is_due_passes() -> None:
    document = study_document(OPTIONS, SOUND, "test")
    verdicts = [one["verdict"] for one in document["estimates"]]
    assert failed(SOUND) == set()
    assert verdicts.count("pass") > 100


def test_every_estimate_says_of_what_it_is() -> None:
    document = study_document(OPTIONS, SOUND, "test")
    said = [(one["quantity"], json.dumps(one["conditions"], sort_keys=True)) for one in document["estimates"]]
    assert [one for one in said if said.count(one) > 1] == []
    offsets_ms = {*OPTIONS.offsets_ms, *RECOVERED_ms}
    for one in document["estimates"]:
        where = one["conditions"]
        assert type(where.get("offset_ms", 0.0)) is float
        assert where.get("offset_ms", 0.0) in offsets_ms
        assert where.get("filter", AUGMENTED) in {AUGMENTED, UNAUGMENTED, ERRORLESS}
        assert where.get("noise", BASE) in {BASE, TIGHT, LOOSE}
    paired = [one["conditions"] for one in document["estimates"] if one["quantity"] == "shift_unexplained_rms"]
    assert {(one["filter"], one["offset_ms"]) for one in paired} == {
        (name, offset_ms) for name in (AUGMENTED, UNAUGMENTED) for offset_ms in OPTIONS.offsets_ms
    }


SPOILT = {
    "Table 5, 0 ms": ("flight", "linear", {"rms": scaled("position_m", 2.0)}, {"position_rms"}),
    "sign of the lag": ("flight", "linear", {"mean": scaled("position_m", -1.0)}, {"position_mean"}),
    "Table 6": ("flight", "acceleration", {"rms": scaled("velocity_m_s", 1.2)}, {"velocity_rms_max"}),
    "Table 7": ("flight", "turn", {"rms": scaled("attitude_deg", 1.2, axis=2)}, {"yaw_rms_max"}),
    "linear motion converges": ("flight", "linear", {"offset_rms_s": times(0.5)}, {"offset_error_rms"}),
    "linear motion is believed": (
        "flight", "linear", {"offset_nees": times(5.0)}, {"offset_nees", "offset_nees_over_offsets"},
    ),
    "linear motion has seen the truth": ("flight", "linear", {"offset_nees": times(0.1)}, {"offset_nees_over_offsets"}),
    "turn does not find it": ("flight", "turn", {"offset_rms_s": times(4.0)}, {"offset_error_rms"}),
    "sign of the estimate": ("flight", "turn", {"offset_mean_s": times(10.0)}, {"offset_error_mean"}),
    "over-confident": (
        "image", "sar",
        {"flight": lambda flight, _: type(flight)(**{**vars(flight), "offset_nees": 8.0 * flight.offset_nees})},
        {"offset_nees"},
    ),
    "shift of another sign": (
        "image", "sar",
        {"azimuth_shift_m": times(-1.0), "predicted_m": times(-1.0)}, {"shift_over_lag"},
    ),
    "shift said, not seen": ("image", "sar", {"azimuth_shift_m": by_offset(20.0, False)}, {"shift_unexplained_rms"}),
    "compensation fails": (
        "image", "sar",
        {"azimuth_shift_m": by_offset(-250.0, True), "predicted_m": by_offset(-250.0, True)}, {"shift_against_none"},
    ),
    "resolution": ("image", "sar", {"azimuth_resolution_m": by_offset(-0.3, False)}, {"resolution_ratio"}),
    "compensated resolution": ("image", "sar", {"azimuth_resolution_m": by_offset(0.1, True)}, {"resolution_ratio"}),
    "side lobes": ("image", "sar", {"islr_dB": by_offset(-50.0, False)}, {"islr_against_none"}),
    "compensated side lobes": ("image", "sar", {"islr_dB": by_offset(5.0, True)}, {"islr_against_none"}),
    "strapdown": ("ideal", "turn", {"position_m": lambda *_: 1.1e-3}, {"navigation_error"}),
    "ideal resolution": ("ideal", "turn", {"resolution_m": times(1.02)}, {"ideal_resolution"}),
    "ideal range": ("ideal", "turn", {"range_resolution_m": times(1.02)}, {"ideal_range_resolution"}),
    "ideal side lobe": ("ideal", "turn", {"pslr_dB": times(1.02)}, {"ideal_pslr"}),
    "ideal side lobes": ("ideal", "turn", {"islr_dB": times(0.9)}, {"ideal_islr"}),
}  # fmt: skip


@pytest.mark.parametrize("name", SPOILT)
def test_every_tolerance_can_fail(name: str) -> None:
    kind, manoeuvre, new, due = SPOILT[name]
    assert failed(changed(SOUND, kind, manoeuvre, **new)) == due


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("manoeuvre", "name", "axis", "due"),
    [
        ("stationary", "position_m", 1, "position_rms_ratio"),
        ("acceleration", "gyro_bias_deg_h", 1, "gyro_bias_rms_ratio"),
        ("turn", "accel_bias_ug", 2, "accel_bias_rms_ratio"),
    ],
)
def test_what_the_offset_must_not_reach(manoeuvre: str, name: str, axis: int, due: str, sign: float) -> None:
    def change(arrays: Any, result: Any) -> Any:
        values = arrays[name].copy()
        values[..., axis] *= 1.0 + sign * np.array([one.offset_s for one in result.groups])
        return {**arrays, name: values}

    assert failed(changed(SOUND, "flight", manoeuvre, rms=change)) == {due}


def test_few_runs_or_a_short_flight_are_not_judged() -> None:
    for options in (StudyOptions(runs=49), StudyOptions(quick=True)):
        document = study_document(options, made_results(options), "test")
        judged = {one["quantity"] for one in document["estimates"] if one["verdict"] != "none"}
        assert all(name.startswith(("ideal", "navigation")) for name in judged)
        assert "nothing but the case without errors is judged" in document["notes"][0]


def test_the_document_is_canonical_and_keeps_the_raw_cuts() -> None:
    text = study_json(study_document(OPTIONS, SOUND, "test"))
    document = json.loads(text)
    assert text == study_json(study_document(OPTIONS, made_results(OPTIONS), "test"))
    assert {one["filter"] for one in document["cuts"]} == {"none", "unaugmented", "augmented"}
    assert all(len(one["at_m"]) == len(one["real"]) == len(one["imaginary"]) for one in document["cuts"])
    limits = [one["limit"] for one in document["estimates"] if one["verdict"] != "none"]
    assert all(isinstance(limit, float) for limit in limits)


def chapters_of(found: Results, options: StudyOptions = OPTIONS) -> dict[str, Any]:
    chapters = study_chapters(options, study_document(options, found, "test"), found)
    return {chapter.name: chapter for chapter in chapters}


def rows_of(chapters: dict[str, Any], title: str) -> list[list[str]]:
    found = [table for chapter in chapters.values() for table in chapter.tables if table.title == title]
    rows: list[list[str]] = found[0].rows
    return rows


def test_the_page_has_every_figure_and_table_of_the_paper() -> None:
    document = study_document(OPTIONS, SOUND, "test")
    page = study_html(document, study_chapters(OPTIONS, document, SOUND), "test")
    captions = re.findall(r"<figcaption>Figure (\d+)\.", page)
    assert [int(number) for number in captions] == [3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16]
    for name in ("Table 5", "Table 6", "Table 7", "What the paper does not state", "What cannot be matched"):
        assert name in page
    assert "0.3219" in page
    assert "SIMULATED" in page
    assert page.count("<image ") == 4  # two chips of each filter


def test_the_page_says_what_failed_first() -> None:
    chapters = chapters_of(changed(SOUND, "ideal", "turn", pslr_dB=times(1.02)))
    rows = rows_of(chapters, "Tolerances")
    assert [row[0] for row in rows if row[-1] == "fail"] == ["ideal pslr"] == [rows[0][0]]


def test_the_paper_stands_beside_ours() -> None:
    rows = rows_of(chapters_of(SOUND), "Table 7")
    assert [row[:2] for row in map(list, rows)] == [
        ["0", "0.01347"],
        ["10", "0.04958"],
        ["20", "0.09429"],
        ["30", "0.1396"],
    ]


def test_offsets_of_ones_own_have_no_paper_value() -> None:
    options = StudyOptions(offsets_ms=(-7.5, 0.0))
    found = made_results(options)
    assert failed(found, options) == set()
    assert [row[1] for row in rows_of(chapters_of(found, options), "Table 5")] == ["–", "0.3219"]
