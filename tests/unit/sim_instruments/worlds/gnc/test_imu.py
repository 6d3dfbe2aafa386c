"""The body's motion, and the simulated sensors of a module: errors, ranges, power, noise, fields."""

import itertools
from collections.abc import Callable

import allantools
import numpy as np
import pytest
from gnc_campaigns import (
    IDEAL,
    MOUNTINGS,
    QUIET,
    Formula,
    Table,
    at,
    body_to_local,
    module,
    posed,
    times_ns,
    trapezoid,
    turning,
)
from scipy import stats
from scipy.spatial.transform import Rotation

from bench.model.clock import NS
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.common.sensor_noise import SlowNoise, WhiteNoise
from sim_instruments.worlds.gnc.imu import GncImu, ImuOptions
from sim_instruments.worlds.gnc.imu_errors import ImuErrors, Triad
from sim_instruments.worlds.gnc.magnetometer import EarthField, Magnetometer

UNITS = [ImuErrors(9, f"GNC-{number:03d}", ImuOptions()) for number in range(300)]
STAMPS = times_ns(500.0)


def test_units_are_drawn_by_seed_and_serial_in_their_classes() -> None:
    """The classes of the page: 1 % scale, 0.3 % cross terms that are not symmetric, 0.1 deg/s, 10 mg."""
    gyro = np.array([unit.gyro.sensitivity for unit in UNITS])
    rows, columns = np.nonzero(~np.eye(3, dtype=bool))
    assert gyro[:, [0, 1, 2], [0, 1, 2]].std() == pytest.approx(0.01, rel=0.1)
    assert gyro[:, rows, columns].std() == pytest.approx(0.003, rel=0.1)
    assert abs(np.corrcoef(gyro[:, 0, 1], gyro[:, 1, 0])[0, 1]) < 0.25
    assert np.std([unit.gyro.bias for unit in UNITS]) == pytest.approx(0.1, rel=0.1)
    assert np.std([unit.accel.bias for unit in UNITS]) == pytest.approx(0.010, rel=0.1)
    assert {round(60 * float(one), 12) for unit in UNITS for one in unit.gyro.white} == {0.3}
    again, other = (ImuErrors(9, serial, ImuOptions()) for serial in ("GNC-001", "GNC-1"))
    assert np.array_equal(again.gyro.sensitivity, UNITS[1].gyro.sensitivity)
    assert not np.array_equal(other.gyro.sensitivity, UNITS[1].gyro.sensitivity)
    ideal = ImuErrors(9, "GNC-001", ImuOptions(errors=False))
    assert np.array_equal(ideal.accel.sensitivity, np.eye(3))
    assert not ideal.gyro.bias.any()
    assert np.array_equal(ideal.gyro.white, again.gyro.white)  # its noise stays


def sensitivity_at(triad: Triad, degC: float) -> np.ndarray:
    """S of a triad at a temperature, written out sensor by sensor."""
    rows = [
        (1.0 + (degC - 25.0) * factor) * row
        for row, factor in zip(triad.sensitivity, triad.scale_per_degC, strict=True)
    ]
    return np.array(rows)


def bias_at(triad: Triad, degC: float) -> np.ndarray:
    return triad.bias + (degC - 25.0) * triad.bias_per_degC


def test_counts_are_rounded_and_end_at_their_range() -> None:
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
    # beyond 400 deg/s, 50 g and 6 gauss nothing more is told
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


def test_temperature_of_scale_and_bias(monkeypatch: pytest.MonkeyPatch) -> None:
    """Turning at 100 deg/s at 15 and at 35 degC: the difference holds both coefficients."""
    found = []
    for degC in (15.0, 35.0):
        rates = []
        for rate in (100.0, -100.0):
            monkeypatch.setattr("sim_instruments.worlds.gnc.imu.LAB_DEGC", degC)
            unit = module(Table((at(0), at(0), turning(rate))), QUIET)
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


