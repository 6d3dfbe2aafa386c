"""The first page: one page of A4, every clause on it, numbers of results.json, a rule with the risk that it carries."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError
from report_sample import estimate_entry, sample_model, unsound

from bench.analysis import Estimate, estimates_of
from bench.report.document import document_files, typeset
from bench.report.first import FirstPage, days_of, first_page
from bench.report.laboratory import Accreditation, Capability, Laboratory, below_capability, not_covered
from bench.report.model import ReportModel
from bench.report.tables import words_of

ROOT = Path(__file__).resolve().parents[3]
WORDS = words_of("en")
MAIN = ("dsf_n", "dsf_p", "bias", "hysteresis_width")
EXAMPLE: dict[str, Any] = yaml.safe_load((ROOT / "docs" / "laboratory.yaml").read_text(encoding="utf-8"))
SCOPE = [
    {"quantity": name, "range": [f"-4000 {unit}", f"4000 {unit}"], "cmc": f"0.1 {unit}", "method": "scale_factor"}
    for name, unit in (("dsf_n", "ppm"), ("dsf_p", "ppm"), ("dsf_n_residual", "ppm"), ("bias", "nA"))
]
EVERYTHING: dict[str, Any] = {
    **EXAMPLE,
    "number": "EX-2026-0002",
    "received": "1999-12-01",
    "issued": "2000-01-09",
    "adjustment": {"what": "A resistor was exchanged.", "results": "as_left", "other": "EX-2026-0001"},
    "replaces": {"number": "EX-2026-0001", "reason": "The customer's number was wrong."},
    "next_calibration": {"day": "2001-01-09", "agreed": True},
    "accreditation": {"body": "Example Body", "number": "EX-0000", "scope": SCOPE},
}


def laboratory(**more: Any) -> Laboratory:
    return Laboratory.model_validate({**EVERYTHING, **more})


@pytest.fixture(scope="module")
def model() -> ReportModel:
    """Ten channels at five temperatures, really measured; some of it judged."""
    found = sample_model(simulated=False)
    judged = [
        estimate_entry("dsf_n_residual", "ppm", value, 10.0, channel=channel, temperature_degC=20.0)
        | {"limit": 100.0, "verdict": verdict, "conformance_probability": inside(value, 10.0 / 1.96, 100.0)}
        for channel, (value, verdict) in enumerate([(3.0, "pass"), (95.0, "conditional_pass"), (120.0, "fail")], 1)
    ]
    estimates = [*found.results["estimates"], *judged]
    started = {"started_utc": "2000-01-01T00:00:00Z", "run": replace(found.run, length_s=137_000.0)}
    return replace(found, main=MAIN, results={**found.results, "estimates": estimates}, **started)


def inside(value: float, u: float, limit: float) -> float:
    """Probability that the true value is within the limit, by the error function."""
    return 0.5 * (math.erf((limit - value) / (u * math.sqrt(2))) - math.erf((-limit - value) / (u * math.sqrt(2))))


@pytest.fixture(scope="module")
def page(model: ReportModel) -> FirstPage:
    return first_page(model, laboratory(), WORDS)


def on(page: FirstPage) -> dict[str, str]:
    """Everything that the page says, by its head."""
    return dict((*page.entries, *page.statements))


def number(text: str) -> float:
    return float(text.replace("−", "-").replace("\u202f", ""))


def test_it_is_one_page_with_everything_stated(model: ReportModel, page: FirstPage) -> None:
    """It takes no second page, and neither does the end mark."""
    doubted = replace(page, doubt=("REFUSED, 3 estimates: " + "a reason of some length, " * 8,) * 3)
    for shown in (page, doubted):
        one = typeset(document_files(model, [], WORDS, shown), format="png", ppi=20.0)
        assert isinstance(one, bytes)  # of several there were a list


def test_values_and_uncertainties_are_those_of_the_results(model: ReportModel, page: FirstPage) -> None:
    (block,) = page.results
    columns = [(name, degC) for name in ("dsf_n", "dsf_p", "bias") for degC in (-10.0, 5.0, 20.0, 35.0, 50.0)]
    assert [(heading, count) for heading, count in block.groups if heading] == [
        ("Scale-factor error N / ppm", 5), ("Scale-factor error P / ppm", 5), ("Bias / nA", 5)
    ]  # fmt: skip
    assert [number(text) for text in block.headers[1:]] == [degC for _, degC in columns]
    by_place = {
        (row["quantity"], row["conditions"].get("channel"), row["conditions"].get("temperature_degC")): row
        for row in model.results["estimates"]
    }
    for line in block.rows:
        channel = int(line[0].split()[0])
        for (name, degC), text in zip(columns, line[1:], strict=True):
            value = by_place[name, channel, degC]["value"] * (1e9 if name == "bias" else 1.0)
            assert number(text) == round(value), (name, channel, degC)
    widths = {name: number(text) for (name, _), text in zip(columns, block.foot[0][1:], strict=True)}
    assert widths == {"dsf_n": 20.0, "dsf_p": 20.0, "bias": 10.0}
    assert [line[0] for line in block.foot] == ["U, gyro", "U, accelerometer", "k"]
    assert set(block.foot[-1][1:]) == {"1.96"}


def test_the_value_nearest_to_its_limit_and_the_risk_of_the_rule(model: ReportModel, page: FirstPage) -> None:
    """A conditional pass at 95 of 100 ppm, u = 10 / 1.96 ppm, is wrong with 16 %; the fail at 120 ppm with 0.004 %."""
    said = on(page)
    assert re.search(r"channel:? 3\b", said["Nearest to its limit"])
    assert (
        "120 ± 10 ppm (k = 1.96), limit ± 100 ppm; the interval goes 30 ppm beyond the limit"
        in said["Nearest to its limit"]
    )
    risk = 100.0 * (1.0 - inside(95.0, 10.0 / 1.96, 100.0))
    assert 16.0 < risk < 17.0
    assert f"Largest risk among the 2 accepted here: {risk:.2f}\u00a0%." in said["Decision rule"]
    assert "Largest risk among the 1 refused here: <\u00a00.01\u00a0%." in said["Decision rule"]


def test_what_the_laboratory_states_is_on_it(model: ReportModel, page: FirstPage) -> None:
    said = on(page)
    assert (page.title, page.number) == ("Calibration report", "EX-2026-0002")
    assert page.end == "End of the report EX-2026-0002"
    assert said["Laboratory"].startswith("Example Calibration Laboratory, Example Street 1, 00000 Exampletown, DE")
    assert said["Customer"] == "Example Navigation Systems, Sample Road 2, 00000 Exampletown, DE"
    assert "NGU, serial number SIM-1, customer's number EQ-0001" in said["Item"]
    assert said["State on receipt"] == EXAMPLE["item"]["state"]
    assert (said["Received"], said["Issued"]) == ("1999-12-01", "2000-01-09")
    assert said["Calibrated (UTC)"] == "2000-01-01 to 2000-01-02"
    assert "measured: 22.8 to 23.2 °C" in said["Environment"]
    assert "30 to 60 % relative humidity" in said["Environment"]
    assert "calibrator 5720A SIM-5720: SIM-0001, 1999-11-01" in said["Traceability"]
    assert "docs/method-af-converter.md" in said["Method"]
    assert "relate only to the item" in said["Validity"]
    assert "replaces EX-2026-0001. Reason: The customer's number was wrong." in said["Replaces"]
    assert "as left" in said["Adjustment"]
    assert said["Next calibration"] == "2001-01-09, as agreed with the customer."
    assert page.signatures == (("head of the laboratory", "A. Example"),)
    colder = first_page(model, laboratory(surroundings={"temperature": ["22 degC", "23 degC"]}), WORDS)
    assert "not within what the laboratory states" in on(colder)["Environment"]
    assert [str(day) for day in days_of(model) or ()] == ["2000-01-01", "2000-01-02"]  # of the name of the session
    assert days_of(replace(model, started_utc="")) is None


def test_the_mark_stands_for_real_results_only(model: ReportModel, page: FirstPage) -> None:
    assert "under the accreditation of the laboratory by Example Body, EX-0000" in on(page)["Accreditation"]
    assert page.not_accredited == ()
    simulated = replace(model, results={**model.results, "provenance": {"simulated": True}})
    shown = first_page(simulated, laboratory(), WORDS)
    assert shown.title == "Calibration report (specimen)"
    assert on(shown)["Accreditation"].startswith("Not stated under the accreditation")
    capable = [{**SCOPE[0], "cmc": "25 ppm"}, *SCOPE[1:]]
    own = laboratory(accreditation={**EVERYTHING["accreditation"], "scope": capable})
    assert first_page(model, own, WORDS).not_accredited == (
        "dsf_n: U = 19.9 ppm is below the CMC of 25 ppm, and 49 more of it",
    )


def test_a_value_that_is_judged_on_the_page_needs_the_scope_too(model: ReportModel) -> None:
    own = laboratory(accreditation={**EVERYTHING["accreditation"], "scope": [SCOPE[0], SCOPE[1], SCOPE[3]]})
    (reason,) = first_page(model, own, WORDS).not_accredited
    assert reason.startswith("dsf_n_residual: 120 ppm by scale_factor is outside the scope")


def test_doubtful_values_are_marked_and_say_so_above(model: ReportModel) -> None:
    first, *others = model.results["estimates"]
    reason = {"code": "odd", "sentence": "It is odd.", "figure": 1.0}
    doubtful = first | {"quality": "doubtful", "reasons": [reason], "expanded_uncertainty": None, "value": 41.0}
    shown = first_page(replace(model, results={**model.results, "estimates": [doubtful, *others]}), None, WORDS)
    assert shown.doubt[0].startswith("DOUBTFUL, 1 estimate of scale-factor error N: It is odd.")
    assert shown.results[0].rows[0][1] == "41 †"
    assert shown.notes == (WORDS("first.results.unsound"),)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"next_calibration": {"day": "2001-01-09", "agreed": False}}, "agreed"),
        ({"next_calibration": {"day": "2001-01-09"}}, "agreed"),
        ({"number": None}, "needs a 'number' of its own"),
        ({"number": "EX-2026-0001"}, "needs a 'number' of its own"),
        ({"number": 'EX"} body'}, "number"),
    ],
)
def test_entries_that_may_not_be_are_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        laboratory(**wrong)


CAPABLE = [
    {"quantity": "dsf_n", "range": ["-1000 ppm", "1000 ppm"], "cmc": "20 ppm", "method": "scale_factor"},
    {"quantity": "bias", "range": ["-1 uA", "1 uA"], "cmc": "0.5 nA", "method": "scale_factor"},
]
OWN = Accreditation.model_validate({"body": "Example Body", "number": "EX-0000", "scope": CAPABLE})


def stated(quantity: str, unit: str, value: float, expanded: float, quality: str = "sound") -> Estimate:
    entry = estimate_entry(quantity, unit, value, expanded, channel=1)
    return estimates_of({"estimates": [entry if quality == "sound" else unsound(entry, quality)]})[0]


@pytest.mark.parametrize(
    ("found", "method", "reason"),
    [
        (stated("dsf_n", "ppm", 12.0, 20.0), "scale_factor", ""),
        (stated("dsf_n", "1", 12e-6, 20e-6), "scale_factor", ""),  # the same in another unit
        (stated("bias", "A", 4e-7, 5e-10), "scale_factor", ""),
        (stated("bias", "nA", 400.0, 0.5), "scale_factor", ""),
        (stated("dsf_n", "ppm", 12.0, 19.9), "scale_factor", "U = 19.9 ppm is below the CMC of 20 ppm"),
        (stated("bias", "nA", 400.0, 0.4), "scale_factor", "U = 0.4 nA is below the CMC of 0.5 nA"),
        (stated("dsf_n", "ppm", 12.0, 0.0), "scale_factor", "U = 0 ppm is below the CMC of 20 ppm"),
        (stated("dsf_n", "ppm", 1000.1, 30.0), "scale_factor", "1000.1 ppm by scale_factor is outside the scope"),
        (stated("dsf_n", "ppm", 12.0, 30.0), "dmm_method", "12 ppm by dmm_method is outside the scope"),
        (stated("dsf_n", "A", 12.0, 30.0), "scale_factor", "12 A by scale_factor is outside the scope"),
        (stated("lag", "pulse", 1.0, 2.0), "scale_factor", "1 pulse by scale_factor is outside the scope"),
        (stated("dsf_n", "ppm", 12.0, 30.0, quality="doubtful"), "scale_factor", "is doubtful"),
    ],
)
def test_each_condition_alone_keeps_a_result_out(found: Estimate, method: str, reason: str) -> None:
    said = not_covered(OWN, method, [found])
    assert said == ({found.quantity: reason} if reason else {})


def test_a_result_outside_the_scope_has_no_capability_to_be_below_of() -> None:
    rows = [stated("dsf_n", "ppm", 5000.0, 1.0), stated("dsf_n", "ppm", 5.0, 1.0, quality="refused")]
    assert below_capability(OWN, "scale_factor", rows) == {}
    assert list(below_capability(OWN, "scale_factor", [*rows, stated("bias", "A", 0.0, 1e-10)])) == ["bias"]


@pytest.mark.parametrize(
    "wrong",
    [{"cmc": "20 nA"}, {"cmc": "20"}, {"cmc": "0 ppm"}, {"range": ["1 ppm", "-1 ppm"]}, {"range": ["1 A", "2 ppm"]}],
)
def test_a_line_of_the_scope_that_says_nothing_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Capability.model_validate(CAPABLE[0] | wrong)
