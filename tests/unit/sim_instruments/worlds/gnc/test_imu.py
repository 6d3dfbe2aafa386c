"""The simulated sensors of a module: errors, ranges, power, and their noise over short and long times."""

from __future__ import annotations

import allantools
import numpy as np
import pytest
from gnc_sensor_bench import IDEAL, QUIET, Table, at, module, posed, times_ns, trapezoid, turning
from scipy import stats

from bench.model.clock import NS
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.common.sensor_noise import SlowNoise, WhiteNoise
from sim_instruments.worlds.gnc.imu import GncImu, ImuOptions
from sim_instruments.worlds.gnc.imu_errors import ImuErrors, Triad

UNITS = [ImuErrors(9, f"GNC-{number:03d}", ImuOptions()) for number in range(300)]
UP = {"+x": (-90, 0), "-x": (90, 0), "+y": (0, 90), "-y": (0, -90), "+z": (0, 0), "-z": (0, 180)}  # middle, inner
COLD = 10**12  # a time long before any power-on
STAMPS = times_ns(500.0)


def test_draws_of_many_units() -> None:
    """The classes of the page: 1 % scale, 0.3 % cross terms that are not symmetric, 0.1 deg/s, 10 mg."""
    gyro = np.array([unit.gyro.sensitivity for unit in UNITS])
    rows, columns = np.nonzero(~np.eye(3, dtype=bool))
    assert gyro[:, [0, 1, 2], [0, 1, 2]].std() == pytest.approx(0.01, rel=0.1)
    assert gyro[:, rows, columns].std() == pytest.approx(0.003, rel=0.1)
    assert abs(np.corrcoef(gyro[:, 0, 1], gyro[:, 1, 0])[0, 1]) < 0.25
    assert np.std([unit.gyro.bias for unit in UNITS]) == pytest.approx(0.1, rel=0.1)
    assert np.std([unit.accel.bias for unit in UNITS]) == pytest.approx(0.010, rel=0.1)
    assert {round(60 * float(one), 12) for unit in UNITS for one in unit.gyro.white} == {0.3}
    walks = np.array([ImuErrors(9, unit, ImuOptions(imu_class="table_2")).gyro.white for unit in map(str, range(300))])
    ten_seconds_deg_h = np.hypot(walks / np.sqrt(10) * 3600, 2.0)
    assert 0.15 < walks.min() * 60 < 0.20
    assert 0.44 < walks.max() * 60 < 0.48
    assert 3.6 <= ten_seconds_deg_h.min() < 3.9  # Table 2 of the paper
    assert 8.8 < ten_seconds_deg_h.max() <= 9.1
    fine = np.array([ImuErrors(9, str(n), ImuOptions(imu_class="table_3")).accel.sensitivity for n in range(100)])
    assert np.abs(fine[:, rows, columns]).max() < 0.001


def test_serial_and_seed_make_the_unit() -> None:
    again, other = (ImuErrors(9, serial, ImuOptions()) for serial in ("GNC-001", "GNC-1"))
    assert np.array_equal(again.gyro.sensitivity, UNITS[1].gyro.sensitivity)
    assert not np.array_equal(other.gyro.sensitivity, UNITS[1].gyro.sensitivity)
    ideal = ImuErrors(9, "GNC-001", ImuOptions(errors=False))
    assert np.array_equal(ideal.accel.sensitivity, np.eye(3))
    assert not ideal.gyro.bias.any()
    assert np.array_equal(ideal.gyro.white, again.gyro.white)  # its noise stays


def test_six_positions_show_the_accelerometer() -> None:
    """N = S (a + b), by least squares over six poses of a quiet unit; written here, from nothing of the fits."""
    inputs, indicated = [], []
    for up, (middle, inner) in UP.items():
        unit = module(posed(0, middle, inner), QUIET)
        sign = 1.0 if up[0] == "+" else -1.0
        inputs.append([*(sign * 9.7969 / 9.80665 * np.eye(3)["xyz".index(up[1])]), 1.0])
        indicated.append(unit.readings(np.array([COLD])).accel_g[0])
    found = np.linalg.lstsq(np.array(inputs), np.array(indicated), rcond=None)[0]
    expected = sensitivity_at(unit.errors.accel, 23.0)
    matrix = found[:3].T
    assert matrix == pytest.approx(expected, abs=1e-12)
    assert np.linalg.solve(expected, found[3]) == pytest.approx(bias_at(unit.errors.accel, 23.0), abs=1e-12)


