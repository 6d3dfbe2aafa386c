"""Recordings of two units in wrong worlds: no time offset that looks sound, and none lost in a right world.

Increments, solutions and stamps are made from the physics alone (``doubt_time_sync``).
"""

from __future__ import annotations

import doubt_time_sync as worlds
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, codes_of, right_world, sorted_classes

from bench.model.assumptions import Assumption, assumptions_of
from bench.plan import compile_sequence

GROSS = {
    "solutions_older_than_tags": {"stamps_disagree"},
    "latency_not_as_stated": {"stamps_disagree"},
    "age_steps": {"offset_steps", "misfit"},
    "age_drifts": {"offset_steps", "misfit"},
    "velocity_older": {"ages_differ"},
    "lever_arm": {"lever_arm"},
    "axes_turned": {"axes_turned"},
    "gyro_scale": {"gyro_scale"},
    "accelerometer_scale": {"misfit"},
    "bad_burst": {"misfit"},
    "frozen_solutions": {"stuck_solutions"},
    "line_fills": {"offset_drifts"},
    "line_switches": {"delays_unsteady"},
    "larger_errors": {"misfit"},
}
BY_NAME = {switch.name: switch for switch in worlds.SWITCHES}


@pytest.mark.parametrize("name", GROSS)
def test_what_is_grossly_wrong_is_doubted_and_named(name: str) -> None:
    wrong = worlds.seen(0, BY_NAME[name], BY_NAME[name].sizes[-1])
    counted = sorted_classes(wrong, right_world(worlds, 0))
    assert counted[WRONG] == 0
    assert counted[DOUBTED] + counted[REFUSED] >= 3
    assert GROSS[name] <= codes_of(wrong)


def test_a_scale_of_the_accelerometers_is_named_where_it_moves_the_offset() -> None:
    assert {"accelerometer_scale", "misfit"} <= codes_of(worlds.seen(2, BY_NAME["accelerometer_scale"], 1e-3))


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


@pytest.mark.parametrize("seed", range(5))
def test_a_right_world_is_not_doubted_and_nothing_is_left_out(seed: int) -> None:
    seen = right_world(worlds, seed)
    assert [entry.reasons for entry in seen.entries if entry.quality != "sound"] == []
    assert all(entry.dropped == 0 for entry in seen.entries)


def taken_for_granted(**sections: object) -> dict[str, Assumption]:
    stated = {"analysis": "time_sync", "latency": {"egi_s": 8e-3, "imu_s": 8e-4, "std_s": 1e-3}}
    return {taken.code: taken for taken in assumptions_of(stated | sections)}


def test_what_no_recording_can_show_is_named_with_its_size() -> None:
    assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= set(taken_for_granted())
    assert "up to 5.5 ms" in taken_for_granted()["latency_as_stated"].unseen
    assert "any size" in taken_for_granted(latency=None)["latency_as_stated"].unseen
    for velocity_m_s, text in ((0.017, "0.11 m"), (0.17, "1.10 m")):
        place = taken_for_granted(egi={"velocity_m_s": velocity_m_s, "level_deg": 0.0013})["one_place"]
        assert text in place.unseen
    assert len(assumptions_of(compile_sequence("time_sync_turn", None, {}).campaign)) == 8
