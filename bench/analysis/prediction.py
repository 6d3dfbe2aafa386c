"""What an analysis knows of a campaign before its first hour, and the uncertainties that it will give.

Decision: docs/decisions/0046-uncertainty-before-the-first-hour.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.analysis.estimates import Estimates
from bench.analysis.material import Reading
from bench.model.ports import RecordWindow


@dataclass(frozen=True)
class Planned:
    """A plan, as far as an analysis may see it.

    ``windows``: of the measuring records, by number, at their planned times.   ``campaign``, ``standards``: as in the
    manifest of a session.   ``calls``: of actions of instruments, at their planned times and still without a value.
    """

    windows: Sequence[RecordWindow]
    campaign: Mapping[str, Any]
    standards: Mapping[str, Mapping[str, Any]]
    calls: Sequence[Reading] = ()


@dataclass(frozen=True)
class Prediction:
    """Estimates with the uncertainties that a plan will give them; ``missing``: what it does not determine, and why."""

    estimates: Estimates
    missing: list[str] = field(default_factory=list)
