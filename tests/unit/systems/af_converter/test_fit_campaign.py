"""The scale-factor campaign as a whole: groups, dropped records, drift, change, clocks, notes and refusals."""

import copy
import dataclasses
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest

from bench.analysis import Analysis, Evidence, Material, analyse
from bench.analysis.doubt import weigh
from bench.model.errors import FitError
from bench.model.quality import Quality

SEED = 21


def run(campaign: sim.SimulatedCampaign, **changes: Any) -> Analysis:
    return analyse(Material(campaign.rows, campaign.campaign | changes, campaign.standards))


def of(analysis: Analysis, quantity: str, **conditions: Any) -> list[dict[str, Any]]:
    return [
        one
        for one in analysis.estimates
        if one["quantity"] == quantity and conditions.items() <= one["conditions"].items()
    ]


@pytest.fixture
def campaign() -> sim.SimulatedCampaign:
    return sim.simulate(SEED, sim.Switches(), repeat_channel=1)


def test_every_channel_and_temperature_has_its_estimates(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign)
    for quantity in ("dsf_n", "dsf_p", "dsf_asymmetry", "bias"):
        places = [
            (one["conditions"]["channel"], one["conditions"]["temperature_degC"]) for one in of(analysis, quantity)
        ]
        assert places == [(channel, at) for at in sim.TEMPERATURES_degC for channel in (1, 2)]
    assert [one["n"] for one in of(analysis, "dsf_n")] == [14] * 10
    assert {one["verdict"] for one in analysis.estimates if "_residual" not in one["quantity"]} == {"none"}
    assert analysis.missing == []
    assert len(analysis.residuals) == 14 * 11
    assert all(abs(one["residual_A"]) < 5 * one["std_ppm"] * 1e-6 * abs(one["current_A"]) or not one["current_A"]
               for one in analysis.residuals)  # fmt: skip


def test_result_is_referred_to_the_measured_unit_temperature(campaign: sim.SimulatedCampaign) -> None:
    first = of(run(campaign), "dsf_n", channel=1, temperature_degC=-10.0)[0]["conditions"]
    expected = np.mean([row.context["unit_temperature_degC"] for row in campaign.rows[:15]])
    assert first["unit_temperature_degC"] == pytest.approx(expected, abs=1e-9)
    assert abs(first["unit_temperature_degC"] + 10.0) > 0.2


def test_rows_of_a_warming_unit_are_referred_to_one_temperature() -> None:
    """Noise-free, 8 ppm/degC, a lag of 0.43 degC: without the referral the asymmetry alone would be off by 0.02 ppm."""
    ideal = sim.Switches(gain=False, calibrator_errors=False, noise=False, quantised=False)
    found = sim.simulate(SEED, ideal)
    analysis = run(found)
    for one in of(analysis, "dsf_asymmetry") + of(analysis, "dsf_n"):
        assert one["value"] == pytest.approx(found.truth(one), abs=0.03)
    for group in analysis.groups:
        assert group["reduced_chi2"] < 0.05


def test_clock_estimates_recover_the_clock_errors(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign)
    ratio = (1 + campaign.master_error) / (1 + campaign.af_error) - 1
    for one in of(analysis, "clock_ratio_error"):
        assert one["value"] == pytest.approx(1e6 * ratio, abs=5 * one["std_uncertainty"])
    for one in of(analysis, "master_clock_error"):
        assert one["value"] == pytest.approx(1e6 * campaign.master_error, abs=1e-3)
        assert one["std_uncertainty"] == pytest.approx(3 / np.sqrt(3), abs=0.001)
    assert len(of(analysis, "clock_ratio_error")) == len(of(analysis, "master_clock_error")) == 5


def test_function_generator_of_the_register_replaces_the_papers_limit(campaign: sim.SimulatedCampaign) -> None:
    standards = campaign.standards | {"function_generator": {"uncertainty": [{"range_A": 0, "relative": 1e-6}]}}
    found = analyse(Material(campaign.rows, campaign.campaign, standards)).estimates
    assert next(one for one in found if one["quantity"] == "master_clock_error")["std_uncertainty"] == pytest.approx(
        0.5, abs=1e-3
    )


