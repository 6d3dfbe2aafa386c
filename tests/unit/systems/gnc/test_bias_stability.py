"""Bias, stability, repeatability and flip against theory of known noise and textbook formulas."""

import math
from collections.abc import Callable

import allantools
import numpy as np
import pytest
from scipy import signal

from bench.maths.allan import allan_deviation
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.estimators import bias_stability as stability
from bench.systems.gnc.estimators.bias_mean import BiasMean, declared_mean, flip_bias, mean_bias
from bench.systems.gnc.estimators.sensor_noise import SensorNoise, expected_range

Keep = Callable[[str, object], None]
RATE_Hz, HOUR_s = 200.0, 3600.0
ARW_deg_sqrt_h, SLOW_deg_h, SLOW_s = 0.3, 2.0, 100.0
WHITE_deg_h = 60.0 * ARW_deg_sqrt_h  # deg/h times sqrt(s)


def slow(rng: np.random.Generator, count: int, step_s: float) -> np.ndarray:
    """A Gauss-Markov process of 2 deg/h."""
    kept = np.exp(-step_s / SLOW_s)
    drive = rng.normal(size=count) * SLOW_deg_h * np.sqrt(1.0 - kept**2)
    drive[0] = SLOW_deg_h * rng.normal()
    return np.asarray(signal.lfilter([1.0], [1.0, -kept], drive))


def gyro(rng: np.random.Generator, length_s: float, rate_Hz: float = RATE_Hz) -> np.ndarray:
    """Rate in deg/h: white noise and the process, in steps of the module."""
    count = round(length_s * rate_Hz)
    rate = slow(rng, count, 1.0 / rate_Hz) + rng.normal(size=count) * WHITE_deg_h * np.sqrt(rate_Hz)
    return np.asarray(np.round(rate / 18.0) * 18.0)  # 0.005 deg/s


def test_by_the_formula_and_not_by_the_samples() -> None:
    rate = gyro(np.random.default_rng(101), HOUR_s)
    found = stability.bias_stability(rate, 1.0 / RATE_Hz)
    means = rate.reshape(360, 2000).mean(axis=1)
    assert found.averages.size == 360
    assert found.value == pytest.approx(float(np.sqrt(((means - means.mean()) ** 2).sum() / 359)), rel=1e-12)
    assert found.mean == pytest.approx(float(rate.mean()), rel=1e-9)
    assert found.missing == 0


@pytest.mark.validates(
    "stability of the bias of 50 simulated gyroscopes (random walk 0.3 deg/sqrt(h), 2 deg/h Gauss-Markov)",
    against="theory sqrt((19.0 x 0.3)^2 + 2^2) = 6.03 deg/h",
)
def test_fifty_units(record_property: Keep) -> None:
    rng = np.random.default_rng(102)
    found = np.array([stability.bias_stability(gyro(rng, HOUR_s, 20.0), 0.05).value for _ in range(50)])
    text = f"{found.mean():.2f} +- {found.std():.2f} deg/h, furthest {100 * np.abs(found / 6.033 - 1).max():.0f} %"
    record_property("obtained", text)
    assert found.mean() == pytest.approx(6.033, rel=0.05)
    np.testing.assert_allclose(found, 6.033, rtol=0.25)


@pytest.mark.validates(
    "95 % intervals of the bias stability",
    against="expected scatter of 200 simulated hours of white and Gauss-Markov noise",
)
def test_intervals_of_the_stability_cover(record_property: Keep) -> None:
    rng = np.random.default_rng(103)
    lag_s = 2.0 * np.abs(np.subtract.outer(np.arange(1800), np.arange(1800)))  # covariance every 2 s, numerically
    means = (SLOW_deg_h**2 * np.exp(-lag_s / SLOW_s)).reshape(360, 5, 360, 5).mean(axis=(1, 3))
    expected = math.sqrt(WHITE_deg_h**2 / 10.0 + (np.trace(means) - means.sum() / 360) / 359)
    found = []
    for _ in range(200):  # the same noise as 720 means of 5 s
        means = slow(rng, 720 * 40, 5.0 / 40).reshape(720, 40).mean(axis=1)
        found.append(stability.bias_stability(means + rng.normal(size=720) * WHITE_deg_h / np.sqrt(5.0), 5.0))
    inside = float(np.mean([abs(one.value - expected) <= coverage_factor() * one.std for one in found]))
    record_property("obtained", f"{100 * inside:.1f} %")
    assert 0.91 <= inside <= 0.99
    stated = float(np.mean([one.std for one in found]))
    assert stated == pytest.approx(float(np.std([one.value for one in found])), rel=0.2)