def test_slow_noise_is_a_gauss_markov_process_from_the_first_power_on() -> None:
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
    first = [SlowNoise(seed, "test", np.ones(3), np.full(3, 300.0)).at(np.array([0]))[0] for seed in range(300)]
    assert np.std(first) == pytest.approx(1.0, rel=0.1)
    # a bench whose clock has run for a year is no slower, and its unit walks as after a second
    year, drifts = 31_536_000 * NS, []
    for begin_ns in (NS, year):
        unit = GncImu(4, "GNC-01", ImuOptions(), Table(), Site())
        unit.power.on(begin_ns)
        stamps = begin_ns + np.arange(0, 3600, 60) * NS
        drifts.append(unit.gyro_bias_deg_s(stamps))
    assert drifts[0] == pytest.approx(drifts[1], rel=1e-9)
    assert np.ptp(drifts[0]) > 1e-4


def test_random_walks_by_allantools_whatever_the_rate() -> None:
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
    # a sample over 20 ms has half the noise of one over 5 ms; the random walk stays
    unit = module(Table(), ImuOptions(errors=False))
    fast = unit.readings(times_ns(200.0)).gyro_deg_s
    slow = unit.readings(times_ns(200.0, rate_hz=50.0), 20_000_000).gyro_deg_s
    assert slow.std(axis=0) == pytest.approx(fast.std(axis=0) / 2, rel=0.03)


