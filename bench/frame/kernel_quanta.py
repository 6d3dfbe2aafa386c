"""Whole quanta in running sums, counted in one pass of the kernel."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from bench.frame.best import kernel, why_no_kernel
from bench.frame.kernel import task as order

Int64 = NDArray[np.int64]
Counts = NDArray[np.uint16]
_SPARE = ctypes.byref(ctypes.c_int64())
_Memory = ctypes.c_char * 1


def kernel_quanta(
    noise: NDArray[np.int32], clocks: Int64, sign: Int64, size: Int64, quantum: Int64, start: Int64
) -> tuple[Counts, Counts, Int64]:
    """Count the quanta that become whole as each row's sum goes on from ``start`` by (size + sign * noise) * clocks.

    Args:
        noise: (rows, n); no step is negative.   clocks: (n,).   sign: +1 or -1, (rows,).   size, quantum, start:
            (rows,), the start above -2^62; no sum reaches 2^62, none holds 2^50 quanta.
    Returns:
        Quanta of each step, modulo 2^16, of the rows with sign +1 and of those with -1, zeros in the others, (rows, n)
        each; what each sum holds beyond whole quanta, (rows,).
    Raises:
        RuntimeError: there is no kernel.
    """
    compiled = kernel()
    if compiled is None:
        raise RuntimeError(why_no_kernel())
    rows, stretches = noise.shape
    noise = noise if noise.strides[1] == noise.itemsize else np.ascontiguousarray(noise)
    clocks = np.ascontiguousarray(clocks)
    counts = np.zeros((2, rows, stretches), np.uint16)
    task = np.empty(order.OF_ROWS + order.ROW_NUMBERS * rows, np.int64)
    task[: order.OF_ROWS] = noise.ctypes.data, noise.strides[0], clocks.ctypes.data, stretches, rows
    of_rows = task[order.OF_ROWS :].reshape(rows, order.ROW_NUMBERS)
    of_rows[:, order.COUNTS] = counts.ctypes.data + counts.strides[1] * (np.arange(rows) + rows * (sign < 0))
    for place, values in ((order.SIGN, sign), (order.SIZE, size), (order.QUANTUM, quantum), (order.START, start)):
        of_rows[:, place] = values
    compiled.count_quanta(_SPARE, None, _Memory.from_buffer(task.data))
    return counts[0], counts[1], of_rows[:, order.START]