def test_generator_off_gives_no_master_clock_error_and_says_so(campaign: sim.SimulatedCampaign) -> None:
    for row in campaign.rows:
        row.sums["fg_count"] = 0
    analysis = run(campaign)
    assert of(analysis, "master_clock_error") == []
    assert any("165 records without function-generator pulses" in note for note in analysis.notes)


def test_closing_repeat_gives_the_drift_and_stays_out_of_the_coefficients(campaign: sim.SimulatedCampaign) -> None:
    analysis = run(campaign)
    for quantity in ("dsf_n_drift", "dsf_p_drift"):
        (drift,) = of(analysis, quantity, channel=1, temperature_degC=50.0)
        assert abs(drift["value"]) < 4 * drift["std_uncertainty"]
        assert drift["std_uncertainty"] < 1.0
    assert len(of(analysis, "dsf_n", channel=1, temperature_degC=50.0)) == 1
    assert {one["n"] for one in of(analysis, "dsf_n_tc1")} == {5}


def test_a_real_drift_is_seen(campaign: sim.SimulatedCampaign) -> None:
    for row in campaign.rows:
        if row.window.conditions["repeat"]:
            row.sums["npp"] = row.sums["npp"] * (1 - 30e-6)
    (drift,) = of(run(campaign), "dsf_n_drift")
    assert drift["value"] == pytest.approx(30.0, abs=4 * drift["std_uncertainty"])


@pytest.mark.parametrize("flag", [Quality.SPLICE, Quality.OVER_RANGE, Quality.TRIPPED, Quality.SUSPECT])
def test_flagged_records_are_left_out_and_counted(campaign: sim.SimulatedCampaign, flag: Quality) -> None:
    clean = run(campaign)
    rows = list(campaign.rows)
    wrong = dataclasses.replace(rows[12], quality=flag, sums=rows[12].sums | {"npp": rows[12].sums["npp"] * 2})
    rows[12] = wrong
    analysis = analyse(Material(rows, campaign.campaign, campaign.standards))
    first = of(analysis, "dsf_n", channel=1, temperature_degC=-10.0)[0]
    assert (first["n"], first["dropped"]) == (13, 1)
    assert first["value"] == pytest.approx(of(clean, "dsf_n")[0]["value"], abs=6.0)


@pytest.mark.parametrize(("lost", "used"), [(10, True), (11, False)])
def test_a_record_with_a_few_lost_frames_counts_for_less(
    campaign: sim.SimulatedCampaign, lost: int, used: bool
) -> None:
    clean = run(campaign)
    row = campaign.rows[7]
    share = 1 - lost / 10_000
    sums = {name: np.floor(values * share) for name, values in row.sums.items()}
    campaign.rows[7] = dataclasses.replace(row, quality=Quality.LOST, lost=lost, frames=10_000 - lost, sums=sums)
    analysis = run(campaign)
    before, after = of(clean, "dsf_n")[0], of(analysis, "dsf_n")[0]
    assert (after["n"], after["dropped"]) == ((14, 0) if used else (13, 1))
    assert after["std_uncertainty"] > before["std_uncertainty"]
    assert after["value"] == pytest.approx(before["value"], abs=4.0)
    std_ppm = [one["std_ppm"] for one in analysis.residuals if one["number"] == 8]
    assert std_ppm == ([pytest.approx(np.sqrt(11 * 5.103**2 + 2 * 3.5**2), rel=0.01)] if used else [])


def test_wiring_records_are_not_part_of_the_campaign(campaign: sim.SimulatedCampaign) -> None:
    clean = run(campaign)
    row = campaign.rows[7]
    window = dataclasses.replace(row.window, conditions=row.window.conditions | {"purpose": "wiring"}, number=0)
    wiring = dataclasses.replace(row, window=window, sums=row.sums | {"npp": row.sums["npp"] * 3})
    campaign.rows.insert(0, wiring)
    assert run(campaign).estimates == clean.estimates


