"""results.json: form, JSON Schema, canonical bytes, and the registry of analyses."""

import copy
import json
from importlib import resources
from typing import Any

import fit_simulation as sim
import jsonschema
import pytest

from bench.analysis import (
    Material,
    analyse,
    analysis_module,
    build_results,
    results_json,
    results_schema,
    validate_results,
)
from bench.model.errors import FitError, InputError

PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "1"}

SHIPPED = resources.files("bench.analysis").joinpath("results.schema.json").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    campaign = sim.simulate(30, sim.Switches(), repeat_channel=1)
    analysis = analyse(Material(campaign.rows, campaign.campaign, campaign.standards))
    return build_results("session", analysis, {"records": 165, "frames": 1_650_000, "flagged": 2}, PROVENANCE)


def test_document_has_the_form_of_the_contract(document: dict[str, Any]) -> None:
    assert document["schema"] == 2
    assert document["campaign"] == "scale_factor"
    assert document["uut"] == {"model": "NGU", "serial": "SIM-1"}
    assert set(document["estimates"][0]) == {
        "quantity", "unit", "value", "std_uncertainty", "coverage_factor", "expanded_uncertainty", "conditions", "n",
        "dropped", "limit", "verdict", "conformance_probability", "quality", "reasons", "common",
    }  # fmt: skip
    assert document["quality"] == {
        "records": 165, "frames": 1_650_000, "frames_bad": 0, "frames_lost": 0, "splices": 0, "retaken": 0,
    }  # fmt: skip


def test_shipped_schema_is_the_one_of_the_declarations_and_accepts_the_document(document: dict[str, Any]) -> None:
    schema = json.loads(SHIPPED)
    assert schema == results_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(results_json(document)), schema)


def test_the_independent_validator_refuses_what_ours_refuses(document: dict[str, Any]) -> None:
    schema = json.loads(SHIPPED)
    for place, value in (
        (("estimates", 0, "verdict"), "good"),
        (("estimates", 0, "std_uncertainty"), -1.0),
        (("estimates", 0, "n"), -1),
        (("estimates", 0, "conditions", "channel"), [1]),
        (("schema",), 3),
        (("quality", "records"), "many"),
        (("uut",), {"model": "NGU"}),
    ):
        wrong = copy.deepcopy(document)
        target: Any = wrong
        for key in place[:-1]:
            target = target[key]
        target[place[-1]] = value
        with pytest.raises(InputError) as caught:
            validate_results(wrong)
        assert caught.value.code == "B-FIT-010"
        assert str(place[0]) in caught.value.message
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, schema)


def test_unknown_key_and_infinite_number_are_refused(document: dict[str, Any]) -> None:
    with pytest.raises(InputError) as caught:
        validate_results(document | {"extra": 1})
    assert caught.value.code == "B-FIT-010"
    wrong = copy.deepcopy(document)
    wrong["estimates"][3]["value"] = float("nan")
    with pytest.raises(InputError, match=r"estimates\.3\.value") as caught:
        validate_results(wrong)
    assert caught.value.code == "B-FIT-010"


def test_text_is_canonical_and_keeps_every_bit(document: dict[str, Any]) -> None:
    text = results_json(document)
    assert json.loads(text) == document
    assert results_json(dict(reversed(list(document.items())))) == text
    assert text.endswith("}\n")


def test_analysis_by_name() -> None:
    assert analysis_module("scale_factor").METHODS == ("gls", "paper", "ols")
    with pytest.raises(FitError, match="unknown analysis 'scale_facto'") as caught:
        analyse(Material([], {"analysis": "scale_facto"}, {}))
    assert caught.value.code == "B-FIT-011"
    assert "scale_factor" in caught.value.next_step