def test_degrees_of_freedom_of_white_and_of_slow_means() -> None:
    rng = np.random.default_rng(104)
    white = [stability.dof_of_means(rng.normal(size=360)) for _ in range(20)]
    kept = np.exp(-1.0 / 20.0)
    slow = [stability.dof_of_means(signal.lfilter([1.0], [1.0, -kept], rng.normal(size=400))[40:]) for _ in range(20)]
    assert min(white) > 250.0
    centring = np.eye(360) - 1.0 / 360
    part = centring @ (kept ** np.abs(np.subtract.outer(np.arange(360), np.arange(360))))
    exact = np.trace(part) ** 2 / np.trace(part @ part)
    assert 14.0 < exact < 20.0
    assert 0.5 * exact < np.median(slow) < 1.2 * exact
    assert stability.dof_of_means(np.zeros(360)) == 359.0


def test_gaps_are_told_and_large_ones_refused() -> None:
    rng = np.random.default_rng(105)
    rate = gyro(rng, HOUR_s, 20.0)
    kept = np.ones(rate.size, bool)
    kept[rng.choice(rate.size - 2, 300, replace=False) + 1] = False
    counter = np.flatnonzero(kept) + 4_000_000_000
    found = stability.bias_stability(stability.on_the_counter(counter, rate[kept]), 0.05)
    assert found.missing == 300
    assert found.value == pytest.approx(stability.bias_stability(rate, 0.05).value, rel=0.02)
    kept[2000:2100] = False
    with pytest.raises(FitError, match=r"B-FIT-092.*1 of 360 means lack more than 10 % .*, the first at 100 s"):
        stability.bias_stability(stability.on_the_counter(np.flatnonzero(kept), rate[kept]), 0.05)


def test_frames_lost_at_the_end_of_the_hour_are_missing_samples() -> None:
    """A single damaged frame at the end must not cost the hour; more than a tenth of an average does."""
    hour = np.random.default_rng(8).normal(size=72_000)
    whole, cut = stability.bias_stability(hour, 0.05), stability.bias_stability(hour[:-3], 0.05)
    assert (cut.missing, cut.averages.size) == (3, 360)
    np.testing.assert_allclose(cut.averages[:-1], whole.averages[:-1], atol=1e-13)
    assert cut.averages[-1] == pytest.approx(hour[-200:-3].mean())
    with pytest.raises(FitError, match=r"B-FIT-092.*359 means of 10 s, 360 are due"):
        stability.bias_stability(hour[:-21], 0.05)
    assert stability.averages_of(np.arange(72_000.0), 0.05)[-1] == pytest.approx(71_800 + 99.5)


STARTS_s, LENGTHS_s = [1200.0 * k for k in range(6)], [600.0] * 6
MEANS_deg_h = [1.0, 2.5, -0.5, 3.0, 0.0, 1.2]


def test_repeatability_is_the_standard_deviation_of_six() -> None:
    found = stability.bias_repeatability(MEANS_deg_h, STARTS_s, LENGTHS_s)
    assert found.value == pytest.approx(float(np.std(MEANS_deg_h, ddof=1)))
    assert found.dof == 5
    assert stability.bias_repeatability(MEANS_deg_h[::-1], STARTS_s[::-1], LENGTHS_s) == found


@pytest.mark.parametrize(
    ("starts", "lengths", "reason"),
    [
        (STARTS_s[:5], LENGTHS_s[:5], "5 windows, 6 are due"),
        ([*STARTS_s[:5], 5900.0], LENGTHS_s, "windows 5 and 6 start 1100 s apart, 1200 s are due"),
        (STARTS_s, [600.0] * 3 + [300.0] + [600.0] * 2, "window 4 is 300 s long"),
    ],
)
def test_windows_that_are_no_repeatability(starts: list[float], lengths: list[float], reason: str) -> None:
    with pytest.raises(FitError, match=f"B-FIT-093.*{reason}"):
        stability.bias_repeatability(MEANS_deg_h[: len(starts)], starts, lengths)


