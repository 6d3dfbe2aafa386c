"""CPU, timer and memories of the simulated GNC module: what they do as the hardware does it, faults included.

Faults of a memory sit in its cells, in the address lines and in the data lines; what a test finds follows from them.
FLASH is erased to ones by sectors and programming can only turn ones into zeros.

Paper 001, Table 1: write and read, add, subtract, multiply, divide; timer 0.5, 1, 2 and 5 ms.
"""

from __future__ import annotations

import zlib
from collections.abc import Set
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from bench.model.arrays import Integers
from sim_instruments.seeds import generator

U32 = NDArray[np.uint32]

LOW, HALF = np.uint32(0xFFFF), np.uint32(16)
OPERATIONS = 256  # of each kind in one test
TICKS = 20  # intervals an answer has room for
LOST_EACH = 5  # with the fault every fifth interrupt is lost
SLOW = 1.03
TIMER_SIGMA_PPM = 20.0
LATENCY_US = 0.3  # standard deviation of one interrupt's latency
Words = Integers  # word addresses

WORD = 4
SECTOR = 4096  # bytes that are erased together
ONES = np.uint32(0xFFFFFFFF)
HIGH_BITS = np.uint32(0xC0000000)  # 0 in the address pattern, one 0 in each of the other two


class ModuleDraws:
    """Generators of one module. What is asked for twice with the same purpose and number is the same twice."""

    def __init__(self, seed: int, serial: str) -> None:
        self._seed, self._serial = seed, zlib.crc32(serial.encode())

    def generator(self, purpose: str, *indexes: int) -> np.random.Generator:
        """Return generator of one purpose; ``indexes`` tell several draws of it apart."""
        return generator(self._seed, f"GNC {purpose}", self._serial, *indexes)


@dataclass(frozen=True)
class CpuResult:
    """Wrong results of + - * / and of the scratch memory, and the first wrong one."""

    wrong: tuple[int, int, int, int]
    memory_wrong: int
    first_expected: int
    first_received: int


class Processor:
    """Arithmetic unit and timer; ``faults`` are looked at whenever something is done."""

    def __init__(self, draws: ModuleDraws, faults: Set[str]) -> None:
        self._draws, self._faults = draws, faults
        self._timer_error = draws.generator("timer").normal(0.0, TIMER_SIGMA_PPM) * 1e-6
        self._timer_runs = 0

    def arithmetic(self, seed: int) -> CpuResult:
        """256 operations of each kind with operands from ``seed``, against results the self-test knows."""
        a, b = _operands(seed)
        with np.errstate(over="ignore"):
            known = (a + b, a - b, a * b, a // b)
        done = (self._add(a, b), self._subtract(a, b), self._multiply(a, b), self._divide(a, b))
        read_back = a | np.uint32(1 << 19) if "cpu_register" in self._faults else a
        expected, received = (np.concatenate(parts) for parts in ((*known, a), (*done, read_back)))
        places = np.flatnonzero(expected != received)
        first = (int(expected[places[0]]), int(received[places[0]])) if len(places) else (0, 0)
        counts = np.bincount(places // OPERATIONS, minlength=5)
        return CpuResult((int(counts[0]), int(counts[1]), int(counts[2]), int(counts[3])), int(counts[4]), *first)

    def timer_intervals_us(self, setting_us: int, ticks: int) -> tuple[list[int], int]:
        """Return intervals between interrupts as the test board's counter measures them, and their number."""
        self._timer_runs += 1
        period_us = setting_us * (SLOW if "timer_slow" in self._faults else 1.0) * (1.0 + self._timer_error)
        due = np.arange(ticks + 1)
        if "timer_lost_interrupts" in self._faults:
            due = due[(due == 0) | (due % LOST_EACH != 0)]
        latency_us = self._draws.generator("interrupt latency", self._timer_runs).normal(0.0, LATENCY_US, ticks + 1)
        seen_us = np.rint(due * period_us + latency_us[due] + 10.0).astype(np.int64)
        intervals = np.diff(seen_us)
        return [int(value) for value in intervals], len(intervals)

    def _add(self, a: U32, b: U32) -> U32:
        if "cpu_carry" not in self._faults:
            return a + b
        low = (a & LOW) + (b & LOW)
        high = (a >> HALF) + (b >> HALF)
        return (low & LOW) | (high << HALF)

    def _subtract(self, a: U32, b: U32) -> U32:
        if "cpu_borrow" not in self._faults:
            return a - b
        low = (a & LOW) - (b & LOW)
        high = (a >> HALF) - (b >> HALF)
        return (low & LOW) | (high << HALF)

    def _multiply(self, a: U32, b: U32) -> U32:
        return a * (b & np.uint32(0xFFFFFF7F)) if "cpu_multiplier" in self._faults else a * b

    def _divide(self, a: U32, b: U32) -> U32:
        quotient: U32 = a // b
        return quotient & np.uint32(0xFFFFFFFE) if "cpu_divider" in self._faults else quotient


def _operands(seed: int) -> tuple[U32, U32]:
    """Return operands of a linear congruential sequence (Numerical Recipes' constants), divisors odd, below 2^12."""
    values, state = [], seed
    for _ in range(2 * OPERATIONS):
        state = (1664525 * state + 1013904223) & 0xFFFFFFFF
        values.append(state)
    drawn = np.array(values, np.uint32)
    return drawn[:OPERATIONS], (drawn[OPERATIONS:] >> np.uint32(20)) | np.uint32(1)


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
    """Findings of one operation; addresses in bytes, all 0 if nothing is wrong."""

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
        """Return cells of a memory; before the first use they hold what chance or an earlier owner left there."""
        if region not in self._cells:
            rng = self._draws.generator("memory content", region)
            self._cells[region] = rng.integers(0, 1 << 32, SIZE[region] // WORD, np.uint32)
        return self._cells[region]

    def _place(self, purpose: str, count: int = 1) -> Words:
        """Return word addresses of faulty cells, in the first sector so that a short test finds them too."""
        return self._draws.generator(purpose).choice(SECTOR // WORD, count, replace=False).astype(np.int64)

    def _lines(self, region: Region, words: Words) -> Words:
        """Return cells that the address lines really select: shorted lines carry the AND of both."""
        if region is not Region.SDRAM or "sdram_address_short" not in self._faults:
            return words
        line, other = _SHORTED_LINES
        both = (words >> line) & (words >> other) & 1
        return (words & ~((1 << line) | (1 << other))) | (both << line) | (both << other)

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
    """Return the values with those of some cells changed by a function, as far as they are among the words."""
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
