"""Search for frames in a stream that is not a clean lattice: damage, foreign bytes, variable lengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from bench.frame.layout import Layout, Message

_UNKNOWN = -1  # all bytes of the header are not there yet
_WRONG = 0  # length or type makes no sense


@dataclass(frozen=True)
class Found:
    """Result of a scan: accepted frames in order, rejected candidates, first undecided byte. All in buffer offsets."""

    start: NDArray[np.int64]
    length: NDArray[np.int64]
    message: NDArray[np.int64]
    bad: NDArray[np.int64]
    position: int


def stored_value(packed: NDArray[np.uint8], big: bool) -> NDArray[np.uint64]:
    """Stored check values (n, size) -> (n,) uint64."""
    wide = np.zeros((len(packed), 8), np.uint8)
    size = packed.shape[1]
    if big:
        wide[:, 8 - size :] = packed
    else:
        wide[:, :size] = packed
    return wide.view(">u8" if big else "<u8").reshape(-1).astype(np.uint64)


class Scanner:
    """Finds, measures and checks all candidates of a window at once."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout

    def scan(self, buffer: NDArray[np.uint8], at: int, stop: int, final: bool, before: int = 0) -> Found:
        """Decode buffer[at:stop] as the reference engine would; ``final``: nothing will follow.

        What begins among the first ``before`` bytes and is not whole is rejected: a tail, shorter than a frame, is due.
        """
        window = buffer[at:stop]
        candidates = _find(window, self._layout.pattern)
        length, message = self._measure(window, candidates)
        complete = (length > 0) & (candidates + length <= len(window))
        valid = np.zeros(len(candidates), np.bool_)
        for index, item in enumerate(self._layout.messages):
            self._check(window, candidates, length, complete & (message == index), item, valid)
        waiting = ((length == _UNKNOWN) | ((length > 0) & ~complete)) & (candidates >= before)
        last = len(window) if final else max(len(window) - len(self._layout.pattern) + 1, min(before, len(window)), 0)
        events = np.flatnonzero(valid if final else valid | waiting)
        taken, position = _serve(candidates, length, waiting, events, last)
        accepted = candidates[taken]
        rejected = candidates[~valid & ~waiting]
        rejected = _outside(rejected[rejected < position], accepted, length[taken])
        return Found(accepted + at, length[taken], message[taken], rejected + at, at + position)

    def _measure(self, window: NDArray[np.uint8], at: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        layout = self._layout
        length = np.full(len(at), layout.messages[0].length, np.int64)
        message = np.zeros(len(at), np.int64)
        if layout.length_field is None and layout.type_field is None:
            return length, message
        there = at + layout.header <= len(window)
        head = sliding_window_view(window, layout.header)[at[there]] if there.any() else np.empty((0, layout.header))
        head = head.astype(np.uint8, copy=False)
        kind = np.zeros(len(head), np.int64)
        if layout.type_field is not None:
            value = _unsigned(head, layout.type_field.offset, layout.type_field.size, layout.type_field.big)
            kind = np.full(len(head), -1, np.int64)
            for index, item in enumerate(layout.messages):
                kind[value == item.type_value] = index
        body = np.array([item.body + layout.check.size for item in layout.messages])[kind]
        fixed = np.array([item.length for item in layout.messages])[kind]
        size = fixed.copy()
        if layout.length_field is not None:
            field = layout.length_field
            size = _unsigned(head, field.offset, field.size, field.big) + layout.length_plus
            size[(size < body) | (size > layout.max_length) | ((fixed > 0) & (size != fixed))] = _WRONG
        size[kind < 0] = _WRONG
        length[:] = _UNKNOWN
        length[there] = size
        message[there] = kind
        return length, message

    def _check(self, window: NDArray[np.uint8], at: NDArray[np.int64], length: NDArray[np.int64],
               chosen: NDArray[np.bool_], message: Message, valid: NDArray[np.bool_]) -> None:  # fmt: skip
        """Set ``valid`` for the chosen candidates whose check passes; one pass per length that occurs."""
        size = self._layout.check.size
        for total in np.unique(length[chosen]).tolist() if message.length == 0 else [message.length]:
            which = np.flatnonzero(chosen & (length == total))
            if not len(which):
                continue
            rows = sliding_window_view(window, total)[at[which]]
            stop = total - size if message.cover_stop is None else message.cover_stop
            values = self._layout.check.of_rows(rows[:, message.cover_start : stop])
            valid[which] = values == stored_value(rows[:, total - size :], self._layout.stored_big)


def _find(window: NDArray[np.uint8], pattern: bytes) -> NDArray[np.int64]:
    """Return offsets of the whole pattern, ascending."""
    ends = len(window) - len(pattern) + 1
    if ends <= 0:
        return np.empty(0, np.int64)
    at = np.flatnonzero(window[:ends] == pattern[0])
    for index in range(1, len(pattern)):
        at = at[window[at + index] == pattern[index]]
    return at.astype(np.int64, copy=False)


def _unsigned(head: NDArray[np.uint8], offset: int, size: int, big: bool) -> NDArray[np.int64]:
    value = np.zeros(len(head), np.int64)
    for index in range(size):
        value = value << 8 | head[:, offset + (index if big else size - 1 - index)]
    return value


def _serve(at: NDArray[np.int64], length: NDArray[np.int64], waiting: NDArray[np.bool_], events: NDArray[np.int64],
           last: int) -> tuple[NDArray[np.int64], int]:  # fmt: skip
    """First come, first served: accepted candidates, and the position where the search must wait for more bytes.

    ``events`` are the candidates that are valid or must wait. Without overlap and waiting nothing is decided in order.
    """
    starts, ends = at[events], at[events] + length[events]
    if not waiting[events].any() and not (starts[1:] < ends[:-1]).any():
        return events, max(int(ends[-1]) if len(ends) else 0, last)
    taken: list[int] = []
    free = 0
    for event, start, end, must_wait in zip(
        events.tolist(), starts.tolist(), ends.tolist(), waiting[events].tolist(), strict=True
    ):
        if start < free:
            continue
        if must_wait:
            return np.array(taken, np.int64), start
        taken.append(event)
        free = end
    return np.array(taken, np.int64), max(free, last)


def _outside(at: NDArray[np.int64], start: NDArray[np.int64], length: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of ``at`` that lie in none of the intervals [start, start + length), which are sorted."""
    if not len(start) or not len(at):
        return at
    before = np.searchsorted(start, at, side="right") - 1
    inside = (before >= 0) & (at < (start + length)[before])
    return at[~inside]
