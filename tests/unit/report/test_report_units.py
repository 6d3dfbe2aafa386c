"""Reports of several units, and the fixed texts of a report."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_sample import estimate, small_model

import bench.report
from bench.analysis import Figure, Table, series
from bench.model.texts import Texts, languages
from bench.report import Report, TemperatureTrace, tables
from bench.report.document import document_files
from bench.report.estimate_tables import across_tables, conditions_text, coverage_table, other_table, value_text
from bench.report.model import Bar, ReportModel, Timetable
from bench.report.plots.figures import timetable_picture
from bench.report.plots.graphs import analysis_pictures
from bench.report.sections import sections_of
from bench.report.sheet import ROOM_pt, sheets
from bench.report.tables import FOLDER, words_of
from bench.report.verdict_tables import verdict_table

WORDS = words_of("en")
SOURCES = sorted(path for path in Path(bench.report.__file__).parent.rglob("*.py") if path.parent.name != "dcc")
KEYS = words_of("en").all


def of_unit(quantity: str, unit: str, value: float, expanded: float, serial: str, **conditions: Any) -> dict[str, Any]:
    made = estimate(quantity, unit, value, expanded, **conditions)
    return made | {"conditions": {"unit": serial, **made["conditions"]}}


def wrong(item: str, count: float, unit: str) -> dict[str, Any]:
    verdict = "fail" if count else "pass"
    judged = {"limit": 0.0, "verdict": verdict, "conformance_probability": 0.0 if count else 1.0}
    return of_unit(f"{item}_wrong", "1", count, 0.0, unit) | judged


def model_of(*estimates: dict[str, Any], **more: Any) -> ReportModel:
    model = small_model()
    return replace(model, results={**model.results, "estimates": list(estimates)}, **more)


def test_the_unit_that_failed_stands_for_its_item_where_nothing_may_be_wrong() -> None:
    units = [wrong("memory", count, f"U-{number}") for number, count in enumerate((0.0, 2.0, 1.0))]
    table = verdict_table(model_of(*units), WORDS)
    assert table is not None
    row = dict(zip(table.headers, table.rows[0], strict=True))
    assert row["worst: value ± U"] == "2"
    assert row["conformance"] == "–"  # no uncertainty, no probability
    assert row["verdicts"] == "2 fail, 1 pass"


def test_verdicts_have_a_column_of_channels_only_where_there_are_channels() -> None:
    table = verdict_table(model_of(wrong("cpu", 0.0, "U-1")), WORDS)
    assert table is not None
    assert "channel" not in table.headers
    assert table.stub == 1
    judged = estimate("dsf_n", "ppm", 1.0, 0.1, channel=3) | {"limit": 2.0, "verdict": "pass"}
    table = verdict_table(model_of(judged), WORDS)
    assert table is not None
    assert table.headers[1] == "channel"
    assert table.rows[0][1] == "3"


def test_units_stand_side_by_side_three_to_a_table_with_their_measure() -> None:
    estimates = [
        of_unit(quantity, "V", 5.0 + number, 0.001, f"U-{number}", role="supply")
        for number in range(6)
        for quantity in ("supply_voltage", "rail_voltage")
    ]
    model = model_of(*estimates)
    first, second = across_tables(model, WORDS)
    assert first.headers[2:] == ("unit", "U-0", "U-1", "U-2")
    assert second.headers[3:] == ("U-3", "U-4", "U-5")
    assert second.caption == f"{first.caption} (continued)"
    assert first.rows[0] == ("supply voltage", "role supply", "V", *(f"{5 + n}.0000 ± 0.0010" for n in range(3)))
    assert other_table(model, WORDS) is None


def test_conditions_that_all_other_results_share_are_said_once() -> None:
    walks = [estimate("angle_random_walk", "deg/√h", 0.1, 0.01, method=name, clock_Hz=20e6) for name in ("a", "b")]
    table = other_table(model_of(*walks), WORDS)
    assert table is not None
    assert table.caption.endswith("In all of them: clock 20\u00a0MHz.")
    assert [row[1] for row in table.rows] == ["method a", "method b"]
    table = other_table(model_of(walks[0]), WORDS)
    assert table is not None
    assert "In all" not in table.caption
    assert table.rows[0][1] == "method a, clock 20\u00a0MHz"


def test_a_matrix_is_set_as_one_and_the_kind_of_a_sensor_is_said() -> None:
    matrix = [
        estimate("accel_matrix", "1", 10.0 * i + j, 0.1, kind="accelerometer", row=row, column=column)
        for i, row in enumerate("xyz")
        for j, column in enumerate("xyz")
    ]
    (table,) = across_tables(model_of(*matrix), WORDS)
    assert table.headers[3:] == ("x", "y", "z")
    assert [row[1] for row in table.rows] == [f"accelerometer, row {row}" for row in "xyz"]
    assert table.rows[2][3:] == ("20.00 ± 0.10", "21.00 ± 0.10", "22.00 ± 0.10")


@pytest.mark.parametrize(
    ("campaign", "conditions", "said"),
    [
        (
            "magnetometer",
            {"kind": "magnetometer", "method": "ellipse", "roll_deg": 45.0},
            "자력계, 방법 타원, 롤 45 deg",
        ),
        ("fog_north", {"item": "test", "head_deg": 30.0, "place": "mark"}, "항목 시험, 분할대 30 deg, 장소 표점"),
        ("time_sync", {"of": "variance of the offset", "observable": True}, "대상 시각 차의 분산, 관측 가능 예"),
        ("rlg_lock_in", {"clock_Hz": 1e8, "method": "raw"}, "시계 100 MHz, 방법 보상 없음"),
        ("gnc_unit_test", {"unit": "GNC-01", "kind": "accel"}, "장치 GNC-01, 가속도계"),
        ("of_a_lab", {"level_V": 8.0, "kind": "gyro"}, "level 8 V, 자이로스코프"),
    ],
)
def test_conditions_are_in_words_of_the_system_and_the_language(
    campaign: str, conditions: dict[str, Any], said: str
) -> None:
    assert conditions_text(words_of("ko"), conditions, campaign).replace("\u00a0", " ") == said


def test_units_of_a_second_table_are_not_continued_twice() -> None:
    units = [of_unit("supply_voltage", "V", 5.0, 0.001, f"U-{number}") for number in range(4)]
    _, second = across_tables(model_of(*units), WORDS)
    assert second.caption.count("(continued)") == 1
    model = model_of(*units)
    (chapter,) = [
        each
        for each in json.loads(document_files(model, sections_of(model, WORDS), WORDS)["report.json"])["chapters"]
        if each["title"] == "Other results"
    ]
    assert [table["continued"].count("(continued)") for table in chapter["tables"]] == [1, 1]


def test_a_korean_word_and_a_unit_stay_whole_in_a_cell() -> None:
    (sheet,) = sheets(tables.Table("", ("랜덤 워크", "deg/h"), (("1.91 ± 0.20 악화", "3 deg/h"),)), ROOM_pt)
    assert sheet.table.rows[0][0].endswith("악\u2060화")
    assert sheet.table.rows[0][1].endswith("deg/\u2060h")


def test_what_has_no_uncertainty_has_no_row_of_zeros_under_uncertainty() -> None:
    counted, measured = wrong("cpu", 0.0, "U-1"), of_unit("supply_voltage", "V", 5.0, 0.01, "U-1")
    table = coverage_table(model_of(counted, measured), WORDS)
    assert table is not None
    assert [row[0] for row in table.rows] == ["supply voltage"]


def test_a_table_that_leads_stands_before_the_verdicts_and_once() -> None:
    leading = Table("Units tested", "", ["unit", "verdict"], [["U-1", "PASS"]], lead=True)
    other = replace(leading, title="Samples", lead=False)
    model = model_of(wrong("cpu", 0.0, "U-1"), tables=(leading, other))
    sections = {one.name: [table.caption for table in one.tables] for one in sections_of(model, WORDS)}
    assert list(sections)[:3] == ["summary", "results", "verdicts"]
    assert sections["results"] == ["Units tested"]
    assert sections["explanations"] == ["Samples"]
    assert Report(model).html().count("<caption><span>Units tested</span></caption>") == 1


def test_what_no_data_can_show_is_a_chapter_of_its_own() -> None:
    taken = {"code": "calibrator_gain", "taken_for_granted": "The gain is right.", "unseen": "Any size.",
             "effect": "One to one.", "shown_by": "A check standard.", "quantities": []}  # fmt: skip
    model = model_of(wrong("cpu", 0.0, "U-1"))
    assert "assumptions" not in {section.name for section in sections_of(model, WORDS)}
    named = replace(model, results={**model.results, "assumptions": [taken]})
    (section,) = [section for section in sections_of(named, WORDS) if section.name == "assumptions"]
    assert section.tables[0].rows == (("The gain is right.", "Any size.", "One to one.", "A check standard."),)


def test_a_short_cell_of_words_is_not_broken() -> None:
    words = Table("T", "", ["a", "b"], [["x" * 50, "not tested"]], prose=True)
    assert '<td class="short">not tested</td>' in Report(model_of(tables=(words,))).html()


@pytest.mark.parametrize("trace", [TemperatureTrace(), TemperatureTrace(*(np.full(9, np.nan),) * 3)])
def test_no_axis_of_temperature_without_a_temperature(trace: TemperatureTrace) -> None:
    picture = timetable_picture(Timetable((Bar("record", "measure", 0.0, 60.0),)), trace, WORDS)
    assert picture is not None
    assert "Temperature" not in picture.svg
    assert "emperature" not in picture.description
    assert timetable_picture(Timetable(), trace, WORDS) is None


def test_a_circle_looks_like_one() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 13)
    round_it = series("after", np.cos(angle), np.sin(angle), "points")
    drawn = Figure("X-Y", "Order: +x, -1.", "X, mgauss", "Y", [round_it])

    def spans(figure: Figure) -> tuple[float, float]:
        (picture,) = analysis_pictures([figure])
        found = re.findall(r'<use [^>]*x="([\d.]+)" y="([\d.]+)" style="fill', picture.svg)[-13:]
        x, y = np.array(found, dtype=float).T
        return float(np.ptp(x)), float(np.ptp(y))

    wide, high = spans(drawn)
    assert wide > 1.5 * high
    wide, high = spans(replace(drawn, equal=True))
    assert wide == pytest.approx(high, rel=1e-3)
    (picture,) = analysis_pictures([drawn])
    assert "X / mgauss" in picture.svg
    assert picture.caption == "Order: +x, −1."


def called(tree: ast.AST) -> Iterator[ast.expr]:
    """First arguments of ``words(...)`` and ``words.all.get(...)``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and node.args and ast.unparse(node.func) in ("words", "words.all.get"):
            yield node.args[0]


