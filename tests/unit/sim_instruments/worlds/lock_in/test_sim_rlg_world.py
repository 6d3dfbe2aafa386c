"""The ring-laser bench: edges by bench time, what people and the supply do, housekeeping, options, truth."""

import binascii
import math
import struct
from contextlib import contextmanager

import numpy as np
import pytest
import pyvisa
from one_estimate import value

from bench.model.clock import NS, VirtualClock, to_ns
from bench.model.ports import RecordWindow
from sim_instruments.worlds.simulation import open_world

SUPPLY = "GPIB0::5::INSTR"
STATION = {"instruments": {"supply": {"driver": "hp_6632b", "resource": SUPPLY}}, "links": {}}
BEAT_S = 3.0


@contextmanager
def opened(seed=1, on=True, **options):
    clock = VirtualClock()
    clock.sleep(5.0)  # the bench is not born at zero
    world = open_world("ring_laser", clock=clock, seed=seed, station=STATION, options=options)
    try:
        world.unit.connect("rlg", 115_200)
        if on:
            world.unit.set_power(True, clock.now_ns(), 15.0)
        yield world
    finally:
        world.close()


LATE_PS = 120_000  # delay of the pick-off's comparator and four times its noise


def asked(world, times_s, acts=None):
    """Edges asked for at times since the world's birth; ``acts``: what somebody does at which of those times."""
    parts = []
    for time_s in sorted({*times_s, *(acts or {})}):
        world.clock.sleep_until_ns(world.edges_epoch_ns + to_ns(time_s))
        if acts and time_s in acts:
            acts[time_s](world)
        parts.append(world.edges_until(world.clock.now_ns()))
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def same(first, second):
    return all(np.array_equal(one, other) for one, other in zip(first, second, strict=True))


def to_40_deg(world):
    world.operate("backscatter_phase", 40.0)


def power_off(world):
    world.unit.set_power(False, world.clock.now_ns(), 0.0)


def test_the_same_edges_come_however_they_are_asked_for():
    acts = {3.2003: to_40_deg, 3.33: power_off}
    times_s = np.random.default_rng(4).uniform(0.0, 3.4, 60).round(9)
    with opened(beat_noise_ppm="10000") as world:
        whole = asked(world, [3.4], acts)
    with opened(beat_noise_ppm="10000") as world:
        assert same(asked(world, [*times_s, 3.2001, 3.3299, 3.4], acts), whole)  # both acts within a block
    with opened(beat_noise_ppm="10000") as world:
        for time_s in sorted(acts):
            world.clock.sleep_until_ns(world.edges_epoch_ns + to_ns(time_s))
            acts[time_s](world)
        assert same(world.edges_until(world.clock.now_ns() + NS), whole)  # nobody looked before the end
    t_ps = whole[0]
    assert t_ps.dtype == np.int64
    assert 0 <= t_ps[0] - 3 * 10**12 < LATE_PS
    assert (np.diff(t_ps) >= 0).all()
    assert t_ps[-1] < 3.33e12
    assert len(t_ps) == pytest.approx(0.33 * 246_500, rel=0.01)


def test_a_new_phase_of_the_backscatter_changes_only_what_comes_later():
    with opened() as world:
        before = asked(world, [3.2])
    with opened() as world:
        after = asked(world, [3.2], {3.1: to_40_deg})
    first = int(np.argmax(before[0][: len(after[0])] != after[0][: len(before[0])]))
    assert 3.1e12 < before[0][first] < 3.1e12 + 3e9  # within two half cycles


def test_edges_of_different_seeds_paths_and_switchings_on_differ():
    found = []
    for seed, path_m in ((1, 0.28), (2, 0.28), (1, 0.34)):
        with opened(seed, on=False) as world:
            world.operate("path_length", path_m)
            world.unit.set_power(True, world.clock.now_ns(), 15.0)
            found.append(asked(world, [3.02]))
            power_off(world)
            world.unit.set_power(True, world.clock.now_ns(), 15.0)
            again = asked(world, [6.04])
            assert 0 <= again[0][0] - 6_020_000_000_000 < LATE_PS
            found.append([again[0] - 3_020_000_000_000, *again[1:]])
    for number, one in enumerate(found):
        assert len(one[0]) > 4000
        assert not any(np.array_equal(one[0], other[0]) for other in found[:number])


def test_time_that_nobody_looked_at_is_not_computed():
    with opened() as world:
        world.clock.sleep(3600.0)
        now_ns = world.clock.now_ns()
        world.skip_edges(now_ns)
        world.clock.sleep(0.1)
        t_ps, channel, *_ = world.edges_until(world.clock.now_ns())
        assert t_ps[0] >= (now_ns - world.edges_epoch_ns) * 1000
        assert len(t_ps) == pytest.approx(24_650, rel=0.02)
        assert (channel == 1).sum() == 80
        zero_ps = t_ps[channel == 1]
        half = np.arange(80)
        late_ps = zero_ps - zero_ps[0] - np.polyval(np.polyfit(half, zero_ps - zero_ps[0], 1), half)
        assert np.ptp(late_ps) < LATE_PS  # the pick-off's grid goes on
        assert 11e3 < late_ps.std() < 19e3  # normal, 15 ns: less leaves its stamps in step with a clock of 20 MHz


def test_a_block_that_is_mounted_starts_at_once_and_is_the_same_when_it_comes_back():
    with opened() as world:
        current_A = world.load[1]
        asked(world, [3.1])
        world.operate("path_length", "0.34")
        assert world.load[1] != current_A
        assert len(world.edges_until(world.clock.now_ns() + 2 * NS)[0]) == 0
        world.clock.sleep(BEAT_S + 1.0)
        assert len(world.edges_until(world.clock.now_ns())[0]) == pytest.approx(299_000, rel=0.01)
        world.operate("path_length", 0.28)
        assert world.load[1] == current_A
        lives = world.laser_unit.lives
        assert lives[0].block == lives[2].block != lives[1].block
        world.operate("path_length", 0.28)
        assert len(world.laser_unit.lives) == 3


