"""Errors that are drawn again block by block are those of one array drawn at once."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.kalman.redrawn import NoisyIncrements, Redrawn

COUNT, LANES = 4501, 3  # two blocks and a part of one
READ = [slice(0, 10), slice(1990, 2010), slice(4400, 4700), slice(100, 150), slice(1500, 4100), slice(7, 7)]
Array = NDArray[np.float64]


def at_once(rng: np.random.Generator, kept: Array | None) -> Array:
    errors = rng.standard_normal((COUNT, LANES, 3))
    if kept is not None:
        new = np.sqrt(1.0 - kept**2)
        for k in range(COUNT - 1):
            errors[k + 1] = kept[k] * errors[k] + new[k] * errors[k + 1]
    return errors


@pytest.mark.parametrize("wander", [False, True])
def test_blocks_are_the_array(wander: bool) -> None:
    kept = np.random.default_rng(1).uniform(0.9, 1.0, COUNT - 1) if wander else None
    rng, other = np.random.default_rng(2), np.random.default_rng(2)
    due, redrawn = at_once(rng, kept), Redrawn(COUNT, LANES, other, kept)
    assert redrawn.shape == due.shape
    for rows in READ:
        np.testing.assert_array_equal(redrawn[rows], due[rows])
    assert rng.standard_normal() == other.standard_normal()


def test_increments_of_a_path_with_noise() -> None:
    rng = np.random.default_rng(3)
    path, constant = rng.standard_normal((COUNT, 3)), rng.standard_normal((LANES, 3))
    due = at_once(np.random.default_rng(4), None) * 0.25
    due += path[:, None] + constant
    increments = NoisyIncrements(path, constant, Redrawn(COUNT, LANES, np.random.default_rng(4)), 0.25)
    for rows in READ:
        np.testing.assert_array_equal(increments[rows], due[rows])
    np.testing.assert_array_equal(increments[2000], due[2000])
