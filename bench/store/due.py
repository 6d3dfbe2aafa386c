"""When the next calibration of a unit is due: drift against the limits, and a longest interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.fit.drift import days_to_limit
from bench.model.clock import NS
from bench.store.comparison import Comparison, ParameterHistory
from bench.store.reading import utc_text
from bench.store.series import YEAR_S

DAY_S = 86400
_DAYS_PER_YEAR = YEAR_S / DAY_S


@dataclass(frozen=True)
class Due:
    """When a campaign of a unit is due again, and because of which parameter ("" = the longest interval allowed)."""

    uut: tuple[str, str]
    campaign: str
    simulated: bool
    calibrations: int
    last_utc_ns: int
    due_utc_ns: int
    governed_by: str

    def as_json(self, now_utc_ns: int) -> dict[str, Any]:
        """Numbers for people and machines; ``overdue`` at the time given."""
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
    """One per campaign of the unit; ``most_days``: the longest interval between two calibrations.

    A parameter that the last calibration of its campaign does not have says nothing.
    """
    series, histories = comparison.series, comparison.parameters
    found = []
    for campaign in sorted({one.parameter.campaign for one in histories}):
        rows = [number for number, row in enumerate(series.calibrations) if row["campaign"] == campaign]
        members = [one for one in histories if one.parameter.campaign == campaign and one.rows[-1] == rows[-1]]
        days = _days_left(members, most_days)
        first = int(days.argmin())
        last = series.calibrations[rows[-1]]
        found.append(
            Due(
                series.uut,
                campaign,
                bool(last["simulated"]),
                len(rows),
                int(last["started_utc_ns"]),
                int(last["started_utc_ns"]) + int(days[first]) * DAY_S * NS,
                members[first].parameter.label if days[first] < most_days else "",
            )
        )
    return found


def _days_left(members: list[ParameterHistory], most_days: int) -> NDArray[np.int64]:
    """Days until the last value plus drift, or the drift alone, reaches its limit."""
    value, std = (np.array([getattr(one, name)[-1] for one in members]) for name in ("value", "std"))
    rate = np.array([one.line.rate if one.line else np.nan for one in members]) / _DAYS_PER_YEAR
    rate_std = np.array([one.line.rate_std if one.line else np.nan for one in members]) / _DAYS_PER_YEAR
    limit, change_limit = (np.array([getattr(one, name) for one in members]) for name in ("limit", "change_limit"))
    by_value = days_to_limit(value, std, rate, rate_std, limit, most_days=most_days)
    by_change = days_to_limit(np.zeros_like(value), std, rate, rate_std, change_limit, most_days=most_days)
    return np.minimum(by_value, by_change)
