"""A unit's clock by its receive stamps: rate and offset within the stated uncertainty, whatever the stamps are like;
one bad reading among many is found, a kink, a step, a gap and honest noise are none.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import optimize

from bench.maths import samples, stamps
from bench.model.errors import FitError
from bench.systems.time_sync.estimators import port_clocks
from bench.systems.time_sync.estimators.stamp_grid import grid_s

Array = Any
LATENCY_s = 0.008
COUNTER = np.arange(3000)


def port(
    seed: int,
    interval_s: float = 0.02,
    ppm: float = 10.0,
    jitter_s: float = 3e-4,
    poll_ns: int = 1_000_000,
    duration_s: float = 60.0,
    tag_noise: float = 1e-5,
) -> tuple[Array, Array, Array, Array, float]:
    """Tags, counter, receive stamps (s, ns) of a unit, and bench time minus tag at tag 0."""
    rng = np.random.default_rng(seed)
    own_s = np.arange(round(duration_s / interval_s)) * interval_s
    begin_s = 100.0 + float(rng.uniform(0.0, 0.02))
    arrived_s = begin_s + own_s / (1.0 + 1e-6 * ppm) + LATENCY_s
    if jitter_s:
        arrived_s = arrived_s + rng.exponential(jitter_s, own_s.size)
    ns = np.rint(arrived_s * 1e9).astype(np.int64)
    if poll_ns:
        ns = -(-ns // poll_ns) * poll_ns
    return own_s + tag_noise * rng.standard_normal(own_s.size), np.arange(own_s.size), ns * 1e-9, ns, begin_s


def fitted(seed: int, **kinds: Any) -> tuple[port_clocks.PortClock, float]:
    """Clock of a unit and the true least delay in the middle."""
    tags_s, counter, stamps_s, ns, begin_s = port(seed, **kinds)
    found = port_clocks.port_clock(tags_s, counter, stamps_s, grid_s(ns))
    rate = 1.0 / (1.0 + 1e-6 * kinds.get("ppm", 10.0)) - 1.0
    return found, begin_s + LATENCY_s + rate * found.at_s


@pytest.mark.parametrize(
    "kinds",
    [{}, {"interval_s": 0.005}, {"poll_ns": 0}, {"jitter_s": 1e-3}, {"ppm": -40.0}],
    ids=["polled", "fast", "fine stamps", "much jitter", "slow clock"],
)
@pytest.mark.validates(
    "intervals of rate and least delay of a port's clock",
    against="simulated ports whose clock and least delay are known: polled, fine, with much jitter",
)
def test_intervals_cover_rate_and_offset(kinds: dict[str, Any]) -> None:
    z = []
    for seed in range(6):
        found, true_s = fitted(seed, **kinds)
        rate = 1.0 / (1.0 + 1e-6 * kinds.get("ppm", 10.0)) - 1.0
        z.append(((found.delay_s - true_s) / found.std_s(found.at_s), (found.rate - rate) / found.rate_std))
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert (rms < 2.0).all(), rms
    assert np.abs(z).max() < 4.0


def test_fine_stamps_tell_as_much_as_the_least_delays_let_them() -> None:
    for seed in range(3):
        found, true_s = fitted(seed, poll_ns=0)
        assert found.grid_s == 0.0
        assert 1e-6 < found.std_s(found.at_s) < 6e-6  # the least of 125 delays of 0.3 ms each; no noise of the tags
        assert found.delay_s == pytest.approx(true_s, abs=2e-6)
        assert found.rate_std < 1e-7
        assert found.std_s(found.at_s + 30.0) == pytest.approx(np.hypot(found.std_s(found.at_s), 30.0 * found.rate_std))


def test_noise_of_the_tags_is_taken_for_no_place_within_a_step() -> None:
    """Clocks that are hardly off keep their place within a step of the bench; seeds 60 to 71."""
    rng, z = np.random.default_rng(60), []
    for seed in range(60, 72):
        ppm = float(rng.uniform(-3.0, 3.0))
        found, true_s = fitted(seed, interval_s=0.005, ppm=ppm, tag_noise=9e-5)
        z.append((found.delay_s - true_s) / found.std_s(found.at_s))
        assert found.tag_noise_s == pytest.approx(9e-5, rel=0.1)
    assert np.sqrt(np.mean(np.square(z))) < 1.6


def test_tags_of_a_clock_that_does_not_run_evenly_stay_as_they_are() -> None:
    tags_s, counter, *_ = port(3, tag_noise=3e-4)
    np.testing.assert_array_equal(port_clocks.even_tags_s(tags_s, counter), tags_s)


@pytest.mark.parametrize("step_s", [0.0, 1e-3])
def test_what_is_expected_of_a_clock_is_what_ports_state(step_s: float) -> None:
    """Root mean squares over the rates that a clock may have; seeds 100 to 139."""
    rng, stated = np.random.default_rng(100), []
    for seed in range(100, 140):
        found, _ = fitted(seed, ppm=float(rng.uniform(-20.0, 20.0)), poll_ns=round(1e9 * step_s))
        stated.append((found.rate_std, found.std_s(found.at_s), found.jitter_std_s))
    due = port_clocks.expected_clock(np.arange(0.0, 60.0, 0.02), port_clocks.StampNoise(3e-4, 20e-6), step_s)
    rms = np.sqrt(np.mean(np.square(stated), axis=0))
    assert rms == pytest.approx([due.rate_std, due.std_s(due.at_s), due.jitter_std_s], rel=0.2)


def test_without_jitter_the_step_is_the_uncertainty() -> None:
    z, stds = [], []
    for seed in range(6):
        tags_s, counter, stamps_s, ns, begin_s = port(seed, jitter_s=0.0)
        other = port(seed + 50, interval_s=0.005)[3]
        found = port_clocks.port_clock(tags_s, counter, stamps_s, grid_s(np.concatenate((ns, other))))
        rate = 1.0 / (1.0 + 1e-5) - 1.0
        z.append((found.delay_s - begin_s - LATENCY_s - rate * found.at_s) / found.std_s(found.at_s))
        stds.append(found.std_s(found.at_s))
    assert min(stds) > 2e-4
    assert np.sqrt(np.mean(np.square(z))) < 1.8


@pytest.mark.validates(
    "line below all delays of a port",
    against="the same problem solved by scipy's linear program",
)
def test_line_below_is_that_of_a_linear_program() -> None:
    """The same problem by a general solver: least sum of distances, no point below the line."""
    rng = np.random.default_rng(4)
    place = np.sort(rng.uniform(-1.0, 1.0, 300))
    delay_s = 0.3 - 0.1 * place + rng.exponential(0.2, 300)
    best = optimize.linprog(
        [-300.0, -place.sum()], A_ub=np.stack([np.ones(300), place], axis=1), b_ub=delay_s, bounds=[(None, None)] * 2
    )
    assert port_clocks.line_below(place, delay_s) == pytest.approx(tuple(best.x), abs=1e-9)


def test_difference_of_two_ports() -> None:
    """Offset and drift between two units, latencies taken off; positive = the first is ahead."""
    one, _ = fitted(2, ppm=13.0)
    other, _ = fitted(3, ppm=10.0, interval_s=0.005)
    begins = port(2)[4], port(3)[4]
    found = port_clocks.clock_difference(one, other, 30.0, latency_s=0.0, latency_std_s=1e-3)
    assert found.drift == pytest.approx(3e-6, abs=3.0 * found.drift_std)
    assert found.offset_s == pytest.approx(begins[1] - begins[0] + 30.0 * 3e-6, abs=4.0 * found.stamps_std_s)
    assert found.std_s == pytest.approx(np.hypot(found.stamps_std_s, 1e-3))


@pytest.mark.parametrize("step_s", [0.0006, -3.0, 0.05])
def test_a_step_of_the_clock_is_found(step_s: float) -> None:
    tags_s, counter, *_ = port(5)
    tags_s[1234:] += step_s
    assert stamps.first_step(tags_s, counter) == 1234


def test_lost_frames_are_no_step_and_too_few_tell_nothing() -> None:
    tags_s, counter, *_ = port(5)
    keep = np.random.default_rng(1).random(tags_s.size) > 0.3
    assert stamps.first_step(tags_s[keep], counter[keep]) is None
    assert stamps.first_step(tags_s[:2], counter[:2]) is None
    assert stamps.tag_noise_s(np.arange(20.0), np.arange(0, 40, 2)) == 0.0  # no two frames in a row
    tags_s, counter, stamps_s, *_ = port(1, duration_s=2.0)
    with pytest.raises(FitError, match=r"B-SYNC-009.*100 frames"):
        port_clocks.port_clock(tags_s, counter, stamps_s)


def smooth(seed: int = 1) -> Array:
    at = COUNTER / 50.0
    clean = np.stack([100.0 * at, np.sin(at), np.where(at > 30.0, 7.0 * (at - 30.0), 0.0)], axis=1)
    return np.asarray(clean + 1e-3 * np.random.default_rng(seed).standard_normal(clean.shape))


@pytest.mark.parametrize("size", [0.2, 10.0, 1e6])
@pytest.mark.parametrize("at", [2, 700, 2997])
def test_one_bad_reading_is_found(size: float, at: int) -> None:
    values = smooth()
    values[at, 1] += size
    assert samples.off_course(values, COUNTER).tolist() == [at]


def test_three_of_three_thousand_are_found_and_not_a_fourth() -> None:
    values = smooth()
    values[[100, 900, 1700, 2500], 0] += [40.0, 30.0, 20.0, 10.0]
    assert samples.off_course(values, COUNTER).tolist() == [100, 900, 1700]


def test_no_reading_of_a_kink_a_step_or_a_gap_is_bad_and_few_are_not_judged() -> None:
    for seed in range(200):
        assert samples.off_course(smooth(seed), COUNTER).size == 0
    stepped, beside, counter = smooth(), smooth(), COUNTER.copy()
    stepped[1000:, 0] += 5.0
    beside[1001] += 50.0
    counter[1000:] += 5
    for values, numbers in ((stepped, COUNTER), (beside, counter), (smooth()[:40], COUNTER[:40])):
        assert samples.off_course(values, numbers).size == 0
