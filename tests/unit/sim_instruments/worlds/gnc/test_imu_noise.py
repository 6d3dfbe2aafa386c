"""Noise of the simulated sensors: its distribution, its Allan deviation, and that nobody's way of asking changes it."""

import allantools
import numpy as np
import pytest
from gnc_sensor_bench import Table, module, times_ns
from scipy import stats

from bench.model.clock import NS
from sim_instruments.worlds.common.sensor_noise import SlowNoise, WhiteNoise
from sim_instruments.worlds.gnc.imu import GncImu, ImuOptions

STAMPS = times_ns(500.0)


def test_white_noise_is_normal_white_and_apart() -> None:
    drawn = WhiteNoise(3, "test", 10).at(STAMPS)
    n = STAMPS.size
    assert drawn.shape == (n, 10)
    for column in drawn.T:
        assert stats.kstest(column, "norm").pvalue > 1e-4
        spectrum = np.abs(np.fft.rfft(column)[1:-1]) ** 2 / n
        assert stats.kstest(spectrum, "expon").pvalue > 1e-4
        assert abs(np.corrcoef(column[:-1], column[1:])[0, 1]) < 5 / np.sqrt(n)
        assert abs(stats.kurtosis(column)) < 5 * np.sqrt(24 / n)
    others = np.concatenate(
        (drawn, WhiteNoise(4, "test", 10).at(STAMPS), WhiteNoise(3, "other", 10).at(STAMPS)), axis=1
    )
    assert np.abs(np.corrcoef(others.T) - np.eye(30)).max() < 5.5 / np.sqrt(n)
    assert np.abs(np.corrcoef((others**2).T) - np.eye(30)).max() < 5.5 / np.sqrt(n)


@pytest.mark.parametrize("step_ns", [1, 999_999, 5_000_000, 1 << 32])
def test_white_noise_of_any_rate(step_ns: int) -> None:
    drawn = WhiteNoise(5, "test", 1).at(10**15 + step_ns * np.arange(50_000, dtype=np.int64))[:, 0]
    assert stats.kstest(drawn, "norm").pvalue > 1e-4
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 5 / np.sqrt(50_000)
    assert np.unique(drawn).size == 50_000


def test_slow_noise_is_a_gauss_markov_process() -> None:
    """Standard deviation and correlation after one correlation time, over 4,000 of them."""
    slow = SlowNoise(1, "test", np.array([2.0, 0.5]), np.array([20.0, 50.0]))
    seconds = np.arange(200_000)
    values = slow.at(seconds * NS)
    for column, sigma, time_s in ((0, 2.0, 20), (1, 0.5, 50)):
        one = values[:, column]
        assert one.std() == pytest.approx(sigma, rel=0.08)
        assert np.corrcoef(one[:-time_s], one[time_s:])[0, 1] == pytest.approx(np.exp(-1), abs=0.06)
    between = slow.at(seconds[5:50] * NS + NS // 4)
    assert between == pytest.approx(values[5:50] + (values[6:51] - values[5:50]) / 4, rel=1e-12)


def test_slow_noise_is_stationary_from_the_start() -> None:
    first = [SlowNoise(seed, "test", np.ones(3), np.full(3, 300.0)).at(np.array([0]))[0] for seed in range(300)]
    assert np.std(first) == pytest.approx(1.0, rel=0.1)


def test_order_of_asking_changes_nothing() -> None:
    """Across the borders of blocks (1,024 s) and chunks, forwards, backwards and one by one."""
    slow = SlowNoise(2, "test", np.ones(2), np.array([10.0, 1000.0]))
    places = np.array([0, 1, 1_023_400_000_000, 1_024 * NS, 1_024 * NS + 1, 5_000 * NS], np.int64)
    together = SlowNoise(2, "test", np.ones(2), np.array([10.0, 1000.0])).at(places)
    for index in (5, 0, 3, 2, 4, 1, 5):
        assert np.array_equal(slow.at(places[index : index + 1])[0], together[index])


@pytest.mark.parametrize("seed", [1, 2])
def test_samples_do_not_depend_on_the_calls(seed: int) -> None:
    stamps = times_ns(1100.0)
    whole = GncImu(seed, "GNC-07").sample(stamps)
    cut = np.random.default_rng(seed).choice(np.arange(1, stamps.size), 12, replace=False)
    pieces = np.split(stamps, np.sort(cut))
    unit = GncImu(seed, "GNC-07")
    order = np.random.default_rng(seed + 5).permutation(len(pieces))
    drawn = {int(place): unit.sample(pieces[place]) for place in order}
    for name in ("gyro", "accel", "mag", "temperature"):
        joined = np.concatenate([getattr(drawn[place], name) for place in range(len(pieces))])
        assert np.array_equal(joined, getattr(whole, name)), name
    assert unit.sample(stamps[:0]).gyro.shape == (0, 3)


def test_slow_noise_begins_with_the_first_power_on() -> None:
    """A bench whose clock has run for a year is no slower, and its unit walks as after a second."""
    year, drifts = 31_536_000 * NS, []
    for begin_ns in (NS, year):
        unit = GncImu(4, "GNC-01")
        unit.power.on(begin_ns)
        stamps = begin_ns + np.arange(0, 3600, 60) * NS
        drifts.append(unit.gyro_bias_deg_s(stamps))
    assert drifts[0] == pytest.approx(drifts[1], rel=1e-9)
    assert np.ptp(drifts[0]) > 1e-4


def test_units_seeds_and_axes_are_strangers() -> None:
    stamps = times_ns(50.0)
    units = [GncImu(1, "GNC-01"), GncImu(1, "GNC-02"), GncImu(2, "GNC-01")]
    columns = np.concatenate([np.hstack((c.gyro, c.accel, c.mag)) for c in (u.sample(stamps) for u in units)], axis=1)
    assert np.abs(np.corrcoef(columns.T) - np.eye(27)).max() < 5.5 / np.sqrt(stamps.size)
    biases = [tuple(unit.errors.gyro.bias) for unit in units]
    assert len(set(biases)) == 3


def test_random_walks_by_allantools() -> None:
    """N of the truth is what allantools finds at 1 s in the counts, rounding and slow noise included (1 % of it)."""
    options = ImuOptions(errors=False)
    unit = module(Table(), options)
    counts = unit.sample(times_ns(2000.0))
    gyro, accel = counts.gyro * 0.005, counts.accel * 1e-3
    for axis in range(3):
        _, found, _, _ = allantools.oadev(gyro[:, axis], rate=200.0, data_type="freq", taus=[1.0])
        assert found[0] == pytest.approx(unit.errors.gyro.white[axis], rel=0.08)
        assert unit.errors.gyro.white[axis] * 60.0 == pytest.approx(0.3)  # deg/rt_h
        _, found, _, _ = allantools.oadev(accel[:, axis], rate=200.0, data_type="freq", taus=[1.0])
        assert found[0] == pytest.approx(np.hypot(0.1e-3, 1e-3 / np.sqrt(12 * 200)), rel=0.08)


def test_noise_of_a_slower_stream() -> None:
    """A sample over 20 ms has half the noise of one over 5 ms; the random walk stays."""
    unit = module(Table(), ImuOptions(errors=False))
    fast = unit.readings(times_ns(200.0)).gyro_deg_s
    slow = unit.readings(times_ns(200.0, rate_hz=50.0), 20_000_000).gyro_deg_s
    assert slow.std(axis=0) == pytest.approx(fast.std(axis=0) / 2, rel=0.03)
