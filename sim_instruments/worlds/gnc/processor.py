"""CPU and timer of the simulated GNC module: arithmetic and interrupts as the hardware does them, faults included.

Paper 001, Table 1: write and read, add, subtract, multiply, divide; timer 0.5, 1, 2 and 5 ms.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_instruments.worlds.gnc.draws import ModuleDraws

U32 = NDArray[np.uint32]

LOW, HALF = np.uint32(0xFFFF), np.uint32(16)
OPERATIONS = 256  # of each kind in one test
TICKS = 20  # intervals an answer has room for
LOST_EACH = 5  # with the fault every fifth interrupt is lost
SLOW = 1.03
TIMER_SIGMA_PPM = 20.0
LATENCY_US = 0.3  # standard deviation of one interrupt's latency


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
        self._timer_error = float(draws.generator("timer").normal(0.0, TIMER_SIGMA_PPM)) * 1e-6
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
        """Intervals between interrupts as the test board's counter measures them, and how many interrupts came."""
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
    """Operands of a linear congruential sequence (Numerical Recipes' constants), the divisors odd and below 2^12."""
    values, state = [], seed
    for _ in range(2 * OPERATIONS):
        state = (1664525 * state + 1013904223) & 0xFFFFFFFF
        values.append(state)
    drawn = np.array(values, np.uint32)
    return drawn[:OPERATIONS], (drawn[OPERATIONS:] >> np.uint32(20)) | np.uint32(1)
