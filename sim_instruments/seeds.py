"""Every random draw of the simulated bench comes from a generator named by (seed, purpose)."""

from __future__ import annotations

import zlib

import numpy as np

_WORD = 1 << 32


def generator(seed: int, purpose: str, *indexes: int) -> np.random.Generator:
    """Return generator of one purpose; the same (seed, purpose, indexes) gives the same draws in any order of use.

    Args:
        seed: seed of the run, 0 or positive.
        purpose: what is drawn, a fixed name such as "calibrator gain".
        indexes: further non-negative integers that tell draws of one purpose apart (range, level, block ...).
    """
    entropy = (seed, zlib.crc32(purpose.encode()), *indexes)
    if min(entropy) >= 0 and max(entropy) < _WORD:  # words of their own: the same draws, made in half of the time
        return np.random.default_rng(np.array(entropy, np.uint32))
    return np.random.default_rng(entropy)
