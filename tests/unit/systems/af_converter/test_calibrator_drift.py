"""Drift of the calibrator as the session shows it: a meter before and after, and the closing repeat."""

import sys
from collections.abc import Callable
from typing import Any

import fit_simulation as sim
import pytest

from bench.analysis import Analysis, Material, Reading, analyse

COMPONENT = "calibrator drift over the campaign"
LEVELS_A = {1e-3: 1e-3, 1e-2: 1e-2, 1e-1: 1e-1}  # level -> range of the meter
NOISE = (-1.2e-8, 0.3e-8, 0.9e-8)  # of the range, three readings


@pytest.fixture(scope="module")
def campaign() -> sim.SimulatedCampaign:
    return sim.simulate(21, sim.Switches(), repeat_channel=1)


def check(t_s: float, ppm: float) -> list[Reading]:
    """Three readings at each level, the calibrator off by ``ppm``, the meter by 7 ppm of its own."""
    found = []
    for level_A, range_A in LEVELS_A.items():
        conditions = {"check_level_A": level_A}
        found.append(Reading(t_s, 0, "dmm", "configure_current", range_A, conditions))
        for second, noise in enumerate(NOISE, 1):
            value_A = level_A * (1 + 1e-6 * (ppm + 7.0)) + noise * range_A
            found.append(Reading(t_s + second, 0, "dmm", "measure_current", value_A, conditions))
        t_s += 10.0
    return found


def times_s(campaign: sim.SimulatedCampaign) -> tuple[float, float]:
    windows = [row.window for row in campaign.rows]
    return 1e-9 * windows[0].t_start_ns - 100.0, 1e-9 * windows[-1].t_end_ns + 100.0


def run(
    campaign: sim.SimulatedCampaign, readings: list[Reading], repeat_ppm: float = 0.0, declared: float | None = None
) -> Analysis:
    rows = []
    for row in campaign.rows:
        factor = 1 + 1e-6 * repeat_ppm * row.window.conditions["repeat"]
        sums = row.sums | {name: row.sums[name] * factor for name in ("npp", "ppp")}
        rows.append(sim.Row(row.window, sums, row.context))
    standards: dict[str, Any] = {"calibrator": dict(campaign.standards["calibrator"])}
    if declared is not None:
        standards["calibrator"]["drift_relative"] = declared
    return analyse(Material(rows, campaign.campaign, standards, readings=readings))


def drifts(analysis: Analysis, kind: str) -> list[dict[str, Any]]:
    return [
        one for one in analysis.estimates
        if one["quantity"] == "calibrator_drift" and one["conditions"]["check"] == kind
    ]  # fmt: skip


def component_ppm(analysis: Analysis) -> float:
    found = {one["std_uncertainty_ppm"] for one in analysis.components if one["component"] == COMPONENT}
    assert len(found) == 1
    return float(found.pop())


def test_two_ppm_are_seen_by_the_meter_and_become_the_component(campaign: sim.SimulatedCampaign) -> None:
    before_s, after_s = times_s(campaign)
    analysis = run(campaign, check(before_s, 0.0) + check(after_s, 2.0))
    found = drifts(analysis, "check by the meter")
    assert [one["conditions"]["current_A"] for one in found] == [1e-3, 1e-2, 1e-1]
    for one in found:
        sys.stdout.write(f"{one['value']:.4f} +- {one['expanded_uncertainty']:.4f} ppm\n")
        assert one["value"] == pytest.approx(2.0, abs=1e-6)
        assert one["expanded_uncertainty"] < 0.05
        assert one["n"] == 6
    assert component_ppm(analysis) == pytest.approx(1.0, abs=0.03)
    assert any("Drift of the calibrator by the meter" in note and "+2.00 ppm" in note for note in analysis.notes)
    assert not any("stated without it" in note for note in analysis.notes)
    tc1 = next(one for one in analysis.estimates if one["quantity"] == "dsf_n_tc1")
    assert tc1["std_uncertainty"] == pytest.approx(1.0 / 60.0, rel=0.15)