def test_the_supply_starts_the_laser_and_feeds_it():
    with opened(on=False) as world:
        manager = pyvisa.ResourceManager(world.visa_library)
        supply = manager.open_resource(SUPPLY, read_termination="\n", write_termination="\n")
        for message in ("VOLT 12", "CURR 1", "OUTP ON"):
            supply.write(message)
        world.clock.sleep(4.0)
        assert len(world.edges_until(world.clock.now_ns())[0]) == 0
        supply.write("VOLT 15")
        supply.write("VOLT 15.2")  # another voltage changes nothing
        world.clock.sleep(3.1)
        assert len(world.edges_until(world.clock.now_ns())[0]) > 10_000
        assert float(supply.query("MEAS:CURR?")) == pytest.approx(0.69, abs=0.01)
        assert len(world.laser_unit.lives) == 1
        manager.close()


def frames(received):
    """Housekeeping taken apart by hand; crc_hqx of the standard library is the frame's check."""
    rows = []
    for at in range(0, len(received), 16):
        assert received[at : at + 2] == b"RL"
        assert struct.unpack_from("<H", received, at + 14)[0] == binascii.crc_hqx(received[at + 2 : at + 14], 0xFFFF)
        rows.append(struct.unpack_from("<IhHHH", received, at + 2))
    return np.array(rows)


def test_housekeeping_tells_temperature_intensity_and_dither():
    with opened() as world:
        world.clock.sleep(300.0)
        rows = frames(world.unit.read("rlg", 10**6))
        counter, degC, volt, dither, status = (rows * [1, 0.01, 1e-4, 0.01, 1]).T
        assert counter.tolist() == list(range(len(rows)))
        assert len(rows) == 2995
        beat = counter >= 25  # 0.5 s + 2.5 s
        assert (status == ~beat).all()
        assert volt[~beat].max() < 0.002
        assert volt[beat].min() > 1.0
        assert degC[0] == pytest.approx(23.0, abs=1.0)
        assert degC[-1] - degC[0] == pytest.approx(8.0 * (1.0 - math.exp(-300.0 / 900.0)), abs=0.1)
        assert (dither[~beat] == 0.0).all()
        block = world.laser_unit.block
        mean = block.laser.dither_deg_s * block.dither_gain
        assert dither[30:].mean() == pytest.approx(mean, abs=0.05)
        assert dither[30:].std() == pytest.approx(math.hypot(5.0 / math.sqrt(80.0), 0.05), rel=0.1)
        assert abs(block.dither_gain - 1.0) > 1e-4  # a sensor that errs


def test_options_reach_the_laser():
    with opened(quantum_noise="off", rate_deg_h="0", dither_noise_ppm="20000", beat_noise_ppm="10000",
                second_harmonic_ppm="5000", backscatter_drift_deg_h="60") as world:  # fmt: skip
        block = world.laser_unit.block
        laser = block.laser
        assert (laser.quantum_deg_rt_h, laser.rate_deg_h) == (0.0, 0.0)
        assert (laser.dither_noise, laser.beat_noise, laser.second_harmonic) == pytest.approx((0.02, 0.01, 0.005))
        assert block.drift_deg_h == 60.0
    with opened() as world:
        assert world.laser_unit.block.laser.quantum_deg_rt_h == pytest.approx(1.15e-4)


def window(world, start_s, stop_s, **conditions):
    t_ns = [world.edges_epoch_ns + to_ns(time_s) for time_s in (start_s, stop_s)]
    return RecordWindow(0, "edges", 0, 100, *t_ns, {"item": "lock_in", **conditions})


def test_truth_is_that_of_the_laser_that_was_on():
    with opened(backscatter_drift_deg_h="3600") as world:
        offset_deg = world.laser_unit.block.phase_offset_deg
        world.clock.sleep(10.0)
        world.operate("backscatter_phase", 30.0)
        world.clock.sleep(10.0)
        world.operate("path_length", 0.14)
        world.clock.sleep(10.0)
        entries = world.truth([
            window(world, 4, 8, path_length_m=0.28, clock_Hz=1e8, phase_setting_deg=90.0),
            window(world, 14, 18, path_length_m=0.28, clock_Hz=1e8, phase_setting_deg=30.0),
            window(world, 24, 28, path_length_m=0.14, clock_Hz=1e8, phase_setting_deg=30.0),
            window(world, 18, 24, path_length_m=0.14, clock_Hz=2e7, phase_setting_deg=30.0),  # a change in the middle
        ])  # fmt: skip
    assert value(entries, "backscatter_phase", phase_setting_deg=90.0) == pytest.approx(90.0 + offset_deg + 6.0)
    at_30 = {"phase_setting_deg": 30.0, "path_length_m": 0.28}
    assert value(entries, "backscatter_phase", **at_30) == pytest.approx(30.0 + offset_deg + 16.0)
    rate = value(entries, "lock_in_rate", **at_30)
    assert rate == pytest.approx(0.05, rel=0.05)
    walk = value(entries, "angle_random_walk", method="raw", **at_30)
    assert walk == pytest.approx(math.hypot(2.724e-3 * rate / 0.05, 1.15e-4), rel=5e-3)
    assert value(entries, "quantum_random_walk", path_length_m=0.14) == pytest.approx(4.6e-4)
    assert value(entries, "path_length_exponent", method="raw") == pytest.approx(-2.5, abs=0.1)
    assert not any(one["conditions"].get("clock_Hz") == 2e7 for one in entries)
