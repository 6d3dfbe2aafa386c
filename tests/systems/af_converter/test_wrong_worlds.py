"""Campaigns and ramps of wrong worlds: no number that looks sound, and none lost in a right one.

Counts, readings, heat and slack are made from the physics alone (``doubt_scale_factor``, ``doubt_dmm_method``,
``doubt_bias_ramp``); nothing of the product or its simulators makes them.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import bias_simulation
import doubt_bias_ramp as of_ramp
import doubt_dmm_method as of_meter
import doubt_scale_factor as of_counts
import fit_simulation as sim
import numpy as np
import pytest
from doubt_classes import (
    DOUBTED,
    REFUSED,
    RIGHT,
    WRONG,
    Switch,
    class_of,
    classes,
    codes_of,
    is_hidden,
    right_world,
    sorted_classes,
)
from scipy import special

from bench.analysis import Material, Trace, build_results, estimates_of
from bench.model.systems import assumptions_of
from bench.session.coefficients import coefficients_of_session
from bench.systems.af_converter.bias_ramp.analysis import analyse
from bench.systems.af_converter.bias_ramp.departures import Rows
from bench.systems.af_converter.estimators.readings import count_step

SEEDS = {of_counts: range(1), of_meter: range(3)}  # ten seeds of each, and 500 right worlds: make doubt
SWITCHES = {worlds: {switch.name: switch for switch in worlds.SWITCHES} for worlds in (of_counts, of_meter, of_ramp)}
SIZES = [
    pytest.param(worlds, switch, size, id=f"{worlds.SYSTEM}-{switch.name}-{size:g}", marks=[pytest.mark.sweep] * long)
    for worlds in SEEDS
    for switch in SWITCHES[worlds].values()
    for size in switch.sizes
    for long in [worlds is of_counts and size != switch.sizes[1]]
]


@pytest.mark.parametrize(("worlds", "switch", "size"), SIZES)
def test_nothing_that_can_be_seen_is_confidently_wrong(worlds: Any, switch: Switch, size: float) -> None:
    wrong = classes(worlds, switch, size, SEEDS[worlds])[WRONG]
    assert wrong == 0 or (is_hidden(worlds, switch, size) and switch.assumption)


@pytest.mark.parametrize(
    ("worlds", "name", "size", "left", "code"),
    [
        (of_counts, "swapped_leads", 1.0, REFUSED, "swapped_leads"),
        (of_counts, "swapped_leads", 0.5, REFUSED, "swapped_leads"),
        (of_counts, "soft_saturation", 1e-3, DOUBTED, "departs"),
        (of_counts, "clipped", 0.1, REFUSED, "implausible_scale_factor"),
        (of_counts, "calibrator_step", 1e-3, DOUBTED, "departs"),
        (of_counts, "clock_misread", 1e-3, DOUBTED, "clock_unsteady"),
        (of_meter, "swapped_leads", 1.0, REFUSED, "swapped_leads"),
        (of_meter, "swapped_leads", 0.34, REFUSED, "stimulus_not_followed"),
        (of_meter, "soft_saturation", 1e-3, DOUBTED, "departs"),
        (of_meter, "clipped", 1e-3, DOUBTED, "departs"),
        (of_meter, "clock_misread", 1e-3, DOUBTED, "clock_unsteady"),
        (of_meter, "meter_range", 1e-4, DOUBTED, "departs"),
        (of_meter, "meter_gain", 0.1, REFUSED, "implausible_scale_factor"),
        (of_meter, "meter_drifts", 1e-3, DOUBTED, "departs"),
        (of_meter, "stuck_meter", 30.0, REFUSED, "implausible_scale_factor"),
    ],
)
def test_what_is_wrong_is_named(worlds: Any, name: str, size: float, left: str, code: str) -> None:
    wrong = worlds.seen(1, SWITCHES[worlds][name], size)
    counted = sorted_classes(wrong, right_world(worlds, 1))
    assert counted[WRONG] == 0
    assert counted[left] >= (9 if worlds is of_counts else 3)
    assert code in codes_of(wrong)


@pytest.mark.parametrize(
    ("worlds", "seeds"),
    [
        (of_counts, 3),
        (of_meter, 5),
        *(pytest.param(*ten, marks=pytest.mark.sweep) for ten in ((of_counts, 10), (of_meter, 20))),
    ],
)
def test_a_right_world_is_not_doubted(worlds: Any, seeds: int) -> None:
    for seed in range(seeds):
        seen = right_world(worlds, seed)
        assert [entry.reasons for entry in seen.entries if entry.quality != "sound"] == [], seed


def test_what_is_hidden_is_named_with_a_size() -> None:
    """By ``bench check`` before the campaign and by the report after it."""
    for worlds, campaign in ((of_counts, sim.simulate(1).campaign), (of_meter, {"analysis": "dmm_method"})):
        taken = {assumption.code: assumption for assumption in assumptions_of(campaign)}
        assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= taken.keys()
        if worlds is of_counts:
            assert set(taken) >= {"calibrator_gain", "open_route_leakage", "generator_frequency"}
            assert "less than 5 ppm" in taken["clock_counts"].unseen
            assert all(any(figure.isdigit() for figure in assumption.effect) for assumption in taken.values())


# --- counts and readings -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("seed", "size"), [(8, 8.0), (6, 4096.0)])
def test_counts_in_steps_are_named_where_chance_lets_them_fit_a_line(seed: int, size: float) -> None:
    """Of all groups of ten campaigns these lay within 5 and 2,000 U of the truth with a chi-square like any other."""
    wrong = of_counts.seen(seed, Switch("stuck_bits", of_counts.STUCK_BITS, (size,)), size)
    assert sorted_classes(wrong, right_world(of_counts, seed))[WRONG] == 0
    named = [entry for entry in wrong.entries if "counts_in_steps" in {reason.code for reason in entry.reasons}]
    assert {entry.conditions["channel"] for entry in named} == {of_counts.WRONG}
    assert len(named) == 3 * len(sim.TEMPERATURES_degC) + 6


def test_right_counts_agree_in_a_step_as_seldom_as_whole_numbers() -> None:
    """Five of the counts of a group: four differences are all even, or multiples of three, four ..., in 8.2 %."""
    rng, counts = np.random.default_rng(1), defaultdict(list)
    for seed in range(50):
        for row in sim.simulate(seed, sim.Switches()).rows:
            at = row.window.conditions
            if at["polarity"]:
                pulses = row.sums["npp"] + row.sums["ppp"]
                counts[seed, at["channel"], at["temperature_degC"]].append(pulses[at["channel"] - 1])
    seen = [count_step(rng.choice(group, 5, replace=False)) for group in counts.values() for _ in range(10)]
    share = np.mean([step > 1 for step, _ in seen])
    print(f"steps above 1: {100 * share:.1f} % of {len(seen)}")
    assert share == pytest.approx(special.zeta(4, 2), abs=0.015)
    assert all(np.mean([chance <= level for _, chance in seen]) < 1.2 * level for level in (0.006, 0.02, 0.09))


def test_one_difference_of_counts_says_nothing_of_steps() -> None:
    """Two counts that are left after a fault: their difference is a multiple of itself, however large."""
    levels = np.array([0.0, 1.0, 1600.0, 3199.0, 4798.0])  # what is left of a campaign after a fault: steps of 1 mA
    assert count_step(np.array([1600.0, 0.0, 1.0, 1600.0])) == (1, 1.0)
    assert count_step(np.array([])) == (1, 1.0)
    step, chance = count_step(levels)
    assert step == 1599
    assert chance < 1e-6
    assert count_step(levels, 1599.3) == (1, 1.0)
    assert count_step(16.0 * np.arange(1.0, 9.0), 1599.3)[0] == 16


def test_one_bad_record_is_left_out_and_named() -> None:
    """One count off by a per cent among 150 records: the results are those of the others."""
    world = of_counts.ONE_BAD_RECORD(1e-2)
    campaign = sim.simulate(2, sim.Switches(), world=world)
    (odd,) = [row.window.number for row in campaign.rows if of_counts.is_bad(row.window.conditions)]
    assert any(f"unlike all others of its group (record {odd})" in note for note in sim.analysed(campaign).notes)
    counted = classes(of_counts, SWITCHES[of_counts]["one_bad_record"], 1e-2, range(3))
    assert counted[WRONG] == counted[DOUBTED] == counted[REFUSED] == 0


@pytest.mark.parametrize(("name", "size"), [("one_bad_record", 1e-2), ("stuck_meter", 6.0), ("one_bad_reading", 0.1)])
def test_one_level_that_is_wrong_is_left_out_and_named(name: str, size: float) -> None:
    """One reading of three that is bad costs its weight alone."""
    switch = SWITCHES[of_meter][name]
    notes, before = of_meter.analysed(0, switch.world(size))[0].notes, right_world(of_meter, 0)
    assert any("unlike all others of its group" in note for note in notes) == (name != "one_bad_reading")
    assert not any("unlike" in note for note in of_meter.analysed(0, of_meter.Wrong())[0].notes)
    wrong = of_meter.seen(0, switch, size)
    assert codes_of(wrong) == set()
    assert sorted_classes(wrong, before)[WRONG] == 0
    for entry, right in zip(wrong.entries, before.entries, strict=True):
        assert name == "one_bad_reading" or abs(entry.value - right.value) < right.expanded_uncertainty


@pytest.mark.parametrize(
    ("name", "said", "ppm"),
    [("meter_range", "10 mA range only", -1000.0), ("meter_drifts", "drift from begin", -360.0)],
)
def test_what_is_off_of_the_meter_is_told_with_its_size(name: str, said: str, ppm: float) -> None:
    """A range of the meter is told from a converter that saturates."""
    wrong, bent = (of_meter.seen(1, SWITCHES[of_meter][one], 1e-3) for one in (name, "soft_saturation"))
    assert sorted_classes(wrong, right_world(of_meter, 1))[WRONG] == 0
    for reason in (reason for entry in wrong.entries for reason in entry.reasons):
        assert said in reason.sentence
        assert reason.figure == pytest.approx(ppm, rel=0.1)
    assert not any("range only" in reason.sentence for entry in bent.entries for reason in entry.reasons)


def test_coefficients_hold_sound_channels_alone() -> None:
    campaign = sim.simulate(7, sim.Switches(), world=of_counts.SOFT_SATURATION(1e-3))
    analysis = sim.analysed(campaign)
    results = build_results("session", analysis, {"records": len(campaign.rows)}, of_counts.PROVENANCE)
    written = coefficients_of_session(analysis, results, campaign.campaign)
    assert written is not None
    assert {part["channel"] for part in written.document["parameters"]} == {3 - of_counts.WRONG}
    assert len(written.document["sources"][0]["missing"]) == 2


@pytest.mark.parametrize("drift", [3e-5, -3e-5])
def test_a_drift_that_the_repeat_found_is_in_every_number_it_bears_on(drift: float) -> None:
    seen = of_counts.seen(3, Switch("drift", of_counts.CALIBRATOR_DRIFT, (drift,)), drift)
    assert sum(entry.quality == "sound" for entry in seen.entries) > 30
    counted = sorted_classes(seen, right_world(of_counts, 3))
    assert counted[WRONG] == 0
    assert counted[RIGHT] < len(seen.entries)  # wider than without a drift


def test_a_level_as_small_as_the_bias_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gyro channel with 0.4 uA of bias, and 0.5 uA as its smallest level."""
    levels_A = (5e-7, *sim.KIND["gyro"]["levels_A"])
    monkeypatch.setitem(sim.KIND["gyro"], "levels_A", levels_A)
    seen = of_counts.seen(4, None, 0.0)
    assert not codes_of(seen) & {"swapped_leads", "stimulus_not_followed"}