def patterns(expression: ast.expr) -> list[str]:
    """Regular expressions of the keys an expression can give; none for a plain variable."""
    if isinstance(expression, ast.IfExp):
        return patterns(expression.body) + patterns(expression.orelse)
    if isinstance(expression, ast.Constant):
        return [re.escape(str(expression.value))]
    if isinstance(expression, ast.JoinedStr):
        parts = [re.escape(part.value) if isinstance(part, ast.Constant) else r"[\w.-]*" for part in expression.values]
        return ["".join(parts)]
    return []


TREES = [ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES]
WANTED = {pattern for tree in TREES for one in called(tree) for pattern in patterns(one)}
LITERAL = {node.value for tree in TREES for node in ast.walk(tree) if isinstance(node, ast.Constant)}
TEMPLATE = (FOLDER / "templates" / "report.html.j2").read_text(encoding="utf-8")


def test_there_are_texts() -> None:
    assert len(KEYS) > 100
    assert len(WANTED) > 50
    assert languages(FOLDER)[0] == "en"


def test_no_text_is_missing() -> None:
    assert [one for one in sorted(WANTED) if not any(re.fullmatch(one, key) for key in KEYS)] == []
    assert [key for key in re.findall(r"words\('([^']+)'\)", TEMPLATE) if key not in KEYS] == []


def test_no_text_is_left_over() -> None:
    used = "|".join(sorted(WANTED))
    left = [key for key in KEYS if not re.fullmatch(used, key) and key not in LITERAL and f"'{key}'" not in TEMPLATE]
    assert left == []


def test_language_of_the_page() -> None:
    model = ReportModel(title="T", results={"session": "s", "estimates": []})
    assert '<html lang="en">' in Report(model).html()


def test_another_language_needs_no_code(tmp_path: Path) -> None:
    (tmp_path / "texts").mkdir()
    (tmp_path / "texts" / "en.json").write_text((FOLDER / "texts" / "en.json").read_text())
    (tmp_path / "texts" / "ko.json").write_text('{"section.summary": "요약"}')
    words = Texts(tmp_path, "ko")
    assert words("section.summary") == "요약"
    assert words("section.quality") == KEYS["section.quality"]


def test_a_value_without_uncertainty_has_four_digits_and_whole_numbers_all() -> None:
    bare = estimate("observability", "1", 0.000388125, 0.1)
    for value, shown in ((0.000388125, "0.0003881"), (521.454, "521.5"), (12345.0, "12345")):
        assert value_text(bare | {"value": value, "expanded_uncertainty": None}) == shown
