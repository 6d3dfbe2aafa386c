"""Temperature of the unit in the fit: gaps in the housekeeping, a failing chamber, an inaccurate sensor."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
from fit_simulation import analysed as run
from one_estimate import every as of

from bench.analysis import Analysis, Material
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.systems.af_converter.constants import read_campaign, read_standards
from bench.systems.af_converter.group_fit import fit_groups
from bench.systems.af_converter.groups import (
    LONGEST_REACH_s,
    campaign_rows,
    group_rows,
    unit_temperatures,
)
from bench.systems.af_converter.scale_factor.estimates import Determined, determine

SEED = 21
# Campaigns, and how far the size of scores may be from 1: a factor of sqrt 2 is seen by 50, one of 1.2 by 150.
TRIALS = pytest.mark.parametrize(
    ("trials", "margin"), [(50, 0.25), pytest.param(150, 0.15, marks=pytest.mark.sweep)], ids=["short", "long"]
)
SCALE_FACTORS = ("dsf_n", "dsf_p", "dsf_asymmetry")


def without_housekeeping(campaign: sim.SimulatedCampaign, lost: Callable[[sim.Row], bool]) -> sim.SimulatedCampaign:
    rows = [replace(row, context={}, quality=Quality.STALE) if lost(row) else row for row in campaign.rows]
    return replace(campaign, rows=rows)


@pytest.fixture
def campaign() -> sim.SimulatedCampaign:
    return sim.simulate(SEED, sim.Switches())


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
    print(f"{len(errors)} interpolated, worst {max(errors):.4f} degC")
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


@TRIALS
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
    print(rms)
    assert all(1.0 - margin < value < 1.0 + margin for value in rms.values())


def test_a_unit_that_still_warms_while_it_is_measured_is_told(campaign: sim.SimulatedCampaign) -> None:
    """The first visit of a temperature ends 0.4 degC warmer than it begins; one that has settled is not mentioned."""
    (note,) = [note for note in run(campaign).notes if note.startswith("A soak was short")]
    assert "changes by +0." in note
    settled = sim.simulate(SEED, sim.Switches(lag=False))
    assert not any(note.startswith("A soak was short") for note in run(settled).notes)


@TRIALS
def test_declared_drift_of_the_calibrator_is_in_the_coefficient(trials: int, margin: float) -> None:
    """2 ppm (one sigma) over the campaign, which the register declares: tc1 scores keep unit size."""
    scores: list[float] = []
    for seed in range(trials):
        campaign = sim.simulate(seed, sim.Switches(gain_drift_sigma=2e-6))
        standards = {"calibrator": campaign.standards["calibrator"] | {"drift_relative": 4e-6}}
        known = determined(replace(campaign, standards=standards))
        scores += [score for name in ("dsf_n_tc1", "dsf_p_tc1") for score in scores_of(known, campaign, name)]
    rms = float(np.sqrt(np.mean(np.square(scores))))
    print(rms)
    assert rms == pytest.approx(0.95, abs=margin)
