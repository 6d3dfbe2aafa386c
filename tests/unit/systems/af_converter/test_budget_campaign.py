"""Budgets of the scale-factor campaign: the totals of results.json, the correlation of real errors, the Monte Carlo."""

import dataclasses
from collections.abc import Callable
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
from one_estimate import every
from scipy import special

from bench.analysis import Material, analyse
from bench.maths.budget import combine_all
from bench.model.errors import FitError
from bench.systems.af_converter.constants import Campaign, Standards, read_campaign, read_standards
from bench.systems.af_converter.group_fit import Fitted, fit_groups
from bench.systems.af_converter.groups import campaign_rows, group_rows
from bench.systems.af_converter.scale_factor.budgets import (
    TRIALS,
    budget_tables,
    check_table,
    components_of,
    nearest_to_reference,
    trials_of,
)

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