def test_group_that_is_not_determined_is_named_and_the_others_stand(campaign: sim.SimulatedCampaign) -> None:
    bad = [
        dataclasses.replace(row, quality=Quality.TRIPPED)
        if row.window.conditions["channel"] == 2 and row.window.conditions["polarity"] < 0 and row.window.number < 31
        else row
        for row in campaign.rows
    ]
    analysis = analyse(Material(bad, campaign.campaign, campaign.standards))
    assert of(analysis, "dsf_n", channel=2, temperature_degC=-10.0) == []
    assert len(of(analysis, "dsf_n", channel=2)) == 4
    assert any("B-FIT-005" in note and "channel 2 at -10 degC" in note for note in analysis.notes)


def test_positive_rows_only_are_refused(campaign: sim.SimulatedCampaign) -> None:
    rows = [row for row in campaign.rows if row.window.conditions["polarity"] >= 0]
    with pytest.raises(FitError, match="K_P is not determined") as caught:
        analyse(Material(rows, campaign.campaign, campaign.standards))
    assert caught.value.code == "B-FIT-005"
    assert caught.value.where == "channel 1 at -10 degC"


def test_change_against_a_previous_calibration_is_judged(campaign: sim.SimulatedCampaign) -> None:
    now = run(campaign)
    previous = copy.deepcopy(of(now, "dsf_n") + of(now, "dsf_p"))
    previous[0]["value"] -= 60.0  # within 100 - U
    previous[2]["value"] += 90.0  # inside the limit, not by U
    previous[4]["value"] += 500.0
    judged = run(campaign, previous=previous)
    verdicts = [one["verdict"] for one in of(judged, "dsf_n_change")]
    assert verdicts == ["pass", "pass", "conditional_pass", "pass", "fail", *["pass"] * 5]
    assert of(judged, "dsf_n_change")[0]["limit"] == 100.0
    assert of(judged, "dsf_n_change")[1]["limit"] == 200.0
    for one, then in zip(of(judged, "dsf_n_change"), previous, strict=False):
        assert one["std_uncertainty"] == pytest.approx(np.sqrt(2.0) * then["std_uncertainty"])  # both in full


def lack_of_fit(analysis: Analysis) -> list[Evidence]:
    """Return which groups do not lie on a straight line."""
    weighed = weigh(analysis.evidence)
    return [check for check in (*weighed.against, *weighed.noted) if check.code == "lack_of_fit"]


def test_rows_off_the_straight_line_are_evidence(campaign: sim.SimulatedCampaign) -> None:
    """Two rows, since one alone would be left out."""
    for row, part, current_A in ((campaign.rows[7], 200e-6, 1e-3), (campaign.rows[9], -200e-6, 10e-3)):
        row.sums["npp"] = row.sums["npp"] * (1 + part)
        assert row.window.conditions["current_A"] == current_A
    assert [check.conditions for check in lack_of_fit(run(campaign))] == [{"channel": 1, "temperature_degC": -10.0}]


def test_traceability_and_drift_of_the_calibrator_are_added_when_stated(campaign: sim.SimulatedCampaign) -> None:
    calibrator = campaign.standards["calibrator"] | {"traceability_relative": 10e-6, "drift_relative": 4e-6}
    campaign.rows = [row for row in campaign.rows if not row.window.conditions["repeat"]]  # it would tell a drift
    plain, full = run(campaign), analyse(Material(campaign.rows, campaign.campaign, {"calibrator": calibrator}))
    closed_s = [1e-9 * row.window.t_start_ns for row in campaign.rows if row.window.conditions["route"] == "closed"]
    slope = 2.0 / 60.0 * (4 * 12_600.0) / np.ptp(closed_s)  # five visits of a channel, 3.5 h apart
    for quantity, extra in (("dsf_n", np.hypot(5.0, 2.0)), ("dsf_asymmetry", 0.0), ("dsf_n_tc1", slope)):
        before, after = of(plain, quantity)[0]["std_uncertainty"], of(full, quantity)[0]["std_uncertainty"]
        assert after == pytest.approx(np.hypot(before, extra), rel=1e-2)
    assert len(plain.notes) == len(full.notes) + 2
    assert any("the temperature coefficients and the drift of channels are stated without" in note
               for note in plain.notes)  # fmt: skip
    assert {one["component"] for one in full.components} > {one["component"] for one in plain.components}


