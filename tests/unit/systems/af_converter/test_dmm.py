"""The DMM method at count level: truth, coverage, refusal of the printed form, the tests of assumption 2, standards;
drift of the calibrator as a meter before and after and the closing repeat show it.

Counts come from ``fit_simulation``; what the meter says is made here from its specification, without the fit.
"""

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

import fit_simulation as sim
import numpy as np
import pytest
from dmm_simulation import (
    OFFSET_A,
    QUANTITIES,
    SPECIFICATION,
    analysed,
    material,
    meter_range,
    readings_of,
    simulate,
    standards,
)
from one_estimate import every, holds
from one_estimate import every as of

from bench.analysis import Analysis, Material, Reading, analyse
from bench.model.errors import FitError
from bench.systems.af_converter.constants import read_campaign, read_ranges
from bench.systems.af_converter.dmm_method import analysis as dmm_method
from bench.systems.af_converter.dmm_method.estimates import MeterLog, reading_sets
from bench.systems.af_converter.estimators.dmm_method import (
    condition_number,
    fit_dmm_method,
    meter_parts,
    pair_rows,
    require_separable,
)
from bench.systems.af_converter.estimators.readings import noise_parts, pulse_currents_A
from bench.systems.af_converter.groups import Group, campaign_rows, group_rows


def misses(seeds: range, **meter: bool) -> dict[str, list[bool]]:
    """By kind of channel and quantity: whether each stated interval misses the truth; a gain belongs to a campaign."""
    found: dict[str, list[bool]] = {}
    for seed in seeds:
        analysis, campaign = analysed(seed, both=False, **meter)
        for one in of(analysis, "dsf_n", "dsf_asymmetry"):
            key = f"{one.conditions['kind']} {one.quantity}"
            found.setdefault(key, []).append(not holds(one, campaign.truth(one)))
    return found


@pytest.mark.validates(
    "DMM method: 95 % intervals of DSF and asymmetry",
    against="the simulated truth of 100 campaigns, in the sweep 300, in which one cause puts all ranges off",
)
@pytest.mark.parametrize(
    ("trials", "margin"), [(100, 5.0), pytest.param(300, 3.5, marks=pytest.mark.sweep)], ids=["short", "long"]
)
def test_intervals_cover_with_one_cause_for_all_gains(
    record_property: Callable[[str, object], None], trials: int, margin: float
) -> None:
    """Fully correlated gains are what the uncertainty is made for: 95 %. Independent ones are covered more often.

    Intervals a third too narrow cover 81 %: one in a hundred of such faults passes 100 campaigns, none 300.
    """
    for key, missed in misses(range(trials), one_gain=True).items():
        coverage = 100 * (1 - np.mean(missed))
        record_property("obtained", f"{key} {coverage:.1f} %")
        assert coverage == pytest.approx(95.0, abs=margin)
    for missed in misses(range(1000, 1040)).values():
        coverage = 100 * (1 - np.mean(missed))
        assert coverage >= 90


def shown(seed: int, **switches: bool) -> tuple[sim.SimulatedCampaign, Any, list[Reading]]:
    """Return a campaign, its meter, and what that has read."""
    campaign, drawn = simulate(seed)
    return campaign, drawn, readings_of(campaign, drawn, **switches)


@pytest.mark.validates(
    "DMM method",
    against="the calibrator method on the same records of 10 campaigns, the errors of both standards drawn apart",
)
def test_agrees_with_the_calibrator_method_on_the_same_records(record_property: Callable[[str, object], None]) -> None:
    worst = 0.0
    for seed in range(40, 50):
        (agreement,) = [table for table in analysed(seed)[0].tables if "calibrator method" in table.title]
        assert len(agreement.rows) == 4
        for row in agreement.rows:
            assert row[5] == pytest.approx(row[3] - row[4])
            worst = max(worst, abs(row[7]))
            assert abs(row[7]) < 1.3  # E_n of twenty standards drawn: 95 % are below 1
    record_property("obtained", f"worst E_n of 40 {worst:.2f}, limit 1.3")


