"""Random errors of many lanes that are never all in memory: a block of them is drawn again whenever it is read.

The numbers are those of one array drawn at once, and the generator stands behind them afterwards.
Source: bookkeeping; Gauss-Markov errors, Brown and Hwang (2012), section 4.6.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_BLOCK = 2000  # rows: 1.5 MB with 30 lanes


class Redrawn:
    """Standard normal errors (n, lanes, 3), or where ``kept`` is given those that wander and return.

    Args:  count: n.   lanes: how many.   rng: seeded.   kept: (n - 1,), share of an error that is left in the next one.
    """

    def __init__(self, count: int, lanes: int, rng: np.random.Generator, kept: Array | None = None) -> None:
        self.shape = (count, lanes, 3)
        self._kept = kept
        self._new = None if kept is None else np.sqrt(1.0 - kept**2)
        self._begins: list[tuple[Mapping[str, Any], Array | None]] = []
        before = None
        for begin in range(0, count, _BLOCK):
            self._begins.append((rng.bit_generator.state, before))
            self._rows, self._number = self._drawn(rng, begin, before), begin // _BLOCK
            before = self._rows[-1].copy()
        self._rng = np.random.Generator(type(rng.bit_generator)())

    def __getitem__(self, rows: slice) -> Array:
        """Rows of a slice without a step, (k, lanes, 3)."""
        start, stop, _ = rows.indices(self.shape[0])
        numbers = range(start // _BLOCK, -(-stop // _BLOCK)) if stop > start else range(0)
        pieces = [self._block(number)[max(start - number * _BLOCK, 0) : stop - number * _BLOCK] for number in numbers]
        if len(pieces) == 1:
            return pieces[0]
        return np.concatenate(pieces) if pieces else np.empty((0, *self.shape[1:]))

    def _block(self, number: int) -> Array:
        if number != self._number:
            self._rng.bit_generator.state, before = self._begins[number]
            self._rows, self._number = self._drawn(self._rng, number * _BLOCK, before), number
        return self._rows

    def _drawn(self, rng: np.random.Generator, begin: int, before: Array | None) -> Array:
        errors = rng.standard_normal((min(_BLOCK, self.shape[0] - begin), *self.shape[1:]))
        if self._kept is None or self._new is None:
            return errors
        for k in range(len(errors)):
            last = errors[k - 1] if k else before
            if last is not None:
                errors[k] = self._kept[begin + k - 1] * last + self._new[begin + k - 1] * errors[k]
        return errors


class NoisyIncrements:
    """Increments of lanes, (n, lanes, 3): those of one path, (n, 3), with constant errors (lanes, 3) and noise."""

    def __init__(self, path: Array, constant: Array, noise: Redrawn, noise_std: float) -> None:
        self.shape = noise.shape
        self._path, self._constant, self._noise, self._noise_std = path, constant, noise, noise_std

    def __getitem__(self, rows: int | slice) -> Array:
        """One row, (lanes, 3), or those of a slice without a step."""
        if not isinstance(rows, slice):
            return np.asarray(self[rows : rows + 1][0])
        increments = self._noise[rows] * self._noise_std
        increments += self._path[rows, None] + self._constant
        return increments
