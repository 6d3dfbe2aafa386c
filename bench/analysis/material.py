"""Everything an analysis may see of a session: records, temperatures, readings, constants; nothing of any truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.model.clock import NS

if TYPE_CHECKING:
    from bench.frame import CommandLayout
    from bench.record import RecordRow

Floats = NDArray[np.float64]


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
    conditions: Mapping[str, Any] = field(default_factory=dict)
    arguments: Mapping[str, Any] = field(default_factory=dict)


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
    conditions: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Material:
    """What a session gives to an analysis.

    ``rows``: the measuring records, by number.   ``campaign``, ``standards``: sections of the manifest.
    ``exchanges``: commands to the unit and their answers.   ``layouts``: of the payloads, by name of the command.
    ``utc_offset_s``: UTC (seconds since 1970) minus the bench clock, None if unknown.
    ``series``: columns of an imported log, (n,) each, "t_s" among them; empty for a session of this bench.
    ``line_s``: seconds that a frame takes on its line, by link; those of one length on a serial port only.
    """

    rows: Sequence[RecordRow]
    campaign: Mapping[str, Any]
    standards: Mapping[str, Mapping[str, Any]]
    trace: Trace = field(default_factory=Trace)
    readings: Sequence[Reading] = ()
    exchanges: Sequence[Exchange] = ()
    layouts: Mapping[str, CommandLayout] = field(default_factory=dict)
    utc_offset_s: float | None = None
    series: Mapping[str, Floats] = field(default_factory=dict)
    line_s: Mapping[str, float] = field(default_factory=dict)

    def readings_of(self, row: RecordRow) -> list[Reading]:
        """Return the readings that a record is made of, in order of time; those without a value are among them."""
        if row.window.link:
            return []
        first_s, last_s = row.window.t_start_ns / NS, row.window.t_end_ns / NS
        return [reading for reading in self.readings if first_s < reading.t_s <= last_s]