ONE = np.array([NS], np.int64)
TURN = Table((at(90.0), at(0), turning(0.05)), "z")  # z north, a turn in 7,200 s: 0.01 deg for each of 36,000 samples
ONCE = np.arange(720_000, dtype=np.int64)[::20] * (NS // 100)


def test_the_field_and_its_noise_are_as_stated() -> None:
    """0.43 gauss, 55 degrees below the horizon, 4 degrees west of north."""
    east, north, up = EarthField().local_gauss
    assert np.hypot(np.hypot(east, north), up) == pytest.approx(0.43, rel=1e-12)
    assert np.rad2deg(np.arctan2(-up, np.hypot(east, north))) == pytest.approx(55.0)
    assert np.rad2deg(np.arctan2(east, north)) == pytest.approx(-4.0)
    noise = module(posed(0, 0, 0), ImuOptions()).readings(times_ns(200.0)).mag_gauss.std(axis=0)
    assert noise == pytest.approx([0.5e-3] * 3, rel=0.02)


@pytest.mark.parametrize("mounting", ["x", "y", "z"])
def test_an_ideal_sensor_shows_it_in_body_axes(mounting: str) -> None:
    for outer, middle, inner in np.random.default_rng(3).uniform(-180, 180, (30, 3)):
        table = posed(outer, middle, inner, mounting)
        expected = body_to_local(table, ONE, Site())[0].inv().apply(EarthField().local_gauss)
        assert module(table, IDEAL).readings(ONE).mag_gauss[0] == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("serial", ["GNC-01", "GNC-02", "GNC-03"])
def test_what_a_turn_about_z_shows(serial: str) -> None:
    """Centre, ratio of the sizes, x at the largest y, and the roll after correction, of 36,000 points of the turn."""
    unit = module(TURN, QUIET, serial)
    seen, true = unit.readings(ONCE).mag_gauss, module(TURN, IDEAL).readings(ONCE).mag_gauss
    plane = unit.magnetometer.in_plane(np.hypot(true[0, 0], true[0, 1]), true[:, 2].mean())
    high, low = seen.max(axis=0), seen.min(axis=0)
    assert (high + low)[:2] / 2 == pytest.approx(plane.offset_gauss, abs=1e-8)
    assert (high - low)[0] / (high - low)[1] == pytest.approx(plane.gain, rel=1e-7)
    x, y = seen[:, 0] - plane.offset_gauss[0], (seen[:, 1] - plane.offset_gauss[1]) * plane.gain
    sin_alpha = x[np.argmax(y)] / y.max()
    assert np.rad2deg(np.arcsin(sin_alpha)) == pytest.approx(plane.angle_deg, abs=0.01)  # a step of the turn
    sin_alpha = np.sin(np.deg2rad(plane.angle_deg))
    corrected = (x - y * sin_alpha) / np.cos(np.deg2rad(plane.angle_deg)) + 1j * y
    assert np.abs(corrected) == pytest.approx(np.full(ONCE.size, plane.radius_gauss), rel=1e-12)  # a circle
    shift_deg = np.rad2deg(np.angle((true[:, 0] + 1j * true[:, 1]) / corrected))  # roll is minus the angle of x, y
    assert shift_deg == pytest.approx(np.full(ONCE.size, plane.roll_deg), abs=1e-9)


def test_draws_of_many_units() -> None:
    """Gains of 3 %, 1 to 2 degrees between the axes, 0.1 gauss of offset; soft iron turns the roll by tenths."""
    planes = [Magnetometer(2, f"GNC-{number}").in_plane(0.35, 0.2) for number in range(400)]
    assert np.std([plane.gain for plane in planes]) == pytest.approx(0.042, rel=0.12)
    angles = np.abs([plane.angle_deg for plane in planes])
    assert np.mean(angles) == pytest.approx(1.5, abs=0.1)
    assert 0.4 < angles.min() < angles.max() < 2.6
    assert np.std([plane.offset_gauss for plane in planes]) == pytest.approx(0.1, rel=0.1)
    assert 0.05 < np.std([plane.roll_deg for plane in planes]) < 0.2
    ideal = Magnetometer(2, "GNC-0", errors=False)
    assert np.array_equal(ideal.matrix, np.eye(3))
    assert not ideal.offset_gauss.any()


def test_the_turntable_makes_it_wrong() -> None:
    """Its iron turns with the unit: the centre of the ellipse is off by more than a tenth of the field."""
    wrong, right = (module(Table(TURN.motion, "z", table), QUIET) for table in ("turntable", "non_magnetic"))
    middles, sizes = [], []
    for unit in (wrong, right):
        seen = unit.readings(ONCE).mag_gauss
        middles.append((seen.max(axis=0) + seen.min(axis=0))[:2] / 2)
        sizes.append((seen.max(axis=0) - seen.min(axis=0))[:2])
    assert np.hypot(*(middles[0] - middles[1])) > 0.043
    gains = [one[0] / one[1] for one in sizes]
    assert abs(gains[0] / gains[1] - 1) > 0.01
    bench = module(Table(TURN.motion, "z", "bench"), QUIET).readings(ONCE[:5]).mag_gauss
    assert np.array_equal(bench, right.readings(ONCE[:5]).mag_gauss)


EARTH_DEG_S = 360.0 / 86_164.0905  # by the length of the sidereal day
SITE = Site(latitude_deg=34.2, gravity_m_s2=9.7969, azimuth_deg=71.0)


def still(
    outer: float, middle: float, inner: float, mounting: str = "x", site: Site = SITE
) -> tuple[np.ndarray, np.ndarray]:
    read = module(posed(outer, middle, inner, mounting), site=site).readings(ONE)
    return read.gyro_deg_s[0], read.accel_g[0]


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_earth_and_gravity_in_a_hundred_poses(mounting: str) -> None:
    rng = np.random.default_rng(1)
    latitude = np.deg2rad(SITE.latitude_deg)
    earth = EARTH_DEG_S * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    for outer, middle, inner in rng.uniform(-720.0, 720.0, (100, 3)):
        attitude = body_to_local(posed(outer, middle, inner, mounting), ONE, SITE)[0]
        rate, force = still(outer, middle, inner, mounting)
        assert rate == pytest.approx(attitude.inv().apply(earth), rel=0, abs=2e-9)
        assert force == pytest.approx(attitude.inv().apply([0, 0, 9.7969 / 9.80665]), rel=0, abs=1e-13)


def wild(mounting: str) -> Table:
    outer = Formula(lambda t_s: 40.0 * t_s + 25.0 * np.sin(2.1 * t_s))
    middle = Formula(lambda t_s: 60.0 * np.sin(1.3 * t_s + 0.4))
    return Table((outer, middle, Formula(lambda t_s: -120.0 * t_s + 80.0 * np.cos(1.7 * t_s))), mounting)


def mean_rate_deg_s(attitude: Callable[[np.ndarray], Rotation], stamps: np.ndarray) -> np.ndarray:
    """Mean body rate over each sample from the attitudes at fifty steps of 0.1 ms."""
    steps = [attitude(stamps - 5_000_000 + 100_000 * step) for step in range(51)]
    turns = [(one.inv() * other).as_rotvec() for one, other in itertools.pairwise(steps)]
    return np.rad2deg(np.sum(turns, axis=0)) / 0.005


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_all_axes_moving(mounting: str) -> None:
    """The rate against the difference of scipy's attitudes over each sample; Earth does not turn here."""
    table, stamps = wild(mounting), times_ns(4.0, first_s=1.0)
    read = module(table, site=Site(latitude_deg=90.0, azimuth_deg=20.0)).readings(stamps)
    expected = mean_rate_deg_s(lambda t_ns: body_to_local(table, t_ns, Site(azimuth_deg=20.0)), stamps)
    middle = body_to_local(table, stamps - 2_500_000, Site(azimuth_deg=20.0))
    earth = middle.inv().apply([0, 0, EARTH_DEG_S])
    assert np.abs(read.gyro_deg_s - earth - expected).max() < 3e-6
    assert np.abs(read.gyro_deg_s).max() > 200.0
    assert np.abs(read.accel_g - middle.inv().apply([0, 0, 9.7969 / 9.80665])).max() < 4e-5  # mean against middle


def test_tilt_turns_the_body_with_its_rate() -> None:
    """A tilt of 1 arcmin that wobbles with the angles, as a rotation vector handed to scipy."""
    options = ImuOptions(errors=False, noise=False, tilt_arcmin=1.0)
    table, stamps = wild("x"), times_ns(4.0, first_s=1.0)
    unit = module(table, options, site=Site(azimuth_deg=20.0))
    tilt = unit.errors.tilt("x")
    assert tilt is not None

    def attitude(t_ns: np.ndarray) -> Rotation:
        angles = np.stack([axis.angle_deg(t_ns) for axis in table.motion], axis=1)
        return body_to_local(table, t_ns, Site(azimuth_deg=20.0)) * Rotation.from_rotvec(tilt.rad(angles))

    latitude = np.deg2rad(34.2)
    earth = attitude(stamps - 2_500_000).inv().apply(EARTH_DEG_S * np.array([0, np.cos(latitude), np.sin(latitude)]))
    expected = mean_rate_deg_s(attitude, stamps)
    read = unit.readings(stamps)
    assert np.abs(read.gyro_deg_s - earth - expected).max() < 1e-4  # the tilt is kept to its first order
    assert (
        np.abs(module(table, site=Site(azimuth_deg=20.0)).readings(stamps).gyro_deg_s - earth - expected).max() > 0.03
    )


def test_size_of_the_tilt() -> None:
    """1 arcmin RMS about each axis over mountings and poses."""
    poses = np.random.default_rng(2).uniform(-180, 180, (50, 3))
    options = ImuOptions(tilt_arcmin=1.0)
    tilts = [ImuErrors(5, f"GNC-{unit}", options).tilt("xyz"[unit % 3]).rad(poses) for unit in range(300)]
    rms_arcmin = np.rad2deg(np.sqrt(np.mean(np.square(tilts), axis=(0, 1)))) * 60
    assert rms_arcmin == pytest.approx([1, 1, 1], rel=0.08)
    assert ImuErrors(5, "GNC-1", ImuOptions()).tilt("x") is None


@pytest.mark.parametrize("turn_deg", [1080.0, -1080.0])
@pytest.mark.parametrize("start_s", [1.0, 1.00237])
def test_the_sum_of_the_samples_is_the_turn(turn_deg: float, start_s: float) -> None:
    """Corners of the trapezoid between samples cost nothing: a sample is the mean over its interval.

    The inner axis points east, where Earth's rate has no component.
    """
    table = Table((at(0), at(0), trapezoid(start_s, turn_deg, 270.0, 270.0)))
    read = module(table, IDEAL).readings(times_ns(15.3))
    assert read.gyro_deg_s[:, 0].sum() * 0.005 == pytest.approx(turn_deg, rel=1e-9)
    slow = module(table, IDEAL).readings(times_ns(15.3, rate_hz=10.0), 100_000_000)
    assert slow.gyro_deg_s[:, 0].sum() * 0.1 == pytest.approx(turn_deg, rel=1e-9)