@dataclass(frozen=True)
class StuckCounter(sim.World):
    """A counter that stands at seven pulses in each of 10,000 frames, whatever the input is."""

    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        return counts | {"n": 70_000.0} if at.channel == of_counts.WRONG else counts


def entries_without_a_wrong_one(campaign: sim.SimulatedCampaign) -> list[dict[str, Any]]:
    """Return the estimates of a campaign, of which none is confidently wrong."""
    document = build_results("doubt", sim.analysed(campaign), {"records": len(campaign.rows)}, of_counts.PROVENANCE)
    entries = [entry for entry in estimates_of(document) if entry.quantity in of_counts.QUANTITIES]
    assert entries
    assert WRONG not in [class_of(entry, campaign.truth(entry), None, 0.0) for entry in entries]
    return entries


@pytest.mark.parametrize("seed", range(2))
def test_a_counter_that_stands_at_seven_pulses_a_frame_is_refused(seed: int) -> None:
    found = entries_without_a_wrong_one(sim.simulate(seed, world=StuckCounter()))
    for entry in found:
        of_it = entry.conditions["channel"] == of_counts.WRONG
        assert entry.quality == "refused" if of_it else entry.quality == "sound"
    assert any(entry.conditions["channel"] != of_counts.WRONG for entry in found)


