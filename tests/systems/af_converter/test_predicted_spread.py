"""Holds predicted uncertainties of a scale-factor campaign against the scatter of what campaigns find, about the truth.

The worlds have every error that the prediction counts, each as large as it is declared. Residuals after compensation
are left out: they are wrong by what the scale-factor error itself is wrong.
"""

from __future__ import annotations

import statistics
import sys
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
from scipy import stats

from bench.analysis import Material, Planned
from bench.systems.af_converter.scale_factor.estimates import determine
from bench.systems.af_converter.scale_factor.predicted import predicted

DRIFT = 2e-6  # of the calibrator, 95 %, declared: seen in temperature coefficients, hardly in scale-factor errors
LENGTH_s, RECORDS_s = (
    5 * 9000.0 + 10 * 15 * 120.0,
    4 * 9000.0 + 10 * 15 * 120.0 - 3 * 120.0,
)  # of it, and of closed rows
SWITCHES = sim.Switches(gain_drift_sigma=DRIFT / 2.0 * LENGTH_s / RECORDS_s)
STEADY = sim.Switches(gain_drift_sigma=DRIFT / 2.0, generator_sigma=3e-6 / 3**0.5, same_cut=True, lag=False)
FEW_degC = (5.0, 20.0)
FEW_s, BETWEEN_s = 2 * 9000.0 + 5 * 15 * 120.0, 2 * 15 * 120.0  # few temperatures: all of it, and between visits
INSIDE = 0.999
Place = tuple[str, str, str]


def campaigns_of(seed: int) -> tuple[sim.SimulatedCampaign, sim.SimulatedCampaign]:
    """Return a campaign of five temperatures, and one of few temperatures for the clocks and a closing repeat.

    The drift that a repeat leaves possible would widen all others, and equal cuts of a clock cancel in the asymmetry.
    """
    both = sim.simulate(seed, SWITCHES), sim.simulate(seed, STEADY, temperatures=FEW_degC, repeat_channel=1)
    for campaign in both:
        campaign.standards["calibrator"]["drift_relative"] = DRIFT
    return both


def place_of(entry: Any) -> Place:
    where = entry["conditions"]
    return entry["quantity"], str(where.get("kind", "")), str(where.get("temperature_degC", ""))


def truth_of(campaign: sim.SimulatedCampaign, entry: Any) -> float:
    """Return the true value of an estimate; a calibrator that delivers more looks like a smaller charge per pulse."""
    if not entry["quantity"].endswith("_drift"):
        return campaign.truth(entry)
    drift_ppm = 1e6 * campaign.drift * BETWEEN_s / FEW_s
    return drift_ppm if entry["quantity"] == "calibrator_drift" else -drift_ppm


def counted(entry: Any, few: bool) -> bool:
    """Return whether an estimate is taken from the campaign of few temperatures, or from the other one."""
    of_few = entry["quantity"].endswith("_drift") or "clock" in entry["quantity"]
    return not entry["quantity"].endswith("_residual") and of_few is few


def ratios_of(count: int) -> dict[Place, float]:
    """Return RMS error over predicted standard uncertainty of each estimate over campaigns of seeds from 0 on."""
    expected = {
        place_of(entry): entry["std_uncertainty"]
        for few, campaign in enumerate(campaigns_of(0))
        for entry in predicted(Planned(campaign.windows, campaign.campaign, campaign.standards)).estimates
        if counted(entry, bool(few))
    }
    scores: dict[Place, list[float]] = {place: [] for place in expected}
    for seed in range(count):
        for few, campaign in enumerate(campaigns_of(seed)):
            known = determine(Material(campaign.rows, campaign.campaign, campaign.standards), "gls")
            for entry in known.estimates:
                if counted(entry, bool(few)):
                    place = place_of(entry)
                    scores[place].append((entry["value"] - truth_of(campaign, entry)) / expected[place])
    assert {len(each) for each in scores.values()} == {count}
    return {place: float(np.sqrt(np.mean(np.square(each)))) for place, each in scores.items()}


@pytest.mark.slow
@pytest.mark.validates(
    "uncertainties predicted from the plan of a scale-factor campaign",
    against="the scatter of simulated campaigns about their truth",
)
@pytest.mark.parametrize("campaigns", [60, pytest.param(500, marks=pytest.mark.sweep)])
def test_predicted_uncertainty_is_the_scatter_of_campaigns(campaigns: int, record_property: Any) -> None:
    """Of all places at most as many as chance allows leave the 99.9 % band of chi-square."""
    found = ratios_of(campaigns)
    low, high = (np.sqrt(stats.chi2.ppf(end, campaigns) / campaigns) for end in ((1 - INSIDE) / 2, (1 + INSIDE) / 2))
    by_quantity: dict[tuple[str, str], list[float]] = {}
    for (quantity, kind, _), ratio in found.items():
        by_quantity.setdefault((quantity, kind), []).append(ratio)
    for (quantity, kind), each in by_quantity.items():
        sys.stdout.write(f"{quantity} {kind}: {min(each):.3f} to {max(each):.3f} ({len(each)} places)\n")
    outside = {place: ratio for place, ratio in found.items() if not low <= ratio <= high}
    middle = statistics.median(statistics.mean(each) for each in by_quantity.values())
    within = f"{len(outside)} of {len(found)} outside {low:.3f} to {high:.3f}"
    figure = f"{campaigns} campaigns: {within}, median {middle:.3f}"
    record_property("obtained", figure)
    sys.stdout.write(f"{figure}: {outside}\n")
    assert len(outside) <= stats.binom.ppf(INSIDE, len(found), 1 - INSIDE)
    assert middle == pytest.approx(1.0, abs=0.03 * np.sqrt(500 / campaigns))
