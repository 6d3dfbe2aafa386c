"""What an analysis knows of a campaign before its first hour, and the uncertainties that it will give.

Decision: docs/decisions/0046-uncertainty-before-the-first-hour.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.analysis.estimates import Estimates
from bench.analysis.material import Reading, Trace
from bench.model.ports import RecordWindow


@dataclass(frozen=True)
class Planned:
    """A plan, as far as an analysis may see it.

    ``windows``: of the measuring records, by number, at their planned times.   ``campaign``, ``standards``: as in the
    manifest of a session.   ``timed``: numbers of the windows whose pulses are timed.   ``trace``: planned temperature
    of the air.   ``readings``: planned calls of instruments with their arguments; nobody knows their values.
    """

    windows: Sequence[RecordWindow]
    campaign: Mapping[str, Any]
    standards: Mapping[str, Mapping[str, Any]]
    timed: Collection[int] = ()
    trace: Trace = field(default_factory=Trace)
    readings: Sequence[Reading] = ()


@dataclass(frozen=True)
class Prediction:
    """Estimates with the uncertainties that a plan will give them; ``missing``: what it does not determine, and why.

    ``assumed``: sentences on the unit for which they hold.
    """

    estimates: Estimates
    missing: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