@pytest.mark.parametrize("repeat", [None, 1])
def test_a_calibrator_that_drifts_by_three_per_mille_leaves_no_small_interval(repeat: int | None) -> None:
    entries_without_a_wrong_one(sim.simulate(4, repeat_channel=repeat, world=of_counts.CALIBRATOR_DRIFT(3e-3)))


# --- ramps ---------------------------------------------------------------------------------------------------------


def reasons_against(estimates: Sequence[Any], quantity: str) -> dict[str, str]:
    """Return sentences by code against a quantity of channel 1; it must not look sound."""
    entries = [entry for entry in estimates if (entry.quantity, entry.conditions.get("channel")) == (quantity, 1)]
    assert entries
    assert all(entry.quality != "sound" for entry in entries)
    return {reason.code: reason.sentence for entry in entries for reason in entry.reasons}


@pytest.mark.parametrize("seed", range(2))
def test_hysteresis_of_three_plays_is_doubted(seed: int) -> None:
    """Three pistons in parallel, each a third of the hysteresis: slack of 0.4, 1.5 and 3.5 times the half-width."""
    seen = of_ramp.seen(seed, SWITCHES[of_ramp]["several_plays"], 1.0)
    assert "departs" in reasons_against(seen.entries, "hysteresis_width")
    assert sorted_classes(seen, right_world(of_ramp, seed))[WRONG] == 0