def group_and_meter(seed: int, channel: int) -> tuple[Group, Any, Any, Any]:
    campaign, drawn = simulate(seed)
    chosen = campaign_rows(campaign.rows)  # type: ignore[arg-type]
    group = next(one for one in group_rows(chosen, sim.MASTER_Hz) if one.channel == channel and not one.repeat)
    meter = MeterLog(chosen, readings_of(campaign, drawn)).meter(group.numbers)
    return group, meter, read_campaign(campaign.campaign).converter(channel), read_ranges(standards(), "dmm")


@pytest.mark.validates(
    "AF paper (12) to (16), corrected: differences and half sums of one group fitted together",
    against="the single rows, whitened by numpy's Cholesky factor and solved by numpy.linalg.lstsq",
)
@pytest.mark.parametrize("channel", [1, 2])
def test_same_numbers_as_weighted_rows_without_pairing(
    record_property: Callable[[str, object], None], channel: int
) -> None:
    """Half sums and half differences are a change of coordinates: unpaired rows with numpy's own solver must agree."""
    group, meter, converter, register = group_and_meter(7, channel)
    rows = group.closed
    n_A, p_A = pulse_currents_A(rows, converter)
    polarity = rows.polarity
    half = np.array([SPECIFICATION[full][0] / 2 for full in meter.range_A])
    gain_A = polarity * meter.current_A * half
    covariance = sum((noise_parts(rows, converter) | meter_parts(rows, meter, register)).values())
    covariance = covariance + np.outer(gain_A, gain_A) * np.equal.outer(meter.range_A, meter.range_A)
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    design = np.column_stack([n_A, -p_A, polarity > 0, polarity < 0])
    expected = np.linalg.lstsq(root @ design, root @ (polarity * meter.current_A - (n_A - p_A)), rcond=None)[0]
    fit = fit_dmm_method(rows, meter, converter, register)
    found = [fit.value_ppm[name] for name in QUANTITIES]
    apart_ppm = np.max(np.abs(found - 1e6 * expected[:2]))
    record_property("obtained", f"channel {channel}: {apart_ppm:.1e} ppm, limit 1e-4")
    assert found == pytest.approx(1e6 * expected[:2], abs=1e-4)


@pytest.mark.validates(
    "AF paper (17) and (18) as printed: K_N and K_P apart are refused, rank 1 of 2",
    against="condition number of their rows by numpy, counts made from the physics; limit 20",
)
@pytest.mark.parametrize(("channel", "joint", "printed"), [(1, 1.78, 200), (2, 2.30, 3000)])
def test_printed_equations_are_refused_with_the_rank(
    record_property: Callable[[str, object], None], channel: int, joint: float, printed: float
) -> None:
    group, meter, converter, register = group_and_meter(7, channel)
    condition = fit_dmm_method(group.closed, meter, converter, register).condition
    assert condition == pytest.approx(joint, abs=0.05)
    levels, pairs = pair_rows(group.closed)
    n_A, p_A = pulse_currents_A(group.closed, converter)
    differences = (pairs[: levels.size] @ np.column_stack([n_A, -p_A]))[levels > 0] / levels[levels > 0, None]
    record_property("obtained", f"channel {channel}: {np.linalg.cond(differences):.0f}, joint {condition:.2f}")
    assert condition_number(differences) > printed
    with pytest.raises(FitError, match=r"B-FIT-001: .*K_N and K_P apart: rank 1 of 2"):
        require_separable(differences, "differences")


def test_analysis_as_printed_gives_the_mean_and_says_why_not_more() -> None:
    analysis, campaign = analysed(5, "as_printed")
    assert {one.quantity for one in of(analysis, "dsf_n", "dsf_p", "dsf_asymmetry", "dsf_mean")} == {"dsf_mean"}
    assert "K_N and K_P are refused" in analysis.notes[0]
    assert "rank 1 of 2" in analysis.notes[0]
    assert analysis.missing == []
    for one in of(analysis, "dsf_mean"):
        truth = campaign.units[one.conditions["channel"]].dsf(one.conditions["unit_temperature_degC"]).mean()
        assert abs(one.value - truth) < 1.5 * one.expanded_uncertainty


