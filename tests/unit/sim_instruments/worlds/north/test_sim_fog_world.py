"""The gyroscope and the bench of the north finder: supply, output, Earth's rate, headings, acts, truth."""

import binascii
import struct
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from bench.model.clock import NS, VirtualClock
from bench.model.ports import RecordWindow
from sim_instruments.worlds.north.options import PARAMETERS
from sim_instruments.worlds.north.sensor import (
    CONSTANT,
    drawn_slow,
    drawn_steps,
    earth_rate_rad_s,
    linear,
    sensed_rad_s,
    sine,
    tilted,
)
from sim_instruments.worlds.north.world import SITE
from sim_instruments.worlds.simulation import open_world

BAUD = 460_800
LENGTH = 20  # sync, counter, output, encoder, temperature, status, check
QUIET = {"noise": "off", "wobble_arcmin": "0", "placement_arcmin": "0"}


class Rig:
    """A bench with the gyroscope's port open; the table turns as told, with 60 deg/s2."""

    def __init__(self, seed=1, **options):
        self.clock = VirtualClock()
        text = {name: str(value) for name, value in options.items()}
        self.world = open_world("fog_north", clock=self.clock, seed=seed, station={"instruments": {}}, options=text)
        self.unit = self.world.unit

    def power(self, on=True):
        self.unit.set_power(on, self.clock.now_ns(), 15.0 if on else 0.0)

    def listen(self):
        self.unit.connect("fog", BAUD, self.world.faults.link("fog"))

    def spin(self, rate_deg_s=360.0, acceleration_deg_s2=60.0):
        self.world.motion[0].run_at(rate_deg_s, acceleration_deg_s2, self.clock.now_ns())

    def read(self):
        return frames(self.unit.read("fog", 10**8))


def running(seed=1, rate_deg_s=360.0, **options):
    """A rig whose table has come to speed, at 20 s; samples from 2 s on."""
    rig = Rig(seed, **options)
    rig.listen()
    rig.power()
    rig.spin(rate_deg_s)
    rig.clock.sleep(20.0)
    return rig


def frames(received):
    """Rows of counter, volt, degrees, degC, status; every byte belongs to a sound frame."""
    assert len(received) % LENGTH == 0
    rows = []
    for at in range(0, len(received), LENGTH):
        frame = received[at : at + LENGTH]
        assert frame[:2] == b"\xf0\x6e"
        assert struct.unpack("<H", frame[-2:])[0] == binascii.crc_hqx(frame[2:-2], 0xFFFF)
        counter, output, encoder, temperature, status = struct.unpack("<IiIhH", frame[2:-2])
        rows.append((counter, 1e-6 * output, encoder * 360.0 / 2**24, 0.01 * temperature, status))
    return np.array(rows).reshape(-1, 5)


def heading_of(output_V, encoder_deg):
    """Heading of the sensing axis at encoder zero by a least-squares sine of the encoder angle, and its amplitude."""
    angle = np.deg2rad(encoder_deg)
    columns = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    east_like, north_like, _ = np.linalg.lstsq(columns, output_V, rcond=None)[0]
    return (90.0 - np.rad2deg(np.arctan2(north_like, east_like))) % 360.0, np.hypot(east_like, north_like)


MS = 1_000_000