@pytest.mark.parametrize(
    ("name", "size", "words"),
    [
        ("second_lag", 0.1, ["another lag", "nA/degC"]),
        ("step_of_bias", 0.1, ["The bias of channel 1, step between 14.9 h and 15 h"]),
        ("width_over_temperature", 0.1, ["The loop of channel 1"]),
        ("bend", 1.0, ["a bend at 30 degC: +2."]),
        ("drift_of_bias", 1.0, ["drift from begin to end"]),
        ("daily_rhythm", 1.0, ["cycle of about 24 h"]),
    ],
)
def test_what_departs_in_a_ramp_is_named(name: str, size: float, words: list[str]) -> None:
    said = " ".join(seen.sentence for entry in of_ramp.seen(1, SWITCHES[of_ramp][name], size).entries
                    for seen in entry.reasons)  # fmt: skip
    assert all(word in said for word in words), said


class Leak(of_ramp.World):
    """Slack that gives way: the piston returns to the middle within 25 min, so that the loop fades in every hold."""

    def added_A(self, at: of_ramp.Course) -> np.ndarray:
        half_degC, leak = at.unit.half_width_degC, np.exp(-bias_simulation.STEP_s / 1500.0)
        behind_degC, path = 0.0, np.zeros_like(at.unit_degC)
        for k, step in enumerate(np.diff(at.unit_degC, prepend=at.unit_degC[0])):
            behind_degC = np.clip((behind_degC - step) * leak, -half_degC, half_degC)
            path[k] = behind_degC
        whole = bias_simulation.slack(at.unit_degC, half_degC) - at.unit_degC
        return self.size * at.unit.width_A * (path - whole) / (2.0 * half_degC)