def test_budget_adds_up(campaign: sim.SimulatedCampaign) -> None:
    for kind in ("gyro", "accelerometer"):
        parts = {
            one["component"]: one["std_uncertainty_ppm"] for one in run(campaign).components if one["kind"] == kind
        }
        combined = parts.pop("combined")
        assert combined == pytest.approx(np.sqrt(np.sum(np.square(list(parts.values())))), rel=0.01)
        assert parts["calibrator gain, common to all rows"] == pytest.approx(10.0, abs=0.02)


def test_one_temperature_gives_no_coefficients() -> None:
    analysis = run(sim.simulate(SEED, sim.Switches(), temperatures=(20.0,)))
    assert not [one for one in analysis.estimates if "_tc" in one["quantity"]]
    assert any(note.startswith("One temperature only") for note in analysis.notes)
    assert "common_step" not in {seen.code for seen in analysis.evidence}  # nothing tells a step in time


def test_same_rows_in_another_order_give_the_same_numbers(campaign: sim.SimulatedCampaign) -> None:
    forward = run(campaign)
    campaign.rows.reverse()
    assert run(campaign).estimates == forward.estimates


def test_no_record_is_an_error(campaign: sim.SimulatedCampaign) -> None:
    with pytest.raises(FitError) as caught:
        analyse(Material([], campaign.campaign, campaign.standards))
    assert caught.value.code == "B-FIT-007"


def test_unusable_campaign_constants_are_named(campaign: sim.SimulatedCampaign) -> None:
    with pytest.raises(FitError, match="af_clock_Hz") as caught:
        run(campaign, af_clock_Hz=-1.0)
    assert caught.value.code == "B-FIT-008"


def test_noise_that_is_not_declared_is_named(campaign: sim.SimulatedCampaign) -> None:
    """No default: an uncertainty from somebody else's noise would not be true."""
    channels = copy.deepcopy(campaign.campaign["channels"])
    del channels[1]["noise"]["walk_A_rth"]
    with pytest.raises(FitError) as caught:
        run(campaign, channels=channels)
    assert caught.value.code == "B-FIT-008"
    assert caught.value.where == "manifest: campaign.channels.1.noise.walk_A_rth"
    del channels[1]["noise"]
    with pytest.raises(FitError, match=r"channels\.1\.noise") as caught:
        run(campaign, channels=channels)
    assert caught.value.code == "B-FIT-008"


def test_more_noise_than_declared_shows_in_chi_square() -> None:
    """20 nA/rtHz instead of the declared 2: 1.4 nA more in each record of an accelerometer channel."""
    kinds = {1: "accelerometer"}
    chi2 = {
        white_A_rtHz: np.mean(
            [
                group["reduced_chi2"]
                for seed in range(10)
                for group in run(sim.simulate(seed, sim.Switches(white_A_rtHz=white_A_rtHz), kinds)).groups
            ]
        )
        for white_A_rtHz in (2e-9, 20e-9)
    }
    print(chi2)
    assert 0.8 < chi2[2e-9] < 1.2
    assert chi2[20e-9] > 1.5
    noisy = sim.simulate(SEED, sim.Switches(white_A_rtHz=20e-9), kinds)
    assert lack_of_fit(run(noisy))
    for channel in noisy.campaign["channels"]:
        channel["noise"]["white_A_rtHz"] = 20e-9
    assert not lack_of_fit(run(noisy))


def test_record_of_an_undeclared_channel_is_named(campaign: sim.SimulatedCampaign) -> None:
    with pytest.raises(FitError, match="channel 2") as caught:
        run(campaign, channels=campaign.campaign["channels"][:1])
    assert caught.value.code == "B-FIT-008"


@pytest.mark.parametrize("standards", [{}, {"calibrator": {}}, {"calibrator": {"uncertainty": [{"range_A": 1.0}]}}])
def test_register_without_the_calibrator_is_an_error(campaign: sim.SimulatedCampaign, standards: dict) -> None:
    with pytest.raises(FitError) as caught:
        analyse(Material(campaign.rows, campaign.campaign, standards))
    assert caught.value.code == "B-FIT-009"
