"""Budgets of the scale-factor campaign: totals of results.json, correlation of real errors, Monte Carlo; temperature of
the unit in the fit: gaps in the housekeeping, a failing chamber, an inaccurate sensor."""

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
from fit_simulation import analysed as run
from one_estimate import every
from one_estimate import every as of
from scipy import special

from bench.analysis import Analysis, Material, analyse
from bench.maths.budget import combine_all
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.systems.af_converter.constants import Campaign, Standards, read_campaign, read_standards
from bench.systems.af_converter.group_fit import Fitted, fit_groups
from bench.systems.af_converter.groups import (
    LONGEST_REACH_s,
    campaign_rows,
    group_rows,
    unit_temperatures,
)
from bench.systems.af_converter.scale_factor.budgets import (
    TRIALS,
    budget_tables,
    check_table,
    components_of,
    nearest_to_reference,
    trials_of,
)
from bench.systems.af_converter.scale_factor.estimates import Determined, determine

SEED = 3
STATED = {"traceability_relative": 10e-6, "drift_relative": 4e-6}
TEMPERATURES = [sim.TEMPERATURES_degC, (20.0,)]  # one gives no coefficients
SENSOR = {"temperature_sensor_u95_degC": 0.1}


def sections(campaign: sim.SimulatedCampaign) -> tuple[dict[str, Any], dict[str, Any]]:
    return campaign.campaign | SENSOR, {"calibrator": campaign.standards["calibrator"] | STATED}


def fitted(
    campaign: sim.SimulatedCampaign, method: str = "gls", given: tuple[dict[str, Any], dict[str, Any]] | None = None
) -> tuple[Fitted, Campaign, Standards]:
    section, register = given or sections(campaign)
    constants, standards = read_campaign(section), read_standards(register)
    groups = group_rows(campaign_rows(campaign.rows), constants.master_Hz)
    return fit_groups(groups, constants, standards, method), constants, standards


@pytest.mark.parametrize("method", ["gls", "paper", "ols"])
def test_budgets_have_the_totals_of_the_results(method: str) -> None:
    campaign = sim.simulate(SEED)
    section, register = sections(campaign)
    analysis = analyse(Material(campaign.rows, section, register), method)
    groups, constants, standards = fitted(campaign, method)
    stated = {
        (one.quantity, one.conditions["channel"], one.conditions["temperature_degC"]): one
        for one in analysis.estimates
        if one.quantity in ("dsf_n", "dsf_p")
    }
    assert len(stated) == 20
    for index, quantity in enumerate(("dsf_n", "dsf_p")):
        for one in groups.groups:
            parts = components_of(one, index, groups, constants, standards)
            budget = combine_all({"": parts}).budgets[""]
            entry = stated[quantity, one.group.channel, one.group.temperature_degC]
            assert budget.std_uncertainty == pytest.approx(entry.std_uncertainty, rel=1e-12)
            assert budget.coverage_factor == entry.coverage_factor
            assert budget.expanded_uncertainty == pytest.approx(entry.expanded_uncertainty, rel=1e-12)


@pytest.mark.parametrize("degrees", [3.0, 8.0])
def test_degrees_of_freedom_of_the_certificate_reach_every_total(degrees: float) -> None:
    """The gain of 10 ppm makes most of U: by hand, 10 and 5 ppm of 3 degrees in the combined u; the budget agrees."""
    campaign = sim.simulate(SEED)
    section, register = sections(campaign)
    plain = analyse(Material(campaign.rows, section, register))
    register["calibrator"] = register["calibrator"] | {"dof": degrees}
    register["function_generator"] = {"uncertainty": [{"relative": 2e-6}], "dof": 4.0}
    analysis = analyse(Material(campaign.rows, section, register))
    groups, constants, standards = fitted(campaign, "gls", (section, register))
    budget = combine_all({"": components_of(groups.groups[0], 0, groups, constants, standards)}).budgets[""]
    entry, before = next(pair for pair in zip(analysis.estimates, plain.estimates, strict=True))
    assert entry.quantity == "dsf_n"
    assert entry.std_uncertainty == before.std_uncertainty
    assert before.dof is None
    assert entry.dof == pytest.approx(budget.dof, rel=1e-9)
    by_hand = entry.std_uncertainty**4 / ((10.0**4 + 5.0**4) / degrees)
    assert entry.dof == pytest.approx(by_hand, rel=0.02)  # the offsets of the ranges bring the rest
    assert entry.coverage_factor == pytest.approx(special.stdtrit(entry.dof, 0.975))
    finite = {one.quantity: one.dof for one in analysis.estimates if one.dof is not None}
    assert finite.pop("master_clock_error") == pytest.approx(4.0, rel=1e-2)
    assert finite.keys() == {
        *("dsf_n", "dsf_p", "dsf_asymmetry", "dsf_n_residual", "dsf_p_residual"),
        *(f"dsf_{side}_tc{order}" for side in "np" for order in range(3)),
    }
    (table,) = [table for table in analysis.tables if table.title == "Monte Carlo check of dsf_n"]
    assert "differs" not in {row[-1] for row in table.rows} or degrees < 5.0
    register["calibrator"] = register["calibrator"] | {"dof": 0.5}
    with pytest.raises(FitError, match="at least 1 is due"):
        analyse(Material(campaign.rows, section, register))


