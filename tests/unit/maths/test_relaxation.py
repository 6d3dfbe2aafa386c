"""How a temperature comes to rest: closed forms, another library's fit, slow parts that hide, rooms that never do."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from scipy.signal import lfilter

from bench.maths.relaxation import Lag, Relaxation, relaxation_of, window_of
from bench.model.clock import NS
from bench.run.steps.soak import MOST_CHANCE, Stability

Floats = NDArray[np.float64]
EVERY_s, SLOT_s, LAG_s = 60.0, 9000.0, 1500.0
NOISE_degC = 0.001


def minutes(count: int) -> Floats:
    return 5000.0 + EVERY_s * np.arange(count)


def approach(t_s: Floats, *parts: tuple[float, float], end_degC: float = 50.3) -> Floats:
    """Parts: (what is left at the last time, lag)."""
    return end_degC + sum(left_degC * np.exp((t_s[-1] - t_s) / lag_s) for left_degC, lag_s in parts)


def judged(t_s: Floats, degC: Floats, known: Lag | None = None) -> Relaxation:
    left = relaxation_of(t_s, degC, float(t_s[-1]), SLOT_s, known)
    assert left is not None
    return left


@pytest.mark.parametrize("seed", range(5))
def test_lag_and_distance_of_one_exponential(seed: int) -> None:
    t_s = minutes(80)
    degC = approach(t_s, (-0.3, LAG_s)) + np.random.default_rng(seed).normal(0.0, NOISE_degC, t_s.size)
    left = judged(t_s, degC)
    (end, _, lag_s), covariance = curve_fit(
        lambda t, end, off, lag: end + off * np.exp(-t / lag), t_s - t_s[-1], degC, p0=(50.0, -1.0, 1000.0)
    )
    print(f"seed {seed}: {left}, scipy: lag {lag_s:.1f} s, end {end:.4f} degC")
    assert left.lag.lag_s == pytest.approx(LAG_s, abs=5.0 * left.lag.share * LAG_s)
    assert left.lag.lag_s == pytest.approx(lag_s, abs=5.0 * (left.lag.share * LAG_s + math.sqrt(covariance[2, 2])))
    assert abs(left.residual_degC + 0.3) < left.bound_degC - abs(left.residual_degC)
    assert 0.3 <= left.bound_degC < 0.45


def test_the_end_and_the_sign_change_nothing() -> None:
    """Self-heating, the offset of a sensor, cooling instead of warming."""
    t_s = minutes(60)
    noise = np.random.default_rng(1).normal(0.0, NOISE_degC, t_s.size)
    warm = judged(t_s, approach(t_s, (-0.2, LAG_s)) + noise)
    hot = judged(t_s, approach(t_s, (-0.2, LAG_s), end_degC=75.0) + noise)
    cold = judged(t_s, 2.0 * 50.3 - approach(t_s, (-0.2, LAG_s)) - noise)
    assert hot.bound_degC == pytest.approx(warm.bound_degC, rel=1e-6)
    assert (cold.residual_degC, cold.bound_degC) == pytest.approx((-warm.residual_degC, warm.bound_degC), rel=1e-6)


def test_too_few_means_tell_nothing() -> None:
    t_s = minutes(9)
    assert relaxation_of(t_s, approach(t_s, (-0.2, LAG_s)), float(t_s[-1]), SLOT_s, Lag(LAG_s, 0.01)) is None


def test_what_is_known_of_the_lag_counts() -> None:
    t_s = minutes(20)
    degC = approach(t_s, (-0.5, LAG_s)) + np.random.default_rng(2).normal(0.0, NOISE_degC, t_s.size)
    alone, told = judged(t_s, degC), judged(t_s, degC, Lag(LAG_s, 0.001))
    assert abs(told.lag.lag_s / LAG_s - 1.0) < 0.1
    assert told.lag.share < 0.06
    assert 0.5 <= told.bound_degC <= alone.bound_degC * 1.01


@pytest.mark.parametrize("slow_s", [2400.0, 4800.0, 7200.0])
@pytest.mark.parametrize("wander_degC", [0.0, 0.01])
def test_a_slow_part_that_is_not_ruled_out_counts(slow_s: float, wander_degC: float) -> None:
    """A second mass behind the sensor's, and a wander that is alike over a lag: the bound holds in every seed."""
    t_s, bounds, blind = minutes(50), [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        alike = math.exp(-EVERY_s / LAG_s)
        wander = lfilter([wander_degC * math.sqrt(1.0 - alike**2)], [1.0, -alike], rng.normal(size=500))[-t_s.size :]
        noise = rng.normal(0.0, 2.5e-4, t_s.size)
        degC = approach(t_s, (-0.15, LAG_s), (-0.15, slow_s)) + noise + wander
        bounds.append(judged(t_s, degC, Lag(LAG_s, 0.01)).bound_degC)
        one = curve_fit(lambda t, end, off: end + off * np.exp(-t / LAG_s), t_s - t_s[-1], degC, p0=(50.0, -1.0))[0]
        blind.append(abs(float(one[1])))
    print(f"0.3 degC left; at most {min(bounds):.3f} to {max(bounds):.3f}; by one lag {min(blind):.3f}")
    assert min(bounds) >= 0.3 - 0.01  # what the wander itself is
    assert min(blind) < 0.3
    if not wander_degC:
        assert max(bounds) < 0.5


def test_parts_of_unlike_signs_count_each() -> None:
    """Their sum passes zero and comes again: the distance that is still to come counts."""
    t_s = minutes(60)
    degC = approach(t_s, (-0.1, 1200.0), (0.1, 4800.0)) + np.random.default_rng(3).normal(0.0, 2.5e-4, t_s.size)
    left = judged(t_s, degC, Lag(1200.0, 0.01))
    later_degC = max(abs(0.1 * math.exp(-s / 4800.0) - 0.1 * math.exp(-s / 1200.0)) for s in range(0, 9000, 60))
    assert abs(left.residual_degC) < 0.03
    assert left.bound_degC >= 0.95 * later_degC


WITHIN_degC, FOR_s, EACH_s = 0.1, 300, 60
HOURS = 6
ROOMS = 12


def room(rng: np.random.Generator, exponent: float, rms_degC: float) -> Floats:
    """A temperature each second with a spectrum f^-exponent, (n,), degC off the target."""
    n = HOURS * 3600
    f = np.fft.rfftfreq(2 * n)
    f[0] = f[1]
    amplitude = f ** (-exponent / 2.0)
    amplitude[0] = 0.0
    found = np.fft.irfft(amplitude * (rng.normal(size=f.size) + 1j * rng.normal(size=f.size)))[:n]
    return (found - found.mean()) * rms_degC / found.std()


def verdicts(off_degC: Floats) -> tuple[list[bool], list[bool], list[float]]:
    """Of every minute: is it left again within 5 min after "stable" by all samples, by five readings; the chance."""
    ours, readings, chances = [], [], []
    watch, heard = Stability(0.0, WITHIN_degC, float(FOR_s)), 0
    t_ns = np.arange(off_degC.size) * NS
    for now in range(FOR_s, off_degC.size - FOR_s, EACH_s):
        watch.add(t_ns[heard : now + 1], off_degC[heard : now + 1])
        heard = now + 1
        left = bool((np.abs(off_degC[now + 1 : now + 1 + FOR_s]) > WITHIN_degC).any())
        stable, window = watch.judged(int(t_ns[now]))
        if stable:
            assert window is not None
            assert window.chance is not None
            ours.append(left)
            chances.append(window.chance)
        if (np.abs(off_degC[now - FOR_s : now + 1 : EACH_s]) <= WITHIN_degC).all():
            readings.append(left)
    return ours, readings, chances


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.5])
def test_what_is_called_stable_is_seldom_contradicted(exponent: float) -> None:
    rng = np.random.default_rng(round(10 * exponent))
    ours, readings, chances = [], [], []
    for _ in range(ROOMS):
        found = verdicts(room(rng, exponent, WITHIN_degC * rng.uniform(0.1, 0.8)))
        for all_of, some in zip((ours, readings, chances), found, strict=True):
            all_of += some  # type: ignore[arg-type]
    print(
        f"f^-{exponent:g}: {sum(ours)} of {len(ours)} contradicted, stated {np.mean(chances):.3f}; "
        f"by five readings {sum(readings)} of {len(readings)}"
    )
    assert len(ours) > 100
    assert sum(ours) <= MOST_CHANCE * len(ours)
    assert sum(ours) <= 1.2 * sum(chances) + 3.0
    assert sum(readings) > MOST_CHANCE * len(readings)


def test_a_drift_towards_the_edge_is_not_stable() -> None:
    t_s = np.arange(-300.0, 1.0)
    noise = np.random.default_rng(1).normal(0.0, 0.001, t_s.size)
    calm, drifting = (window_of(t_s, rate * t_s + noise, -0.1, 0.1) for rate in (0.0, 0.00035))
    assert calm.chance == pytest.approx(0.01, abs=1e-3)
    assert drifting.chance is not None
    assert drifting.chance > 0.05  # 0.105 degC further within 300 s, and 0.1 degC of room
    assert drifting.slope_degC_min == pytest.approx(0.021, rel=0.02)


def test_too_few_samples_state_no_chance() -> None:
    window = window_of(np.array([-10.0, -5.0, 0.0]), np.array([0.01, 0.02, 0.03]), -0.1, 0.1)
    assert window.chance is None
    assert window.slope_degC_min == pytest.approx(0.12)
    assert math.isnan(window_of(np.array([0.0]), np.array([0.01]), -0.1, 0.1).slope_degC_min)
