"""Where the check of a frame stands, what it covers, and what stands behind it: for rows of frames of one length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.frame.layout import Layout, Message

Rows = NDArray[np.uint8]


def are_right(layout: Layout, message: Message, rows: Rows) -> NDArray[np.bool_]:
    """Return for each frame (n, length) whether its check and its trailer are right, (n,)."""
    right = _computed(layout, message, rows) == _stored(rows[:, _place(layout, rows.shape[1])], layout.stored_big)
    if layout.trailer:
        right &= (rows[:, -len(layout.trailer) :] == np.frombuffer(layout.trailer, np.uint8)).all(axis=1)
    return np.asarray(right)


def seal(layout: Layout, message: Message, rows: Rows) -> None:
    """Write the check and the trailer of frames (n, length) whose fields are there."""
    size = layout.check.size
    if layout.trailer:
        rows[:, -len(layout.trailer) :] = np.frombuffer(layout.trailer, np.uint8)
    packed = _computed(layout, message, rows).astype("<u8").view(np.uint8).reshape(len(rows), 8)[:, :size]
    rows[:, _place(layout, rows.shape[1])] = packed[:, ::-1] if layout.stored_big else packed


def _place(layout: Layout, length: int) -> slice:
    """Return where the check stands in a frame of that length."""
    at = length - layout.tail if layout.check_field is None else layout.check_field.offset
    return slice(at, at + layout.check.size)


def _computed(layout: Layout, message: Message, rows: Rows) -> NDArray[np.uint64]:
    length = rows.shape[1]
    stop = length - layout.tail if message.cover_stop is None else message.cover_stop
    covered = rows[:, message.cover_start : stop]
    held = None if layout.check_field is None else layout.check_field.offset - message.cover_start
    if held is not None and 0 <= held < covered.shape[1]:
        covered = covered.copy()
        covered[:, held : held + layout.check.size] = 0
    return np.asarray(layout.check.of_rows(covered), np.uint64)


def _stored(packed: Rows, big: bool) -> NDArray[np.uint64]:
    """Stored check values (n, size) -> (n,) uint64."""
    wide = np.zeros((len(packed), 8), np.uint8)
    size = packed.shape[1]
    if big:
        wide[:, 8 - size :] = packed
    else:
        wide[:, :size] = packed
    return wide.view(">u8" if big else "<u8").reshape(-1).astype(np.uint64)