def test_components_are_shown_with_the_uncertainty_of_one_reading() -> None:
    """By hand, for a gyroscope: 1.25 uC in 100 s over sqrt(6) is 5.10 nA, 2 nA/sqrt(Hz) over 100 s 0.14 nA."""
    groups, constants, standards = fitted(sim.simulate(SEED))
    one = next(one for one in groups.groups if constants.channel(one.group.channel).kind == "gyro")
    shown = {part.name: part.std_uncertainty for part in components_of(one, 0, groups, constants, standards)}
    assert shown["quantisation of the counts"] == pytest.approx(5.103, abs=5e-3)
    assert shown["white noise of the converter"] == pytest.approx(0.1414, abs=5e-4)
    assert shown["calibrator gain, common to all rows"] == pytest.approx(10.0)
    assert shown["calibrator traceability, calibration of all ranges"] == pytest.approx(5.0)
    assert shown["calibrator drift over the campaign"] == pytest.approx(2.0)
    assert shown["temperature sensor of the unit"] == pytest.approx(0.05)


def test_tables_show_every_contribution_and_the_total() -> None:
    """Two quantities of the two channels at the temperature nearest to the reference; what is not stated is no line."""
    campaign = sim.simulate(SEED)
    groups, constants, standards = fitted(campaign)
    nearest = nearest_to_reference(groups, constants)
    assert [(one.group.channel, one.group.temperature_degC) for one in nearest] == [(1, 20.0), (2, 20.0)]
    tables = budget_tables(groups, constants, standards, "gls")
    assert sum(one.title.startswith("Correlation of") for one in tables) == 2
    whole = [one for one in tables if one.title.startswith("Uncertainty budget of dsf_")]
    assert [one.title.partition(", channel ")[2][0] for one in whole] == ["1", "2", "1", "2"]
    stated = {"calibrator traceability, calibration of all ranges", "calibrator drift over the campaign"}
    for table in whole:
        total = sum(_number(row[4]) ** 2 for row in table.rows[:-1])
        assert float(table.rows[-1][4]) == pytest.approx(np.sqrt(total), rel=5e-3)
        for u, sensitivity, contribution in ([_number(row[at]) for at in (1, 3, 4)] for row in table.rows[:-1]):
            assert u * sensitivity == pytest.approx(contribution, rel=2e-2)
        assert sum(float(row[5].split()[0]) for row in table.rows[:-1]) == pytest.approx(100.0, abs=0.1)
        assert stated <= {row[0] for row in table.rows}
    silent = budget_tables(*fitted(campaign, "gls", (campaign.campaign, campaign.standards)), "gls")
    assert not stated & {row[0] for table in silent for row in table.rows}


@pytest.mark.validates(
    "correlation of scale factors between channels",
    against="errors of 400 simulated campaigns",
)
@pytest.mark.slow
def test_stated_correlation_is_that_of_the_errors(record_property: Callable[[str, object], None]) -> None:
    """Seeds 1000 to 1399, one temperature, channels of two kinds that share the calibrator's gain."""
    errors, stated = [], []
    for seed in range(1000, 1400):
        campaign = sim.simulate(seed, sim.Switches(lag=False), temperatures=(20.0,))
        groups, constants, standards = fitted(campaign, "gls", (campaign.campaign, campaign.standards))
        errors.append([one.fit.dsf_ppm[0] - campaign.units[one.group.channel].dsf(20.0)[0] for one in groups.groups])
        parts = {str(one.group.channel): components_of(one, 0, groups, constants, standards) for one in groups.groups}
        stated.append(combine_all(parts).correlation[0, 1])
    found = float(np.corrcoef(np.array(errors).T)[0, 1])
    print(f"correlation of the errors {found:.4f}, stated {np.mean(stated):.4f}")
    record_property("obtained", f"stated {np.mean(stated):.4f}, errors {found:.4f}")
    # Fisher: 1/sqrt(397) in artanh
    assert np.arctanh(found) == pytest.approx(np.arctanh(np.mean(stated)), abs=3.5 / np.sqrt(397))
    assert np.mean(stated) > 0.95


