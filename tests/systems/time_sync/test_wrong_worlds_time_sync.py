"""Recordings of two units in wrong worlds: no time offset that looks sound, and none lost in a right world.

Increments, solutions and stamps are made from the physics alone (``doubt_time_sync``).
"""

import doubt_time_sync as worlds
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, codes_of, right_world, sorted_classes

from bench.model.systems import Assumption, assumptions_of
from bench.plan import compile_sequence

_AGE, _DELAY = "Age of the solutions", "Least delay, "
GROSS: dict[str, tuple[int, list[str]]] = {  # estimates that are doubted at the least, and what is said
    "solutions_older_than_tags": (3, [f"{_AGE}: +30", "least delay, at frames of the EGI only"]),
    "latency_not_as_stated": (3, ["at frames of the EGI only", "age of the solutions"]),
    "age_steps": (2, [f"{_AGE}, step between 9.6 s and 10.1 s after the begin"]),
    "age_drifts": (4, ["drift from begin to end"]),
    "velocity_older": (2, [f"{_AGE}, at velocity only: +100 ms"]),
    "lever_arm": (2, ["Lever arm between both units, forward: -10 m", "enter it into the EGI"]),
    "axes_turned": (2, ["Axes of both units turned against each other, right: -0.09"]),
    "bad_burst": (2, ["8.4 s, there only"]),
    "frozen_solutions": (3, ["24 solutions of the EGI repeat the one before"]),
    "line_fills": (4, ["drift from begin to end"]),
    "line_switches": (3, [f"{_DELAY}frames of the EGI, step between 7.49 s and 9.97 s after the begin: +9.91 ms"]),
    "larger_errors": (2, ["What the fit leaves over is no noise"]),
}
BY_NAME = {switch.name: switch for switch in worlds.SWITCHES}


@pytest.mark.parametrize("name", GROSS)
def test_what_is_grossly_wrong_is_doubted_and_named(name: str) -> None:
    wrong = worlds.seen(0, BY_NAME[name], BY_NAME[name].sizes[-1])
    counted, (least, words) = sorted_classes(wrong, right_world(worlds, 0)), GROSS[name]
    assert counted[WRONG] == 0
    assert counted[DOUBTED] + counted[REFUSED] >= least
    said = " ".join(reason.sentence for entry in wrong.entries for reason in entry.reasons)
    assert all(word in said for word in words), said


@pytest.mark.parametrize(
    ("name", "size", "words"),
    [
        ("gyro_scale", 1e3, "Scale of the gyros of the inertial unit"),
        ("accelerometer_scale", 1e4, "Scale of the accelerometers of the inertial unit"),
        ("velocity_older", 10.0, "Age of the solutions, at velocity only"),
    ],
)
def test_what_departs_moves_results_as_far_as_it_says(name: str, size: float, words: str) -> None:
    """Against the filters themselves, of the same seed in a right world."""
    world = BY_NAME[name].world(size * (1e-6 if "scale" in name else 1e-3))
    right, wrong = (worlds.analyse(worlds.Recording(0, one).material()) for one in (worlds.World(), world))
    (found,) = [seen for seen in wrong.evidence if seen.code == "departs"]
    assert words in found.sentence
    assert found.figure == pytest.approx(size, rel=0.05)
    pairs = [pair for pair in zip(right.estimates, wrong.estimates, strict=True) if pair[1] in found.entries]
    moved = [abs(one.value - other.value) / other.expanded_uncertainty for one, other in pairs if other.std_uncertainty]
    assert max(moved) == pytest.approx(found.move, rel=0.1)


def test_an_offset_beyond_what_was_looked_for_is_refused() -> None:
    wrong = worlds.seen(0, BY_NAME["solutions_older_than_tags"], 0.2)
    assert sorted_classes(wrong, right_world(worlds, 0))[REFUSED] == 2
    assert "implausible_offset" in codes_of(wrong)


@pytest.mark.parametrize(
    ("name", "note"),
    [("one_bad_solution", "1 solutions of the EGI"), ("one_bad_increment", "1 samples of the inertial unit")],
)
def test_one_bad_reading_is_left_out_and_named(name: str, note: str) -> None:
    size = BY_NAME[name].sizes[-1]
    analysis = worlds.analyse(worlds.Recording(0, BY_NAME[name].world(size)).material())
    assert any(note in sentence for sentence in analysis.notes)
    wrong = worlds.seen(0, BY_NAME[name], size)
    assert codes_of(wrong) == set()
    for entry, before in zip(wrong.entries, right_world(worlds, 0).entries, strict=True):
        assert abs(entry.value - before.value) < 0.1 * before.expanded_uncertainty


@pytest.mark.parametrize("seed", range(3))
def test_a_right_world_is_not_doubted_and_nothing_is_left_out(seed: int) -> None:
    seen = right_world(worlds, seed)
    assert [entry.reasons for entry in seen.entries if entry.quality != "sound"] == []
    assert all(entry.dropped == 0 for entry in seen.entries)


def taken_for_granted(**sections: object) -> dict[str, Assumption]:
    stated = {"analysis": "time_sync", "latency": {"egi_s": 8e-3, "imu_s": 8e-4, "std_s": 1e-3}}
    return {taken.code: taken for taken in assumptions_of(stated | sections)}


def test_what_no_recording_can_show_is_named_with_its_size() -> None:
    assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= set(taken_for_granted())
    assert "up to 7.1 ms" in taken_for_granted()["latency_as_stated"].unseen
    assert "any size" in taken_for_granted(latency=None)["latency_as_stated"].unseen
    for velocity_m_s, text in ((0.017, "0.5 ms"), (0.17, "5.0 ms")):
        assert text in taken_for_granted(egi={"velocity_m_s": velocity_m_s})["one_offset"].unseen
    assert len(assumptions_of(compile_sequence("time_sync_turn", None, {}).campaign)) == 4
