"""Holds what is predicted of a bias ramp against the spread of simulated ramps about their truth, and a recorded one.

Seeds of the ramps are 1000 to 1009, in the sweep 1000 to 1499.
"""

from __future__ import annotations

import copy
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bias_simulation import MASTER_ppm
from ramp_spread import Place, errors_of, place
from rehearsal import ROOT
from spread_study import judged

from bench.analysis import Planned
from bench.plan import compile_sequence
from bench.session.predicted import planned_of, predicted, predicted_document, predicted_lines
from bench.systems.af_converter.bias_ramp.predicted import predicted as of_ramp
from bench.systems.af_converter.constants import read_campaign

FIRST = 1000
SHOWN = {"bias", "hysteresis_width", "play_half_width", "thermal_lag", "white_noise", "random_walk"}
SHOWN |= {f"master_clock_error_tc{order}" for order in range(4)}


def planned(name: str) -> Planned:
    return planned_of(compile_sequence(name, None, {}))


def ratios(campaigns: int) -> dict[Place, float]:
    """Root mean square of estimate minus truth over the predicted standard uncertainty, over campaigns of 25 hours."""
    plan = planned("bias_ramp_25h")
    plan = replace(plan, campaign={**plan.campaign, "master_curve_ppm": MASTER_ppm[1:]})
    expected = {place(entry): entry["std_uncertainty"] for entry in of_ramp(plan).estimates}
    constants = read_campaign(plan.campaign)
    kinds = {channel.kind: channel.typical for channel in constants.channels if channel.typical is not None}
    found: dict[Place, list[float]] = {}
    for seed in range(FIRST, FIRST + campaigns):
        for where, error in errors_of(seed, kinds, constants.thermal_lag_s or 0.0).items():
            found.setdefault(where, []).append(error)
    shown = {where: errors for where, errors in found.items() if where in expected}
    return {where: float(np.sqrt(np.mean(np.square(errors)))) / expected[where] for where, errors in shown.items()}


@pytest.mark.slow
@pytest.mark.validates(
    "uncertainties predicted from the plan of a bias ramp of 25 hours",
    against="the spread about the truth of 10 ramps simulated from heat and charge, in the sweep of 500",
)
@pytest.mark.parametrize("campaigns", [10, pytest.param(500, marks=pytest.mark.sweep)])
def test_the_spread_of_ramps_is_what_was_predicted(
    record_property: Callable[[str, object], None], campaigns: int
) -> None:
    """Each in its 99.9 % band of chi-square, the median within 3 % at 500. A walk is overstated, never understated."""
    found = ratios(campaigns)
    assert {quantity for quantity, *_ in found} >= SHOWN
    assert judged(found, campaigns, record_property) == {}


def as_found(plan: Planned, number: int, values: Mapping[tuple[str, float | None], float]) -> Planned:
    """Return a plan whose data sheet says of a channel what was found of it."""
    campaign: dict[str, Any] = copy.deepcopy(dict(plan.campaign))
    (channel,) = (entry for entry in campaign["channels"] if entry["number"] == number)
    channel["typical"] = {
        "bias_A": values["bias", 20.0],
        "bias_tc1_A_degC": values["bias_tc1", None],
        "hysteresis_width_A": values["hysteresis_width", None],
        "play_half_width_degC": values["play_half_width", None],
    }
    return replace(
        plan, campaign={**campaign, "channels": [channel], "thermal_lag_s": 60.0 * values["thermal_lag", None]}
    )


@pytest.mark.parametrize("number", [1, 7])
def test_what_is_predicted_is_what_the_ramp_states(ramp: Path, number: int) -> None:
    """Of the recorded short ramp, for a unit as it was found; the chamber of the run lags its program by minutes."""
    results = json.loads((ramp / "results.json").read_text(encoding="utf-8"))["estimates"]
    of_channel = {place(entry)[::2]: entry for entry in results if entry["conditions"].get("channel") == number}
    plan = planned("bias_ramp_short")
    found = of_ramp(as_found(plan, number, {where: entry["value"] for where, entry in of_channel.items()})).estimates
    shown = {place(entry)[::2]: entry for entry in found if entry["conditions"].get("channel") == number}
    assert shown.keys() == of_channel.keys()
    ratio = {where: entry["std_uncertainty"] / of_channel[where]["std_uncertainty"] for where, entry in shown.items()}
    sys.stdout.write(f"channel {number}: {ratio}\n")
    assert ratio.pop(("white_noise", None)) > 0.99  # the rest of the ramp had no instability; beforehand it may have
    assert list(ratio.values()) == pytest.approx([1.0] * len(ratio), abs=0.06)
    assert all(entry["limit"] == of_channel[where]["limit"] for where, entry in shown.items())