def test_zero_of_the_meter_is_subtracted_where_it_was_measured() -> None:
    """Without zeros the specification stands in; it weighs a hundred times as much as what the zeros leave."""
    parts, told = [], []
    for zeros in (True, False):
        campaign, _, readings = shown(3, zeros=zeros)
        analysis = dmm_method.analyse(material(campaign, readings))
        parts += [one for one in analysis.components if one["component"] == "zero of the meter"][:1]
        told.append(any("zero of the meter was not measured" in note for note in analysis.notes))
    assert parts[0]["std_uncertainty_ppm"] < 0.01
    assert parts[1]["std_uncertainty_ppm"] > 1.0
    assert told == [False, True]


@pytest.mark.parametrize(("ppm", "verdict"), [(0.0, "pass"), (400.0, "fail")])
def test_a_shift_between_repeated_points_is_seen_and_judged(ppm: float, verdict: str) -> None:
    campaign, drawn = simulate(8)
    for row in campaign.rows:
        if row.window.conditions["repeat"]:
            for name in ("npp", "ppp"):  # the unit counts more in the points taken again
                row.sums[name] = np.floor(row.sums[name] * (1 + 1e-6 * ppm))
    analysis = dmm_method.analyse(material(campaign, readings_of(campaign, drawn)))
    top = [one for one in of(analysis, "repeat_shift") if one.conditions["current_A"] >= 10e-3]
    assert len(top) == 6
    assert {one.verdict for one in top} == {verdict}
    for one in top:
        assert one.value == pytest.approx(ppm, abs=4 * one.std_uncertainty + 0.02)
    said = next(note for note in analysis.notes if "repeat_shift" in note)
    assert ("no more than chance" in said) == (ppm == 0)


def test_leakage_of_the_switch_is_seen() -> None:
    """30 nA into the accelerometer channel while the route is closed; its counts resolve 1 nA."""
    campaign, drawn = simulate(9)
    for row in campaign.rows:
        conditions = row.window.conditions
        if conditions["channel"] == 2 and conditions["route"] == "closed":
            more = 30e-9 * 100 / sim.KIND["accelerometer"]["k0_C"]  # type: ignore[operator]
            name = "npp" if row.sums["npp"][1] else "ppp"
            row.sums[name][1] += more if name == "npp" else -more
    analysis = dmm_method.analyse(material(campaign, readings_of(campaign, drawn)))
    leakage = [one for one in of(analysis, "switch_leakage") if one.conditions["channel"] == 2]
    assert [one.conditions["polarity"] for one in leakage] == [1, -1]
    assert all(one.value == pytest.approx(30e-9, abs=4 * one.std_uncertainty) for one in leakage)
    assert any("switch_leakage" in note and "more than chance explains" in note for note in analysis.notes)
    for one in of(analysis, "dsf_asymmetry"):  # and it does not reach the scale factors
        assert abs(one.value - campaign.truth(one)) < 2 * one.expanded_uncertainty


def test_which_readings_a_record_owns() -> None:
    """Those of the attempt that counts; readings without a value leave the others of their set."""
    campaign, _, readings = shown(4)
    row = campaign.rows[-1]
    begin_s = 1e-9 * row.window.t_start_ns - 18.0
    failed = [
        Reading(begin_s, 0, "dmm", "configure_current", 1.0),
        Reading(begin_s + 1, 0, "dmm", "measure_current", 9.0),
    ]
    log = MeterLog(campaign.rows, readings + failed)  # type: ignore[arg-type]
    plain = MeterLog(campaign.rows, readings)  # type: ignore[arg-type]
    assert log.meter([row.window.number]) == plain.meter([row.window.number])
    values = [("configure_current", 1e-3), *[("measure_current", one) for one in (None, 1e-4, float("nan"), 3e-4)]]
    (found,) = reading_sets(Reading(float(at), 0, "dmm", name, value) for at, (name, value) in enumerate(values))
    assert (found.values_A, found.end_s) == ([1e-4, 3e-4], 4.0)


