"""Verdicts of the residual after compensation: reachable, judged with the guard band, absent where nothing is left."""

import copy
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest

from bench.analysis import Analysis, Material, analyse

SEED = 5
RESIDUALS = ("dsf_n_residual", "dsf_p_residual")


def run(campaign: sim.SimulatedCampaign, **changes: Any) -> Analysis:
    return analyse(Material(campaign.rows, campaign.campaign | changes, campaign.standards))


def of(analysis: Analysis, *quantities: str) -> list[dict[str, Any]]:
    return [one for one in analysis.estimates if one["quantity"] in quantities]


def test_a_unit_that_a_parabola_describes_passes() -> None:
    analysis = run(sim.simulate(SEED, sim.Switches()))
    found = of(analysis, *RESIDUALS)
    assert len(found) == 2 * 2 * 5
    assert {one["verdict"] for one in found} == {"pass"}
    assert {(one["conditions"]["kind"], one["limit"]) for one in found} == {("gyro", 100.0), ("accelerometer", 200.0)}
    assert max(abs(one["value"]) for one in found) < 3.0
    assert all(one["expanded_uncertainty"] == pytest.approx(20.0, abs=0.5) for one in found)


def test_residual_is_what_an_independent_parabola_leaves_over() -> None:
    """Nearly equal weights: numpy's own polynomial through the same five values leaves nearly the same."""
    analysis = run(sim.simulate(SEED, sim.Switches(cubic_ppm_degC3=0.01)))
    for quantity in ("dsf_n", "dsf_p"):
        values = [one for one in of(analysis, quantity) if one["conditions"]["channel"] == 2]
        warmth = np.array([one["conditions"]["unit_temperature_degC"] for one in values]) - 20.0
        dsf_ppm = np.array([one["value"] for one in values])
        left_ppm = dsf_ppm - np.polynomial.polynomial.polyval(
            warmth, np.polynomial.polynomial.polyfit(warmth, dsf_ppm, 2)
        )
        found = [one["value"] for one in of(analysis, f"{quantity}_residual") if one["conditions"]["channel"] == 2]
        assert np.max(np.abs(left_ppm)) > 30.0
        np.testing.assert_allclose(found, left_ppm, atol=0.2)


@pytest.mark.parametrize(
    ("cubic", "verdict"), [(0.005, "pass"), (0.0113, "conditional_pass"), (0.0136, "conditional_fail"), (0.018, "fail")]
)
def test_what_compensation_leaves_over_is_judged(cubic: float, verdict: str) -> None:
    """The parabola through a cubic at five temperatures 15 degC apart leaves 2.4 * 15^3 = 8100 degC3 of it."""
    found = of(run(sim.simulate(SEED, sim.Switches(cubic_ppm_degC3=cubic), {1: "gyro"})), *RESIDUALS)
    worst = max(found, key=lambda one: abs(one["value"]))
    assert abs(worst["value"]) == pytest.approx(8100 * cubic, abs=3.0)
    assert worst["verdict"] == verdict


def test_one_temperature_that_is_off_fails() -> None:
    campaign = sim.simulate(SEED, sim.Switches())
    for row in campaign.rows:
        if row.window.conditions["temperature_degC"] == 20.0:
            row.sums["npp"] = row.sums["npp"] * (1 - 600e-6)
    found = of(run(campaign), "dsf_n_residual")
    assert {one["verdict"] for one in found if one["conditions"]["temperature_degC"] == 20.0} == {"fail"}
    assert {one["verdict"] for one in of(run(campaign), "dsf_p_residual")} == {"pass"}


def test_no_more_temperatures_than_coefficients_no_verdict() -> None:
    analysis = run(sim.simulate(SEED, sim.Switches(), temperatures=(-10.0, 20.0, 50.0)))
    assert of(analysis, "dsf_n_tc2") != []
    assert of(analysis, *RESIDUALS) == []
    assert {one["verdict"] for one in analysis.estimates} == {"none"}
    assert any(note.startswith("No verdict") for note in analysis.notes)


def test_without_a_limit_there_is_no_verdict() -> None:
    campaign = sim.simulate(SEED, sim.Switches())
    channels = copy.deepcopy(campaign.campaign["channels"])
    for channel in channels:
        del channel["stability_limit_ppm"]
    assert {one["verdict"] for one in of(run(campaign, channels=channels), *RESIDUALS)} == {"none"}