def test_frames_and_waveform_are_the_same_samples_and_the_encoder_is_latched_in_their_middle():
    rig = running(seed=7)
    rows = rig.read()
    np.testing.assert_array_equal(rows[:, 0], np.arange(len(rows)))
    assert len(rows) == 17_999  # 2.000 s to 19.999 s: the last one is still on the line
    analogue = rig.world.waveform(2000, 2000 + len(rows))
    np.testing.assert_allclose(rows[:, 1], analogue, atol=0.501e-6)
    assert analogue.std() > 0.9
    true_deg = rig.world.sensor.table_deg((2000 + rows[:, 0].astype(np.int64)) * MS + MS // 2)
    apart_deg = (rows[:, 2] - true_deg + 180.0) % 360.0 - 180.0
    assert np.abs(apart_deg).max() <= 180.0 / 2**24 * 1.001
    assert rows[:, 2].min() >= 0.0
    assert rows[:, 2].max() < 360.0


@pytest.mark.parametrize("parameters", PARAMETERS)
def test_it_does_not_matter_how_one_asks(parameters):
    rigs = [running(seed=3, parameters=parameters) for _ in range(2)]
    whole = rigs[0].world.waveform(1500, 9000)
    cuts = [1500, 1501, 2000, 2003, 4711, 8999, 9000]
    rng = np.random.default_rng(2)
    parts = {}
    for place in rng.permutation(len(cuts) - 1):
        parts[place] = rigs[1].world.waveform(cuts[place], cuts[place + 1])
    np.testing.assert_array_equal(np.concatenate([parts[place] for place in range(len(cuts) - 1)]), whole)
    rigs[0].clock.sleep(100.0)
    np.testing.assert_array_equal(rigs[0].world.waveform(1500, 9000), whole)


def test_bytes_do_not_depend_on_when_they_are_read():
    received = []
    for step_s in (0.05, 1.7, 20.0):
        rig = Rig(5)
        rig.listen()
        rig.power()
        rig.spin()
        parts = []
        for _ in range(round(20.0 / step_s)):
            rig.clock.sleep(step_s)
            parts.append(rig.unit.read("fog", 10**8))
        received.append(b"".join(parts))
    shortest = min(map(len, received))
    assert shortest > 300_000
    assert len({one[:shortest] for one in received}) == 1


def test_noise_is_white_and_of_the_stated_size():
    world = running(seed=9, scale_V=0, random_walk_V=0.3, vibration_V=0.4).world
    noise_V = world.waveform(2000, 20_000)
    assert noise_V.std() == pytest.approx(0.5, rel=0.02)
    for lag in (1, 2, 10, 500):
        assert abs(np.corrcoef(noise_V[lag:], noise_V[:-lag])[0, 1]) < 4.0 / np.sqrt(18_000)
    assert world.sensor.noise_V == pytest.approx(0.5)


@pytest.mark.parametrize("rate_deg_s", [360.0, -360.0, 90.0])
@pytest.mark.parametrize("head_deg", [0.0, 70.0, -110.0])
def test_the_azimuth_is_that_of_the_mark_and_the_head(rate_deg_s, head_deg):
    rig = Rig(1, **QUIET)
    rig.world.operate("head", head_deg)
    rig.listen()
    rig.power()
    rig.spin(rate_deg_s)
    rig.clock.sleep(30.0)
    rows = rig.read()[-8000:]
    heading_deg, amplitude_V = heading_of(rows[:, 1], rows[:, 2])
    assert heading_deg == pytest.approx((20.0 + head_deg) % 360.0, abs=1e-5)
    assert amplitude_V == pytest.approx(1.0, abs=1e-5)


def test_the_field_is_somewhere_else_and_nobody_says_where():
    azimuths_deg = []
    for seed in range(6):
        rig = Rig(seed, **QUIET)
        rig.world.operate("place", "field")
        rig.world.operate("head", 0.0)
        rig.listen()
        rig.power()
        rig.spin()
        rig.clock.sleep(12.0)
        rows = rig.read()[-3000:]
        found_deg = heading_of(rows[:, 1], rows[:, 2])[0]
        assert found_deg == pytest.approx(float(rig.world.heading_deg(np.array([0]))[0]), abs=1e-4)
        azimuths_deg.append(found_deg)
        rig.world.operate("place", "mark")
        assert float(rig.world.heading_deg(np.array([rig.clock.now_ns()]))[0]) == SITE.azimuth_deg
    assert np.ptp(azimuths_deg) > 60.0


def test_an_act_does_not_change_what_was():
    rig = running(seed=4)
    before = rig.world.waveform(2000, 20_000)
    rig.world.operate("head", 90.0)
    rig.clock.sleep(5.0)
    np.testing.assert_array_equal(rig.world.waveform(2000, 20_000), before)
    rows = rig.read()
    assert heading_of(rows[:18_000, 1], rows[:18_000, 2])[0] == pytest.approx(20.0, abs=2.5)
    assert heading_of(rows[18_000:, 1], rows[18_000:, 2])[0] == pytest.approx(110.0, abs=4.0)


@pytest.mark.parametrize(("tilt", "head_deg"), [((2.0, 0.0), 0.0), ((2.0, 0.0), 90.0), ((1.0, -3.0), 45.0)])
def test_the_level_tells_what_turns_north(tilt, head_deg):
    """The tilt about north, by the level's two axes and the heading, explains the error of the azimuth."""
    rig = Rig(1, **QUIET, rotation_tilt_arcmin=tilt[0], rotation_tilt_east_arcmin=tilt[1])
    rig.world.operate("head", head_deg)
    rig.listen()
    rig.power()
    rig.spin()
    rig.clock.sleep(20.0)
    rows = rig.read()[-8000:]
    heading = np.deg2rad(20.0 + head_deg)
    x_mrad, y_mrad = rig.world.level_mrad(rig.clock.now_ns())
    about_north, about_east = (
        x_mrad * np.cos(heading) - y_mrad * np.sin(heading),
        x_mrad * np.sin(heading) + y_mrad * np.cos(heading),
    )
    arcmin = 1e3 * np.deg2rad(1.0 / 60.0)
    assert (about_north, about_east) == pytest.approx((tilt[0] * arcmin, tilt[1] * arcmin))
    error_deg = heading_of(rows[:, 1], rows[:, 2])[0] - (20.0 + head_deg)
    assert error_deg == pytest.approx(np.rad2deg(1e-3 * about_north) * np.tan(np.deg2rad(37.0)), rel=3e-3)


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_harmonics_have_the_stated_size(order):
    rig = running(**QUIET, **{f"harmonic_{order}_ppm": 10_000})
    rows = rig.read()[-8000:]
    angle = np.deg2rad(rows[:, 2])
    found = [2.0 * np.hypot(*(np.mean(rows[:, 1] * wave(k * angle)) for wave in (np.sin, np.cos))) for k in range(1, 6)]
    due = [1.0 if k == 1 else 0.01 if k == order else 0.0 for k in range(1, 6)]
    np.testing.assert_allclose(found, due, atol=2e-5)


@pytest.mark.parametrize(("table_rate", "share"), [("on", 1.0), ("off", 0.0)])
def test_an_axis_out_of_the_plane_feels_the_table(table_rate, share):
    """360 deg/s sin(1 arcmin) in units of 12.01 deg/h; and the vertical part of the Earth's rate in both cases."""
    due_V = share * 360.0 * 3600.0 * np.sin(np.deg2rad(1.0 / 60.0)) / (15.041067 * np.cos(np.deg2rad(37.0)))
    world = running(**QUIET, axis_tilt_arcmin=1, table_rate=table_rate).world
    vertical_V = np.tan(np.deg2rad(37.0)) * np.sin(np.deg2rad(1.0 / 60.0))
    assert world.waveform(10_000, 20_000).mean() - vertical_V == pytest.approx(due_V, abs=2e-5)


def test_the_amplitude_is_true_with_tilts():
    world = running(**QUIET, scale_V=2, axis_tilt_arcmin=60, table_rate="off", rotation_tilt_east_arcmin=60).world
    output_V = world.waveform(10_000, 20_000)
    found = heading_of(output_V, world.sensor.table_deg(np.arange(10_000, 20_000) * MS + MS // 2))[1]
    assert found == pytest.approx(world.sensor.amplitude_V, rel=3e-6)
    assert world.sensor.amplitude_V == pytest.approx(
        2.0 * np.cos(np.deg2rad(1.0)) * np.cos(np.deg2rad(36.0)) / np.cos(np.deg2rad(37.0)), rel=1e-9
    )


@pytest.mark.parametrize(
    ("parameters", "scatter_V"), [("slow", 0.05), ("step", 0.05), ("linear", 0.05), ("double", 0.1)]
)
def test_parameters_vary(parameters, scatter_V):
    rig = running(seed=2, **QUIET, parameters=parameters, ramp_s=20)
    rows = rig.read()
    ideal = np.sin(np.deg2rad(70.0 + rows[:, 2]))
    assert scatter_V < (rows[:, 1] - ideal).std() * 2.0 < 0.25
    assert np.abs(rows[:, 1]).max() <= 1.2


def window(number, item, head_deg, begin_s, **more):
    conditions = {"item": item, "head_deg": head_deg, "index": 1, **more}
    return RecordWindow(number, "fog", 0, 5000, begin_s * NS, (begin_s + 5) * NS, conditions)


def test_truth_is_that_of_the_time_of_each_record():
    rig = Rig(6)
    rig.clock.sleep(10.0)
    rig.world.operate("head", 350.0)
    rig.clock.sleep(10.0)
    rig.world.operate("place", "field")
    rig.clock.sleep(10.0)
    windows = [
        window(1, "calibration", 0.0, 0, place="mark"), window(2, "test", 350.0, 12, place="mark"),
        window(3, "test", 350.0, 14, place="mark"), window(4, "search", 350.0, 22, place="field"),
    ]  # fmt: skip
    found = rig.world.truth(windows)
    azimuths = [one for one in found if one["quantity"] == "azimuth"]
    assert azimuths[0]["value"] == 10.0
    assert azimuths[0]["conditions"] == {"item": "test", "place": "mark", "head_deg": 350.0}
    assert azimuths[1]["value"] == float(rig.world.heading_deg(np.array([25 * NS]))[0])
    assert len(azimuths) == 2  # that of the calibration is stated
    rest = {(one["quantity"], *one["conditions"].values()): one["value"] for one in found if one not in azimuths}
    assert rest == {
        ("index_placement", "a"): rig.world.sensor.placement_deg["a"],
        ("index_placement", "b"): rig.world.sensor.placement_deg["b"],
        ("scale", "waveform"): 1.0,
        ("noise", "waveform"): pytest.approx(np.sqrt(0.5)),
    }
    assert rig.world.truth([]) == []


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


def test_the_swing_has_its_size_at_full_speed_and_none_at_rest():
    world = running(wobble_arcmin=30, wobble_Hz=10).world
    t_ns = np.arange(19_000, 20_000) * MS
    swing = world.sensor.table_deg(t_ns) - world.motion[0].angle_deg(t_ns)
    np.testing.assert_allclose(swing, 0.5 * np.sin(2.0 * np.pi * 10.0 * t_ns / NS), atol=1e-9)
    rig = Rig(1)
    rig.power()
    rig.clock.sleep(30.0)
    assert rig.world.pulses("a", 0, 30 * NS).size == 0
    assert np.ptp(rig.world.sensor.table_deg(np.arange(0, 1000 * MS, MS))) == 0.0


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


def of_heading(heading_deg, **tilts):
    """Sensed rate of an axis of that heading, deg/h."""
    in_table = tilted(tilts.get("east", 0.0), tilts.get("north", 0.0)).T @ earth_rate_rad_s(LATITUDE_DEG)
    angle_rad = np.deg2rad(90.0 - np.asarray(heading_deg))
    return np.rad2deg(sensed_rad_s(in_table, angle_rad, 0.0)) * 3600.0


@pytest.mark.parametrize(("east", "north"), [(0.0, 0.0), (1.0, 0.0), (0.0, -2.0), (0.7, 0.4)])
def test_the_tilt_is_a_turn_by_its_vector(east, north):
    vector = np.deg2rad([east, north, 0.0])
    np.testing.assert_allclose(tilted(east, north), Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)
    for heading_deg in (0.0, 50.0, 222.0):
        flat = np.array([np.sin(np.deg2rad(heading_deg)), np.cos(np.deg2rad(heading_deg)), 0.0])
        axis = Rotation.from_rotvec(vector).apply(flat)
        due = EARTH_DEG_H * axis @ [0.0, np.cos(np.deg2rad(LATITUDE_DEG)), np.sin(np.deg2rad(LATITUDE_DEG))]
        assert of_heading(heading_deg, east=east, north=north) == pytest.approx(due, abs=2e-6)


def all_of_them():
    rng = np.random.default_rng(11)
    return {
        "constant": CONSTANT,
        "slow": drawn_slow(rng),
        "double": sine(2.0, 0.3),
        "linear": linear(20.0),
        "steps": drawn_steps(rng, 17, 1.0),
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


def test_each_variation_goes_as_it_says():
    assert linear(10.0).at(np.array([0.0, 5.0, 10.0, 15.0, 20.0])) == pytest.approx([-0.2, 0.0, 0.2, 0.0, -0.2])
    steps = drawn_steps(np.random.default_rng(3), 4, 0.5)
    found = steps.at(np.arange(0.05, 4.0, 0.1)).reshape(8, 5)
    assert np.ptp(found, axis=1).max() == 0.0
    assert np.unique(found[:4, 0]).size == 4
    np.testing.assert_array_equal(found[:4], found[4:])
