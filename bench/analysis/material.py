"""Everything an analysis may see of a session: records, temperatures, readings, constants; nothing of any truth.

A recording through a motion is cut in two, so that a command may stand between; the second part says ``continues: 1``,
its frames come right behind those of the first (docs/sequences.md), and both are one record again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis.form import Document
from bench.maths.arrays import Floats
from bench.model.clock import NS

if TYPE_CHECKING:
    from bench.frame import CommandLayout
    from bench.record import RecordRow, Samples, SignalValues

CONTINUES = "continues"


def _none() -> Floats:
    return np.empty(0)


@dataclass(frozen=True)
class Trace:
    """Temperatures of the whole run, about one a minute, all (k,), degC; NaN = no reading.

    ``t_s``: seconds of the bench clock, the one that stamps records; the preparation is included.
    """

    t_s: Floats = field(default_factory=_none)
    air_degC: Floats = field(default_factory=_none)
    unit_degC: Floats = field(default_factory=_none)


@dataclass(frozen=True)
class Reading:
    """A value that an instrument returned to a step; ``value`` is None if it gave none.

    ``arguments`` of the action are known of the readings that a record is made of.
    """

    t_s: float
    step: int
    role: str
    name: str
    value: Any
    conditions: Document = field(default_factory=dict)
    arguments: Document = field(default_factory=dict)


@dataclass(frozen=True)
class GivenValue:
    """A value of the unit under test that a person measured and gave; ``low``, ``high``: the limits it was asked with.

    ``value`` is None if none was given.
    """

    t_s: float
    step: int
    quantity: str
    value: float | None
    unit: str
    low: float | None
    high: float | None
    conditions: Document = field(default_factory=dict)


@dataclass(frozen=True)
class Exchange:
    """A command to the unit under test and what came back.

    ``item``: the test item it belongs to, "" for a command that is no test.   ``attempts``: how often it was sent.
    ``status``: that of the answer, None if nobody answered.   ``refused``: the unit refused the command itself.
    ``sent``, ``received``: payloads, the received one behind its status.   ``begin_s``, ``end_s``: bench clock.
    """

    step: int
    item: str
    name: str
    sequence: int
    attempts: int
    begin_s: float
    end_s: float
    status: int | None
    refused: bool
    sent: bytes
    received: bytes
    conditions: Document = field(default_factory=dict)


@dataclass(frozen=True)
class Material:
    """Everything that a session gives to an analysis.

    ``rows``: the measuring records, by number.   ``campaign``, ``standards``: sections of the manifest.
    ``exchanges``: commands to the unit and their answers.   ``given``: values a person measured.
    ``layouts``: of the payloads, by name of the command.
    ``utc_offset_s``: UTC (seconds since 1970) minus the bench clock, None if unknown.
    ``series``: columns of an imported log, (n,) each, "t_s" among them; empty for a session of this bench.
    ``not_due``: keys (``bench.model.quantities``) of values that the run did not have to give, because its decisions
    left out every step that reads them.
    ``line_s``: seconds that a frame takes on its line, by link; those of one length on a serial port only.
    """

    rows: Sequence[RecordRow]
    campaign: Document
    standards: Mapping[str, Document]
    trace: Trace = field(default_factory=Trace)
    readings: Sequence[Reading] = ()
    exchanges: Sequence[Exchange] = ()
    given: Sequence[GivenValue] = ()
    layouts: Mapping[str, CommandLayout] = field(default_factory=dict)
    utc_offset_s: float | None = None
    series: Mapping[str, Floats] = field(default_factory=dict)
    line_s: Mapping[str, float] = field(default_factory=dict)
    not_due: frozenset[str] = frozenset()

    def readings_of(self, row: RecordRow) -> list[Reading]:
        """Return the readings that a record is made of, in order of time; those without a value are among them."""
        if row.window.link:
            return []
        first_s, last_s = row.window.t_start_ns / NS, row.window.t_end_ns / NS
        return [reading for reading in self.readings if first_s < reading.t_s <= last_s]


def joined(rows: Sequence[RecordRow]) -> Sequence[RecordRow]:
    """Return the same records; one that continues the record before it is part of that one.

    A record that should continue and whose frames do not follow stays alone, so that its samples are not taken for
    what they are not.
    """
    if not any(CONTINUES in row.window.conditions for row in rows):
        return rows
    merged: list[RecordRow] = []
    for row in rows:
        if merged and _follows(merged[-1], row):
            merged[-1] = _both(merged[-1], row)
        else:
            merged.append(row)
    return merged


def _follows(before: RecordRow, row: RecordRow) -> bool:
    behind = before.window.first_counter + before.window.frames
    return bool(row.window.conditions.get(CONTINUES)) and row.window.first_counter == behind


def _both(first: RecordRow, second: RecordRow) -> RecordRow:
    window = replace(first.window, frames=first.window.frames + second.window.frames, t_end_ns=second.window.t_end_ns)
    return replace(
        first,
        window=window,
        sums={name: total + second.sums[name] for name, total in first.sums.items()},
        frames=first.frames + second.frames,
        lost=first.lost + second.lost,
        bad=first.bad + second.bad,
        quality=first.quality | second.quality,
        duplicate=first.duplicate + second.duplicate,
        suspect=first.suspect + second.suspect,
        timing={},
        first_half={},
        samples=_samples(first.samples, second.samples),
        signals=_signals(first.signals, second.signals),
    )


def _signals(first: Mapping[str, SignalValues], second: Mapping[str, SignalValues]) -> dict[str, SignalValues]:
    """Return the signals that both parts have."""
    return {
        name: replace(
            signal,
            t_ns=np.concatenate((signal.t_ns, second[name].t_ns)),
            values=np.concatenate((signal.values, second[name].values)),
        )
        for name, signal in first.items()
        if name in second
    }


def _samples(first: Samples | None, second: Samples | None) -> Samples | None:
    if first is None or second is None:
        return None
    return replace(
        first,
        columns={name: np.concatenate((part, second.columns[name])) for name, part in first.columns.items()},
        counter=np.concatenate((first.counter, second.counter)),
        t_ns=np.concatenate((first.t_ns, second.t_ns)),
    )
