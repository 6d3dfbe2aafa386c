"""The next calibration of a unit: drift against the limits, and a longest interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.maths.drift import days_to_limit
from bench.maths.verdict import coverage_factor
from bench.model.clock import NS, utc_text
from bench.store.comparison import Comparison, ParameterHistory
from bench.store.series import YEAR_S

DAY_S = 86400
_NO_RESULT = "the last calibration has no result"
_LEAST_SHARE = 0.1  # of the longest interval, over which calibrations must be spread to tell that there is no drift
_PLAIN = 5.0  # standard uncertainties of the rate, so that none of some hundred parameters has it by chance
_DAYS_PER_YEAR = YEAR_S / DAY_S


@dataclass(frozen=True)
class Due:
    """Next due date of a campaign of a unit, and the parameter that sets it ("" = the longest interval allowed)."""

    uut: tuple[str, str]
    campaign: str
    simulated: bool
    calibrations: int
    last_utc_ns: int
    due_utc_ns: int
    governed_by: str

    def as_json(self, now_utc_ns: int) -> dict[str, Any]:
        """Return numbers for people and machines; ``overdue`` at the time given."""
        return {
            "uut_model": self.uut[0],
            "uut_serial": self.uut[1],
            "campaign": self.campaign,
            "simulated": self.simulated,
            "calibrations": self.calibrations,
            "last_utc": utc_text(self.last_utc_ns),
            "due_utc": utc_text(self.due_utc_ns),
            "governed_by": self.governed_by,
            "overdue": self.due_utc_ns <= now_utc_ns,
        }


def dues_of(comparison: Comparison, most_days: int) -> list[Due]:
    """Return one per campaign of the unit; ``most_days``: the longest interval between two calibrations.

    A parameter that the last calibration of its campaign does not have says nothing; where it has none at all, the
    campaign is due at once, because nothing is known of the unit since.
    """
    series, histories = comparison.series, comparison.parameters
    dues = []
    for campaign in sorted({history.parameter.campaign for history in histories}):
        rows = [number for number, row in enumerate(series.calibrations) if row["campaign"] == campaign]
        members = [
            history for history in histories if history.parameter.campaign == campaign and history.rows[-1] == rows[-1]
        ]
        days = _days_left(members, most_days)
        first = int(days.argmin()) if members else -1
        left, last = int(days[first]) if members else 0, series.calibrations[rows[-1]]
        dues.append(
            Due(
                series.uut,
                campaign,
                bool(last["simulated"]),
                len(rows),
                int(last["started_utc_ns"]),
                int(last["started_utc_ns"]) + left * DAY_S * NS,
                _NO_RESULT if not members else members[first].parameter.label if left < most_days else "",
            )
        )
    return dues


def _days_left(members: list[ParameterHistory], most_days: int) -> NDArray[np.int64]:
    """Return days until the last value plus drift, or the drift alone, reaches its limit."""
    value, std = (np.array([getattr(history, name)[-1] for history in members]) for name in ("value", "std"))
    lines = [history.line if _tells_drift(history, most_days) else None for history in members]
    rate = np.array([line.rate if line else np.nan for line in lines]) / _DAYS_PER_YEAR
    rate_std = np.array([line.rate_expanded if line else np.nan for line in lines]) / coverage_factor() / _DAYS_PER_YEAR
    low, high, change = (
        np.array([getattr(history, name) for history in members]) for name in ("low", "high", "change_limit")
    )
    counted = (low == value) & (high == value)  # nothing was wrong: a count does not drift
    low, high = np.where(counted, -np.inf, low), np.where(counted, np.inf, high)
    change = np.where(np.isnan(change), np.inf, change)
    by_value = days_to_limit(value, std, rate, rate_std, low, high, most_days=most_days)
    by_change = days_to_limit(np.zeros_like(value), std, rate, rate_std, -change, change, most_days=most_days)
    return np.minimum(by_value, by_change)


def _tells_drift(history: ParameterHistory, most_days: int) -> bool:
    """Return whether a drift line may be carried on: calibrations far enough apart, or a drift that is plain to see.

    Two calibrations of one week that agree say nothing about a year; the uncertainty of their rate, carried on, would
    make a unit due the sooner the more often it is checked.
    """
    if history.line is None:
        return False
    spread_days = float(history.t_year[-1] - history.t_year[0]) * _DAYS_PER_YEAR
    return spread_days >= _LEAST_SHARE * most_days or abs(history.line.rate) > _PLAIN * history.line.rate_std
