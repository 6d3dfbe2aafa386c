"""Many sessions as one: verdicts, yield, distributions, the worst values, and the page and file that say so."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from report_sample import LIMIT, SEED, calibrations, coupling, results

from bench.analysis import estimate
from bench.report.batch.document import batch_document, batch_html, batch_json
from bench.report.batch.model import Batch, LeftOut, Unit

GOOD, BAD = 0.5 * LIMIT, 2.0 * LIMIT


def batch_of(*documents: dict[str, object]) -> Batch:
    found = Batch()
    for document in documents:
        found.add(document, str(document["session"]))
    return found


def outcomes(found: Batch) -> dict[str, str]:
    return {unit.serial: str(outcome) for unit, outcome in found.outcomes.items()}


# --- verdicts and yield --------------------------------------------------------------------------------------------


def test_a_unit_passes_if_no_session_of_it_fails() -> None:
    found = batch_of(
        results("s1", "A", [coupling(GOOD)]),
        results("s2", "A", [coupling(GOOD)], campaign="imu_bias"),
        results("s3", "B", [coupling(GOOD)]),
        results("s4", "B", [coupling(BAD), coupling(GOOD, "y")], campaign="imu_bias"),
        results("s5", "C", [coupling(GOOD)], incomplete=True),
    )
    assert outcomes(found) == {"A": "pass", "B": "fail", "C": "no_result"}
    assert (found.yield_of().passed, found.yield_of().failed, found.yield_of().without) == (1, 1, 1)
    assert found.yield_of().share == 0.5
    by_campaign = {name: found.yield_of(name) for name in found.campaigns}
    assert (by_campaign["imu_bias"].passed, by_campaign["imu_bias"].failed) == (1, 1)
    assert (by_campaign["imu_calibration"].passed, by_campaign["imu_calibration"].without) == (2, 1)


def test_a_unit_of_which_something_is_missing_does_not_pass() -> None:
    """Of one of several units: GPS was not tested. Of a whole session: no hour for the stability."""
    found = Batch()
    several = [coupling(GOOD, unit="A"), coupling(GOOD, unit="A1"), coupling(BAD, unit="C")]
    found.add(results("s1", "BATCH", several), "s1", ["unit A: GPS was not tested", "unit C: GPS was not tested"])
    found.add(results("s2", "D", [coupling(GOOD)]), "s2", ["stability: no record"])
    assert outcomes(found) == {"A": "no_result", "A1": "pass", "C": "fail", "D": "no_result"}


def test_a_pass_does_not_outweigh_a_session_without_a_result() -> None:
    found = batch_of(results("s1", "A", [coupling(GOOD)]))
    found.without_result({"campaign": {"uut": {"model": "GNC", "serial": "A"}, "analysis": "imu_bias"}}, "s2")
    assert outcomes(found) == {"A": "no_result"}


def test_a_conditional_fail_is_no_pass_and_an_estimate_without_a_limit_is_not_judged() -> None:
    near = {**coupling(GOOD).document, "verdict": "conditional_fail"}
    document = results("s1", "A", [coupling(GOOD)])
    document["estimates"] = [near]
    free = estimate("gyro_bias", "deg/h", 3.0, 1.0, {"axis": "x"}, n=6)
    barely = results("s4", "D", [coupling(GOOD)])
    barely["estimates"] = [{**coupling(GOOD).document, "verdict": verdict} for verdict in ("pass", "conditional_pass")]
    found = batch_of(document, results("s2", "B", [free]), results("s3", "C", []), barely)
    assert outcomes(found) == {"A": "conditional_fail", "B": "not_judged", "C": "no_result", "D": "conditional_pass"}
    assert (found.yield_of().passed, found.yield_of().failed, found.yield_of().without) == (1, 1, 2)


def test_units_of_one_session_are_told_apart() -> None:
    tested = [coupling(GOOD, unit="GNC-1"), coupling(BAD, unit="GNC-2"), coupling(GOOD, unit="GNC-3")]
    found = batch_of(results("s1", "BATCH-1", tested, campaign="gnc_unit_test"))
    assert outcomes(found) == {"GNC-1": "pass", "GNC-2": "fail", "GNC-3": "pass"}
    ((spread),) = found.spreads
    assert len(spread.members) == 3
    assert "unit" not in spread.quantity.where


def test_equal_serial_numbers_of_two_models_are_two_units() -> None:
    other = results("s2", "A", [coupling(BAD)])
    other["uut"]["model"] = "IMU"
    found = batch_of(results("s1", "A", [coupling(GOOD)]), other)
    assert {unit: str(said) for unit, said in found.outcomes.items()} == {
        Unit("GNC", "A"): "pass", Unit("IMU", "A"): "fail",
    }  # fmt: skip


# --- distributions -------------------------------------------------------------------------------------------------


def test_statistics_are_those_of_the_values() -> None:
    documents = calibrations(50)
    values = [
        one["value"]
        for document in documents
        for one in document["estimates"]
        if one["quantity"] == "gyro_scale_error" and one["conditions"]["axis"] == "y"
    ]
    (found,) = [
        one
        for one in batch_document(batch_of(*documents), "test")["quantities"]
        if one["quantity"] == "gyro_scale_error" and one["conditions"]["axis"] == "y"
    ]
    assert (found["n"], found["unit"], found["worst"]) == (50, "ppm", None), f"seed {SEED}"
    assert found["mean"] == pytest.approx(np.mean(values), rel=1e-12)
    assert found["std"] == pytest.approx(np.std(values, ddof=1), rel=1e-12)
    assert found["min"]["value"] == min(values)
    (alone,) = batch_of(results("s1", "A", [coupling(GOOD)])).spreads
    assert alone.std is None
    assert found["max"]["serial"] == documents[int(np.argmax(values))]["uut"]["serial"]


@pytest.mark.parametrize(
    ("values", "worst"),
    [
        ((GOOD, -BAD, 0.9 * LIMIT), -BAD),  # the size counts, not the value
        ((0.2 * LIMIT, -0.4 * LIMIT, 0.3 * LIMIT), -0.4 * LIMIT),  # all certain to be inside: the greatest use
    ],
)
def test_the_worst_is_the_one_most_likely_outside(values: tuple[float, ...], worst: float) -> None:
    documents = [results(f"s{n}", f"U{n}", [coupling(value, u=1e-9)]) for n, value in enumerate(values)]
    (found,) = batch_of(*documents).spreads
    assert found.worst is not None
    assert found.worst.value == worst


def test_an_uncertain_value_inside_is_worse_than_a_certain_one_nearer_to_the_limit() -> None:
    sure, unsure = coupling(0.9 * LIMIT, u=1e-6), coupling(0.8 * LIMIT, u=2e-4)
    found = batch_of(results("s1", "A", [sure]), results("s2", "B", [unsure]))
    assert [one.unit.serial for _, one in found.worst] == ["B", "A"]


def test_a_count_that_must_be_zero() -> None:
    counts = [estimate("memory_wrong", "1", n, 0.0, {"item": "memory"}, n=1, limit=0.0) for n in (0.0, 1.0, 2.0)]
    found = batch_of(*(results(f"s{n}", f"U{n}", [one]) for n, one in enumerate(counts)))
    assert outcomes(found) == {"U0": "pass", "U1": "fail", "U2": "fail"}
    assert found.worst[-1][1].unit.serial == "U0"
    json.loads(batch_json(found, "test"))


# --- what is written -----------------------------------------------------------------------------------------------


def test_the_file_says_what_was_added_and_is_the_same_again() -> None:
    documents = calibrations(20)
    text = batch_json(batch_of(*documents), "test 0")
    assert text == batch_json(batch_of(*documents), "test 0")
    found = json.loads(text)
    assert (len(found["units"]), len(found["parts"]), found["simulated"]) == (20, 20, True)
    failed = sum(one["verdict"] == "fail" for one in found["units"])
    assert found["yield"]["units"]["fail"] == failed
    low, high = found["yield"]["units"]["interval_95"]
    assert low < (20 - failed) / 20 <= high


def test_the_page_is_whole_and_watermarked_only_if_simulated() -> None:
    simulated = batch_html(batch_of(*calibrations(30)), "test 0")
    assert simulated == batch_html(batch_of(*calibrations(30)), "test 0")
    assert "SIMULATED" in simulated
    real = batch_html(batch_of(results("s1", "A", [coupling(GOOD)], simulated=False)), "test 0")
    assert "SIMULATED" not in real
    assert not re.search(r"(?:src|href)=\"(?!#)", simulated)
    for figure in re.findall(r"<svg.*?</svg>", simulated, re.DOTALL):
        ElementTree.fromstring(figure)


def test_a_simulated_session_among_real_ones_is_named() -> None:
    page = batch_html(
        batch_of(results("real", "A", [coupling(GOOD)], simulated=False), results("toy", "B", [coupling(GOOD)])), "t"
    )
    assert "SIMULATED" in page
    assert "Some of the sessions are simulated: toy." in page


def test_units_with_doubt_are_counted() -> None:
    reason = {"code": "lack_of_fit", "sentence": "The levels do not lie on a line.", "figure": 3.0}
    document = results("s2", "B", [coupling(GOOD)])
    document["estimates"][0] |= {
        "expanded_uncertainty": None, "verdict": "indeterminate", "quality": "doubtful", "reasons": [reason]
    }  # fmt: skip
    found = batch_of(results("s1", "A", [coupling(GOOD)]), document)
    assert [unit.serial for unit in found.doubted] == ["B"]
    assert [part["not_sound"] for part in json.loads(batch_json(found, "t"))["parts"]] == [0, 1]
    assert "1 units with doubt" in batch_html(found, "t")


def test_what_was_left_out_stands_on_the_page() -> None:
    found = batch_of(results("s1", "A", [coupling(GOOD)]))
    found.left_out.append(LeftOut("s2", "B-REC-012", "the manifest <is> missing"))
    page = batch_html(found, "test")
    assert "B-REC-012" in page
    assert "the manifest &lt;is&gt; missing" in page
