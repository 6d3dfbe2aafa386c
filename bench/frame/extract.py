"""Cutting one field out of a matrix of frames, vectorised."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame.layout import Field


def extract_column(rows: NDArray[np.uint8], item: Field) -> NDArray[Any]:
    """Raw values of a field: (n,) or (n, count), native byte order; bytes give (n, count) uint8.

    Args: rows: (n, body) uint8, any strides between rows; at least one byte stands before the field (the sync).
    """
    count = len(rows)
    width = np.dtype(item.dtype).itemsize
    if item.kind == "b":
        return rows[:, item.offset : item.offset + item.length].copy()
    elements = 1 if item.count is None else item.count
    if item.size == width:
        column = _natural(rows, item, elements)
    elif elements == 1 and item.offset + item.size - width >= 0 and item.big:
        column = _overlapped(rows, item, width)
    else:
        column = _padded(rows, item, elements, width)
    return column.reshape(count) if item.count is None else column


def _natural(rows: NDArray[np.uint8], item: Field, elements: int) -> NDArray[Any]:
    packed = np.ascontiguousarray(rows[:, item.offset : item.offset + item.length])
    wire = np.dtype(item.dtype).newbyteorder(">" if item.big else "<")
    values = packed.view(wire) if item.size > 1 or item.kind == "i" else packed
    return values.astype(item.dtype, copy=False).reshape(len(rows), elements)


def _overlapped(rows: NDArray[np.uint8], item: Field, width: int) -> NDArray[Any]:
    """A big-endian u24/u40.. read as a wider integer that begins in the byte before it; the surplus is masked off."""
    start = item.offset + item.size - width
    packed = np.ascontiguousarray(rows[:, start : start + width])
    wide = packed.view(f">u{width}").astype(f"u{width}")
    if item.kind == "u":
        return np.asarray(wide & wide.dtype.type((1 << (8 * item.size)) - 1))
    return _sign(wide, item.size, width)


def _padded(rows: NDArray[np.uint8], item: Field, elements: int, width: int) -> NDArray[Any]:
    block = rows[:, item.offset : item.offset + item.length].reshape(len(rows), elements, item.size)
    wide = np.zeros((len(rows), elements, width), np.uint8)
    wide[:, :, : item.size] = block[:, :, ::-1] if item.big else block
    values = wide.view(f"<u{width}").astype(f"u{width}", copy=False).reshape(len(rows), elements)
    return _sign(values, item.size, width) if item.kind == "i" else values


def _sign(values: NDArray[Any], size: int, width: int) -> NDArray[Any]:
    """Return two's complement of ``size`` bytes in a wider word: shift up, back down with the sign."""
    shift = 8 * (width - size)
    return np.asarray((values << values.dtype.type(shift)).view(f"i{width}") >> shift)
