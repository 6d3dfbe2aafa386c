"""Noise of the simulated sensors as functions of bench time, so that it does not matter how time is cut into calls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from sim_instruments.seeds import generator

UInt64 = NDArray[np.uint64]

GRID_S = 1.0  # of the slow noise; straight lines between
_BLOCK = 1024
_HALF = np.uint64(32)
_LOW = np.uint64(0xFFFF_FFFF)


class WhiteNoise:
    """Standard normal numbers that are a function of (seed, purpose, column, time stamp).

    Time stamp and a key of the pair of columns go twice through the mixing function of SplitMix64 (Steele, Lea, Flood
    2014); the two halves of the result make two normal numbers (Box and Muller), never larger than 6.8.
    """

    def __init__(self, seed: int, purpose: str, columns: int) -> None:
        pairs = (columns + 1) // 2
        self._columns = columns
        self._keys = generator(seed, purpose).integers(0, 2**64, (2, pairs), np.uint64)

    def at(self, t_ns: Integers) -> Floats:
        """Return numbers at bench times (n,), (n, columns)."""
        stamps = np.asarray(t_ns).astype(np.uint64)
        drawn = np.empty((stamps.size, 2 * self._keys.shape[1]))
        for pair, (first, second) in enumerate(self._keys.T):
            bits = _mixed(_mixed(stamps + first) ^ second)
            radius = np.sqrt(-2.0 * np.log(((bits >> _HALF).astype(float) + 0.5) / 2.0**32))
            turn = (bits & _LOW).astype(float) * (2.0 * np.pi / 2.0**32)
            drawn[:, 2 * pair] = radius * np.cos(turn)
            drawn[:, 2 * pair + 1] = radius * np.sin(turn)
        return drawn[:, : self._columns]


def _mixed(bits: UInt64) -> UInt64:
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58_476D_1CE4_E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D0_49BB_1331_11EB)
    return bits ^ (bits >> np.uint64(31))


class SlowNoise:
    """First-order Gauss-Markov processes, stationary from the start, on a grid of 1 s joined by straight lines.

    Args:
        seed, purpose: name the draws.
        sigmas, times_s: standard deviation and correlation time of each process, (c,).
    """

    def __init__(self, seed: int, purpose: str, sigmas: Floats, times_s: Floats) -> None:
        self._seed, self._purpose = seed, purpose
        self._keep = np.exp(-GRID_S / np.asarray(times_s, float))
        self._kick = np.sqrt(1.0 - self._keep**2)
        self._sigmas = np.asarray(sigmas, float)
        self._starts: list[Floats] = [generator(seed, f"{purpose} start").standard_normal(self._keep.size)]
        self._newest: tuple[int, Floats] = (-1, np.empty(0))

    def at(self, t_ns: Integers) -> Floats:
        """Return values at times since the start (n,), (n, c), in the unit of ``sigmas``; before it the first one."""
        place = np.maximum(np.asarray(t_ns, np.int64), 0) / (GRID_S * NS)
        cell = place.astype(np.int64)
        values = np.empty((cell.size, self._keep.size))
        blocks = cell // _BLOCK
        for block in np.unique(blocks):
            inside = blocks == block
            row, grid = cell[inside] - block * _BLOCK, self._grid(int(block))
            part = (place[inside] - cell[inside])[:, None]
            values[inside] = grid[row] + part * (grid[row + 1] - grid[row])
        return np.asarray(values * self._sigmas)

    def _grid(self, block: int) -> Floats:
        """Return values of unit variance at the grid points of a block and at the first of the next, (1025, c)."""
        while len(self._starts) <= block:
            self._starts.append(self._walked(len(self._starts) - 1)[-1])
        if self._newest[0] != block:
            self._newest = (block, self._walked(block))
        return self._newest[1]

    def _walked(self, block: int) -> Floats:
        kicks = generator(self._seed, self._purpose, block).standard_normal((_BLOCK, self._keep.size)) * self._kick
        grid = np.empty((_BLOCK + 1, self._keep.size))
        grid[0] = self._starts[block]
        for step in range(_BLOCK):
            grid[step + 1] = grid[step] * self._keep + kicks[step]
        return grid
