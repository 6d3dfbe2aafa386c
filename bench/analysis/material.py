"""Everything an analysis may see of a session: records, temperatures, readings, constants; nothing of any truth.

A recording through a motion is cut in two, so that a command may stand between; the second part says ``continues: 1``,
its frames come right behind those of the first (docs/sequences.md), and both are one record again.

With it go why a record may not enter any estimate, and what the register of standards says of an instrument: its
specification by range and age, and whether it still holds.

Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis.estimates import Document
from bench.analysis.wording import say
from bench.maths.arrays import Floats
from bench.model.clock import NS
from bench.model.quantities import Quality
from bench.model.units import format_quantity

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


_EXPANDED = 2.0  # the register states 95 %
_DAY_S = 86_400.0
_ALIKE = 1e-9  # of two ranges that went through different roundings


@dataclass(frozen=True)
class Specification:
    """One line of the register, 95 %: ``relative`` of the reading plus ``floor``, in the unit of the reading."""

    relative: float
    floor: float

    def std(self, value: float) -> float:
        """Return the standard uncertainty of a reading of this value."""
        return (self.relative * abs(value) + self.floor) / _EXPANDED


def specification_of(
    standards: Mapping[str, Document], reading: Reading, value: float, age_s: float | None
) -> Specification | None:
    """Return the line of the register that holds for a reading; None if none does.

    It names the action, holds for an instrument of this age (seconds since its calibration; None is unknown), and is of
    the range that was set, else of the lowest range that holds the value.
    """
    lines = [
        line for line in standards.get(reading.role, {}).get("specifications", ()) if line["reads"] == reading.name
    ]
    lines = [line for line in lines if "age_s" not in line or (age_s is not None and age_s <= line["age_s"])]
    set_to = reading.arguments.get("range")
    if isinstance(set_to, int | float):
        lines = [line for line in lines if "range" not in line or abs(line["range"] - set_to) <= _ALIKE * abs(set_to)]
    else:
        lines = [line for line in lines if "range" not in line or abs(value) <= line["range"]]
    if not lines:
        return None
    line = min(lines, key=lambda line: (line.get("range", 0.0), line.get("age_s", float("inf"))))
    return Specification(float(line["relative"]), float(line["floor"]))


def age_s(standards: Mapping[str, Document], role: str, utc_s: float | None) -> float | None:
    """Return how long ago an instrument was calibrated, seconds, at a UTC; None where either is not known."""
    calibrated = standards.get(role, {}).get("calibrated")
    if calibrated is None or utc_s is None:
        return None
    return utc_s - datetime.fromisoformat(str(calibrated)).replace(tzinfo=UTC).timestamp()


def age_text(seconds: float | None) -> str:
    """Return an age in words."""
    if seconds is None or math.isinf(seconds):
        return say("age.unknown")
    return say("age.known", days=seconds / _DAY_S)


@dataclass(frozen=True)
class Outlived:
    """A range of a standard whose specification held for ``age_s`` after its calibration; the age it had, seconds."""

    role: str
    range_A: float
    age_s: float
    had_s: float


def outlived_text(ranges: Sequence[Outlived]) -> str:
    """Return what is wrong with one or more ranges of a standard, for a person."""
    first, more = ranges[0], len(ranges) - 1
    told = {
        "role": first.role,
        "range": format_quantity(first.range_A, "A"),
        "days": first.age_s / _DAY_S,
        "age": age_text(first.had_s),
    }
    if more > 1:
        return say("outlived.more", count=more, **told)
    return say("outlived.one_more" if more else "outlived", **told)


def outlived(standards: Mapping[str, Document], role: str, end_utc_s: float) -> list[Outlived]:
    """Return the ranges of a standard whose specification did not hold at the end of a measurement.

    A register that does not say when the standard was calibrated cannot say that its specification held.
    """
    known_s = age_s(standards, role, end_utc_s)
    had_s = math.inf if known_s is None else known_s
    lines = standards.get(role, {}).get("uncertainty") or ()
    return [
        Outlived(role, float(line["range_A"]), float(line["age_s"]), had_s)
        for line in lines
        if "age_s" in line and had_s > float(line["age_s"])
    ]


if TYPE_CHECKING:
    from bench.record import RecordRow

_LINK_FLAGS = Quality.LOST | Quality.BAD_FRAMES | Quality.DUPLICATE
_NO_PROBLEM = int(_LINK_FLAGS | Quality.STALE)
_MOST_LOST = 1e-3  # of the frames of a record; a few lost frames take their share of counts and of the gate with them
_NEEDED_CLOCKS = ("af_clock", "master_count")
_COUNTS = {"npp", "ppp"}


def flag_problem(row: RecordRow) -> str:
    """Return what is wrong with a record whatever it holds, "" if nothing is."""
    if not row.quality & ~_NO_PROBLEM:
        return ""
    flags = Quality(row.quality) & ~_LINK_FLAGS & ~Quality.STALE
    return ", ".join(str(flag.name).lower().replace("_", " ") for flag in flags)


def count_problem(row: RecordRow) -> str:
    """Return why the counts of a record may not enter an estimate, "" if they may.

    Rates are taken over the frames that did arrive, so a loss of up to 0.1 % costs resolution, not truth.
    """
    if problem := flag_problem(row):
        return problem
    if row.lost > _MOST_LOST * row.window.frames:
        return say("problem.frames_lost")
    complete = all(_counted(row.sums.get(name, 0)) for name in _NEEDED_CLOCKS) and row.sums.keys() >= _COUNTS
    return "" if complete else say("problem.no_clock_counts")


def _counted(value: Any) -> bool:
    """Return whether any count is not zero; a clock is one number as a rule."""
    return bool(value.any() if isinstance(value, np.ndarray) else value)


@dataclass(frozen=True)
class Check:
    """One verdict: ``ok`` None if there is too little to judge yet."""

    name: str
    ok: bool | None
    value: float | None
    limit: float
    text: str


def link_checks(counts: Mapping[str, int], max_lost: float, max_bad: float) -> list[Check]:
    """Return share of the frames of all links that are missing, and that are damaged.

    Where a counter jumped by more than it can tell, nobody knows whether few enough are missing.
    """
    jumps = counts.get("jumps", 0)
    due = counts["frames"] + counts["frames_lost"]
    shares = (("frames lost", "frames_lost", max_lost, due), ("frames damaged", "frames_bad", max_bad, due))
    checks = []
    for name, key, limit, of in shares:
        share = counts[key] / of if of else None
        text, ok = f"{counts[key]} of {of} frames", None if share is None else share <= limit
        if jumps and key == "frames_lost":
            text, ok = f"{text}, and {jumps} jumps of unknown size of the counter", False if ok is False else None
        checks.append(Check(name, ok, share, limit, text))
    return checks
