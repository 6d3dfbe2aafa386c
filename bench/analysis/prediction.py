"""What an analysis knows of a campaign before its first hour, and the uncertainties that it will give.

Decision: docs/method-uncertainty.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from bench.analysis.estimates import Document, Estimates
from bench.analysis.material import Exchange, Reading, Trace
from bench.model.ports import RecordWindow

PROMPT = "prompt"  # name of a reading that is what a person is asked to set, without a role


@dataclass(frozen=True)
class Planned:
    """A plan, as far as an analysis may see it.

    ``windows``: of the measuring records, by number, at their planned times.   ``campaign``, ``standards``: as in the
    manifest of a session.   ``timed``: numbers of the windows whose pulses are timed.   ``trace``: planned temperature
    of the air.   ``readings``: planned calls of instruments and ``PROMPT`` of persons with their arguments, those of
    the preparation among them; nobody knows their values.   ``exchanges``: planned commands to the unit, without
    answers.   ``rates_Hz``: of the frames of each link.   ``steps_s``: in which each link is looked at, so those of its
    receive stamps; a link that is watched all the time has none.   ``begin_utc_s``: UTC (seconds since 1970) at the
    begin of the preparation, None if unknown.
    """

    windows: Sequence[RecordWindow]
    campaign: Document
    standards: Mapping[str, Document]
    timed: Collection[int] = ()
    trace: Trace = field(default_factory=Trace)
    readings: Sequence[Reading] = ()
    exchanges: Sequence[Exchange] = ()
    rates_Hz: Mapping[str, float] = field(default_factory=dict)
    steps_s: Mapping[str, float] = field(default_factory=dict)
    begin_utc_s: float | None = None


@dataclass(frozen=True)
class Bound:
    """The smallest standard uncertainty that any estimator could reach (Cramer-Rao), beside what is planned.

    ``bound``: in ``unit``.   ``ratio``: of the planned standard uncertainty over it, 1 at the least.
    """

    quantity: str
    unit: str
    conditions: Document
    bound: float
    ratio: float


@dataclass(frozen=True)
class Prediction:
    """Estimates with the uncertainties that a plan will give them; ``missing``: what it does not determine, and why.

    ``assumed``: sentences on the unit for which they hold.   ``bounds``: of those for which one is known.
    """

    estimates: Estimates
    missing: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
    bounds: list[Bound] = field(default_factory=list)
