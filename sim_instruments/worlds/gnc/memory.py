"""Memories of the simulated GNC module as arrays of cells: RAM, SDRAM, SPI FLASH, internal FLASH.

Faults sit in the cells, in the address lines and in the data lines; what a test finds follows from them. FLASH is
erased to ones by sectors and programming can only turn ones into zeros.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from sim_instruments.worlds.gnc.draws import ModuleDraws

U32 = NDArray[np.uint32]
Words = NDArray[np.int64]  # word addresses

WORD = 4
SECTOR = 4096  # bytes that are erased together
ONES = np.uint32(0xFFFFFFFF)
HIGH_BITS = np.uint32(0xC0000000)  # 0 in the address pattern, one 0 in each of the other two


class Region(IntEnum):
    """Number of a memory in the command."""

    RAM = 0
    SDRAM = 1
    SPI_FLASH = 2
    INTERNAL_FLASH = 3


class Operation(IntEnum):
    """Number of what is done with it."""

    WRITE_READ = 0
    ERASE = 1
    BLANK_CHECK = 2
    PROGRAM = 3
    VERIFY = 4


SIZE = {Region.RAM: 65_536, Region.SDRAM: 1_048_576, Region.SPI_FLASH: 524_288, Region.INTERNAL_FLASH: 262_144}
FLASH = (Region.SPI_FLASH, Region.INTERNAL_FLASH)
_SHORTED_LINES = (9 - 2, 13 - 2)  # of the word address
_DATA_OPEN = np.uint32(1 << 22)


@dataclass(frozen=True)
class MemoryResult:
    """What one operation has found; addresses in bytes, all 0 if nothing is wrong."""

    checked: int
    wrong: int = 0
    address: int = 0
    expected: int = 0
    received: int = 0


def pattern_of(pattern: int, words: Words) -> U32:
    """Return what is written: 0x55555555, 0xAAAAAAAA, or each word its byte address."""
    if pattern == 2:
        return (words * WORD).astype(np.uint32)
    return np.full(len(words), 0x55555555 if pattern == 0 else 0xAAAAAAAA, np.uint32)


class Memories:
    """The four memories of one module; ``erases`` counts the erasures of each."""

    def __init__(self, draws: ModuleDraws, faults: Set[str]) -> None:
        self._draws, self._faults = draws, faults
        self._cells: dict[Region, U32] = {}
        self.erases = dict.fromkeys(Region, 0)

    def do(self, region: Region, operation: Operation, pattern: int, start: int, length: int) -> MemoryResult:
        """Do one operation on ``length`` bytes from byte ``start`` on; both are multiples of 4 inside the memory."""
        words = np.arange(start // WORD, (start + length) // WORD)
        if operation is Operation.ERASE:
            self._erase(region, start, length)
            return MemoryResult(len(words))
        if operation is Operation.PROGRAM:
            self._program(region, words, pattern_of(pattern, words))
            return MemoryResult(len(words))
        expected = pattern_of(pattern, words)
        if operation is Operation.BLANK_CHECK:
            expected = np.full(len(words), ONES)
        elif operation is Operation.WRITE_READ:
            self._write(region, words, expected)
        return _compare(words, expected, self._read(region, words))

    def _array(self, region: Region) -> U32:
        """Cells of a memory; before the first use they hold what chance or an earlier owner left there."""
        if region not in self._cells:
            rng = self._draws.generator("memory content", region)
            self._cells[region] = rng.integers(0, 1 << 32, SIZE[region] // WORD, np.uint32)
        return self._cells[region]

    def _place(self, purpose: str, count: int = 1) -> Words:
        """Word addresses of faulty cells, in the first sector so that a short test finds them too."""
        return self._draws.generator(purpose).choice(SECTOR // WORD, count, replace=False).astype(np.int64)

    def _lines(self, region: Region, words: Words) -> Words:
        """Cells that the address lines really select: shorted lines carry the AND of both."""
        if region is not Region.SDRAM or "sdram_address_short" not in self._faults:
            return words
        one, other = _SHORTED_LINES
        both = (words >> one) & (words >> other) & 1
        return (words & ~((1 << one) | (1 << other))) | (both << one) | (both << other)

    def _write(self, region: Region, words: Words, values: U32) -> None:
        self._array(region)[self._lines(region, words)] = values

    def _read(self, region: Region, words: Words) -> U32:
        cells = self._array(region)
        values: U32 = cells[self._lines(region, words)]
        if region is Region.SDRAM and "sdram_data_open" in self._faults:
            values = values | _DATA_OPEN
        if region is Region.RAM and "ram_stuck_bit" in self._faults:
            values = _changed(values, words, self._place("stuck cell"), lambda old: old | np.uint32(1 << 30))
        if region is Region.RAM and "ram_coupled_bits" in self._faults:
            pair = self._place("coupled cells", 2)
            both = np.uint32(cells[pair[0]] & cells[pair[1]])
            values = _changed(values, words, pair, lambda old: (old & np.uint32(0xFFFF0000)) | (both & 0xFFFF))
        return values

    def _erase(self, region: Region, start: int, length: int) -> None:
        """Erase every sector that is touched."""
        self.erases[region] += 1
        if region is Region.INTERNAL_FLASH and "internal_flash_protected" in self._faults:
            return
        cells = self._array(region)
        first, last = start // SECTOR, (start + length - 1) // SECTOR
        span = slice(first * SECTOR // WORD, (last + 1) * SECTOR // WORD)
        cells[span] = ONES
        if region is Region.SPI_FLASH and "flash_weak_cell" in self._faults:
            cells[self._place("weak cell")] &= ~HIGH_BITS
        if region is Region.INTERNAL_FLASH and "internal_flash_worn" in self._faults:
            rng = self._draws.generator("worn block", self.erases[region])
            worn = rng.choice(SECTOR // WORD, 40, replace=False)
            cells[worn] &= ~(np.uint32(1) << rng.integers(0, 32, 40).astype(np.uint32))

    def _program(self, region: Region, words: Words, values: U32) -> None:
        if region is Region.INTERNAL_FLASH and "internal_flash_protected" in self._faults:
            return
        cells = self._array(region)
        cells[words] &= values
        if region is Region.SPI_FLASH and "flash_lost_bits" in self._faults:
            cells[self._place("lost bits")] |= HIGH_BITS


def _changed(values: U32, words: Words, places: Words, change: object) -> U32:
    """The values with those of some cells changed by a function, as far as they are among the words."""
    changed = values.copy()
    at = np.isin(words, places)
    changed[at] = change(changed[at])  # type: ignore[operator]
    return changed


def _compare(words: Words, expected: U32, received: U32) -> MemoryResult:
    wrong = np.flatnonzero(expected != received)
    if not len(wrong):
        return MemoryResult(len(words))
    first = wrong[0]
    return MemoryResult(len(words), len(wrong), int(words[first]) * WORD, int(expected[first]), int(received[first]))
