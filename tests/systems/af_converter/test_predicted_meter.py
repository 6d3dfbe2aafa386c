"""Holds what is predicted of a campaign by the DMM method against the spread of simulated campaigns about their truth.

Seeds are 2000 to 2039, in the sweep 2000 to 2499. Gains of the ranges have one cause, which is what the stated
uncertainty is made for, and a reading has the noise of a digit, which the prediction takes for unknown scatter.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import dmm_simulation
import fit_simulation as sim
import numpy as np
import pytest
from spread_study import judged

from bench.analysis import Planned, Reading
from bench.plan import compile_sequence
from bench.session.predicted import planned_of, predicted
from bench.systems.af_converter.dmm_method.analysis import determine
from bench.systems.af_converter.dmm_method.estimates import DISPLAY_PART
from bench.systems.af_converter.dmm_method.predicted import predicted as by_meter

FIRST = 2000
Place = tuple[str, ...]


def place(entry: Mapping[str, Any]) -> Place:
    where = entry["conditions"]
    return (entry["quantity"], *(str(where.get(key, "")) for key in ("kind", "current_A", "polarity")))


def truth(campaign: sim.SimulatedCampaign, entry: dict[str, Any]) -> float:
    quantity, where = entry["quantity"], entry["conditions"]
    if quantity in ("switch_leakage", "repeat_shift"):
        return 0.0
    if quantity == "dsf_mean":
        return float(campaign.units[where["channel"]].dsf(where["unit_temperature_degC"]).mean())
    return campaign.truth(entry)


def planned(campaign: sim.SimulatedCampaign, readings: list[Reading]) -> Planned:
    """Return the plan of a simulated campaign: what was asked for, nothing of what came out."""
    calls = [
        Reading(one.t_s, one.step, one.role, one.name, None, one.conditions, {"range": one.value}) for one in readings
    ]
    given = dmm_simulation.material(campaign, readings, both=False)
    return Planned(campaign.windows, given.campaign, given.standards, readings=calls)


def ratios(campaigns: int) -> dict[Place, float]:
    """Root mean square of estimate minus truth over the predicted standard uncertainty."""
    expected: dict[Place, float] = {}
    found: dict[Place, list[float]] = {}
    for seed in range(FIRST, FIRST + campaigns):
        campaign, meter = dmm_simulation.simulate(seed, one_gain=True, noise=DISPLAY_PART)
        readings = dmm_simulation.readings_of(campaign, meter)
        if not expected:
            plan = planned(campaign, readings)
            expected = {place(entry): entry["std_uncertainty"] for entry in by_meter(plan).estimates}
        for entry in determine(dmm_simulation.material(campaign, readings, both=False), "joint").estimates:
            found.setdefault(place(entry), []).append(entry["value"] - truth(campaign, dict(entry)))
    assert found.keys() == expected.keys()
    return {where: float(np.sqrt(np.mean(np.square(errors)))) / expected[where] for where, errors in found.items()}


@pytest.mark.slow
@pytest.mark.validates(
    "uncertainties predicted from the plan of a campaign by the DMM method",
    against="the spread about the truth of 40 simulated campaigns, in the sweep of 500",
)
@pytest.mark.parametrize("campaigns", [40, pytest.param(500, marks=pytest.mark.sweep)])
def test_the_spread_of_campaigns_is_what_was_predicted(
    record_property: Callable[[str, object], None], campaigns: int
) -> None:
    """Each in its 99.9 % band of chi-square, the median within 3 % at 500."""
    assert judged(ratios(campaigns), campaigns, record_property) == {}


def test_the_meter_stands_on_the_range_that_was_asked_for() -> None:
    """20 ppm (95 %) of its good ranges and 110 of the largest: between 10 and 13 ppm, and 0.05 ppm of the asymmetry."""
    found = predicted(compile_sequence("dmm_method", None, {}))
    assert found.missing == []
    by_quantity: dict[str, list[float]] = {}
    for entry in found.estimates:
        by_quantity.setdefault(entry["quantity"], []).append(entry["std_uncertainty"])
    assert {name: len(values) for name, values in by_quantity.items()} == {
        "dsf_n": 10, "dsf_p": 10, "dsf_asymmetry": 10, "dsf_mean": 10, "bias": 10, "switch_leakage": 20,
        "repeat_shift": 20,
    }  # fmt: skip
    assert all(10.0 < std_ppm < 14.0 for std_ppm in by_quantity["dsf_n"])
    assert all(0.03 < std_ppm < 0.08 for std_ppm in by_quantity["dsf_asymmetry"])


def test_without_readings_of_the_meter_nothing_is_determined() -> None:
    plan = planned_of(compile_sequence("dmm_method", None, {}))
    kept = [reading for reading in plan.readings if reading.role != "dmm" or reading.conditions.get("channel") == 1]
    found = by_meter(Planned(plan.windows, plan.campaign, plan.standards, readings=kept))
    assert {entry["conditions"]["channel"] for entry in found.estimates} == {1}
    assert len([sentence for sentence in found.missing if "B-FIT-050" in sentence]) == 9
