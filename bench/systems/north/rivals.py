"""What could be true instead of one error that all known azimuths share: a short fixed list, fitted beside it.

A drift and one step in time (a bench that moves), a wave once per turn of the dividing head (tilt, a magnet on the
bench) and twice (unlike gains, an amplitude that goes with twice the angle of the table). The probability of each is
multiplied by the length of the list, that of the step by its places too.
Source: docs/decisions/0025-doubt.md; F test of nested linear models.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from bench.analysis import Evidence, Floats
from bench.systems.north.errors_at_known import Errors, f_test
from bench.systems.north.wording import method_name, say

OF_ALL = ("index_placement", "scale", "azimuth_bound")  # what hangs on the azimuths as well
_LIST = 4
_FEWEST_TO_STEP = 4


def rivals(method: str, errors: Errors) -> Iterator[Evidence]:
    """Yield each rival that the known azimuths can tell from a common error; moves in degrees."""
    time = errors.times_s - errors.times_s.mean() if len(errors.times_s) else errors.times_s
    turned = np.deg2rad(errors.heads_deg)
    for code, columns in (
        ("north_drifts", time[:, None]),
        ("once_per_turn", np.column_stack((np.cos(turned), np.sin(turned)))),
        ("twice_per_turn", np.column_stack((np.cos(2.0 * turned), np.sin(2.0 * turned)))),
    ):
        if len(time) < columns.shape[1] + 2:
            continue
        gain, size_deg, rank = _gain(errors, columns)
        if rank == columns.shape[1]:
            ratio, probability = f_test(gain, rank, 1.0, errors.noise_dof)
            yield _rival(code, size_deg, probability, ratio, method=method_name(method))
    if len(time) >= _FEWEST_TO_STEP:
        order = np.argsort(errors.times_s)
        step_deg, gain, where = best_step(errors.mean_deg[order], errors.weights[order])
        ratio, probability = f_test(gain, 1, 1.0, errors.noise_dof)
        head_deg = errors.heads_deg[order][where]
        chance = probability * (len(time) - 1)
        yield _rival("north_steps", abs(step_deg), chance, ratio, method=method_name(method), head=head_deg)


def _rival(code: str, size_deg: float, probability: float, ratio: float, **values: object) -> Evidence:
    sentence = say(f"rival.{code}", **values, size=size_deg, ratio=math.sqrt(ratio))
    return Evidence(code, sentence, size_deg, min(1.0, probability * _LIST), size_deg, OF_ALL)


def _gain(errors: Errors, columns: Floats) -> tuple[float, float, int]:
    """Return what columns beside the mean take off chi-square, the change they make in deg, their rank."""
    root = np.sqrt(errors.weights)
    centred = columns - np.average(columns, axis=0, weights=errors.weights)
    _, left = errors.common_error()
    values, _, rank, _ = np.linalg.lstsq(centred * root[:, None], left * root, rcond=1e-9)
    fitted_deg = centred @ values
    return float(np.sum(errors.weights * fitted_deg**2)), float(np.ptp(fitted_deg)), int(rank)


def best_step(value: Floats, weights: Floats) -> tuple[float, float, int]:
    """Return the step in a series that takes most off chi-square, what it takes off, and its first index behind."""
    whole = np.cumsum(weights)
    before = whole[:-1]
    behind = whole[-1] - before
    sums = np.cumsum(weights * value)
    steps = (sums[-1] - sums[:-1]) / behind - sums[:-1] / before
    gains = steps**2 * before * behind / whole[-1]
    where = int(np.argmax(gains))
    return float(steps[where]), float(gains[where]), where + 1