@pytest.mark.parametrize(("declared", "expected_ppm"), [(1e-6, 1.0), (10e-6, 5.0)])
def test_the_larger_of_declared_and_seen_counts(
    campaign: sim.SimulatedCampaign, declared: float, expected_ppm: float
) -> None:
    before_s, after_s = times_s(campaign)
    analysis = run(campaign, check(before_s, 0.0) + check(after_s, 2.0), declared=declared)
    assert component_ppm(analysis) == pytest.approx(expected_ppm, abs=0.03)


def test_a_check_on_one_side_only_is_said_to_tell_nothing(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign, check(times_s(campaign)[0], 0.0))
    assert drifts(analysis, "check by the meter") == []
    assert any("on one side of the campaign only" in note for note in analysis.notes)


def test_a_meter_that_is_not_in_the_loop_shows_no_drift_at_all(campaign: sim.SimulatedCampaign) -> None:
    """Zero before and zero after would otherwise be a calibrator that stood still."""
    before_s, after_s = times_s(campaign)
    analysis = run(campaign, check(before_s, -1e6) + check(after_s, -1e6))
    assert drifts(analysis, "check by the meter") == []
    assert any("6 of 6 checks by the meter left out" in note for note in analysis.notes)


def carried_on(campaign: sim.SimulatedCampaign, repeat: dict[str, Any]) -> float:
    """Length of the campaign over the hours between a visit and its repeat."""
    begin_s, end_s = (edge + side for edge, side in zip(times_s(campaign), (100.0, -100.0), strict=True))
    return float((end_s - begin_s) / 3600.0 / repeat["conditions"]["hours"])


def test_closing_repeat_that_shows_nothing_bounds_the_whole_campaign(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign, [])
    (one,) = drifts(analysis, "closing repeat")
    assert abs(one["value"]) < one["expanded_uncertainty"] < 1.5
    assert one["conditions"]["hours"] == pytest.approx(1.0, abs=0.01)  # two channels of 15 points here
    bound_ppm = carried_on(campaign, one) * (abs(one["value"]) + one["expanded_uncertainty"])
    assert component_ppm(analysis) == pytest.approx(bound_ppm / 2)
    assert any("none is seen. A steady drift of less than" in note for note in analysis.notes)


@pytest.mark.validates(
    "drift of the calibrator from the closing repeat",
    against="3 ppm put into the counts of the repeat",
)
def test_closing_repeat_that_shows_a_change_is_carried_on_to_the_whole_campaign(
    record_property: Callable[[str, object], None],
    campaign: sim.SimulatedCampaign,
) -> None:
    """A calibrator 3 ppm up: 3 ppm more pulses of both kinds, a scale-factor error 3 ppm lower."""
    analysis = run(campaign, [], repeat_ppm=3.0)
    (one,) = drifts(analysis, "closing repeat")
    record_property("obtained", f"{one['value']:.3f} +- {one['expanded_uncertainty']:.3f} ppm")
    assert one["value"] == pytest.approx(3.0, abs=3 * one["std_uncertainty"])
    bound_ppm = carried_on(campaign, one) * (one["value"] + one["expanded_uncertainty"])
    assert component_ppm(analysis) == pytest.approx(bound_ppm / 2, rel=1e-6)


def test_visits_are_compared_by_the_points_that_both_hold() -> None:
    """More zeros in the first visit alone would leave the offsets of the ranges in the difference (2.8 ppm)."""
    campaign = sim.simulate(21, sim.Switches(zero_in_every_range=True), repeat_channel=1)
    campaign.rows = [
        row for row in campaign.rows
        if not (row.window.conditions["repeat"] and not row.window.conditions["current_A"]
                and row.window.conditions["range_A"] > 1e-3)
    ]  # fmt: skip
    (one,) = drifts(run(campaign, []), "closing repeat")
    assert one["n"] == 14
    assert one["expanded_uncertainty"] < 1.0


def test_a_unit_that_changed_is_told_from_a_calibrator_that_did(campaign: sim.SimulatedCampaign) -> None:
    before_s, after_s = times_s(campaign)
    steady = run(campaign, check(before_s, 0.0) + check(after_s, 0.0), repeat_ppm=5.0)
    assert any("the unit itself has changed" in note for note in steady.notes)
    assert component_ppm(steady) < 0.05
    quiet = run(campaign, check(before_s, 0.0) + check(after_s, 0.0))
    assert not any("the unit itself has changed" in note for note in quiet.notes)
