"""North finders of wrong worlds: no number that looks sound, and none lost in a right one.

Samples and readings are made from the physics alone (``doubt_north``); nothing of the product or its simulators makes
them.
"""

import doubt_north as worlds
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, Switch, classes, is_hidden, right_world, sorted_classes

from bench.model.systems import assumptions_of

SHORT = range(1)  # ten seeds of each, and 500 right worlds: make doubt
NAMED = [
    ("once_per_turn", 0.1, 20, ["once per turn of the bench", "+5.7"]),  # 0.1 of the amplitude: 5.73 deg
    ("modulated", 0.1, 15, ["twice per turn of the bench", "+2.8"]),  # half of it: 2.86 deg
    ("field_motor", 0.1, 5, ["mplitude of the signal, at search only: +0.6", " dB"]),
    ("mark_wrong", 5.0, 20, ["at mark only: +5."]),
    ("bench_turns", 10.0, 20, ["drift from begin to end: +10"]),
    ("bench_knocked", 10.0, 20, ["step between 16.9 min and 18.4 min", "+10"]),
    ("restless", 5.0, 20, ["More than one thing departs"]),
    ("delay_after_move", 10.0, 2, ["zimuth by the lock-ins (delay, index), at search only: -10"]),
    ("noisy_field", 10.0, 2, ["Noise, at search only: +20.7 dB"]),
    ("rate_stated", 2.0, 2, []),
    ("head_scale", 0.03, 10, ["the angle of the dividing head: +10."]),
]
OTHERS = [switch for switch in worlds.SWITCHES if switch.name not in [name for name, *_ in NAMED]]


def switch_of(name: str) -> Switch:
    return next(switch for switch in worlds.SWITCHES if switch.name == name)


@pytest.mark.parametrize("switch", OTHERS, ids=lambda switch: switch.name)
def test_nothing_that_can_be_seen_is_confidently_wrong(switch: Switch) -> None:
    """The gross ones that are not named below; every size is in the long form."""
    size = switch.sizes[-1]
    assert classes(worlds, switch, size, SHORT)[WRONG] == 0 or (is_hidden(worlds, switch, size) and switch.assumption)


@pytest.mark.parametrize(("name", "size", "doubted", "words"), NAMED)
def test_what_is_wrong_is_named_with_its_size(name: str, size: float, doubted: int, words: list[str]) -> None:
    wrong = worlds.seen(1, switch_of(name), size)
    counted = sorted_classes(wrong, right_world(worlds, 1))
    assert counted[WRONG] == 0
    assert counted[DOUBTED if words else REFUSED] >= doubted
    said = " ".join(reason.sentence for entry in wrong.entries for reason in entry.reasons)
    assert all(word in said for word in words), said


def test_where_one_departure_does_not_explain_the_headings_no_azimuth_is_sure() -> None:
    entries = worlds.seen(0, switch_of("restless"), 0.5).entries
    assert {entry.quality for entry in entries if entry.quantity in ("azimuth", "azimuth_error")} == {"doubtful"}


@pytest.mark.parametrize("seed", range(3))
def test_a_right_world_is_not_doubted(seed: int) -> None:
    assert [entry.reasons for entry in right_world(worlds, seed).entries if entry.quality != "sound"] == []


def test_every_hidden_switch_is_named_by_an_assumption() -> None:
    site = {"latitude_deg": 37.0, "azimuth_deg": 20.0, "azimuth_std_deg": 0.02}
    named = {one.code for one in assumptions_of({"analysis": "fog_north", "site": site})}
    assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= named