@pytest.mark.parametrize("repeat", [0, 1])
def test_a_unit_that_still_warms_is_named(repeat: int) -> None:
    """Points of a channel at different temperatures: the method has no coefficients to refer them to one."""
    campaign, _, readings = shown(4)
    for row in [row for row in campaign.rows if row.window.conditions["repeat"] == repeat][:5]:
        row.context["unit_temperature_degC"] -= 0.3
    analysis = dmm_method.analyse(material(campaign, readings))
    assert any("moved by up to 0.30 degC" in note for note in analysis.notes)


def test_without_readings_beside_the_records_there_is_no_result() -> None:
    """None at all, zeros alone, or without a value; where one channel has some the other is named."""
    campaign, _, readings = shown(4)
    zeros = [one for one in readings if "zero_range_A" in one.conditions]
    flagged = [dataclasses.replace(one, value=None) if one.name == "measure_current" else one for one in readings]
    for left in ([], zeros, flagged):
        with pytest.raises(FitError, match="reading of the meter") as caught:
            dmm_method.analyse(material(campaign, left))
        assert caught.value.code == "B-FIT-050"
        assert "configure_current" in caught.value.next_step
    of_first = {1e-9 * row.window.t_start_ns for row in campaign.rows if row.window.conditions["channel"] == 1}
    kept = [one for one in readings if not any(0 < begin - one.t_s < 20 for begin in of_first)]
    analysis = dmm_method.analyse(material(campaign, kept))
    assert {one.conditions["channel"] for one in of(analysis, "dsf_n")} == {2}
    assert any("channel 1 at 20 degC" in one and "B-FIT-050" in one for one in analysis.missing)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda register: register.pop("dmm"), "B-FIT-009"),
        (lambda register: register["dmm"]["uncertainty"][0].pop("relative"), "B-FIT-009"),
        (lambda register: register["dmm"]["uncertainty"].pop(0), "B-FIT-003"),
    ],
)
def test_what_the_register_lacks_is_named(change: Callable[[dict[str, Any]], object], code: str) -> None:
    campaign, drawn = simulate(4)
    register = standards()
    change(register)
    given = Material(campaign.rows, campaign.campaign, register, readings=readings_of(campaign, drawn))
    with pytest.raises(FitError) as caught:
        dmm_method.analyse(given)
    assert caught.value.code == code


def test_the_reading_beside_a_record_is_the_current_the_meter_was_given() -> None:
    """A zero with the wrong sign would leave twice the zero, up to 8 uA here; given are the set-point and OFFSET_A."""
    campaign, drawn = simulate(3)
    drawn.gain, drawn.linearity_A = dict.fromkeys(SPECIFICATION, 0.0), {}
    drawn.zero_A = {full: 4e-6 * full for full in SPECIFICATION}
    closed = [row for row in campaign.rows if row.window.conditions["route"] == "closed"]
    levels = {row.window.conditions["current_A"] for row in closed}
    drawn.linearity_A = {(full, level): 0.0 for full in SPECIFICATION for level in levels}
    log = MeterLog(campaign.rows, readings_of(campaign, drawn))  # type: ignore[arg-type]
    meter = log.meter([row.window.number for row in closed])
    given_A = np.array([row.window.conditions["current_A"] * (1 + campaign.gain) + OFFSET_A for row in closed])
    assert (np.abs(meter.current_A - given_A) < 5e-9 * meter.range_A).all()


def restated(seed: int, role: str, **words: float) -> list[Material]:
    """Return a material and the same with these words in its register."""
    campaign, _, readings = shown(seed)
    plain = material(campaign, readings)
    stated = copy.deepcopy(dict(plain.standards))
    stated[role] |= words
    return [plain, dataclasses.replace(plain, standards=stated)]