@pytest.mark.parametrize("seed", range(2))
def test_a_loop_that_relaxes_is_doubted(seed: int) -> None:
    seen = of_ramp.seen(seed, Switch("leak", Leak, (1.0,)), 1.0)
    assert "departs" in codes_of(seen)
    assert sorted_classes(seen, right_world(of_ramp, seed))[WRONG] == 0


def test_estimates_follow_the_readings_as_the_search_takes_them_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the fit itself, in which a small second lag really flows: what it moves, within 0.05 U.

    The hour that is compensated worst may be another one then, so that its mean is not compared.
    """
    given: list[Any] = []
    residuals = Rows.residuals
    monkeypatch.setattr(Rows, "residuals", lambda *of: given.append(residuals(*of)) or given[-1])
    for size in (0.0, 0.02):
        of_ramp.seen(2, SWITCHES[of_ramp]["second_lag"], size, noise_free=True)
    rows, others = given
    moved = rows.operator @ (others.readings - rows.readings) / rows.expanded
    changed = np.subtract([one.value for one in others.stated], [one.value for one in rows.stated]) / rows.expanded
    same = [one.quantity != "bias_residual" for one in rows.stated]
    assert np.abs(moved[same]).max() > 0.3
    assert moved[same] == pytest.approx(changed[same], abs=0.05)


def ramp_results(ramps: dict[int, bias_simulation.Ramp]) -> list[Any]:
    """Return the estimates of some channels in one ramp."""
    world = next(iter(ramps.values()))
    trace = Trace(world.trace_t_s, world.air_degC, world.sensor_degC)
    rows, campaign = bias_simulation.rows(ramps), bias_simulation.campaign(ramps)
    analysis = analyse(Material(rows, campaign, {"generator": {}}, trace))
    return estimates_of(build_results("session", analysis, {}, of_ramp.PROVENANCE))


@pytest.mark.parametrize("seed", range(3))
def test_two_thermal_lags_without_hysteresis_are_doubted(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the converter follows the air within 25 min, half within 150 min."""
    quick = bias_simulation.heat()
    both = (quick.unit_degC + bias_simulation.follow(quick.air_degC, 9000.0)) / 2.0
    monkeypatch.setattr(bias_simulation, "heat", lambda _=0.0: replace(quick, unit_degC=both))
    unit = bias_simulation.draw(np.random.default_rng(seed), "gyro", hysteresis=False)
    entries = ramp_results({1: bias_simulation.ramp(seed, "gyro", unit)})
    assert "departs" in reasons_against(entries, "hysteresis_width")


def test_a_step_of_the_bias_is_doubted_on_its_channel_alone() -> None:
    t_s = bias_simulation.heat().t_s
    stepped = bias_simulation.ramp(1, added_A=1e-8 * (np.arange(t_s.size) > 0.6 * t_s.size))
    entries = ramp_results({1: stepped, 2: bias_simulation.ramp(2, "accelerometer")})
    assert "step between 1" in reasons_against(entries, "bias")["departs"]
    assert all(one.quality == "sound" for one in entries if one.conditions.get("channel") == 2)


@pytest.mark.parametrize("hysteresis", [True, False])
@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.sweep) for seed in range(2, 8))])
def test_a_right_ramp_is_not_doubted(seed: int, hysteresis: bool) -> None:
    rng = np.random.default_rng(seed)
    units = [bias_simulation.draw(rng, kind, hysteresis=hysteresis) for kind in ("gyro", "accelerometer")]
    ramps = {k: bias_simulation.ramp(seed + 50 * k, unit.kind, unit) for k, unit in enumerate(units, 1)}
    assert [one.reasons for one in ramp_results(ramps) if one.quality != "sound"] == []