def test_turns_show_the_gyroscope() -> None:
    """Column j of S is half the difference of the sums of both senses about axis j, per degree: earth and bias go."""
    found = np.empty((3, 3))
    for axis, mounting in enumerate("xyz"):
        sums = []
        for turn in (1080.0, -1080.0):
            table = Table((at(90.0), at(-34.2), trapezoid(1.003, turn, 270.0, 270.0)), mounting)
            unit = module(table, QUIET)
            sums.append(unit.readings(times_ns(15.3)).gyro_deg_s.sum(axis=0) * 0.005)
        found[:, axis] = (sums[0] - sums[1]) / 2160.0
    expected = sensitivity_at(unit.errors.gyro, 23.0)
    assert found == pytest.approx(expected, abs=1e-9)
    assert np.abs(expected - expected.T).max() > 1e-3


def sensitivity_at(triad: Triad, degC: float) -> np.ndarray:
    """S of a triad at a temperature, written out sensor by sensor."""
    rows = [
        (1.0 + (degC - 25.0) * factor) * row
        for row, factor in zip(triad.sensitivity, triad.scale_per_degC, strict=True)
    ]
    return np.array(rows)


def bias_at(triad: Triad, degC: float) -> np.ndarray:
    return triad.bias + (degC - 25.0) * triad.bias_per_degC


def test_rounding() -> None:
    """Counts are the nearest of 0.005 deg/s, 1 mg, 120 microgauss and 0.01 degC."""
    unit = module(Table(), ImuOptions())
    stamps = times_ns(10.0)
    read, counts = unit.readings(stamps), unit.sample(stamps)
    for raw, exact, lsb in (
        (counts.gyro, read.gyro_deg_s, 0.005),
        (counts.accel, read.accel_g, 1e-3),
        (counts.mag, read.mag_gauss, 120e-6),
        (counts.temperature, read.temperature_degC, 0.01),
    ):
        assert raw.dtype == np.int64
        assert np.abs(raw * lsb - exact).max() <= lsb / 2 * (1 + 1e-9)
        assert len(np.unique(raw)) > 3  # the noise moves every sensor over several steps


def test_saturation() -> None:
    """Beyond 400 deg/s, 50 g and 6 gauss nothing more is told."""
    fast = module(Table((at(0), at(0), turning(500.0))), IDEAL).sample(times_ns(1.0))
    assert set(fast.gyro[:, 0]) == {80_000}
    back = module(Table((at(0), at(0), turning(-400.1))), IDEAL).sample(times_ns(1.0))
    assert set(back.gyro[:, 0]) == {-80_000}
    just = module(Table((at(0), at(0), turning(399.0))), IDEAL).sample(times_ns(1.0))
    assert set(just.gyro[:, 0]) == {79_800}
    heavy = module(Table(), IDEAL, site=Site(gravity_m_s2=600.0)).sample(times_ns(0.1))
    assert set(heavy.accel[:, 2]) == {50_000}
    strong = module(Table(), IDEAL)
    strong.magnetometer.offset_gauss = np.array([9.0, -9.0, 3.5])
    counts = strong.sample(times_ns(0.1)).mag
    assert list(counts[0][:2]) == [50_000, -50_000]
    assert abs(counts[0][2]) < 50_000