@pytest.mark.validates(
    "95 % intervals of a bias of 3 min",
    against="300 simulated records of white noise, and the random walk by the package allantools",
)
def test_bias_of_three_minutes(record_property: Keep) -> None:
    rng = np.random.default_rng(107)
    records = 40.0 + rng.normal(size=(300, 3600)) * WHITE_deg_h * np.sqrt(20.0)
    found = [mean_bias(one, 0.05) for one in records]
    inside = float(np.mean([abs(one.value - 40.0) <= coverage_factor(one.dof) * one.std for one in found]))
    record_property("obtained", f"{100 * inside:.1f} %")
    assert 0.91 <= inside <= 0.99
    assert np.median([one.std for one in found]) == pytest.approx(WHITE_deg_h / np.sqrt(180.0), rel=0.05)
    _, deviation, _, _ = allantools.oadev(records[0], rate=20.0, data_type="freq", taus=[1.0])
    assert found[0].std == pytest.approx(float(deviation[0]) / np.sqrt(180.0), rel=1e-9)


def test_slow_noise_widens_the_bias() -> None:
    rng = np.random.default_rng(108)
    walk = np.cumsum(rng.normal(size=3600)) * 0.5
    rate = walk + rng.normal(size=3600) * 10.0
    found = mean_bias(rate, 0.05)
    assert found.std > 3.0 * float(allan_deviation(rate, 0.05, factors=[20]).deviation[0]) / np.sqrt(180.0)
    assert found.dof < 50.0
    with pytest.raises(FitError, match=r"B-FIT-092.*59\.9 s of samples"):
        mean_bias(np.zeros(1198), 0.05)


def test_coarse_steps_without_noise() -> None:
    """A quiet sensor that stays within one step of its output is not known better than the step."""
    found = mean_bias(np.full(3600, 3.0), 0.05, resolution=1.0)
    assert found.value == 3.0
    assert found.std == pytest.approx(1.0 / np.sqrt(12.0))
    dithered = mean_bias(np.round(np.random.default_rng(109).normal(size=3600)), 0.05, resolution=1.0)
    assert dithered.std < 0.1 / np.sqrt(12.0)


def level(axis: str, up: np.ndarray, bias_mg: float, rng: np.random.Generator) -> BiasMean:
    """Readings of one axis in mg where ``up`` is the upward direction in the unit's axes."""
    return mean_bias(1000.0 * up["xyz".index(axis)] + bias_mg + rng.normal(size=3600) * 1.4, 0.05)


def test_a_flip_about_x_takes_the_tilt_out_and_one_about_y_does_not() -> None:
    rng = np.random.default_rng(110)
    tilt = np.deg2rad(1.0 / 60.0)
    up = np.array([0.0, np.sin(tilt), np.cos(tilt)])  # the table leans: +y of the unit points up by 1 arcminute
    about_x, about_y = up * [1.0, -1.0, -1.0], up * [-1.0, 1.0, -1.0]
    first = level("y", up, 10.0, rng)
    found = flip_bias(first, level("y", about_x, 10.0, rng), axis="y", about="x")
    assert abs(found.value - 10.0) < 4.0 * found.std
    assert found.std < 0.03
    wrong = (first.value + level("y", about_y, 10.0, rng).value) / 2.0
    assert wrong - 10.0 == pytest.approx(0.29, abs=0.08)
    with pytest.raises(FitError, match=r"B-FIT-094.*does not reverse axis y"):
        flip_bias(first, first, axis="y", about="y")


def test_uncertainty_of_a_flip() -> None:
    one = BiasMean(1.0, 0.3, 20.0, 3600, 0)
    found = flip_bias(one, one, axis="y", about="x")
    assert found.std == pytest.approx(np.sqrt(0.15**2 * 2))
    assert found.samples == 7200
    assert flip_bias(one, one, axis="z", about="x").dof == pytest.approx(40.0)


WANDERING = [(3.0, 40.0), (2.0, 300.0)]


