"""The chapter on predicted and achieved uncertainties, in both languages, from estimates made up here."""

from __future__ import annotations

from typing import Any

from bench.model.texts import Said
from bench.report.agreement_tables import agreement_parts
from bench.report.model import ReportModel
from bench.report.sections import sections_of
from bench.report.tables import words_of
from bench.systems.af_converter.wording import say

ENGLISH, KOREAN = words_of("en"), words_of("ko")
SENSOR = say("component.sensor")


def entry(quantity: str, U: float | None, channel: int, sensor: float = 0.0, unit: str = "ppm") -> dict[str, Any]:
    common = {"common": {"standards": {}, "campaign": {SENSOR: sensor}}} if sensor else {}
    return {"quantity": quantity, "unit": unit, "value": 1.0, "conditions": {"channel": channel}, "n": 1, "dropped": 0,
            "std_uncertainty": None if U is None else U / 2.0, "coverage_factor": 2.0, "expanded_uncertainty": U,
            "limit": None, "verdict": "none", **common}  # fmt: skip


PREDICTED = (
    entry("dsf_n", 20.0, 1), entry("dsf_n", 22.0, 2), entry("dsf_n", 22.0, 3), entry("dsf_asymmetry", 0.6, 1),
    entry("bias", 8e-9, 1, unit="A"), entry("dsf_n_tc1", 0.1, 1),
)  # fmt: skip
ACHIEVED = (
    entry("dsf_n", 20.2, 1), entry("dsf_n", 22.0, 2), entry("dsf_n", None, 3), entry("dsf_asymmetry", 1.0, 1, 0.4),
    entry("bias", 1.2e-8, 1, unit="A"), entry("dsf_n_tc1", 0.08, 1),
)  # fmt: skip


def model(*predicted: dict[str, Any]) -> ReportModel:
    results = {"session": "s", "campaign": "scale_factor", "method": "gls", "uut": {}, "quality": {},
               "provenance": {}, "estimates": list(ACHIEVED)}  # fmt: skip
    return ReportModel(title="T", results=results, predicted=predicted)


def test_the_table_and_the_sentences() -> None:
    said, table = agreement_parts(model(*PREDICTED), ENGLISH)
    assert table is not None
    assert "more than 10\u00a0% and by more than chance explains (99.9\u00a0% of a chi-square" in table.caption
    assert table.headers[3:] == ("U predicted", "U achieved", "achieved / predicted")
    assert table.rows[0] == ("Scale-factor error N", "ppm", "2 of 3", "20 to 22", "20 to 22", "1.00 to 1.01")
    assert table.rows[2] == ("Bias", "nA", "1", "8.0", "12", "1.50")
    assert said == (
        f"More than 10\u00a0% above the prediction, most of it by one error ({SENSOR}): Scale-factor asymmetry "
        "(1 of 1, up to 1.67 times).",
        "More than 10\u00a0% above the prediction, by no error that several results share: Bias (1 of 1, up to 1.50 "
        "times).",
        "More than 10\u00a0% below the prediction, which should be the least: Scale-factor error N, temperature "
        "coefficient of first order (1 of 1, down to 0.80 times).",
    )


def test_in_korean_the_error_has_its_korean_name() -> None:
    said, table = agreement_parts(model(*PREDICTED), KOREAN)
    assert isinstance(SENSOR, Said)
    assert SENSOR.told("ko") in said[0]
    assert SENSOR not in said[0]
    assert table is not None
    assert table.rows[0][2] == "3개 중 2개"


def test_without_a_prediction_there_is_no_such_chapter() -> None:
    assert agreement_parts(model(), ENGLISH) == ((), None)
    assert "agreement" not in {section.name for section in sections_of(model(), ENGLISH)}
    (chapter,) = [section for section in sections_of(model(*PREDICTED), ENGLISH) if section.name == "agreement"]
    assert chapter.annex
    assert len(chapter.paragraphs) == 3