def test_the_plan_that_an_analysis_sees() -> None:
    """By hand: the air at the corners of the sequence, windows without a gap, all of them timed."""
    plan = planned("bias_ramp_25h")
    begin_s = plan.windows[0].t_start_ns * 1e-9
    hours = np.array([-0.5, 0.0, 2.0, 7.0, 12.0, 12.5, 13.0, 18.0, 23.0, 24.5])
    expected_degC = [-10.0, -10.0, -10.0, 20.0, 50.0, 50.0, 50.0, 20.0, -10.0, -10.0]
    air_degC = np.interp(begin_s + 3600.0 * hours, plan.trace.t_s, plan.trace.air_degC)
    np.testing.assert_allclose(air_degC, expected_degC, atol=1e-9)
    assert plan.trace.air_degC[0] == 23.0
    assert {window.frames for window in plan.windows} == {10_000}
    first = [window.first_counter for window in plan.windows]
    assert np.diff(first).tolist() == [10_000] * 899
    assert len(plan.timed) == 900
    assert not planned("bias_ramp_25h_integrated").timed


def test_without_a_typical_unit_nothing_is_predicted(tmp_path: Path) -> None:
    """The unit that a prediction holds for is said with it."""
    plan = compile_sequence("bias_ramp_25h", None, {})
    known = predicted(plan)
    assert known.missing == []
    (curve, gyro, _) = (line for line in predicted_lines(plan, known) if line.startswith("assumed: "))
    assert all(text in gyro for text in ("gyro", "400 nA", "2 nA/degC", "20 nA", "2.5 degC", "25 min"))
    assert "5e-05 ppm/degC3" in curve
    assert predicted_document(plan, known)["assumed"] == known.assumed
    text = (ROOT / "sequences" / "bias_ramp_25h.yaml").read_text(encoding="utf-8")
    for name, old in (("lag", "  thermal_lag: 25 min"), ("kind", "       typical: {bias: -255 nA")):
        (line,) = (line for line in text.splitlines() if line.startswith(old))
        path = tmp_path / f"{name}.yaml"
        path.write_text(text.replace(f"{line}\n", "    }\n" if name == "kind" else ""), encoding="utf-8")
        found = predicted(compile_sequence(str(path), None, {}))
        kinds = {entry["conditions"].get("kind") for entry in found.estimates} - {None}
        assert kinds == (set() if name == "lag" else {"gyro"})
        assert any("uut: " in sentence and "typical" in sentence for sentence in found.missing)


def changed(plan: Planned, **words: Any) -> Planned:
    """Return a plan whose first channel is declared otherwise."""
    channel = copy.deepcopy(dict(plan.campaign["channels"][0]))
    for section, values in words.items():
        channel[section] |= values
    return replace(plan, campaign={**plan.campaign, "channels": [channel]})


@pytest.mark.parametrize(
    ("windows", "words", "untold"),
    [
        (432, {}, {"hysteresis_width", "play_half_width", "thermal_lag"}),  # half a ramp: up alone
        (900, {"noise": {"walk_A_rth": 0.0}}, {"random_walk"}),
        (900, {"typical": {"hysteresis_width_A": 0.0}}, {"play_half_width"}),
    ],
)
def test_what_a_plan_or_a_unit_does_not_tell_is_named(windows: int, words: dict[str, Any], untold: set[str]) -> None:
    plan = planned("bias_ramp_25h")
    found = of_ramp(changed(replace(plan, windows=plan.windows[:windows]), **words))
    quantities = {entry["quantity"] for entry in found.estimates}
    assert "bias" in quantities
    assert not quantities & untold
    named = "branch down: no usable record" if windows < 900 else f"{min(untold)} of gyro channels"
    assert any(sentence.startswith(named) for sentence in found.missing)
    assert ("hysteresis_width" in quantities) == (windows == 900)


def test_coefficients_of_the_master_oscillator_are_known_as_the_sensor_lets_them() -> None:
    """By hand: a sensor that is off by 0.05 degC moves what lies on a cubic by its next derivative."""
    plan = planned("bias_ramp_25h")
    curve = {**plan.campaign, "master_curve_ppm": (0.0, 0.01, 1e-3)}
    std = {name: entry["std_uncertainty"] for entry in of_ramp(replace(plan, campaign=curve)).estimates
           if (name := entry["quantity"]).startswith("master_clock_error_tc")}  # fmt: skip
    assert std["master_clock_error_tc1"] == pytest.approx(2.0 * 0.01 * 0.05, rel=1e-3)
    assert std["master_clock_error_tc2"] == pytest.approx(3.0 * 1e-3 * 0.05, rel=1e-3)
    without = {name: value for name, value in plan.campaign.items() if name != "master_curve_ppm"}
    unknown = of_ramp(replace(plan, campaign=without))
    assert not [entry for entry in unknown.estimates if entry["quantity"] in std.keys() - {"master_clock_error_tc0"}]
    assert [sentence for sentence in unknown.missing if "declare 'master_curve'" in sentence] != []
