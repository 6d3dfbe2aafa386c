"""One series of scores on its charts, and all charts of a unit, of a station or of certificates together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bench.maths.control.limits import KINDS, Charts, Limits, Signal, chart
from bench.maths.control.predictions import Change
from bench.model.arrays import Floats
from bench.store.selection import Filters
from bench.store.series import Parameter

RUN_LENGTH = 200.0  # points of a subject until the first false signal of any chart, where nobody says another
_STATISTICS = ("ewma", "cusum_up", "cusum_down")


@dataclass(frozen=True)
class ChartedSeries:
    """Points of one series in order of time, (n,); those of the first phase are not judged.

    ``names``: sessions, or certificates of which each is a point.   ``change``: that a signal at a place shows.
    """

    parameter: Parameter
    names: list[str]
    t_year: Floats  # since 1970
    value: Floats
    expected: Floats
    std: Floats
    score: Floats
    first: int
    scatter_std: float
    limits: Limits
    change: Callable[[int], Change | None]

    @cached_property
    def charts(self) -> Charts:
        """Charts of the scores behind the first phase."""
        return chart(self.score[self.first :], self.limits)

    @property
    def label(self) -> str:
        """Quantity and conditions in one line."""
        return self.parameter.label

    @property
    def judged(self) -> int:
        """How many points are judged: those behind the first phase of which something could be expected."""
        return int(np.isfinite(self.score[self.first :]).sum())

    @cached_property
    def signals(self) -> list[tuple[Signal, int, Change | None]]:
        """Signals with the place of their point in the series, and the change that they show."""
        places = [(signal, self.first + signal.point) for signal in self.charts.signals]
        return [(signal, place, self.change(place)) for signal, place in places]

    def as_json(self) -> dict[str, Any]:
        """Return numbers for people and machines; a statistic of a point that is not judged is null."""
        lines = {
            "value": self.value, "expected": self.expected, "std": self.std, "score": self.score,
            **{name: np.append(np.full(self.first, np.nan), getattr(self.charts, name)) for name in _STATISTICS},
        }  # fmt: skip
        finite = {name: [v if np.isfinite(v) else None for v in line.tolist()] for name, line in lines.items()}
        return {
            **vars(self.parameter),
            "first_phase": self.first,
            "scatter_std": self.scatter_std if np.isfinite(self.scatter_std) else None,
            "degrees_of_freedom": self.limits.dof if np.isfinite(self.limits.dof) else None,
            "run_length_of_each": self.limits.run_length,
            "limits": {name: getattr(self.limits, name) for name in KINDS},
            "points": [
                {"name": name, "year": 1970.0 + year, **{key: line[place] for key, line in finite.items()}}
                for place, (name, year) in enumerate(zip(self.names, self.t_year.tolist(), strict=True))
            ],
            "signals": [self._signal(*entry) for entry in self.signals],
        }

    def _signal(self, signal: Signal, place: int, change: Change | None) -> dict[str, Any]:
        said: dict[str, Any] = {
            "rule": signal.kind, "name": self.names[place], "statistic": signal.statistic, "limit": signal.limit,
        }  # fmt: skip
        if change is None:
            return said
        return {
            **said,
            "since": self.names[change.since],
            "since_earliest": self.names[change.earliest],
            "since_latest": self.names[change.latest],
            "size": change.size,
            "size_expanded_uncertainty": change.expanded,
        }


@dataclass(frozen=True)
class ChartedSubject:
    """All charts of one subject, for which the run length is declared together; ``shown`` are those asked for."""

    kind: str  # "unit", "certificates" or "station"
    name: str
    simulated: bool
    run_length: float
    phase: dict[str, Any] | None  # the first phase that somebody stated
    series: list[ChartedSeries]
    shown: list[ChartedSeries]
    notes: list[str]

    def as_json(self) -> dict[str, Any]:
        """Return one JSON document."""
        return {
            **{name: getattr(self, name) for name in ("kind", "name", "simulated", "run_length", "phase", "notes")},
            "charts_together": len(KINDS) * len(self.series),
            "series": [series.as_json() for series in self.shown],
        }


def wanted(charted: Sequence[ChartedSeries], filters: Filters) -> list[ChartedSeries]:
    return [
        series
        for series in charted
        if filters.campaign in (None, series.parameter.campaign)
        and filters.quantity in (None, series.parameter.quantity)
    ]
