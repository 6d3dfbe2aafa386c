"""Campaigns by the DMM method in wrong worlds: no number that looks sound, and none lost in a right one.

Counts and readings are made from the physics alone (``doubt_dmm_method``).
"""

from __future__ import annotations

import doubt_dmm_method as worlds
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, codes_of, is_hidden, right_world, sorted_classes

from bench.analysis import is_sound
from bench.model.assumptions import assumptions_of

SIZES = [(switch.name, size) for switch in worlds.SWITCHES for size in switch.sizes]
BY_NAME = {switch.name: switch for switch in worlds.SWITCHES}


@pytest.mark.parametrize(("name", "size"), SIZES)
def test_nothing_that_can_be_seen_is_confidently_wrong(name: str, size: float) -> None:
    switch = BY_NAME[name]
    visible = not is_hidden(worlds, switch, size)
    for seed in range(3):
        counted = sorted_classes(worlds.seen(seed, switch, size), right_world(worlds, seed))
        assert counted[WRONG] == 0 or not visible
        assert counted[WRONG] == 0 or switch.assumption


@pytest.mark.parametrize(
    ("name", "size", "left", "code"),
    [
        ("swapped_leads", 1.0, REFUSED, "swapped_leads"),
        ("swapped_leads", 0.34, REFUSED, "stimulus_not_followed"),
        ("soft_saturation", 1e-3, DOUBTED, "lack_of_fit"),
        ("clipped", 1e-3, DOUBTED, "lack_of_fit"),
        ("clock_misread", 1e-3, DOUBTED, "clock_unsteady"),
        ("meter_range", 1e-4, DOUBTED, "meter_range_off"),
        ("meter_gain", 0.1, REFUSED, "implausible_scale_factor"),
        ("meter_drifts", 1e-3, DOUBTED, "not_repeated"),
        ("stuck_meter", 30.0, REFUSED, "implausible_scale_factor"),
    ],
)
def test_what_is_wrong_is_named(name: str, size: float, left: str, code: str) -> None:
    wrong = worlds.seen(1, BY_NAME[name], size)
    assert sorted_classes(wrong, right_world(worlds, 1))[left] >= 3
    assert code in codes_of(wrong)


@pytest.mark.parametrize(("name", "size"), [("one_bad_record", 1e-2), ("stuck_meter", 6.0)])
def test_one_level_that_is_wrong_is_left_out_and_named(name: str, size: float) -> None:
    analysis, _ = worlds.analysed(0, BY_NAME[name].world(size))
    assert any("unlike all others of its group" in note for note in analysis.notes)
    wrong = worlds.seen(0, BY_NAME[name], size)
    assert codes_of(wrong) == set()
    for entry, before in zip(wrong.entries, right_world(worlds, 0).entries, strict=True):
        assert abs(entry["value"] - before["value"]) < before["expanded_uncertainty"]


def test_one_bad_reading_of_three_costs_its_weight() -> None:
    wrong = worlds.seen(0, BY_NAME["one_bad_reading"], 0.1)
    assert codes_of(wrong) == set()
    assert sorted_classes(wrong, right_world(worlds, 0))[WRONG] == 0


def test_a_range_that_is_off_is_not_told_by_one_channel() -> None:
    """A converter that saturates has one channel against the straight line: that is not the meter."""
    assert "meter_range_off" not in codes_of(worlds.seen(1, BY_NAME["soft_saturation"], 1e-3))


def test_a_range_that_moves_one_channel_alone_is_doubted_there() -> None:
    """No single level carries the line: without the gain of the range it moves by 2.4 times its uncertainty."""
    wrong = worlds.seen(3, BY_NAME["meter_range"], 1e-4)
    assert sorted_classes(wrong, right_world(worlds, 3))[WRONG] == 0
    assert codes_of(wrong) == {"lack_of_fit"}


@pytest.mark.parametrize("seed", range(20))
def test_a_right_world_is_not_doubted(seed: int) -> None:
    seen = right_world(worlds, seed)
    assert [entry["reasons"] for entry in seen.entries if not is_sound(entry)] == []
    assert not any("unlike" in note for note in worlds.analysed(seed, worlds.Wrong())[0].notes)


@pytest.mark.sweep
def test_right_worlds_are_doubted_once_in_five_hundred() -> None:
    doubted = [seed for seed in range(500) if codes_of(worlds.seen(seed, None, 0.0))]
    print(f"seeds 0 to 499: doubted {doubted}")
    assert len(doubted) <= 5


def test_what_is_hidden_is_named() -> None:
    named = {taken.code for taken in assumptions_of({"analysis": "dmm_method"})}
    assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= named