@pytest.mark.parametrize("method", ["gls", "ols"])
def test_trials_agree_with_the_budget(method: str) -> None:
    groups, constants, standards = fitted(sim.simulate(SEED), method)
    members = nearest_to_reference(groups, constants)
    for one in members:
        budget = combine_all({"": components_of(one, 0, groups, constants, standards)}).budgets[""]
        found = trials_of(one, groups, constants, standards, method)
        assert found.trials == TRIALS
        assert found.mean == pytest.approx(one.fit.dsf_ppm[0], abs=5 * budget.std_uncertainty / np.sqrt(TRIALS))
        assert found.std == pytest.approx(budget.std_uncertainty, rel=0.01)
        (row,) = check_table([(one, budget)], groups, constants, standards, method).rows
        assert row[-1] == "agrees"


@pytest.mark.validates(
    "a budget without the calibrator's gain is noticed",
    against="Monte Carlo propagation of every input through the fit",
)
def test_trials_notice_a_budget_without_the_common_gain() -> None:
    groups, constants, standards = fitted(sim.simulate(SEED))
    one = nearest_to_reference(groups, constants)[0]
    parts = [part for part in components_of(one, 0, groups, constants, standards) if part.common != "gain"]
    (row,) = check_table([(one, combine_all({"": parts}).budgets[""])], groups, constants, standards, "gls").rows
    assert row[-1] == "differs"


@pytest.mark.parametrize("temperatures", TEMPERATURES)
def test_trials_hold_the_noise_and_the_ranges_alone(temperatures: tuple[float, ...]) -> None:
    """Gain, traceability, drift and sensor off: what is left is the covariance of the fit.

    Of one temperature, the coefficients that nobody knows are part of it.
    """
    groups, constants, standards = fitted(sim.simulate(SEED, temperatures=temperatures))
    quiet = dataclasses.replace(
        standards,
        drift=None,
        ranges={
            at: dataclasses.replace(entry, relative=0.0, calibration=None) for at, entry in standards.ranges.items()
        },
    )
    still = constants.model_copy(update={"temperature_sensor_u95_degC": 0.0})
    for one in nearest_to_reference(groups, constants):
        found = trials_of(one, groups, still, quiet, "gls")
        assert found.std == pytest.approx(np.sqrt(one.fit.covariance_ppm2[0, 0]), rel=0.01)


def _number(text: str) -> float:
    """A number as it is printed."""
    figures, _, power = text.replace("−", "-").replace("\u202f", "").partition("·10")
    return float(figures) * 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or "0")


@pytest.mark.parametrize("temperatures", TEMPERATURES)
def test_tables_of_a_campaign_with_a_closing_repeat_have_its_totals(temperatures: tuple[float, ...]) -> None:
    """Whatever the repeat says about drift: the table by channel shows the U of results.json, to its two digits."""
    campaign = sim.simulate(SEED, temperatures=temperatures, repeat_channel=1)
    analysis = analyse(Material(campaign.rows, *sections(campaign)))
    for quantity in ("dsf_n", "dsf_p"):
        (table,) = [one for one in analysis.tables if one.title == f"Uncertainty of {quantity} by channel"]
        stated = every(analysis, quantity, temperature_degC=20.0)
        shown = {str(one.conditions["channel"]): f"{one.expanded_uncertainty:.2g}" for one in stated}
        assert {row[0]: row[-1] for row in table.rows} == shown


UNIT_SEED = 21
# Campaigns, and how far the size of scores may be from 1: a factor of sqrt 2 is seen by 50, one of 1.2 by 150.
COVERAGE_TRIALS = pytest.mark.parametrize(
    ("trials", "margin"), [(50, 0.25), pytest.param(150, 0.15, marks=pytest.mark.sweep)], ids=["short", "long"]
)
SCALE_FACTORS = ("dsf_n", "dsf_p", "dsf_asymmetry")


def without_housekeeping(campaign: sim.SimulatedCampaign, lost: Callable[[sim.Row], bool]) -> sim.SimulatedCampaign:
    rows = [replace(row, context={}, quality=Quality.STALE) if lost(row) else row for row in campaign.rows]
    return replace(campaign, rows=rows)