def test_warm_up() -> None:
    """6 degC with a lag of 80 s from power-on, back with the same lag after power-off."""
    unit = module(Table(), IDEAL)
    unit.power.on(100 * NS)
    unit.power.off(500 * NS)
    unit.power.on(600 * NS)
    seconds = np.array([50, 100, 180, 499, 580, 700])
    after = 6.0 * (1 - np.exp(-400 / 80))
    again = 6.0 + (after * np.exp(-100 / 80) - 6.0) * np.exp(-100 / 80)
    expected = [0, 0, 6 * (1 - np.exp(-1)), 6 * (1 - np.exp(-399 / 80)), after * np.exp(-1), again]
    assert unit.temperature_degC(seconds * NS) - 23.0 == pytest.approx(expected, abs=1e-12)
    assert list(unit.power.period(seconds * NS)) == [0, 0, 0, 0, 0, 1]
    assert unit.sample(np.array([480 * NS])).temperature[0] == round(100 * (23 + 6 * (1 - np.exp(-380 / 80))))


def test_temperature_of_scale_and_bias() -> None:
    """Turning at 100 deg/s at 15 and at 35 degC: the difference holds both coefficients."""
    found = []
    for degC in (15.0, 35.0):
        rates = []
        for rate in (100.0, -100.0):
            unit = GncImu(11, "GNC-01", QUIET, surroundings=Table((at(0), at(0), turning(rate))),
                          ambient_degC=lambda t_ns, degC=degC: np.full(np.shape(t_ns), degC))  # fmt: skip
            rates.append(unit.readings(np.array([10 * NS])).gyro_deg_s[0])
        found.append(((rates[0] - rates[1])[0] / 200.0, (rates[0] + rates[1]) / 2.0))
    gyro = unit.errors.gyro
    assert (found[1][0] - found[0][0]) / 20.0 == pytest.approx(
        gyro.sensitivity[0, 0] * gyro.scale_per_degC[0], rel=1e-6
    )
    assert 15e-6 <= abs(gyro.scale_per_degC[0]) <= 45e-6
    cold, warm = sensitivity_at(gyro, 15.0) @ bias_at(gyro, 15.0), sensitivity_at(gyro, 35.0) @ bias_at(gyro, 35.0)
    assert found[1][1] - found[0][1] == pytest.approx(warm - cold, abs=2e-6)  # Earth's rate times 20 x 45 ppm


def test_power_on_brings_another_bias() -> None:
    """Of 1.2 to 4.8 deg/h and 15 to 70 micro-g; nothing without noise."""
    unit, twin = module(Table(), ImuOptions()), module(Table(), ImuOptions())
    quiet = module(Table(), QUIET)
    for one in (unit, twin, quiet):
        for period in range(150):
            one.power.on(period * 1000 * NS)
            one.power.off((period * 1000 + 500) * NS)
    stamps = (np.arange(150) * 1000 + 490) * NS
    jumps = unit.gyro_bias_deg_s(stamps) * 3600
    assert np.array_equal(jumps, twin.gyro_bias_deg_s(stamps) * 3600)
    expected = np.hypot(unit.errors.gyro.turn_on * 3600, 2.0)
    assert jumps.std(axis=0) == pytest.approx(expected, rel=0.2)
    assert np.all((unit.errors.gyro.turn_on * 3600 >= 1.2) & (unit.errors.gyro.turn_on * 3600 <= 4.8))
    assert np.all((unit.errors.accel.turn_on >= 15e-6) & (unit.errors.accel.turn_on <= 70e-6))
    assert quiet.gyro_bias_deg_s(stamps).std(axis=0).max() < 1e-8  # what is left of the warm-up


def test_an_hour_of_ten_second_means() -> None:
    """Each axis against 19 ARW and the slow noise; the counts are rounded, the accelerometers all but white."""
    unit = GncImu(11, "GNC-01", ImuOptions(imu_class="table_2"))
    unit.power.on(0)
    counts = unit.sample(times_ns(3600.0, first_s=900.0))
    means = counts.gyro.reshape(360, 2000, 3).mean(axis=1) * 0.005 * 3600
    expected = np.sqrt(unit.errors.gyro.white**2 / 10 * 3600**2 + 0.85 * 2.0**2)
    assert means.std(axis=0, ddof=1) == pytest.approx(expected, rel=0.2)
    accel_mg = counts.accel.reshape(360, 2000, 3).mean(axis=1)
    assert accel_mg.std(axis=0, ddof=1) == pytest.approx(np.full(3, 0.034), rel=0.2)


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
