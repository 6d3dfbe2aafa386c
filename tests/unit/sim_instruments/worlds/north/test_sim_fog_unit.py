"""Index marks of the simulated table; supply, start and port of the simulated gyroscope."""

from itertools import pairwise

import numpy as np
import pytest
from fog_rig import QUIET, Rig, running

from bench.model.clock import NS

MS = 1_000_000

# --- marks ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_deg_s", [360.0, -360.0])
def test_pulses_come_once_a_turn_and_b_is_a_quarter_turn_from_a(rate_deg_s):
    world = running(rate_deg_s=rate_deg_s, wobble_arcmin=0).world
    a, b = (world.pulses(mark, 10 * NS, 20 * NS) for mark in "ab")
    assert len(a) == len(b) == 10
    assert np.abs(np.diff(a) - NS).max() <= 1
    placed = world.sensor.placement_deg
    sense = np.sign(rate_deg_s)
    lead_deg = ((a[5] - b) / NS * 360.0 + 180.0) % 360.0 - 180.0  # how far ahead of A pulse B comes
    np.testing.assert_allclose(lead_deg, sense * (90.0 + placed["a"] - placed["b"]), atol=1e-6)
    deg = world.sensor.table_deg(np.array([a[0], b[0]]))
    apart = (deg - [placed["a"], 270.0 + placed["b"]] + 180.0) % 360.0 - 180.0
    assert np.abs(apart).max() < 1e-6


def test_pulses_of_a_table_that_comes_to_speed():
    rig = Rig(1, **QUIET)
    rig.spin(360.0, 60.0)
    rig.clock.sleep(10.0)
    found = rig.world.pulses("a", 1, 10 * NS)
    turned_deg = 360.0 * np.arange(1, len(found) + 1)
    due_s = np.where(turned_deg <= 1080.0, np.sqrt(turned_deg / 30.0), 6.0 + (turned_deg - 1080.0) / 360.0)
    np.testing.assert_allclose(found / NS, due_s, atol=2e-9)
    assert len(found) == 6


def test_pulses_do_not_depend_on_how_one_asks():
    world = running(seed=8, parameters="white").world
    whole = world.pulses("b", 0, 20 * NS)
    edges = np.sort(np.random.default_rng(1).integers(0, 20 * NS, 500)).tolist()
    edges = [0, *edges, int(whole[3]), int(whole[3]) + 1, 20 * NS]
    edges.sort()
    parts = [world.pulses("b", start, stop) for start, stop in pairwise(edges)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert np.diff(whole).min() > 0.9 * NS


def test_a_table_at_rest_gives_no_pulses_and_does_not_swing():
    rig = Rig(1)
    rig.power()
    rig.clock.sleep(30.0)
    assert rig.world.pulses("a", 0, 30 * NS).size == 0
    assert np.ptp(rig.world.sensor.table_deg(np.arange(0, 1000 * MS, MS))) == 0.0


def test_the_swing_has_its_size_at_full_speed():
    world = running(wobble_arcmin=30, wobble_Hz=10).world
    t_ns = np.arange(19_000, 20_000) * MS
    swing = world.sensor.table_deg(t_ns) - world.motion[0].angle_deg(t_ns)
    np.testing.assert_allclose(swing, 0.5 * np.sin(2.0 * np.pi * 10.0 * t_ns / NS), atol=1e-9)


def test_a_swing_in_step_with_the_turns_displaces_the_pulses_anew_after_each_start():
    """60 swings a turn: each pulse finds the table displaced alike, by up to the swing; the encoder sees it, too."""
    displaced_deg = []
    for wait_s in (0.0, 1.003, 2.007):
        rig = Rig(1, **{**QUIET, "wobble_arcmin": "3"})
        rig.clock.sleep(wait_s)
        rig.spin()
        rig.clock.sleep(20.0)
        t_ns = rig.world.pulses("a", 15 * NS, 20 * NS)
        uniform_deg = (rig.world.motion[0].angle_deg(t_ns) + 180.0) % 360.0 - 180.0
        assert np.ptp(uniform_deg) < 1e-5
        displaced_deg.append(uniform_deg[0])
    assert np.abs(displaced_deg).max() < 0.05
    assert np.ptp(displaced_deg) > 0.02


# --- supply and port -----------------------------------------------------------------------------------------------


def test_it_speaks_2_s_behind_its_supply_and_counts_from_0():
    rig = Rig(1)
    rig.listen()
    rig.clock.sleep(3.0)
    assert rig.read().size == 0
    rig.power()
    rig.clock.sleep(2.0)
    assert rig.read().size == 0
    rig.clock.sleep(0.1)
    rows = rig.read()
    assert rows[0, 0] == 0
    assert len(rows) == 99
    rig.power(on=False)
    rig.clock.sleep(5.0)
    rows = rig.read()
    assert len(rows) in (0, 1)
    output_V = rig.world.waveform(0, 10_000)
    assert not output_V[:5000].any()
    assert output_V[5000:5100].all()
    assert not output_V[5100:].any()
    rig.power()
    rig.clock.sleep(2.01)
    assert rig.read()[0, 0] == 0


def test_who_comes_late_finds_the_counter_further_on():
    rig = Rig(1)
    rig.power()
    rig.clock.sleep(10.0)
    rig.listen()
    rig.clock.sleep(0.1)
    rows = rig.read()
    assert rows[0, 0] in (7999, 8000)
    np.testing.assert_array_equal(np.diff(rows[:, 0]), 1)
    np.testing.assert_allclose(rows[:, 1], rig.world.waveform(2000, 20_000)[rows[:, 0].astype(int)], atol=0.501e-6)


def test_the_supply_feeds_it_from_12_V_on():
    assert Rig(1).world.load == (12.0, 0.4)


def test_it_warms_up():
    rig = Rig(1)
    rig.power()
    degC = []
    for wait_s in (2.5, 597.5, 5400.0):
        rig.unit.disconnect("fog")
        rig.clock.sleep(wait_s)
        rig.listen()
        rig.clock.sleep(0.1)
        degC.append(rig.read()[0, 3])
    assert degC == pytest.approx([23.02, 23.0 + 4.0 * (1.0 - np.exp(-1.0)), 27.0], abs=0.011)


def test_nobody_moves_the_table_while_its_past_is_read():
    rig = Rig(1)
    assert rig.unit.lock is rig.world.lock
