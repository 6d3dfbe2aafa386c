"""Long terms of logs at rest against an independent likelihood ratio, and what means are worth by a further one."""

from collections.abc import Iterator

import numpy as np
import pytest
from allan_simulation import record
from numpy.typing import NDArray
from scipy import signal

from bench.maths.long_terms import LongTerms, blocks_of, long_terms, noise_at_rest

N, LEVEL, SEED = 6000, 0.01, 47
MEAN = N**-0.5  # standard deviation of the mean of white noise
WORLDS = {
    "white": {},
    "weak walk": {"random_walk": 6.0 * MEAN * (3.0 / N) ** 0.5},
    "walk": {"random_walk": 25.0 * MEAN * (3.0 / N) ** 0.5},
    "flicker": {"bias_instability": 15.0 * MEAN},
    "drift": {"rate_ramp": 25.0 * MEAN / N},
    "quantisation": {"quantisation_noise": 3.0},
}
PAUSES = {"none": 0.0, "tenth": 0.1, "half": 0.5, "nine tenths": 0.9}


def logs(name: str, pause: float, seeds: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64], float]]:
    """Yield counter and readings of a log with one pause (even seeds) or many, and the mean of as long behind it."""
    for seed in range(seeds):
        rng = np.random.default_rng([SEED, seed])
        length = round(N / (1.0 - pause))
        values = record(rng, length + N, 1.0, **{"white_noise": 1.0, **WORLDS[name]})
        parts = 1 if seed % 2 == 0 else 20
        kept = np.zeros(length, bool)
        for part in range(1, parts + 2):
            end = round(part * length / (parts + 1))
            kept[end - round((1.0 - pause) * length / (parts + 1)) : end] = True
        yield np.flatnonzero(kept), values[:length][kept], float(values[length:].mean())


def found(counter: NDArray[np.int64], values: NDArray[np.float64]) -> LongTerms:
    return long_terms(blocks_of(counter, values, 1.0), values.size * 1.0, np.random.default_rng(1))


def neyman_pearson(name: str, seeds: int) -> float:
    """Return the power of the test that knows size and shape of the long term, of means of 60 samples."""
    count, size = N // 60, 60
    rng = np.random.default_rng(SEED)
    noise = {term: size for term, size in WORLDS[name].items() if term != "rate_ramp"}
    alone = np.array([record(rng, N, 1.0, **noise).reshape(count, size).mean(axis=1) for _ in range(2000)])
    centred = np.eye(count) - 1.0 / count
    shape = np.cov(alone @ centred, rowvar=False)
    lag = np.arange(count)
    drift = WORLDS[name].get("rate_ramp", 0.0) * size * (lag - lag.mean())
    white = np.eye(count) / size
    inverse = np.linalg.pinv(centred @ white @ centred), np.linalg.pinv(centred @ (white + shape) @ centred)

    def score(means: NDArray[np.float64]) -> NDArray[np.float64]:
        means = means @ centred
        quadratic = ((means @ (inverse[0] - inverse[1])) * means).sum(axis=1)
        return np.asarray(quadratic + 2.0 * means @ inverse[1] @ drift)

    limit = np.quantile(score(rng.standard_normal((4000, count)) / size**0.5), 1.0 - LEVEL)
    seen = np.array([values.reshape(count, size).mean(axis=1) for _, values, _ in logs(name, 0.0, seeds)])
    return float(np.mean(score(seen) > limit))


def judged(name: str, pause: float, seeds: int) -> tuple[float, float, float]:
    """Return the shares of logs in which the term is found, another one is, and the next mean lies in its interval."""
    own = set(WORLDS[name]) - {"quantisation_noise"}
    right = false = inside = 0
    for counter, values, ahead in logs(name, pause, seeds):
        seen = found(counter, values)
        right += bool(own & {*seen.present, *seen.possible})
        false += bool(set(seen.present) - own) or (bool(seen.possible) and not own & set(seen.possible))
        inside += abs(ahead - values.mean()) <= 2.0**0.5 * seen.expanded
    return right / seeds, false / seeds, inside / seeds


