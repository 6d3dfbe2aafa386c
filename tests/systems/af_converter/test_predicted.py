"""Holds what ``bench check`` predicts of a campaign against what it then states."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from rehearsal import ROOT, rehearsed
from units_campaign import CUTS, OF_ONE, compiled_text, cut, single_plan, units_plan

from bench.commands.check import Request, check
from bench.plan import compile_sequence
from bench.session.predicted import predicted, predicted_lines
from bench.session.service import read_view
from bench.session.view import analyse_view

TOLERANCE = 0.01  # of U: counts and temperatures of a real unit are not quite the planned ones
LEFT_OUT = ("unit_temperature_degC", "hours")
NEGATIVE = '          - point: {current: "{level}", polarity: -, level_index: "{level_index}", repeat: "{repeat}"}\n'


def places(estimates: list[Any]) -> dict[tuple[str, str], float]:
    """Standard uncertainty of each estimate without the drift that a repeat leaves: that depends on what it shows."""
    found = {}
    for entry in estimates:
        where = {key: value for key, value in entry["conditions"].items() if key not in LEFT_OUT}
        parts = entry.get("common", {}).get("campaign", {}).values()
        own = entry["std_uncertainty"] ** 2 - sum(part**2 for part in parts)
        found[entry["quantity"], json.dumps(where, sort_keys=True)] = math.sqrt(own)
    return found


def test_what_is_predicted_is_what_the_campaign_states(tmp_path: Path) -> None:
    plan = single_plan(tmp_path)
    found = predicted(plan)
    assert found.missing == []
    results, _ = analyse_view(read_view(rehearsed(tmp_path, plan, seed=1).run.folder))
    before, after = places(found.estimates), places(results["estimates"])
    print({place[0]: f"{before[place] / stated:.4f}" for place, stated in after.items()})
    assert before == pytest.approx(after, rel=TOLERANCE)


def test_no_campaign_of_several_units_and_none_without_a_prediction(tmp_path: Path) -> None:
    for plan in (units_plan(tmp_path), compile_sequence(ROOT / "sequences" / "gnc_unit_test.yaml", None, {})):
        (line,) = predicted_lines(plan, predicted(plan))
        assert line.startswith("missing: ")
        assert "predict" in line


def test_what_a_plan_does_not_determine_is_named(tmp_path: Path) -> None:
    plan = compiled_text(tmp_path, cut("scale_factor_38h", [*OF_ONE, *CUTS, (NEGATIVE, "")]), {})
    found = predicted(plan)
    assert found.estimates == []
    (line,) = predicted_lines(plan, found)
    assert line.startswith("missing: K_P is not determined")


def test_it_is_printed_and_in_the_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    single_plan(tmp_path)
    path = str(tmp_path / "units_tiny.yaml")
    assert check(Request(path, None, [], None, json=False, predict=True)) == 0
    said = capsys.readouterr().out
    assert "predicted    Scale-factor error N: U at least " in said
    assert check(Request(path, None, [], None, json=True, predict=True)) == 0
    document = json.loads(capsys.readouterr().out)["predicted"]
    assert document["missing"] == []
    assert not {"value", "verdict", "conformance_probability"} & document["estimates"][0].keys()
    assert {entry["quantity"] for entry in document["estimates"]} >= {"dsf_n", "dsf_p", "dsf_asymmetry", "bias"}
    assert check(Request(path, None, [], None, json=True)) == 0
    assert "predicted" not in json.loads(capsys.readouterr().out)
