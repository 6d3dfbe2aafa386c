"""The bench of the north finder: one process seen by port and lock-in; headings; what a person does; truth."""

import dataclasses
from decimal import Decimal

import numpy as np
import pytest
from fog_rig import QUIET, Rig, heading_of, running

from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from sim_instruments.worlds.north.options import NUMBERS, OPTIONS, PARAMETERS, TEXTS, FogOptions
from sim_instruments.worlds.north.world import SITE

MS = 1_000_000

# --- one process ---------------------------------------------------------------------------------------------------


def test_frames_and_waveform_are_the_same_samples():
    rig = running(seed=7)
    rows = rig.read()
    np.testing.assert_array_equal(rows[:, 0], np.arange(len(rows)))
    assert len(rows) == 17_999  # 2.000 s to 19.999 s: the last one is still on the line
    analogue = rig.world.waveform(2000, 2000 + len(rows))
    np.testing.assert_allclose(rows[:, 1], analogue, atol=0.501e-6)
    assert analogue.std() > 0.9


def test_the_encoder_is_latched_in_the_middle_of_the_sample():
    rig = running(seed=7)
    rows = rig.read()
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


def test_another_seed_draws_other_noise_and_marks_and_field():
    one, other = running(seed=1).world, running(seed=2).world
    assert np.abs(one.waveform(5000, 5100) - other.waveform(5000, 5100)).max() > 0.1
    assert one.sensor.placement_deg != other.sensor.placement_deg
    assert abs(np.corrcoef(one.waveform(5000, 15000), other.waveform(5000, 15000))[0, 1]) > 0.3  # the same Earth


def test_noise_is_white_and_of_the_stated_size():
    world = running(seed=9, scale_V=0, random_walk_V=0.3, vibration_V=0.4).world
    noise_V = world.waveform(2000, 20_000)
    assert noise_V.std() == pytest.approx(0.5, rel=0.02)
    for lag in (1, 2, 10, 500):
        assert abs(np.corrcoef(noise_V[lag:], noise_V[:-lag])[0, 1]) < 4.0 / np.sqrt(18_000)
    assert world.sensor.noise_V == pytest.approx(0.5)


# --- headings ------------------------------------------------------------------------------------------------------


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


def test_a_table_that_comes_to_speed_is_the_same_signal():
    rig = running(**{**QUIET, "wobble_arcmin": "3"})
    rows = rig.read()[:6000]  # 2 s to 8 s; full speed comes at 6 s
    assert heading_of(rows[:, 1], rows[:, 2]) == pytest.approx((20.0, 1.0), abs=2e-4)


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


# --- options -------------------------------------------------------------------------------------------------------


def test_every_option_has_a_default_and_says_it():
    offered = {**OPTIONS, **{name: entry[0] for name, entry in {**NUMBERS, **TEXTS}.items()}}
    defaults = {field.name: field.default for field in dataclasses.fields(FogOptions)}
    assert defaults.keys() == offered.keys()
    for name, text in offered.items():
        due = defaults[name]
        said = ("on" if due else "off") if isinstance(due, bool) else f"{due:g}" if isinstance(due, float) else due
        assert f"default {said}" in text, name
    for name, (_, least, most) in NUMBERS.items():
        assert least <= defaults[name] <= most


@pytest.mark.parametrize(
    ("name", "value"), [("noise", "yes"), ("scale_V", "11"), ("parameters", "wild"), ("rate", "1")]
)
def test_an_option_that_cannot_be_is_refused(name, value):
    with pytest.raises(InputError, match="B-SIM-002"):
        Rig(1, **{name: value})


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


# --- a person, the truth -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "code"),
    [
        ("unit", "FOG-2", "B-SIM-018"),
        ("place", "roof", "B-SIM-019"),
        ("head", "north", "B-SIM-019"),
        ("head", 361.0, "B-SIM-019"),
        ("head", float("nan"), "B-SIM-019"),
        ("head", None, "B-SIM-019"),
    ],
)
def test_what_a_person_cannot_do_is_refused(name, value, code):
    with pytest.raises(InputError, match=code):
        Rig(1).world.operate(name, value)


def test_an_angle_may_be_written_in_any_way():
    world = Rig(1).world
    for value in (30, "30", 30.0, Decimal(30)):
        world.operate("head", value)
        assert float(world.heading_deg(np.array([0]))[0]) == 50.0


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
