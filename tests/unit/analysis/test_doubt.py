"""Evidence is weighed over a whole campaign, and what is not sound loses what it cannot claim."""

from __future__ import annotations

from typing import Any

import pytest

from bench.analysis import (
    Analysis,
    Evidence,
    EvidenceInterval,
    build_results,
    doubt_lines,
    estimate,
    is_sound,
    sound_compensation,
    stated_value,
    validate_results,
)
from bench.analysis.doubt import FALSE_DOUBT, LEAST_MOVE, base_quantity, stated, weigh
from bench.model.errors import InputError

PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "test"}
PLACE = {"channel": 1, "temperature_degC": 20.0}


def seen(probability: float, move: float = 1.0, **more: Any) -> Evidence:
    return Evidence("lack_of_fit", "The levels do not lie on a line.", 3.0, probability, move, **more)


def entry(quantity: str = "dsf_n", **conditions: Any) -> Any:
    return estimate(quantity, "ppm", 400.0, 10.0, PLACE | conditions, n=14, limit=500.0, dof=12.0)


def test_the_level_is_shared_by_all_checks_that_chance_can_fail() -> None:
    just_beyond = FALSE_DOUBT / 10 * 0.999
    few = [seen(just_beyond), *(seen(0.5) for _ in range(9))]
    assert [one.probability for one in weigh(few).against] == [just_beyond]
    assert weigh([*few, seen(0.5)]).against == []
    certain = seen(0.0, move=float("inf"))
    assert weigh([*few, certain]).against == [few[0], certain]  # what is not by chance takes no share


def test_what_moves_no_number_is_a_note() -> None:
    weighed = weigh([seen(0.0, move=LEAST_MOVE), seen(0.0, move=LEAST_MOVE * 1.01)])
    assert [one.move for one in weighed.noted] == [LEAST_MOVE]
    assert [one.move for one in weighed.against] == [LEAST_MOVE * 1.01]


@pytest.mark.parametrize(
    ("quantities", "conditions", "borne"),
    [
        ((), {}, True),
        (("dsf_n",), PLACE, True),
        (("dsf_p",), PLACE, False),
        (("dsf_n",), {"channel": 2}, False),
        (("dsf_n",), {"repeat": 1}, True),  # the estimate says nothing of a repeat
    ],
)
def test_what_evidence_bears_on(quantities: tuple[str, ...], conditions: dict[str, Any], borne: bool) -> None:
    assert seen(0.0, quantities=quantities, conditions=conditions).bears_on(entry()) is borne


@pytest.mark.parametrize("name", ["dsf_n", "dsf_n_tc0", "dsf_n_tc2", "dsf_n_residual", "dsf_n_change", "dsf_n_drift"])
def test_a_coefficient_belongs_to_its_quantity(name: str) -> None:
    assert base_quantity(name) == "dsf_n"
    assert seen(0.0, quantities=("dsf_n",)).bears_on(entry(name))


def test_a_doubtful_estimate_keeps_its_value_and_claims_nothing() -> None:
    document = stated(entry(), [seen(0.0, interval=EvidenceInterval(390.0, 420.0, "leaving out one level"))])
    assert document["value"] == 400.0
    for name in ("std_uncertainty", "coverage_factor", "expanded_uncertainty", "dof", "conformance_probability"):
        assert document[name] is None
    assert (document["verdict"], document["quality"]) == ("indeterminate", "doubtful")
    assert document["reasons"] == [{"code": "lack_of_fit", "sentence": seen(0.0).sentence, "figure": 3.0}]
    assert document["evidence_interval"] == {"low": 390.0, "high": 420.0, "basis": "leaving out one level"}
    assert stated_value(document) == "400 (doubtful)"
    assert not is_sound(document)


def test_a_refused_estimate_has_no_value() -> None:
    document = stated(entry(), [seen(0.0), seen(0.0, refuses=True)])
    assert (document["value"], document["quality"], len(document["reasons"])) == (None, "refused", 2)
    assert stated_value(document) == "refused"


def results(*evidence: Evidence, incomplete: bool = False) -> dict[str, Any]:
    entries = [entry(), entry(channel=2), entry("dsf_n_tc1")]
    unit = {"model": "NGU", "serial": "1"}
    parameters = [{"channel": channel, "kind": "gyro", "parameter": "dsf_n"} for channel in (1, 2)]
    analysis = Analysis("scale_factor", "gls", unit, entries, evidence=list(evidence), compensation=parameters)
    document = build_results("session", analysis, {}, PROVENANCE, incomplete=incomplete)
    document["kept"] = [part["channel"] for part in sound_compensation(analysis, document).compensation]
    document["missing"] = sound_compensation(analysis, document).missing
    return document


def test_results_state_what_the_evidence_leaves() -> None:
    document = results(seen(0.0, quantities=("dsf_n",), conditions=PLACE), seen(0.4))
    assert document["schema"] == 2
    assert [one["quality"] for one in document["estimates"]] == ["doubtful", "sound", "doubtful"]
    assert [one["verdict"] for one in document["estimates"]] == ["indeterminate", "pass", "indeterminate"]
    assert document["kept"] == [2]
    assert document["missing"] == ["channel 1: no coefficients of dsf_n, doubtful: The levels do not lie on a line."]
    assert doubt_lines(document["estimates"]) == [
        "DOUBTFUL, 2 estimates: The levels do not lie on a line. [lack_of_fit]"
    ]


def test_what_is_only_noted_stands_in_the_notes() -> None:
    document = results(seen(0.0, move=0.1))
    assert all(is_sound(one) for one in document["estimates"])
    assert document["notes"] == [seen(0.0).sentence]
    assert document["kept"] == [1, 2]
    assert doubt_lines(document["estimates"]) == []


@pytest.mark.parametrize(
    ("quality", "change"),
    [
        ("sound", {"expanded_uncertainty": None}),
        ("sound", {"reasons": [{"code": "a", "sentence": "b", "figure": None}]}),
        ("doubtful", {"reasons": []}),
        ("doubtful", {"expanded_uncertainty": 1.0}),
        ("refused", {"value": 1.0}),
        ("doubtful", {"value": None}),
    ],
)
def test_a_document_that_claims_what_its_quality_denies_is_refused(quality: str, change: dict[str, Any]) -> None:
    document = results(*([] if quality == "sound" else [seen(0.0, refuses=quality == "refused")]))
    document = {name: value for name, value in document.items() if name not in ("kept", "missing")}
    validate_results(document)
    document["estimates"][0] |= change
    with pytest.raises(InputError, match=quality):
        validate_results(document)


def test_a_document_before_doubt_is_still_read() -> None:
    document = {name: value for name, value in results().items() if name not in ("kept", "missing")}
    document["schema"] = 1
    for one in document["estimates"]:
        del one["quality"], one["reasons"]
    validate_results(document)
    assert all(is_sound(one) for one in document["estimates"])