@pytest.mark.parametrize("name", ["white", "walk", "drift"])
def test_terms_are_found_and_a_further_mean_lies_in_its_interval(name: str) -> None:
    right, false, inside = judged(name, 0.1, 16)
    assert (right, false) == (float(name != "white"), 0.0)
    assert inside >= 14 / 16


def test_what_no_noise_does_is_odd() -> None:
    rng = np.random.default_rng(SEED)
    for size, odd in ((0.0, False), (80.0, True)):
        white = rng.standard_normal(N)
        step, cycle = size * MEAN * (np.arange(N) > 2000), size * MEAN * np.sin(np.arange(N) / 200.0)
        for shape, expected in ((step, 2000.0), (cycle, 400.0 * np.pi)):
            seen = found(np.arange(N), white + shape)
            assert (seen.oddness < 2e-3) == odd
            assert not odd or seen.odd_s == pytest.approx(expected, rel=0.15)


def test_few_blocks_show_nothing() -> None:
    seen = found(np.arange(40), np.random.default_rng(SEED).standard_normal(40))
    assert (seen.present, seen.possible) == ((), ())


@pytest.mark.sweep
@pytest.mark.parametrize("name", WORLDS)
def test_forty_logs_of_each_kind_and_pause(name: str) -> None:
    shares = {pause: judged(name, kept, 40) for pause, kept in PAUSES.items()}
    for pause, (right, false, inside) in shares.items():
        print(f"{name}, pauses {pause}: found {right:.3f}, false {false:.3f}, next mean inside {inside:.3f}")
    _, false, inside = np.mean(list(shares.values()), axis=0)
    assert false <= 0.02
    assert inside >= 0.916  # two standard deviations below 95 % of 160
    if name not in ("white", "quantisation"):
        assert shares["none"][0] >= 0.9 * neyman_pearson(name, 40) - 0.05


def interpolated(values: NDArray[np.float64], rate: float) -> NDArray[np.float64]:
    """Return samples that were interpolated to so many times their rate."""
    return np.interp(np.arange(0.0, values.size - 1.0, 1.0 / rate), np.arange(values.size), values)


FILTERS = {
    "to 0.8 of the rate": (0.8, lambda values: interpolated(values, 0.8), 1.0078),  # samples count unevenly
    "to twice the rate": (2.0, lambda values: interpolated(values, 2.0), 1.0),
    "to 3/2 of the rate, band-limited": (1.5, lambda values: signal.resample_poly(values, 3, 2)[200:-200], 1.0),
    "mean of four": (1.0, lambda values: np.convolve(values, np.full(4, 0.25), "valid"), 1.0),
    "first order": (1.0, lambda values: signal.lfilter([0.2], [1.0, -0.8], values)[200:], 1.0),
}


def whites(kind: str, seeds: range) -> NDArray[np.float64]:
    """Return white noise of filtered samples by seed, its deviation from the truth in expanded uncertainties."""
    rate, filtered, truth = FILTERS[kind]
    off = []
    for seed in seeds:
        samples = filtered(np.random.default_rng([SEED, seed]).standard_normal(20_000))
        (white,) = noise_at_rest(samples, 1.0 / rate).stated
        off.append((white.coefficient - truth) / (2.0 * white.std_uncertainty))
    return np.array(off)


@pytest.mark.parametrize("kind", FILTERS)
def test_samples_that_hang_together_do_not_make_white_noise_small(kind: str) -> None:
    off = whites(kind, range(10, 14))
    assert np.all(np.abs(off) < 1.5), off
    assert abs(off.mean()) < 1.5 / 4**0.5, off


@pytest.mark.sweep
@pytest.mark.parametrize("kind", FILTERS)
def test_forty_logs_of_each_filter(kind: str) -> None:
    off = np.abs(whites(kind, range(40)))
    inside = float(np.mean(off <= 1.0))
    print(f"{kind}: inside {inside:.3f}, at most {off.max():.2f} U off")
    assert inside >= 0.85
    assert off.max() < 2.0
