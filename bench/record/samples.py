"""What is kept of the frames of a record: samples, every value of those that carry measurements; and signals.

Signals are single numbers of frames of its own link or of another one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.frame import FrameDefinition, Message, MessageBatch, Signal, columns, of_message
from bench.model.arrays import Column, Floats, Integers

PER_SAMPLE = "sample"
Scale = tuple[float, float, str]


@dataclass(frozen=True)
class Samples:
    """Good frames of a record in the order of their counter; a frame that is missing has no row.

    ``columns``: raw integers of the fields with ``per: sample``, (n,) or (n, elements).   ``counter``: (n,) unwrapped,
    so that what is missing can be told.   ``t_ns``: (n,) receive stamps.   ``scales``: by field, physical value =
    raw * scale + shift in unit.
    """

    columns: Mapping[str, Column]
    counter: Integers
    t_ns: Integers
    scales: Mapping[str, Scale]

    def __len__(self) -> int:
        return len(self.counter)

    def scaled(self, name: str) -> Floats:
        """Values of one field in its unit, (n,) or (n, elements). Raises: KeyError for a field that is not there."""
        scale, shift, _ = self.scales[name]
        return self.columns[name].astype(np.float64) * scale + shift

    def unit(self, name: str) -> str:
        """Unit of one field, "" if it has none."""
        return self.scales[name][2]

    def until(self, last_ns: int) -> Samples:
        """Return those received up to ``last_ns``."""
        stop = int(np.searchsorted(self.t_ns, last_ns, side="right"))
        columns = {name: column[:stop] for name, column in self.columns.items()}
        return Samples(columns, self.counter[:stop], self.t_ns[:stop], self.scales)


def sample_scales(message: Message) -> dict[str, Scale]:
    """The fields of a message that are samples, with their scales; empty for one that counts."""
    return {item.name: (item.scale, item.shift, item.unit) for item in message.fields if item.per == PER_SAMPLE}


def counting_message(definition: FrameDefinition) -> Message | None:
    """The message that records are cut from: it has a counter, and counts per frame or samples; None without one."""
    for message in definition.layout.messages:
        if any(item.per in ("frame", PER_SAMPLE) for item in message.fields):
            return message if message.counter is not None else None
    return None


class SampleKeeper:
    """Collects the frames of one window; none of them comes twice."""

    def __init__(self, scales: Mapping[str, Scale]) -> None:
        self._scales = scales
        self._pieces: list[tuple[Integers, Integers, dict[str, Column]]] = []

    def add(self, counter: Integers, t_ns: Integers, columns: Mapping[str, Column]) -> None:
        """Take frames behind those before."""
        self._pieces.append((counter.copy(), t_ns.copy(), {name: columns[name].copy() for name in self._scales}))

    def samples(self) -> Samples:
        """Return everything taken so far."""
        return Samples(
            {name: _joined([piece[2][name] for piece in self._pieces]) for name in self._scales},
            _joined([piece[0] for piece in self._pieces]).astype(np.int64),
            _joined([piece[1] for piece in self._pieces]).astype(np.int64),
            dict(self._scales),
        )


class BesideKeeper:
    """Collects the samples that other links sent while a record ran, (begin_ns, end_ns] as they were received."""

    def __init__(self, begin_ns: int, end_ns: int) -> None:
        self._begin_ns, self._end_ns = begin_ns, end_ns
        self._keepers: dict[str, SampleKeeper] = {}
        self._highest: dict[str, int] = {}

    def add(self, link: str, frames: MessageBatch) -> None:
        """Take the next frames of a link; those that carry no samples, or cannot be true, or came twice, are left."""
        scales = sample_scales(frames.message)
        if not scales or frames.counter is None or frames.t_ns is None:
            return
        before = np.maximum.accumulate(np.concatenate(([self._highest.get(link, -1)], frames.counter)))
        inside = (frames.t_ns > self._begin_ns) & (frames.t_ns <= self._end_ns)
        rows = np.flatnonzero(inside & ~frames.suspect & (frames.counter > before[:-1]))
        if rows.size:
            keeper = self._keepers.setdefault(link, SampleKeeper(scales))
            keeper.add(frames.counter[rows], frames.t_ns[rows], {name: frames.raw(name)[rows] for name in scales})
            self._highest[link] = int(frames.counter[rows[-1]])

    def samples(self, last_ns: int) -> dict[str, Samples]:
        """Return everything received up to ``last_ns``, by link; a link that sent nothing is left out."""
        kept = {link: keeper.samples().until(last_ns) for link, keeper in self._keepers.items()}
        return {link: samples for link, samples in kept.items() if len(samples)}


def _joined(parts: Sequence[Column]) -> Column:
    return np.concatenate(parts) if parts else np.empty(0, np.int64)


@dataclass(frozen=True)
class SignalValues:
    """One signal over a record: receive stamps ``t_ns`` and ``values`` in the unit of the field, both (n,)."""

    t_ns: Integers
    values: Floats


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

    def add(self, link: str, frames: MessageBatch, rows: slice | Integers) -> None:
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
