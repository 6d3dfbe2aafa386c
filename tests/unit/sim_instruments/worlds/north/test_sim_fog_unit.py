"""The simulated gyroscope: supply, output, frames; the Earth's rate on it by scipy; how parameters vary."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from fog_rig import QUIET, Rig, running
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from bench.model.clock import NS
from sim_instruments.worlds.north.sensor import earth_rate_rad_s, sensed_rad_s, tilted
from sim_instruments.worlds.north.variation import Constant, Linear, Sine, drawn_slow, drawn_steps

MS = 1_000_000

# --- marks ---------------------------------------------------------------------------------------------------------
LATITUDE_DEG = 37.0
EARTH_DEG_H = 15.041067
FINE_S = np.linspace(0.0, 50.0, 500_001)


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


def of_heading(heading_deg, **tilts):
    """Sensed rate of an axis of that heading, deg/h."""
    in_table = tilted(tilts.get("east", 0.0), tilts.get("north", 0.0)).T @ earth_rate_rad_s(LATITUDE_DEG)
    angle_rad = np.deg2rad(90.0 - np.asarray(heading_deg))
    return np.rad2deg(sensed_rad_s(in_table, angle_rad, tilts.get("axis", 0.0))) * 3600.0


def phase_deg(sensed):
    """Heading of the largest rate when all whole degrees of heading are given."""
    headings = np.deg2rad(np.arange(360.0))
    return np.rad2deg(np.arctan2(sensed @ np.sin(headings), sensed @ np.cos(headings)))


def amplitude(sensed):
    headings = np.deg2rad(np.arange(360.0))
    return np.hypot(sensed @ np.sin(headings), sensed @ np.cos(headings)) / 180.0


@pytest.mark.parametrize("longitude_deg", [0.0, 127.0])
def test_against_the_axis_of_the_earth_in_earth_fixed_coordinates(longitude_deg):
    """Axis of rotation (0, 0, 1), local directions by longitude and latitude: nothing local is assumed."""
    latitude, longitude = np.deg2rad([LATITUDE_DEG, longitude_deg])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    north = np.cross(up, east)
    for heading_deg in (0.0, 20.0, 135.0, 300.0):
        heading = np.deg2rad(heading_deg)
        axis = np.cos(heading) * north + np.sin(heading) * east
        assert of_heading(heading_deg) == pytest.approx(EARTH_DEG_H * axis[2], abs=2e-6)


def test_nothing_is_felt_east_and_west_and_most_north():
    east, west, north, south = of_heading([90.0, 270.0, 0.0, 180.0])
    assert max(abs(east), abs(west)) < 1e-12
    assert north == -south == pytest.approx(EARTH_DEG_H * np.cos(np.deg2rad(LATITUDE_DEG)), abs=2e-6)


@pytest.mark.parametrize(("east", "north"), [(1.0, 0.0), (0.0, -2.0), (0.7, 0.4)])
def test_the_tilt_is_a_turn_by_its_vector(east, north):
    vector = np.deg2rad([east, north, 0.0])
    np.testing.assert_allclose(tilted(east, north), Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)
    for heading_deg in (0.0, 50.0, 222.0):
        flat = np.array([np.sin(np.deg2rad(heading_deg)), np.cos(np.deg2rad(heading_deg)), 0.0])
        axis = Rotation.from_rotvec(vector).apply(flat)
        due = EARTH_DEG_H * axis @ [0.0, np.cos(np.deg2rad(LATITUDE_DEG)), np.sin(np.deg2rad(LATITUDE_DEG))]
        assert of_heading(heading_deg, east=east, north=north) == pytest.approx(due, abs=2e-6)


def test_a_tilt_about_north_turns_north_and_one_about_east_does_not():
    headings = np.arange(360.0)
    arcmin = 1.0 / 60.0
    apparent_north = phase_deg(of_heading(headings, north=arcmin))
    assert apparent_north * 60.0 == pytest.approx(-np.tan(np.deg2rad(37.0)), rel=1e-4)  # 0.75 arcmin to the west
    assert abs(phase_deg(of_heading(headings, east=arcmin))) < 1e-9
    gain = amplitude(of_heading(headings, east=arcmin)) / amplitude(of_heading(headings))
    assert gain - 1.0 == pytest.approx(np.deg2rad(arcmin) * np.tan(np.deg2rad(37.0)), rel=1e-3)


def test_an_axis_out_of_the_plane_loses_little_and_feels_the_vertical():
    headings = np.arange(360.0)
    level, tilted_axis = of_heading(headings), of_heading(headings, axis=1.0)
    loss = amplitude(tilted_axis) / amplitude(level) - 1.0
    assert loss == pytest.approx(-0.000152, abs=1e-6)  # the paper's factor 1 - sin: -0.0175
    assert tilted_axis.mean() == pytest.approx(EARTH_DEG_H * np.sin(np.deg2rad(37.0)) * np.sin(np.deg2rad(1.0)), 1e-6)


def all_of_them():
    rng = np.random.default_rng(11)
    return {
        "constant": Constant(),
        "slow": drawn_slow(rng),
        "double": Sine(2.0, 0.3),
        "linear": Linear(20.0),
        "steps": drawn_steps(rng, (17,), 1.0),
    }


@pytest.mark.parametrize("name", ["constant", "slow", "double", "linear", "steps"])
def test_the_integral_is_that_of_the_values(name):
    one = all_of_them()[name]
    middle_s = (FINE_S[1:] + FINE_S[:-1]) / 2.0
    summed = np.concatenate(([0.0], np.cumsum(one.at(middle_s)) * (FINE_S[1] - FINE_S[0])))
    np.testing.assert_allclose(one.integral_s(FINE_S), summed, atol=1e-6)
    if name != "steps":
        np.testing.assert_allclose(
            one.integral_s(FINE_S), cumulative_trapezoid(one.at(FINE_S), FINE_S, initial=0.0), atol=1e-6
        )


@pytest.mark.parametrize("name", ["slow", "double", "linear", "steps"])
def test_nothing_leaves_20_percent_and_most_of_it_is_used(name):
    found = all_of_them()[name].at(FINE_S)
    assert np.abs(found).max() <= 0.2 + 1e-12
    assert np.ptp(found) > 0.25


def test_a_linear_one_goes_up_and_comes_back():
    assert Linear(10.0).at(np.array([0.0, 5.0, 10.0, 15.0, 20.0])) == pytest.approx([-0.2, 0.0, 0.2, 0.0, -0.2])


def test_steps_stay_for_their_time_and_repeat_behind_the_table():
    steps = drawn_steps(np.random.default_rng(3), (4,), 0.5)
    found = steps.at(np.arange(0.05, 4.0, 0.1)).reshape(8, 5)
    assert np.ptp(found, axis=1).max() == 0.0
    assert np.unique(found[:4, 0]).size == 4
    np.testing.assert_array_equal(found[:4], found[4:])


def test_each_run_varies_by_itself():
    rng = np.random.default_rng(5)
    for one in (drawn_slow(rng, (3, 1)), drawn_steps(rng, (3, 20), 1.0)):
        found = one.at(np.arange(0.5, 20.0))
        assert found.shape == (3, 20) == one.integral_s(np.arange(0.5, 20.0)).shape
        assert np.abs(np.diff(found, axis=0)).max(axis=1).min() > 0.01
