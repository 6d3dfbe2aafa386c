"""Scale-factor campaigns of wrong worlds: no number that looks sound, and none lost in a right one.

Counts are made from the physics alone (``doubt_scale_factor``); nothing of the product or its simulators makes them.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import doubt_scale_factor as worlds
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

from bench.analysis import build_results, is_sound
from bench.model.assumptions import assumptions_of
from bench.session.coefficients import coefficients_of_session
from bench.systems.af_converter.estimators.pulses import count_step

SHORT = range(1)  # ten seeds of each, and 500 right worlds: make doubt
SIZES = [(switch, size) for switch in worlds.SWITCHES for size in switch.sizes]
NAMES = [f"{switch.name}-{size:g}" for switch, size in SIZES]


@pytest.mark.parametrize(("switch", "size"), SIZES, ids=NAMES)
def test_nothing_that_can_be_seen_is_confidently_wrong(switch: Switch, size: float) -> None:
    assert classes(worlds, switch, size, SHORT)[WRONG] == 0 or is_hidden(worlds, switch, size)


@pytest.mark.parametrize(
    ("name", "size", "left", "codes"),
    [
        ("swapped_leads", 1.0, REFUSED, {"swapped_leads"}),
        ("swapped_leads", 0.5, REFUSED, {"swapped_leads"}),
        ("soft_saturation", 1e-3, DOUBTED, {"lack_of_fit"}),
        ("clipped", 0.1, REFUSED, {"implausible_scale_factor"}),
        ("calibrator_step", 1e-3, DOUBTED, {"common_step"}),
        ("clock_misread", 1e-3, DOUBTED, {"clock_unsteady"}),
        ("calibrator_drift", 3e-3, DOUBTED, {"lack_of_fit"}),
    ],
)
def test_what_is_wrong_is_named(name: str, size: float, left: str, codes: set[str]) -> None:
    switch = next(switch for switch in worlds.SWITCHES if switch.name == name)
    wrong = worlds.seen(1, switch, size)
    assert sorted_classes(wrong, right_world(worlds, 1))[left] >= 9
    assert codes <= codes_of(wrong)


@pytest.mark.parametrize(("seed", "size"), [(8, 8.0), (6, 4096.0)])
def test_counts_in_steps_are_named_where_chance_lets_them_fit_a_line(seed: int, size: float) -> None:
    """Of all groups of ten campaigns these lay within 5 and 2,000 U of the truth with a chi-square like any other."""
    wrong = worlds.seen(seed, Switch("stuck_bits", worlds.StuckBits, (size,)), size)
    assert sorted_classes(wrong, right_world(worlds, seed))[WRONG] == 0
    named = [entry for entry in wrong.entries if "counts_in_steps" in {reason["code"] for reason in entry["reasons"]}]
    assert {entry["conditions"]["channel"] for entry in named} == {worlds.WRONG}
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
    assert count_step(np.array([1600.0, 0.0, 1.0, 1600.0])) == (1, 1.0)
    assert count_step(np.array([])) == (1, 1.0)
    step, chance = count_step(np.array([0.0, 1.0, 1600.0, 3199.0, 4798.0]))
    assert step == 1599
    assert chance < 1e-6
    levels = np.array([0.0, 1.0, 1600.0, 3199.0, 4798.0])  # what is left of a campaign after a fault: steps of 1 mA
    assert count_step(levels, 1599.3) == (1, 1.0)
    assert count_step(16.0 * np.arange(1.0, 9.0), 1599.3)[0] == 16


def test_one_bad_record_is_left_out_and_named() -> None:
    """One count off by a per cent among 150 records: the results are those of the others."""
    world = worlds.OneBadRecord(1e-2)
    campaign = sim.simulate(2, sim.Switches(), world=world)
    analysis = sim.analysed(campaign)
    (odd,) = [row.window.number for row in campaign.rows if world.hits(row.window.conditions)]
    assert any(f"unlike all others of its group (record {odd})" in note for note in analysis.notes)
    switch = next(switch for switch in worlds.SWITCHES if switch.name == "one_bad_record")
    counted = classes(worlds, switch, 1e-2, range(3))
    assert counted[WRONG] == counted[DOUBTED] == counted[REFUSED] == 0


def test_coefficients_hold_sound_channels_alone() -> None:
    campaign = sim.simulate(7, sim.Switches(), world=worlds.SoftSaturation(1e-3))
    analysis = sim.analysed(campaign)
    results = build_results("session", analysis, {"records": len(campaign.rows)}, worlds.PROVENANCE)
    written = coefficients_of_session(analysis, results, campaign.campaign)
    assert written is not None
    assert {part["channel"] for part in written.document["parameters"]} == {3 - worlds.WRONG}
    assert len(written.document["sources"][0]["missing"]) == 2


@pytest.mark.parametrize("seed", range(10))
def test_a_right_world_is_not_doubted(seed: int) -> None:
    seen = right_world(worlds, seed)
    assert [entry["reasons"] for entry in seen.entries if not is_sound(entry)] == []


@pytest.mark.parametrize("drift", [3e-5, -3e-5])
def test_a_drift_that_the_repeat_found_is_in_every_number_it_bears_on(drift: float) -> None:
    seen = worlds.seen(3, Switch("drift", worlds.CalibratorDrift, (drift,)), drift)
    assert sum(is_sound(entry) for entry in seen.entries) > 30
    counted = sorted_classes(seen, right_world(worlds, 3))
    assert counted[WRONG] == 0
    assert counted[RIGHT] < len(seen.entries)  # wider than without a drift


def test_a_level_as_small_as_the_bias_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gyro channel with 0.4 uA of bias, and 0.5 uA as its smallest level."""
    levels_A = (5e-7, *sim.KIND["gyro"]["levels_A"])
    monkeypatch.setitem(sim.KIND["gyro"], "levels_A", levels_A)
    seen = worlds.seen(4, None, 0.0)
    assert not codes_of(seen) & {"swapped_leads", "stimulus_not_followed"}


