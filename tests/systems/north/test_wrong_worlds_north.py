"""North finders of wrong worlds: no number that looks sound, and none lost in a right one.

Samples and readings are made from the physics alone (``doubt_north``); nothing of the product or its simulators makes
them.
"""

from __future__ import annotations

import doubt_north as worlds
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, Switch, classes, codes_of, is_hidden, right_world, sorted_classes

from bench.model.assumptions import assumptions_of

SHORT = range(1)  # ten seeds of each, and 500 right worlds: make doubt
SIZES = [(switch, size) for switch in worlds.SWITCHES for size in switch.sizes]
NAMES = [f"{switch.name}-{size:g}" for switch, size in SIZES]


def switch_of(name: str) -> Switch:
    return next(switch for switch in worlds.SWITCHES if switch.name == name)


@pytest.mark.parametrize(("switch", "size"), [(one, one.sizes[-1]) for one in worlds.SWITCHES],
                         ids=[one.name for one in worlds.SWITCHES])  # fmt: skip
def test_nothing_that_can_be_seen_is_confidently_wrong(switch: Switch, size: float) -> None:
    """The gross ones; every size is in the long form."""
    assert classes(worlds, switch, size, SHORT)[WRONG] == 0 or (is_hidden(worlds, switch, size) and switch.assumption)


@pytest.mark.parametrize(
    ("name", "size", "left", "codes"),
    [
        ("once_per_turn", 0.1, DOUBTED, {"known_azimuths_apart", "once_per_turn"}),
        ("modulated", 0.1, DOUBTED, {"known_azimuths_apart", "twice_per_turn"}),
        ("field_motor", 0.1, DOUBTED, {"amplitude_at_place"}),
        ("mark_wrong", 5.0, DOUBTED, {"methods_apart", "all_azimuths_off"}),
        ("bench_turns", 10.0, DOUBTED, {"north_drifts"}),
        ("bench_knocked", 10.0, DOUBTED, {"north_steps"}),
        ("restless", 5.0, DOUBTED, {"repeats_apart"}),
        ("delay_after_move", 10.0, DOUBTED, {"methods_step"}),
        ("noisy_field", 10.0, DOUBTED, {"noise_changes"}),
        ("rate_stated", 2.0, REFUSED, set()),
    ],
)
def test_what_is_wrong_is_named(name: str, size: float, left: str, codes: set[str]) -> None:
    wrong = worlds.seen(1, switch_of(name), size)
    assert sorted_classes(wrong, right_world(worlds, 1))[left] >= (5 if name == "field_motor" else 2)
    assert codes <= codes_of(wrong)


@pytest.mark.parametrize("seed", range(5))
def test_a_right_world_is_not_doubted(seed: int) -> None:
    assert [entry.reasons for entry in right_world(worlds, seed).entries if entry.quality != "sound"] == []


def test_every_hidden_switch_is_named_by_an_assumption() -> None:
    site = {"latitude_deg": 37.0, "azimuth_deg": 20.0, "azimuth_std_deg": 0.02}
    named = {one.code for one in assumptions_of({"analysis": "fog_north", "site": site})}
    assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= named