def test_wandering_is_the_integral_of_its_covariance() -> None:
    noise = SensorNoise(1.0, WANDERING, 0.0, 0.01)
    begin_s, length_s = np.array([100.0, 0.0, 160.0]), np.array([60.0, 90.0, 20.0])
    points = begin_s[:, None] + (np.arange(400) + 0.5) / 400.0 * length_s[:, None]
    apart = np.abs(points.ravel()[:, None] - points.ravel())
    whole = sum(size**2 * np.exp(-apart / time_s) for size, time_s in WANDERING)
    summed = whole.reshape(3, 400, 3, 400).mean(axis=(1, 3))
    np.testing.assert_allclose(noise.wander(begin_s, length_s), summed, rtol=1e-4)
    # what all records share is no error of their bias
    noise = SensorNoise(0.0, [(5.0, 1e9)], 0.0, 0.01)
    begin_s, length_s = np.array([0.0, 100.0]), np.array([50.0, 80.0])
    assert np.abs(noise.wander_about_mean(begin_s, length_s)).max() < 1e-4
    about_first = noise.wander_about_mean(begin_s, length_s, np.array([True, False]))
    assert about_first[0, 0] == pytest.approx(0.0, abs=1e-12)


def test_allan_variance_of_white_noise_and_of_a_correlated_part() -> None:
    """IEEE Std 952 C.1.6: sigma^2 T/tau (3 and 4 exponentials) is that of exponentially correlated noise."""
    tau_s, size, time_s = 25.0, 3.0, 40.0
    x = tau_s / time_s
    due = 2.0 * size**2 / x * (1.0 - (3.0 - 4.0 * math.exp(-x) + math.exp(-2.0 * x)) / (2.0 * x))
    noise = SensorNoise(1.5, [(size, time_s)], 0.0, 0.01)
    assert noise.allan_variance(tau_s) == pytest.approx(1.5**2 / tau_s + due, rel=1e-12)
    keep = math.exp(-1.0 / 40.0)
    kicks = np.random.default_rng(32).normal(0.0, 3.0 * math.sqrt(1.0 - keep**2), 200_000)
    curve = allan_deviation(np.asarray(signal.lfilter([1.0], [1.0, -keep], kicks)), 1.0, factors=[20])
    due = SensorNoise(0.0, [(3.0, 40.0)], 0.0, 1.0).allan_variance(20.0)
    assert curve.deviation[0] ** 2 == pytest.approx(due, rel=0.03)


def test_a_declared_mean_is_what_records_of_such_noise_say() -> None:
    rng = np.random.default_rng(31)
    noise = SensorNoise(0.3, [], 0.05, 0.05)
    samples = rng.normal(0.0, 0.3 / math.sqrt(0.05), (60, 3600))
    found = [mean_bias(np.round(row / 0.05) * 0.05, 0.05, 0.05) for row in samples]
    declared = declared_mean(0.0, noise, 3600)
    measured = float(np.median([mean.std for mean in found]))
    assert measured == pytest.approx(declared.std, rel=0.03)
    assert declared.std == pytest.approx(math.sqrt((0.3**2 + 0.05**2 / 12.0 * 0.05) / 180.0), rel=1e-12)
    assert declared.dof == pytest.approx(float(np.median([mean.dof for mean in found])), rel=0.01)


def test_degrees_of_freedom_of_a_declared_stability() -> None:
    """White noise has n - 1; wandering has 2 E^2 / Var by the traces of its covariance."""
    white = SensorNoise(1.0, [], 0.0, 0.1)
    assert stability.declared_variance(white, 360, 10.0) == pytest.approx((0.1, 359.0))
    noise = SensorNoise(6.0, WANDERING, 0.0, 0.1)
    covariance = noise.of_means(10.0 * np.arange(360), np.full(360, 10.0))
    centred = (np.eye(360) - 1.0 / 360.0) @ covariance
    due = float(np.trace(centred) ** 2 / np.trace(centred @ centred))
    found = stability.bias_stability(np.zeros(36_000), 0.1, declared=noise)
    assert found.dof == pytest.approx(due, rel=1e-9)
    assert found.value == pytest.approx(math.sqrt(float(np.trace(centred)) / 359.0), rel=1e-9)


@pytest.mark.parametrize(("count", "deviations"), [(2, 1.128), (5, 2.326), (10, 3.078), (25, 3.931), (50, 4.498)])
def test_the_range_of_a_sample_is_that_of_tippett(count: int, deviations: float) -> None:
    assert expected_range(count) == pytest.approx(deviations, abs=6e-4)