@pytest.fixture
def campaign() -> sim.SimulatedCampaign:
    return sim.simulate(UNIT_SEED, sim.Switches())


def worst_score(analysis: Analysis, campaign: sim.SimulatedCampaign, quantities: tuple[str, ...]) -> float:
    return max(abs(score) for name in quantities for score in scores_of(analysis, campaign, name, channel=1))


def scores_of(
    analysis: Analysis | Determined, campaign: sim.SimulatedCampaign, quantity: str, **conditions: Any
) -> list[float]:
    """Errors over stated standard uncertainties."""
    found = of(analysis, quantity, **conditions)
    return [(one.value - campaign.truth(one)) / one.std_uncertainty for one in found]


def determined(campaign: sim.SimulatedCampaign, **changes: Any) -> Determined:
    """Return what the fit finds, before anything doubts it; ``changes`` are of the manifest."""
    return determine(Material(campaign.rows, campaign.campaign | changes, campaign.standards), "gls")


def test_half_of_the_housekeeping_missing_moves_nothing(campaign: sim.SimulatedCampaign) -> None:
    holes = without_housekeeping(
        campaign, lambda row: row.window.conditions["channel"] == 1 and row.window.number % 2 == 0
    )
    analysis = run(holes)
    assert worst_score(analysis, holes, SCALE_FACTORS) < 4.0
    assert any(
        "records without housekeeping: their unit temperature is interpolated" in note for note in analysis.notes
    )
    first = of(analysis, "dsf_n", channel=1, temperature_degC=-10.0)[0]
    assert (first.n, first.dropped) == (14, 0)


def test_interpolation_is_close_and_its_uncertainty_covers_the_error(campaign: sim.SimulatedCampaign) -> None:
    holes = without_housekeeping(campaign, lambda row: row.window.number % 5 in (2, 3, 4))
    known = unit_temperatures(holes.rows)
    pairs = [
        (known[row.window.number], row.context["unit_temperature_degC"])
        for row, hole in zip(campaign.rows, holes.rows, strict=True)
        if not hole.context and row.window.number in known
    ]
    errors = [abs(one.value_degC - true_degC) for one, true_degC in pairs]
    assert len(errors) > 80
    assert all(error < one.std_degC and one.std_degC >= 0.05 for error, (one, _) in zip(errors, pairs, strict=True))


def test_records_of_one_gap_share_an_error_and_those_of_two_do_not(campaign: sim.SimulatedCampaign) -> None:
    holes = without_housekeeping(campaign, lambda row: row.window.number in (5, 6, 8))
    (first, *_) = group_rows(campaign_rows(holes.rows), sim.MASTER_Hz)
    gaps = dict(zip(first.numbers, first.closed.temperature_gap.tolist(), strict=True))
    assert gaps[5] == gaps[6] != gaps[8]
    assert {gaps[number] for number in (2, 3, 4, 7)} == {0}
    assert np.flatnonzero(first.closed.temperature_std_degC).size == 3


def test_an_interpolated_temperature_costs_certainty(campaign: sim.SimulatedCampaign) -> None:
    constants, register = read_campaign(campaign.campaign), read_standards(campaign.standards)
    holes = without_housekeeping(campaign, lambda row: row.window.number in (10, 11, 12, 13))

    def std_ppm(rows: Any) -> float:
        found = fit_groups(group_rows(campaign_rows(rows), constants.master_Hz), constants, register, "ols")
        return float(np.sqrt(found.groups[0].fit.noise_ppm2[0, 0]))

    assert std_ppm(holes.rows) > 1.005 * std_ppm(campaign.rows)


@pytest.mark.parametrize(("apart_s", "found"), [(LONGEST_REACH_s, True), (LONGEST_REACH_s + 1, False)])
@pytest.mark.parametrize("side", [0, 2])
def test_reach_of_the_interpolation(campaign: sim.SimulatedCampaign, apart_s: float, found: bool, side: int) -> None:
    """In time, and neither to another link nor to another set-point."""
    starts_s = [1000.0, 1120.0, 1240.0]
    starts_s[side] = starts_s[1] + (apart_s if side else -apart_s)
    rows = [
        replace(
            row,
            context={} if index == 1 else {"unit_temperature_degC": -10.0 + index},
            window=replace(
                row.window, t_start_ns=round(1e9 * starts_s[index]), t_end_ns=round(1e9 * starts_s[index]) + 10**11
            ),
        )
        for index, row in enumerate(campaign.rows[:3])
    ]
    known = unit_temperatures(rows)
    assert (2 in known) == found
    assert {1, 3} <= known.keys()
    if found:
        share = (starts_s[1] - starts_s[0]) / (starts_s[2] - starts_s[0])
        assert known[2].value_degC == pytest.approx(-10.0 + 2 * share)
        assert known[2].std_degC == pytest.approx(np.hypot(2 / np.sqrt(12), 0.05))
    warmer = rows[2].window.conditions | {"temperature_degC": 5.0}
    for change in ({"link": "port_c"}, {"conditions": warmer}):
        other = replace(rows[2], window=replace(rows[2].window, **change))
        assert 2 not in unit_temperatures([*rows[:2], other])


