"""Scale-factor campaigns of one temperature whose unit is still warming up: nobody knows its temperature coefficients.

The campaigns are those of ``fit_simulation``: the unit warms by 0.43 degC with a lag of 25 min. Its
calibrator is steady.
"""

import sys
from collections.abc import Callable
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
from scipy import stats

from bench.analysis import Analysis, Estimates, Material, Planned
from bench.systems.af_converter.group_fit import UNKNOWN_SLOPE_ppm_degC
from bench.systems.af_converter.scale_factor.analysis import analyse
from bench.systems.af_converter.scale_factor.estimates import determine
from bench.systems.af_converter.scale_factor.predicted import predicted
from bench.systems.af_converter.wording import say

CAMPAIGNS = 60  # seeds from 0 on
INSIDE = 0.999
CHANGES = ("calibrator_drift", "dsf_n_drift", "dsf_p_drift")
OF_ONE: dict[str, Any] = {"temperatures": (20.0,), "repeat_channel": 1}


def material_of(campaign: sim.SimulatedCampaign) -> Material:
    return Material(campaign.rows, campaign.campaign, campaign.standards)


def planned(campaign: sim.SimulatedCampaign) -> Planned:
    return Planned(campaign.windows, campaign.campaign, campaign.standards)


def scores_of(slope_ppm_degC: float) -> dict[str, list[float]]:
    """Return error over standard uncertainty of each scale factor and change, by quantity; the calibrator is steady."""
    scores: dict[str, list[float]] = {}
    for seed in range(CAMPAIGNS):
        campaign = sim.simulate(seed, sim.Switches(tc1_sigma_ppm_degC=slope_ppm_degC), **OF_ONE)
        for entry in determine(material_of(campaign), "gls").estimates:
            quantity = entry.quantity
            if quantity.startswith("dsf") or quantity in CHANGES:
                truth = 0.0 if quantity in CHANGES else campaign.truth(entry)
                scores.setdefault(quantity, []).append((entry.value - truth) / entry.std_uncertainty)
    return scores


def drifts(estimates: Estimates) -> dict[str, Any]:
    return {entry.quantity: entry for entry in estimates if entry.quantity in CHANGES}


@pytest.mark.validates(
    "changes between visits and scale factors of a campaign of one temperature",
    against="60 simulated campaigns of units that warm by 0.43 degC, coefficients of 8 ppm/degC",
)
def test_intervals_hold_the_truth_while_the_unit_warms(record_property: Callable[[str, object], None]) -> None:
    """At least as many as chance leaves of 95 %: before, 0.48 to 0.62 of the changes and 0.05 of the asymmetries."""
    held = {name: [abs(score) <= 1.96 for score in each] for name, each in scores_of(8.0).items()}
    said = ", ".join(f"{name} {np.mean(each):.3f} of {len(each)}" for name, each in held.items())
    sys.stdout.write(f"seeds 0 to {CAMPAIGNS - 1}: {said}\n")
    record_property("obtained", said)
    assert held.keys() >= {*CHANGES, "dsf_n", "dsf_p", "dsf_asymmetry"}
    for name, each in held.items():
        assert sum(each) >= stats.binom.ppf(1.0 - INSIDE, len(each), 0.95), name


def test_uncertainties_are_those_of_the_coefficients_that_they_count() -> None:
    """Of units drawn with coefficients as large as nobody's, the scatter is the stated one, neither less nor more."""
    for name, each in scores_of(UNKNOWN_SLOPE_ppm_degC).items():
        low, high = stats.chi2.ppf([(1 - INSIDE) / 2, (1 + INSIDE) / 2], len(each)) / len(each)
        sys.stdout.write(f"{name}: {np.mean(np.square(each)):.3f}, {low:.3f} to {high:.3f}\n")
        if name not in ("dsf_n", "dsf_p"):  # their largest part is the calibrator's gain, which both kinds share
            assert low < np.mean(np.square(each)) < high, name


def run(drift_ppm: float, *, lag: bool) -> Analysis:
    """Return the analysis of a campaign whose calibrator delivers more in the repeat."""
    campaign = sim.simulate(4, sim.Switches(lag=lag), **OF_ONE)
    return analyse(Material(sim.repeated_off(campaign, drift_ppm), campaign.campaign, campaign.standards))


def component_ppm(analysis: Analysis) -> float:
    parts = (one for one in analysis.components if one["component"] == "calibrator drift over the campaign")
    return max((one["std_uncertainty_ppm"] for one in parts), default=0.0)


def test_a_steady_unit_shows_a_drift_and_it_counts() -> None:
    found = run(4.0, lag=False)
    drift = drifts(found.estimates)["calibrator_drift"]
    assert drift.value == pytest.approx(4.0, abs=drift.expanded_uncertainty)
    assert drift.expanded_uncertainty < 1.0
    assert component_ppm(found) > 2.0
    assert any("this is the drift of the calibrator in the budget" in note for note in found.notes)


def test_what_warming_can_explain_bounds_no_drift_and_says_so() -> None:
    found = run(4.0, lag=True)
    assert drifts(found.estimates)["calibrator_drift"].expanded_uncertainty > 20.0
    assert component_ppm(found) == 0.0
    (note,) = [note for note in found.notes if "cannot be told apart" in note]
    assert "temperature differed by +0.24 degC" in note
    assert any("a drift over the campaign is not included" in note for note in found.notes)
    assert component_ppm(run(100.0, lag=True)) > 50.0, "no coefficient makes as much of so little warming"


def test_the_prediction_names_what_warming_may_be() -> None:
    campaign = sim.simulate(4, **OF_ONE)
    found = predicted(planned(campaign))
    assert drifts(found.estimates) == {}
    assert {"dsf_n", "dsf_asymmetry", "bias"} <= {entry.quantity for entry in found.estimates}
    assert found.missing == [say("predicted.untold", place="channel 1 at 20 degC, repeat 1", step=1.0)]
    assert found.assumed == [say("predicted.steady", step=1.0)]
    several = predicted(planned(sim.simulate(4, temperatures=(5.0, 20.0), repeat_channel=1)))
    assert drifts(several.estimates).keys() == set(CHANGES)
    assert (several.missing, several.assumed) == ([], [])