def test_what_a_switch_hides_is_named_with_a_size() -> None:
    """By ``bench check`` before the campaign and by the report after it."""
    taken = {assumption.code: assumption for assumption in assumptions_of(sim.simulate(1).campaign)}
    assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= taken.keys()
    assert set(taken) >= {"calibrator_gain", "open_route_leakage", "generator_frequency"}
    assert "less than 5 ppm" in taken["clock_counts"].unseen
    assert all(any(figure.isdigit() for figure in assumption.effect) for assumption in taken.values())


@dataclass(frozen=True)
class StuckCounter(sim.World):
    """A counter that stands at seven pulses in each of 10,000 frames, whatever the input is."""

    def counted(self, counts: dict[str, float], at: sim.Place) -> dict[str, float]:
        return counts | {"n": 70_000.0} if at.channel == worlds.WRONG else counts


@pytest.mark.parametrize("seed", range(2))
def test_a_counter_that_stands_at_seven_pulses_a_frame_is_refused(seed: int) -> None:
    found = classes_of(sim.simulate(seed, world=StuckCounter()))
    of_it = [entry for entry, _ in found if entry["conditions"]["channel"] == worlds.WRONG]
    assert all(entry["quality"] == "refused" for entry in of_it)
    others = [entry for entry, _ in found if entry["conditions"]["channel"] != worlds.WRONG]
    assert others
    assert all(is_sound(entry) for entry in others)


def classes_of(campaign: sim.SimulatedCampaign) -> list[tuple[dict[str, object], str]]:
    """Return estimates with their classes; none is confidently wrong."""
    document = build_results("doubt", sim.analysed(campaign), {"records": len(campaign.rows)}, worlds.PROVENANCE)
    entries = [entry for entry in document["estimates"] if entry["quantity"] in worlds.QUANTITIES]
    found = [(entry, class_of(entry, campaign.truth(entry), None, 0.0)) for entry in entries]
    assert found
    assert not [entry for entry, kind in found if kind == WRONG]
    return found


@pytest.mark.parametrize("repeat", [None, 1])
def test_a_calibrator_that_drifts_by_three_per_mille_leaves_no_small_interval(repeat: int | None) -> None:
    classes_of(sim.simulate(4, repeat_channel=repeat, world=worlds.CalibratorDrift(3e-3)))
