"""The panels of ``bench history compare --plot``."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from bench.model.errors import InputError
from bench.report import plots
from bench.session.output import writing
from bench.store import Comparison, ParameterHistory

_EPOCH_YEAR = 1970.0


def draw(comparison: Comparison, path: Path) -> None:
    """Draw the parameters with the clearest drift. Raises: InputError B-CLI-007 if the file cannot be written."""
    if path.suffix not in plots.FORMATS:
        raise InputError("B-CLI-007", "is neither .svg nor .png", where=str(path), next_step="name such a file")
    histories = sorted(comparison.parameters, key=_clearest)[: plots.MOST_PANELS]
    series = comparison.series
    left = len(comparison.parameters) - len(histories)
    more = f", {left} more parameters not drawn" if left > 0 else ""
    title = f"{' '.join(series.uut)}: {len(series.calibrations)} calibrations, clearest drift first{more}"
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        plots.plot_history(
            [_panel(history) for history in histories], title, bool(series.calibrations[-1]["simulated"]), path
        )


def _clearest(history: ParameterHistory) -> float:
    """Return drift over its standard uncertainty, the largest first; what has no line comes last."""
    return 0.0 if history.line is None else -abs(history.line.rate) / history.line.rate_std


def _panel(history: ParameterHistory) -> plots.Panel:
    empty = np.empty(0)
    at = plots.line_years(history.t_year[0], history.t_year[-1]) if history.line else empty
    unit = history.parameter.unit
    nano = unit == "A" or unit.startswith("A/")
    scale = 1e9 if nano else 1.0
    return plots.Panel(
        title=history.parameter.label,
        unit=f"n{unit}" if nano else unit,
        year=history.t_year + _EPOCH_YEAR,
        value=scale * history.value,
        expanded=scale * history.factor * history.std,
        line_year=at + _EPOCH_YEAR,
        line=scale * history.line.at(at) if history.line else empty,
        line_expanded=scale * history.line.factor * history.line.std_at(at) if history.line else empty,
        action_sigma=3.0 * scale * history.chart.sigma if history.chart else math.nan,
        low=scale * history.low,
        high=scale * history.high,
        outside=np.isin(history.rows, history.outside),
    )
