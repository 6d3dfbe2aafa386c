"""Whole quanta in running sums: how many more of them each sum holds than the one before."""

from __future__ import annotations

import numpy as np

from bench.frame.kernel import task as order
from bench.frame.kernel.words import inlined, load_32, load_64, store_16, tell, told


@inlined
def count_row(row, noise, clocks, counts, count):
    """Follow one row; gives back what its last sum holds beyond whole quanta, at the place of its start."""
    sign, size, quantum = told(row, order.SIGN), told(row, order.SIZE), told(row, order.QUANTUM)
    inverse = 1.0 / np.float64(quantum)
    total, before, held = told(row, order.START), np.int64(0), np.int64(0)
    for index in range(count):
        extra = np.int64(np.int32(load_32(noise + np.uint64(4 * index))))
        total += (size + sign * extra) * np.int64(load_64(clocks + np.uint64(8 * index)))
        held = np.int64(np.float64(total) * inverse)  # right or one beside it
        left = total - held * quantum
        held += np.int64(left >= quantum) - np.int64(left < 0)
        held = max(held, np.int64(0))
        store_16(counts + np.uint64(2 * index), np.uint64(held - before))
        before = held
    tell(row, order.START, total - held * quantum)


def count_quanta(task):
    """Count the quanta of all rows; ``task`` is an address, ``bench.frame.kernel.task`` says of what."""
    noise, clocks = np.uint64(told(task, order.NOISE)), np.uint64(told(task, order.CLOCKS))
    count = told(task, order.STRETCHES)
    for index in range(told(task, order.ROWS)):
        row = task + np.uint64(8 * (order.OF_ROWS + order.ROW_NUMBERS * index))
        from_row = noise + np.uint64(told(task, order.NOISE_BYTES) * index)
        count_row(row, from_row, clocks, np.uint64(told(row, order.COUNTS)), count)
