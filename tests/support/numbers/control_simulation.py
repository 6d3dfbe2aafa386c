"""Calibrations in control, and with a step: how long the charts run until they signal."""

from __future__ import annotations

import math

import numpy as np

from bench.maths.control.limits import KINDS, Limits, chart, limits_for
from bench.maths.control.predictions import Readings, first_phase, predictions
from bench.maths.control.run_lengths import CUSUM_REFERENCE, EWMA_WEIGHT, ewma_std, normal_scores

OWN, SHARED, DRIFT, FIRST = 2.0, 10.0, 12.0, 12


def history(rng: np.random.Generator, count: int, per_certificate: int, step: float = 0.0, at: int = 0) -> Readings:
    """A unit that drifts, calibrated each quarter, with certificates that are off by what they state."""
    t, label = np.arange(count) / 4.0, (np.arange(count) // per_certificate).astype(np.int64)
    value = 300.0 + DRIFT * t + rng.normal(0.0, SHARED, label[-1] + 1)[label] + rng.normal(0.0, OWN, count)
    value[at:] += step * OWN
    std = np.full(count, math.hypot(OWN, SHARED))
    return Readings(t, value, std, np.full(count, SHARED), label, np.zeros(count, dtype=np.int64))


def signals_begun_again(scores: np.ndarray, limits: Limits) -> dict[str, int]:
    """Signals of each chart of scores (n,) or (n, series), each chart beginning again behind its own signals."""
    zero = np.zeros(scores.shape[1:])
    ewma, up, down = zero, zero, zero
    counts = dict.fromkeys(KINDS, 0)
    for row in scores:
        row = np.nan_to_num(row)
        ewma = (1.0 - EWMA_WEIGHT) * ewma + EWMA_WEIGHT * row
        up, down = np.maximum(0.0, up + row - CUSUM_REFERENCE), np.maximum(0.0, down - row - CUSUM_REFERENCE)
        beyond = {
            "shewhart": np.abs(row) > limits.shewhart,
            "ewma": np.abs(ewma) > limits.ewma * ewma_std(),
            "cusum": np.maximum(up, down) > limits.cusum,
        }
        for kind, hit in beyond.items():
            counts[kind] += int(np.sum(hit))
        ewma = np.where(beyond["ewma"], 0.0, ewma)
        up, down = (np.where(beyond["cusum"], 0.0, side) for side in (up, down))
    return counts


def run_lengths_of_histories(
    seed: int, histories: int, points: int, declared: float, per_certificate: int
) -> dict[str, float]:
    """Points for each false signal of a chart that is declared for ``declared`` points, by whole histories."""
    rng, counts = np.random.default_rng(seed), dict.fromkeys(KINDS, 0)
    for _ in range(histories):
        readings = history(rng, FIRST + points, per_certificate)
        scatter = first_phase(readings, FIRST)
        scores = predictions(readings, scatter).score[FIRST:]
        for kind, count in signals_begun_again(scores, limits_for(declared / len(KINDS), 1, scatter.dof)).items():
            counts[kind] += count
    return {kind: histories * points / max(count, 1) for kind, count in counts.items()}


def run_length_of_family(
    seed: int, units: int, points: int, declared: float, series: int, dof: int, correlation: float
) -> float:
    """Points to the first signal of any of 3 ``series`` charts of a unit, whose scores are correlated; by the rate."""
    rng, limits = np.random.default_rng(seed), limits_for(declared, series, dof)
    common, own = math.sqrt(correlation), math.sqrt(1.0 - correlation)
    signals = 0
    for _ in range(units):
        shape = (dof + points, series)
        noise = common * rng.normal(size=(shape[0], 1)) + own * rng.normal(size=shape)
        ratio = np.sqrt(np.mean(noise[:dof] ** 2, axis=0))
        scores = normal_scores(noise[dof:] / ratio, np.full((points, series), float(dof)))
        signals += _families(scores, limits)
    return units * points / max(signals, 1)


def _families(scores: np.ndarray, limits: Limits) -> int:
    """Signals of all charts of a unit together, all of them beginning again behind each."""
    signals, begun = 0, 0
    while begun < scores.shape[0]:
        firsts = [chart(column, limits).signals[:1] for column in scores[begun:].T]
        points = [found[0].point for found in firsts if found]
        if not points:
            break
        signals, begun = signals + 1, begun + min(points) + 1
    return signals


def delays(seed: int, histories: int, step: float, declared: float, per_certificate: int, at: int) -> list[float]:
    """Calibrations from a step on, the first at place ``at``, until a chart signals; 30 where none does."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(histories):
        readings = history(rng, at + 30, per_certificate, step, at)
        scatter = first_phase(readings, FIRST)
        limits = limits_for(declared, 1, scatter.dof)
        signals = chart(predictions(readings, scatter).score[FIRST:], limits).signals
        after = [signal.point - (at - FIRST) + 1 for signal in signals if signal.point >= at - FIRST]
        found.append(float(min(after, default=30)))
    return found
