"""Calibrations in control, and with a step: how long the charts run until they signal."""

import math

import numpy as np

from bench.maths.control.limits import KINDS, Limits, limits_for
from bench.maths.control.predictions import Readings, first_phase, predictions
from bench.maths.control.run_lengths import CUSUM_REFERENCE, EWMA_WEIGHT, ewma_std

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
