"""The random walk of the biases: any time of a campaign may be asked, and only the stretch asked last is kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim_instruments.seeds import generator
from sim_instruments.worlds.af_converter.constants import CHANNELS, WALK_A_RTH

Float = NDArray[np.float64]
Int64 = NDArray[np.int64]

_STEP_S = 10.0
_BLOCK = 4096
_STEP_A = WALK_A_RTH * np.sqrt(_STEP_S / 3600.0)


class BiasWalk:
    """Walks of all channels, drawn on a 10 s grid of bench time and joined by straight lines.

    A block of 4,096 steps depends on the seed, its number and the value the block before ended with. Those values are
    kept, so an earlier time costs one block and the memory does not grow with the campaign.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._starts_A: list[Float] = [np.zeros(CHANNELS)]  # value before the first step of each block
        self._newest: tuple[int, Float] = (-1, np.empty(0))

    def at(self, index: Int64, t_s: Float | float) -> Float:
        """Walk of the channels ``index`` (from 0) at bench time ``t_s``, ampere; the arguments broadcast."""
        place = np.maximum(t_s, 0.0) / _STEP_S
        cell = np.asarray(place).astype(np.int64)
        first, last = int(cell.min()) // _BLOCK, int(cell.max()) // _BLOCK
        if first == last:
            return self._joined(first, index, place, cell)
        index, place, cell = np.broadcast_arrays(index, place, cell)
        walk_A = np.empty(cell.shape)
        for block in range(first, last + 1):
            inside = cell // _BLOCK == block
            if inside.any():
                walk_A[inside] = self._joined(block, index[inside], place[inside], cell[inside])
        return walk_A

    def _joined(self, block: int, index: Int64, place: Float, cell: Int64) -> Float:
        grid_A = self._grid_A(block)
        row = cell - block * _BLOCK
        low_A, high_A = grid_A[row, index], grid_A[row + 1, index]
        return np.asarray(low_A + (place - cell) * (high_A - low_A))

    def _grid_A(self, block: int) -> Float:
        """Return values at the steps of a block and at the first of the next one, (4097, 10)."""
        while len(self._starts_A) <= block:
            self._starts_A.append(self._grid_A(len(self._starts_A) - 1)[_BLOCK - 1].copy())
        if self._newest[0] != block:
            grid_A = np.empty((_BLOCK + 1, CHANNELS))
            grid_A[:_BLOCK] = np.cumsum(self._steps_A(block, _BLOCK), axis=0) + self._starts_A[block]
            grid_A[_BLOCK] = grid_A[_BLOCK - 1] + self._steps_A(block + 1, 1)[0]
            self._newest = (block, grid_A)
        return self._newest[1]

    def _steps_A(self, block: int, count: int) -> Float:
        """Return the first ``count`` steps of a block, (count, 10)."""
        return generator(self._seed, "ngu bias walk", block).standard_normal((count, CHANNELS)) * _STEP_A