@pytest.mark.parametrize("method", ["joint", "as_printed"])
def test_the_calibration_of_the_meter_itself_is_a_component(method: str) -> None:
    """30 ppm (95 %) common to all ranges: 15 ppm in every scale factor, nothing in the asymmetry."""
    found = [dmm_method.analyse(one, method) for one in restated(3, "dmm", traceability_relative=3e-5)]
    assert [any("relative to its own calibration" in note for note in one.notes) for one in found] == [True, False]
    for before, after in zip(*(of(one, *QUANTITIES, "dsf_asymmetry", "dsf_mean") for one in found), strict=True):
        more_ppm2 = after.std_uncertainty**2 - before.std_uncertainty**2
        assert more_ppm2 == pytest.approx(0.0 if before.quantity == "dsf_asymmetry" else 225.0, rel=1e-2, abs=1e-3)


def test_both_standards_count_in_full_in_the_agreement() -> None:
    """By hand: the meter's method, 10 ppm of gain and 20 ppm of a stated calibration of the calibrator."""
    analysis = dmm_method.analyse(restated(3, "calibrator", traceability_relative=4e-5)[1])
    (table,) = [one for one in analysis.tables if one.title.startswith("DMM method and")]
    by_place = {(one.conditions["channel"], one.quantity): one for one in of(analysis, *QUANTITIES)}
    for row in table.rows:
        own_ppm = by_place[row[0], row[1]].std_uncertainty
        assert row[6] == pytest.approx(1.96 * np.sqrt(own_ppm**2 + 10.0**2 + 20.0**2), rel=0.02)


def test_a_shift_is_judged_by_the_specification_and_knows_of_the_random_walk() -> None:
    campaign, drawn = simulate(8)
    plain = material(campaign, readings_of(campaign, drawn))
    walking = copy.deepcopy(dict(plain.campaign))
    for one in walking["channels"]:
        one["noise"]["walk_A_rth"] = 1e-6
    steady = of(dmm_method.analyse(plain), "repeat_shift")
    for one, other in zip(
        steady, of(dmm_method.analyse(dataclasses.replace(plain, campaign=walking)), "repeat_shift"), strict=True
    ):
        level_A, polarity = one.conditions["current_A"], one.conditions["polarity"]
        relative, floor = SPECIFICATION[meter_range(level_A)]
        assert one.limit == pytest.approx(1e6 * (relative + floor * meter_range(level_A) / level_A))
        wanted = {"channel": 1, "current_A": level_A, "polarity": polarity}
        places = [row.window.t_start_ns for row in campaign.rows if wanted.items() <= row.window.conditions.items()]
        hours = abs(places[1] - places[0]) / 3.6e12
        assert other.std_uncertainty == pytest.approx(1e6 * 1e-6 * np.sqrt(hours) / level_A, rel=0.05)


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


@pytest.mark.validates(
    "drift of the calibrator from the closing repeat",
    against="3 ppm put into the counts of the repeat",
)
@pytest.mark.parametrize("ppm", [0.0, 3.0])
def test_closing_repeat_that_shows_a_change_is_carried_on_to_the_whole_campaign(
    record_property: Callable[[str, object], None], campaign: sim.SimulatedCampaign, ppm: float
) -> None:
    """A calibrator 3 ppm up: 3 ppm more pulses of both kinds, a scale-factor error 3 ppm lower; or nothing is seen."""
    analysis = run(campaign, [], repeat_ppm=ppm)
    (one,) = every(analysis, "calibrator_drift", check="closing repeat")
    if ppm:
        record_property("obtained", f"{one.value:.3f} +- {one.expanded_uncertainty:.3f} ppm")
    assert one.value == pytest.approx(ppm, abs=3 * one.std_uncertainty)
    assert one.expanded_uncertainty < 1.5
    assert one.conditions["hours"] == pytest.approx(1.0, abs=0.01)  # two channels of 15 points here
    begin_s, end_s = (edge + side for edge, side in zip(times_s(campaign), (100.0, -100.0), strict=True))
    longer = (end_s - begin_s) / 3600.0 / one.conditions["hours"]
    bound_ppm = longer * (abs(one.value) + one.expanded_uncertainty)
    assert component_ppm(analysis) == pytest.approx(bound_ppm / 2, rel=1e-6)
    assert any("none is seen. A steady drift of less than" in note for note in analysis.notes) == (ppm == 0.0)


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
