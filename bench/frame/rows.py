"""Rows of frames of one length, (n, length) uint8: fields and checks, read and written.

A field is read and written where it stands, as numbers at a stride or as bytes of one element, never byte by byte.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame.layout import Field, Layout, Message

Rows = NDArray[np.uint8]


def extract_column(rows: Rows, item: Field) -> NDArray[Any]:
    """Raw values of a field: (n,) or (n, count), native byte order; bytes give (n, count) uint8.

    Args: rows: (n, body) uint8, any strides between rows; at least one byte stands before the field (the sync).
    """
    if item.kind == "b":
        return rows[:, item.offset : item.offset + item.length].copy()
    elements = 1 if item.count is None else item.count
    if item.packed or item.step:
        column = _scattered(rows, item, elements)
    elif item.size == np.dtype(item.dtype).itemsize:
        column = _natural(rows, item, elements)
    elif elements == 1 and item.offset + item.size - np.dtype(item.dtype).itemsize >= 0 and item.big:
        column = _overlapped(rows, item)
    else:
        column = _padded(rows, item, elements)
    return column.reshape(len(rows)) if item.count is None else column


def store_column(rows: Rows, item: Field, values: NDArray[Any]) -> None:
    """Write values of a field that fit it: (n, count), (1, count), or (n, 1) or (1, 1) where all elements are alike."""
    elements = 1 if item.count is None else item.count
    if values.shape[1] != elements:
        values = np.broadcast_to(values, (len(values), elements))
    if item.packed or item.step:
        _store_bits(rows, item, values)
        return
    target = rows[:, item.offset : item.offset + item.length]
    wire = np.ascontiguousarray(values, _wire(item))
    width = wire.itemsize
    if item.size == width:  # all elements in one piece
        target.view(f"V{item.length}")[:] = wire.view(f"V{item.length}")
        return
    surplus = width - item.size if item.big else 0
    packed = wire.view(np.uint8).reshape(*wire.shape, width)[..., surplus : surplus + item.size]
    target.view(f"V{item.size}")[:] = packed.view(f"V{item.size}")[..., 0]


def _wire(item: Field) -> np.dtype[Any]:
    return np.dtype(item.dtype).newbyteorder(">" if item.big else "<")


def _natural(rows: Rows, item: Field, elements: int) -> NDArray[Any]:
    place, wire = rows[:, item.offset : item.offset + item.length], _wire(item)
    if elements > 1:
        place = np.ascontiguousarray(place.view(f"V{item.length}"))
    return place.view(wire).astype(item.dtype).reshape(len(rows), elements)


def _overlapped(rows: Rows, item: Field) -> NDArray[Any]:
    """A big-endian u24/u40.. read as a wider integer that begins in the byte before it; the surplus is masked off."""
    width = np.dtype(item.dtype).itemsize
    wide = rows[:, item.offset + item.size - width : item.offset + item.size].view(f">u{width}").astype(f"u{width}")
    if item.kind == "u":
        return np.asarray(wide & wide.dtype.type((1 << (8 * item.size)) - 1))
    return _sign(wide, item.size, width)


def _scattered(rows: Rows, item: Field, elements: int) -> NDArray[Any]:
    """Elements that are no whole bytes or lie apart: the bytes that hold one, shifted to its lowest bit."""
    column = np.empty((len(rows), elements), np.uint64)
    at, odd = np.array([item.place(element) for element in range(elements)]).T
    for begin in np.unique(odd).tolist():
        alike = np.flatnonzero(odd == begin)
        size = -(-(begin + item.width) // 8)
        value = np.zeros((len(rows), len(alike)), np.uint64)
        for index in range(size):
            value = value << np.uint64(8) | rows[:, at[alike] + (index if item.big else size - 1 - index)]
        column[:, alike] = value >> np.uint64(8 * size - begin - item.width if item.big else begin)
    if item.kind == "f":
        return column.astype(f"u{item.size}").view(item.dtype)
    unused = np.uint64(64 - item.width)
    column <<= unused
    signed = column.view(np.int64) if item.kind == "i" else column
    return (signed >> signed.dtype.type(unused)).astype(item.dtype)


def _padded(rows: Rows, item: Field, elements: int) -> NDArray[Any]:
    width = np.dtype(item.dtype).itemsize
    block = rows[:, item.offset : item.offset + item.length].reshape(len(rows), elements, item.size)
    wide = np.zeros((len(rows), elements, width), np.uint8)
    wide[:, :, : item.size] = block[:, :, ::-1] if item.big else block
    values = wide.view(f"<u{width}").astype(f"u{width}", copy=False).reshape(len(rows), elements)
    return _sign(values, item.size, width) if item.kind == "i" else values


def _sign(values: NDArray[Any], size: int, width: int) -> NDArray[Any]:
    """Return two's complement of ``size`` bytes in a wider word: shift up, back down with the sign."""
    shift = 8 * (width - size)
    return np.asarray((values << values.dtype.type(shift)).view(f"i{width}") >> shift)


def _store_bits(rows: Rows, item: Field, values: NDArray[Any]) -> None:
    """Set the bits of elements that are no whole bytes or lie apart; those of their neighbours stay."""
    values = np.ascontiguousarray(values, item.dtype)
    if item.kind == "f":
        values = values.view(f"u{item.size}")
    for element in range(values.shape[1]):
        at, odd = item.place(element)
        size = -(-(odd + item.width) // 8)
        value = values[:, element].astype(np.uint64) & np.uint64((1 << item.width) - 1)
        value <<= np.uint64(8 * size - odd - item.width if item.big else odd)
        for index in range(size):
            shift = 8 * (size - 1 - index if item.big else index)
            rows[:, at + index] |= (value >> np.uint64(shift) & np.uint64(255)).astype(np.uint8)


def are_right(layout: Layout, message: Message, rows: Rows) -> NDArray[np.bool_]:
    """Return for each frame (n, length) whether its check and its trailer are right, (n,)."""
    right = _computed(layout, message, rows) == extract_column(rows, _stored(layout, rows.shape[1]))
    if layout.trailer:
        right &= (rows[:, -len(layout.trailer) :] == np.frombuffer(layout.trailer, np.uint8)).all(axis=1)
    return np.asarray(right)


def seal(layout: Layout, message: Message, rows: Rows) -> None:
    """Write the check and the trailer of frames (n, length) whose fields are there."""
    if layout.trailer:
        rows[:, -len(layout.trailer) :] = np.frombuffer(layout.trailer, np.uint8)
    if layout.check.size:
        store_column(rows, _stored(layout, rows.shape[1]), _computed(layout, message, rows)[:, np.newaxis])


def _stored(layout: Layout, length: int) -> Field:
    """Return where the check stands in a frame of that length."""
    at = length - layout.tail if layout.check_field is None else layout.check_field.offset
    return Field("check", "u", layout.check.size, None, at, layout.stored_big)


def _computed(layout: Layout, message: Message, rows: Rows) -> NDArray[Any]:
    length = rows.shape[1]
    stop = length - layout.tail if message.cover_stop is None else message.cover_stop
    covered = rows[:, message.cover_start : stop]
    held = None if layout.check_field is None else layout.check_field.offset - message.cover_start
    if held is not None and 0 <= held < covered.shape[1]:
        covered = covered.copy()
        covered[:, held : held + layout.check.size] = 0
    return layout.check.of_rows(covered)
