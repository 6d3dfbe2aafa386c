"""Signals of a record: single numbers of the frames that came while it ran, of its own link or of another one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.frame import MessageBatch, Signal, columns, of_message


@dataclass(frozen=True)
class SignalValues:
    """One signal over a record: receive stamps ``t_ns`` and ``values`` in the unit of the field, both (n,)."""

    t_ns: NDArray[np.int64]
    values: NDArray[np.float64]


class SignalKeeper:
    """Collects some signals of the frames of a record, and of those that came beside them in (begin_ns, end_ns]."""

    def __init__(self, signals: Sequence[Signal], begin_ns: int, end_ns: int) -> None:
        self._signals, self._begin_ns, self._end_ns = signals, begin_ns, end_ns
        self._pieces: dict[str, list[SignalValues]] = {signal.name: [] for signal in signals}

    def add_beside(self, link: str, frames: MessageBatch) -> None:
        """Take frames of a message that is not counted; one that cannot be true is left out."""
        if frames.t_ns is not None:
            inside = (frames.t_ns > self._begin_ns) & (frames.t_ns <= self._end_ns)
            self.add(link, frames, np.flatnonzero(inside & ~frames.suspect))

    def add(self, link: str, frames: MessageBatch, rows: slice | NDArray[np.int64]) -> None:
        """Take some of the frames of a message of a link."""
        chosen = of_message(self._signals, link, frames.message.name)
        if not chosen or frames.t_ns is None or not len(frames.t_ns[rows]):
            return
        for signal, column in zip(chosen, columns(chosen, link, frames).T, strict=True):
            self._pieces[signal.name].append(SignalValues(frames.t_ns[rows], column[rows]))

    def between(self, first_ns: int, last_ns: int) -> dict[str, SignalValues]:
        """Return what was received in (first_ns, last_ns], by name; nothing of a signal that did not come."""
        found = {}
        for name, pieces in self._pieces.items():
            t_ns = np.concatenate([piece.t_ns for piece in pieces]) if pieces else np.empty(0, np.int64)
            start, stop = np.searchsorted(t_ns, (first_ns, last_ns), side="right")
            if start < stop:
                values = np.concatenate([piece.values for piece in pieces])
                found[name] = SignalValues(t_ns[start:stop], values[start:stop])
        return found
