"""Compares calibrations of one unit: drift, agreement of each with the one before, control limits; or of two."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.maths.drift import NO_STANDARD, DriftLine, IndividualsChart, en_scores, fit_drift_line, individuals_chart
from bench.model.arrays import Floats
from bench.store.errors import StoreError
from bench.store.selection import Filters
from bench.store.series import Parameter, Series, read_pair, read_series

Labels = NDArray[np.int64]
LEAST_FOR_CONTROL = 8  # calibrations; fewer moving ranges say too little about the scatter


@dataclass(frozen=True)
class ParameterHistory:
    """One parameter over all calibrations that have it; arrays (m,) in order of time."""

    parameter: Parameter
    rows: NDArray[np.int64]  # calibrations in the series
    t_year: Floats
    value: Floats
    std: Floats
    factor: Floats
    en: Floats  # against the calibration before; NaN for the first, and for the first after an adjustment
    line: DriftLine | None  # since the last adjustment; None if no two between adjustments are at different times
    chart: IndividualsChart | None  # of the residuals about the line
    low: float  # limits of the value; infinite where there is none
    high: float
    change_limit: float  # of the change since the last calibration; NaN if there is none
    level: NDArray[np.int64]  # another label after each adjustment

    @property
    def compared(self) -> bool:
        """The last calibration has one before it, and no adjustment lies between them."""
        return self.value.size > 1 and bool(self.level[-1] == self.level[-2])

    @property
    def outside(self) -> NDArray[np.int64]:
        """Calibrations beyond the action limits."""
        if self.chart is None or self.line is None:
            return self.rows[:0]
        low, high = self.chart.action
        return self.rows[(self.line.residual < low) | (self.line.residual > high)]

    def as_json(self, series: Series) -> dict[str, Any]:
        """Return numbers for people and machines."""
        line, chart = self.line, self.chart
        en = self.en[np.isfinite(self.en)]
        return {
            **vars(self.parameter),
            "calibrations": int(self.value.size),
            "value": float(self.value[-1]),
            "expanded_uncertainty": float(self.factor[-1] * self.std[-1]),
            "change": float(self.value[-1] - self.value[-2]) if self.compared else None,
            "en": float(en[-1]) if en.size else None,
            "en_worst": float(en[np.abs(en).argmax()]) if en.size else None,
            "en_above_1": int((np.abs(en) > 1.0).sum()),
            "rate_per_year": None if line is None else line.rate,
            "rate_expanded_uncertainty": None if line is None else line.rate_expanded,
            "between_calibrations_std": None if line is None else line.between_std,
            "reduced_chi2": line.chi2 / line.dof if line and line.dof else None,
            "control_sigma": None if chart is None else chart.sigma,
            "control_limits_2_sigma": None if chart is None else list(chart.warning),
            "control_limits_3_sigma": None if chart is None else list(chart.action),
            "moving_range_limit": None if chart is None else chart.range_limit,
            "out_of_control": [series.calibrations[row]["session"] for row in self.outside],
            "limit": self.high if np.isfinite(self.high) and self.low == -self.high else None,
            "limits": {"low": _limit(self.low), "high": _limit(self.high)},
            "change_limit": None if np.isnan(self.change_limit) else self.change_limit,
        }


def _limit(end: float) -> float | None:
    return end if np.isfinite(end) else None


@dataclass(frozen=True)
class Comparison:
    """All calibrations of a unit against each other."""

    series: Series
    parameters: list[ParameterHistory]


def compare_unit(url: str, filters: Filters) -> Comparison:
    """Compare all calibrations of a unit, newest results of each.

    Args:   url: of the history.   filters: the unit (may be left out if there is one only), campaign, quantity.
    Raises: StoreError B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    series = read_series(url, filters)
    return Comparison(series, [_history(series, column) for column in range(len(series.parameters))])


def _history(series: Series, column: int) -> ParameterHistory:
    rows = np.flatnonzero(np.isfinite(series.value[:, column]))
    t = series.t_year[rows]
    value, std, factor = (grid[rows, column] for grid in (series.value, series.std, series.factor))
    shared, standard = np.minimum(series.shared[rows, column], std), series.standard[rows, column]
    level = series.level[rows]
    line = None
    if ((np.diff(t) > 0.0) & (np.diff(level) == 0)).any() and (std > 0.0).all():
        line = fit_drift_line(t, value, std, shared, standard, level)
    chart = individuals_chart(line.residual) if line and value.size >= LEAST_FOR_CONTROL else None
    return ParameterHistory(
        parameter=series.parameters[column],
        rows=rows,
        t_year=t,
        value=value,
        std=std,
        factor=factor,
        en=_en_of_each(value, std * factor, shared * factor, standard, level),
        line=line,
        chart=chart,
        low=float(series.low[column]),
        high=float(series.high[column]),
        change_limit=float(series.change_limit[column]),
        level=level,
    )


def _en_of_each(value: Floats, expanded: Floats, shared: Floats, standard: Labels, level: Labels) -> Floats:
    """Return E_n of each calibration against the one before, (m,), NaN for the first and across an adjustment."""
    same = (standard[1:] == standard[:-1]) & (standard[1:] != NO_STANDARD)
    parts = np.where(same, shared[:-1], 0.0), np.where(same, shared[1:], 0.0)
    scores = en_scores(np.diff(value), (expanded[:-1], expanded[1:]), parts)
    return np.concatenate([[np.nan], np.where(np.diff(level) == 0, scores, np.nan)])


def compare_pair(url: str, first: str, second: str) -> dict[str, Any]:
    """Return change of every parameter, its expanded uncertainty and E_n, the standard common to both being left out.

    Args:   url: of the history.   first, second: sessions or the beginnings of their SHA-256.
    Raises: StoreError B-STORE-011 if they have nothing in common, B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    series, covariance = read_pair(url, first, second)
    value, expanded = series.value, series.std * series.factor
    both = np.flatnonzero(np.isfinite(value).all(axis=0))
    if not both.size:
        raise StoreError(
            "B-STORE-011",
            "these have no parameter in common",
            where=f"{first}, {second}",
            next_step="compare two calibrations of one unit by the same campaign",
        )
    same = (series.standard[0] == series.standard[1]) & (series.standard[0] != NO_STANDARD)
    shared = np.where(same, np.minimum(series.shared, series.std), 0.0)
    # what the estimates themselves say, else the least that the register says of their quantity
    covariance = np.where(np.isnan(covariance), shared[0] * shared[1], covariance)
    common = series.factor[0] * series.factor[1] * covariance
    change = value[1] - value[0]
    en = en_scores(change, (expanded[0], expanded[1]), (common, np.ones_like(common)))
    spread = np.sqrt(np.maximum(expanded[0] ** 2 + expanded[1] ** 2 - 2.0 * common, 0.0))
    return {
        "uut_model": series.uut[0],
        "uut_serial": series.uut[1],
        "sessions": [row["session"] for row in series.calibrations],
        "methods": [row["method"] for row in series.calibrations],
        "notes": list(series.notes),
        "parameters": [
            {
                **vars(series.parameters[column]),
                "values": value[:, column].tolist(),
                "expanded_uncertainties": expanded[:, column].tolist(),
                "change": float(change[column]),
                "change_expanded_uncertainty": float(spread[column]),
                "en": float(en[column]) if np.isfinite(en[column]) else None,
                "shared_standard": bool(covariance[column]),
            }
            for column in both
        ],
    }
