"""Holds what ``bench check`` predicts of a campaign against what it then states."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rehearsal import rehearsed
from units_campaign import CUTS, OF_ONE, compiled_text, cut, single_plan, units_plan

from bench.analysis import estimates_of
from bench.commands.check import check
from bench.commands.requests import CheckRequest
from bench.maths.verdict import verdict
from bench.model.errors import FitError, InputErrors
from bench.plan import Plan
from bench.session.one_unit import session_of_unit
from bench.session.predicted import chance_of, predicted, predicted_lines
from bench.session.service import read_view
from bench.session.view import analyse_view

TOLERANCE = 0.01  # of U: counts and temperatures of a real unit are not quite the planned ones
REPEATED = "channel 2 at 23 degC, repeat 1"
LEFT_OUT = ("unit", "unit_temperature_degC", "hours")
NEGATIVE = '          - point: {current: "{level}", polarity: -, level_index: "{level_index}", repeat: "{repeat}"}\n'


def places(estimates: list[Any]) -> dict[tuple[str, str], float]:
    """Standard uncertainty of each estimate without the drift that a repeat leaves: that depends on what it shows.

    Without what changed between the visits: how warm the unit is in each of them, no plan knows.
    """
    found = {}
    for entry in (entry for entry in estimates if not entry.quantity.endswith("_drift")):
        where = {key: value for key, value in entry.conditions.items() if key not in LEFT_OUT}
        parts = [] if entry.common is None else entry.common.campaign.values()
        own = entry.std_uncertainty**2 - sum(part**2 for part in parts)
        found[entry.quantity, json.dumps(where, sort_keys=True)] = math.sqrt(own)
    return found


def test_what_is_predicted_is_what_the_campaign_states(tmp_path: Path) -> None:
    plan = single_plan(tmp_path)
    found = predicted(plan)
    (untold,) = found.missing
    assert untold.startswith(f"drift of calibrator and unit by {REPEATED}")
    results, _ = analyse_view(read_view(rehearsed(tmp_path, plan, seed=1).run.folder))
    before, after = places(found.estimates), places(estimates_of(results))
    print({place[0]: f"{before[place] / stated:.4f}" for place, stated in after.items()})
    assert before == pytest.approx(after, rel=TOLERANCE)


def test_each_of_several_units_is_predicted_by_itself(tmp_path: Path) -> None:
    plan = units_plan(tmp_path)
    found = predicted(plan)
    (untold,) = found.missing
    assert untold.startswith(f"drift of calibrator and unit by {REPEATED}"), "the same of every unit"
    folder = rehearsed(tmp_path, plan, seed=1).run.folder
    for unit in plan.units:
        with session_of_unit(folder, unit.serial) as home:
            results, _ = analyse_view(read_view(home))
        own = [entry for entry in found.estimates if entry.conditions["unit"] == unit.serial]
        assert places(own) == pytest.approx(places(estimates_of(results)), rel=TOLERANCE)


def test_what_a_plan_does_not_determine_is_named(tmp_path: Path) -> None:
    plan = compiled_text(tmp_path, cut("scale_factor_38h", [*OF_ONE, *CUTS, (NEGATIVE, "")]), {})
    found = predicted(plan)
    assert found.estimates == []
    (line,) = predicted_lines(plan, found)
    assert line.startswith("missing: K_P is not determined")


def test_it_is_printed_and_in_the_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    single_plan(tmp_path)
    path = str(tmp_path / "units_tiny.yaml")
    assert check(CheckRequest(path, json=False)) == 0
    said = capsys.readouterr().out
    assert "predicted    Scale-factor error N: U at least " in said
    assert check(CheckRequest(path, json=True)) == 0
    document = json.loads(capsys.readouterr().out)["predicted"]
    assert [REPEATED in sentence for sentence in document["missing"]] == [True]
    for entry in document["estimates"]:
        assert math.hypot(*entry["components"].values()) == pytest.approx(entry["std_uncertainty"])
    gain = next(entry for entry in document["estimates"] if entry["quantity"] == "dsf_n")["components"]
    assert next(iter(gain.items())) == ("5720A SIM5720 SIM-0001: gain", pytest.approx(10.0))  # 20 ppm of 95 %
    assert not {"value", "verdict", "conformance_probability"} & document["estimates"][0].keys()
    assert {entry["quantity"] for entry in document["estimates"]} >= {"dsf_n", "dsf_p", "dsf_asymmetry", "bias"}


def test_the_chance_of_a_pass_stands_beside_the_limit(tmp_path: Path) -> None:
    plan = with_spread(tmp_path, "dsf_n_residual: 50 ppm, dsf_x: 1 ppm")
    found = predicted(plan)
    entries = [entry for entry in found.estimates if entry.quantity == "dsf_n_residual"]
    chances = [chance_of(entry, plan.campaign) for entry in entries]
    random = np.random.default_rng(1)  # seed 1
    for entry, chance in zip(entries, chances, strict=True):
        measured = random.normal(random.normal(0.0, 50.0, 20_000), entry.std_uncertainty)
        passed = [verdict(value, entry.expanded_uncertainty, entry.limit) == "pass" for value in measured]
        assert chance == pytest.approx(np.mean(passed), abs=4.0 * 0.5 / math.sqrt(20_000))
    others = [entry for entry in found.estimates if entry.quantity == "dsf_n"]
    assert {chance_of(entry, plan.campaign) for entry in others} == {None}
    lines = list(predicted_lines(plan, found))
    assert any(line.endswith(f"{100 * min(filter(None, chances)):.3g} % of units pass (50 values)") for line in lines)
    assert "missing: dsf_x, of which a spread is declared, is no result of this plan" in lines


def with_spread(folder: Path, spread: str) -> Plan:
    """Return the campaign of 38 h with a spread of its units."""
    words = ("uut:\n  model: NGU", f"uut:\n  spread: {{{spread}}}\n  model: NGU")
    return compiled_text(folder, cut("scale_factor_38h", [words]), {})


def test_a_spread_that_is_none_or_in_another_unit_is_refused(tmp_path: Path) -> None:
    for spread in ("-25 ppm", "0 ppm"):
        with pytest.raises(InputErrors, match="no standard deviation"):
            with_spread(tmp_path, f"dsf_n_residual: {spread}")
    plan = with_spread(tmp_path, "dsf_n_residual: 1 mA")
    with pytest.raises(FitError, match=r"spread of dsf_n_residual is in A, and the quantity is in ppm") as refused:
        list(predicted_lines(plan, predicted(plan)))
    assert refused.value.code == "B-FIT-051"


def test_of_an_analysis_that_predicts_nothing_nothing_is_said(tmp_path: Path) -> None:
    plan = single_plan(tmp_path)
    foreign = replace(plan, campaign={**plan.campaign, "analysis": "noise_of_mine"})
    assert list(predicted_lines(foreign, predicted(foreign))) == []