def test_groups_without_temperatures_are_refused_by_name(campaign: sim.SimulatedCampaign) -> None:
    """The first temperature without any housekeeping: no result there, all else stands and is unbiased."""
    cold = without_housekeeping(campaign, lambda row: row.window.conditions["temperature_degC"] == -10.0)
    analysis = run(cold)
    assert [place.split(":")[0] for place in analysis.missing] == ["channel 1 at -10 degC", "channel 2 at -10 degC"]
    assert all("15 without a unit temperature" in one and "B-FIT-012" in one for one in analysis.missing)
    assert any("30 records left out of the fits: without a unit temperature" in note for note in analysis.notes)
    assert of(analysis, "dsf_n", temperature_degC=-10.0) == []
    assert worst_score(analysis, cold, SCALE_FACTORS) < 4.0
    (clock,) = of(analysis, "clock_ratio_error", temperature_degC=-10.0)
    assert "unit_temperature_degC" not in clock.conditions
    with pytest.raises(FitError, match="without a unit temperature") as caught:
        run(without_housekeeping(campaign, lambda _: True))
    assert (caught.value.code, caught.value.where) == ("B-FIT-012", "channel 1 at -10 degC")


def test_a_chamber_that_fails_leaves_no_result_under_its_set_point(campaign: sim.SimulatedCampaign) -> None:
    """Records flagged by the cutter, and one whose interpolated temperature is off, count as not settled."""
    for index, row in enumerate(campaign.rows):
        conditions = row.window.conditions | {"settle_band_degC": 1.0}
        change: dict[str, Any] = {"window": replace(row.window, conditions=conditions)}
        if conditions["temperature_degC"] == 50.0 and conditions["channel"] == 2:
            stale = row.window.number % 2
            change["context"] = {} if stale else {"unit_temperature_degC": 40.0}
            change["quality"] = Quality.STALE if stale else Quality.NOT_SETTLED
        campaign.rows[index] = replace(row, **change)
    analysis = run(campaign)
    (missing,) = analysis.missing
    assert missing.startswith("channel 2 at 50 degC:")
    assert "not settled" in missing
    assert f"No result: {missing}" in analysis.notes
    assert len(of(analysis, "dsf_n")) == 9


@COVERAGE_TRIALS
def test_sensor_of_the_unit_is_in_the_uncertainty(trials: int, margin: float) -> None:
    """A thermometer off by 1 degC (one sigma), the same in a campaign: it is declared, and scores keep unit size."""
    quantities = (*SCALE_FACTORS, "dsf_n_tc0", "dsf_n_tc1", "dsf_n_tc2", "bias_tc0")
    scores: dict[str, list[float]] = {name: [] for name in quantities}
    switches = sim.Switches(gain=False, sensor_sigma_degC=1.0)
    for seed in range(trials):
        campaign = sim.simulate(seed, switches)
        for entry in campaign.standards["calibrator"]["uncertainty"]:
            entry["relative"] = 1e-9
        known = determined(campaign, temperature_sensor_u95_degC=2.0)
        for name in quantities:
            scores[name] += scores_of(known, campaign, name)
    rms = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in scores.items()}
    assert all(1.0 - margin < value < 1.0 + margin for value in rms.values())


def test_a_unit_that_still_warms_while_it_is_measured_is_told(campaign: sim.SimulatedCampaign) -> None:
    """The first visit of a temperature ends 0.4 degC warmer than it begins; one that has settled is not mentioned."""
    (note,) = [note for note in run(campaign).notes if note.startswith("A soak was short")]
    assert "changes by +0." in note
    settled = sim.simulate(UNIT_SEED, sim.Switches(lag=False))
    assert not any(note.startswith("A soak was short") for note in run(settled).notes)
