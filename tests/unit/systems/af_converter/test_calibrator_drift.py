"""Drift of the calibrator as the session shows it: a meter before and after, and the closing repeat."""

import sys
from collections.abc import Callable
from typing import Any

import fit_simulation as sim
import pytest
from one_estimate import every

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
    stated = {} if declared is None else {"drift_relative": declared}
    standards = {"calibrator": campaign.standards["calibrator"] | stated}
    return analyse(Material(sim.repeated_off(campaign, repeat_ppm), campaign.campaign, standards, readings=readings))


def component_ppm(analysis: Analysis) -> float:
    found = {one["std_uncertainty_ppm"] for one in analysis.components if one["component"] == COMPONENT}
    assert len(found) == 1
    return float(found.pop())


def test_two_ppm_are_seen_by_the_meter_and_become_the_component(campaign: sim.SimulatedCampaign) -> None:
    before_s, after_s = times_s(campaign)
    analysis = run(campaign, check(before_s, 0.0) + check(after_s, 2.0))
    found = every(analysis, "calibrator_drift", check="check by the meter")
    assert [one.conditions["current_A"] for one in found] == [1e-3, 1e-2, 1e-1]
    for one in found:
        sys.stdout.write(f"{one.value:.4f} +- {one.expanded_uncertainty:.4f} ppm\n")
        assert one.value == pytest.approx(2.0, abs=1e-6)
        assert one.expanded_uncertainty < 0.05
        assert one.n == 6
    assert component_ppm(analysis) == pytest.approx(1.0, abs=0.03)
    assert any("Drift of the calibrator by the meter" in note and "+2.00 ppm" in note for note in analysis.notes)
    assert not any("stated without it" in note for note in analysis.notes)
    tc1 = next(one for one in analysis.estimates if one.quantity == "dsf_n_tc1")
    assert tc1.std_uncertainty == pytest.approx(1.0 / 60.0, rel=0.15)


@pytest.mark.parametrize(("declared", "expected_ppm"), [(1e-6, 1.0), (10e-6, 5.0)])
def test_the_larger_of_declared_and_seen_counts(
    campaign: sim.SimulatedCampaign, declared: float, expected_ppm: float
) -> None:
    before_s, after_s = times_s(campaign)
    analysis = run(campaign, check(before_s, 0.0) + check(after_s, 2.0), declared=declared)
    assert component_ppm(analysis) == pytest.approx(expected_ppm, abs=0.03)


@pytest.mark.parametrize(
    ("levels_ppm", "said"),
    [
        ((0.0, None), "on one side of the campaign only"),
        ((-1e6, -1e6), "6 of 6 checks by the meter left out"),
    ],
)
def test_a_check_that_tells_nothing_is_named(
    campaign: sim.SimulatedCampaign, levels_ppm: tuple[float | None, ...], said: str
) -> None:
    """On one side only; by a meter that is not in the loop, whose zeros would be a calibrator that stood still."""
    edges = zip(times_s(campaign), levels_ppm, strict=True)
    analysis = run(campaign, [one for at_s, ppm in edges if ppm is not None for one in check(at_s, ppm)])
    assert every(analysis, "calibrator_drift", check="check by the meter") == []
    assert any(said in note for note in analysis.notes)


def carried_on(campaign: sim.SimulatedCampaign, repeat: dict[str, Any]) -> float:
    """Length of the campaign over the hours between a visit and its repeat."""
    begin_s, end_s = (edge + side for edge, side in zip(times_s(campaign), (100.0, -100.0), strict=True))
    return float((end_s - begin_s) / 3600.0 / repeat.conditions["hours"])


def test_closing_repeat_that_shows_nothing_bounds_the_whole_campaign(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign, [])
    (one,) = every(analysis, "calibrator_drift", check="closing repeat")
    assert abs(one.value) < one.expanded_uncertainty < 1.5
    assert one.conditions["hours"] == pytest.approx(1.0, abs=0.01)  # two channels of 15 points here
    bound_ppm = carried_on(campaign, one) * (abs(one.value) + one.expanded_uncertainty)
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
    (one,) = every(analysis, "calibrator_drift", check="closing repeat")
    record_property("obtained", f"{one.value:.3f} +- {one.expanded_uncertainty:.3f} ppm")
    assert one.value == pytest.approx(3.0, abs=3 * one.std_uncertainty)
    bound_ppm = carried_on(campaign, one) * (one.value + one.expanded_uncertainty)
    assert component_ppm(analysis) == pytest.approx(bound_ppm / 2, rel=1e-6)


def test_visits_are_compared_by_the_points_that_both_hold() -> None:
    """More zeros in the first visit alone would leave the offsets of the ranges in the difference (2.8 ppm)."""
    campaign = sim.simulate(21, sim.Switches(zero_in_every_range=True), repeat_channel=1)
    campaign.rows = [
        row for row in campaign.rows
        if not (row.window.conditions["repeat"] and not row.window.conditions["current_A"]
                and row.window.conditions["range_A"] > 1e-3)
    ]  # fmt: skip
    (one,) = every(run(campaign, []), "calibrator_drift", check="closing repeat")
    assert one.n == 14
    assert one.expanded_uncertainty < 1.0


def test_a_unit_that_changed_is_told_from_a_calibrator_that_did(campaign: sim.SimulatedCampaign) -> None:
    before_s, after_s = times_s(campaign)
    steady = run(campaign, check(before_s, 0.0) + check(after_s, 0.0), repeat_ppm=5.0)
    assert any("the unit itself has changed" in note for note in steady.notes)
    assert component_ppm(steady) < 0.05
    quiet = run(campaign, check(before_s, 0.0) + check(after_s, 0.0))
    assert not any("the unit itself has changed" in note for note in quiet.notes)
