"""Charts of a unit, of which a check standard is one: every parameter over its calibrations."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.maths.control.limits import limits_for
from bench.maths.control.predictions import (
    Readings,
    Scatter,
    change_until,
    first_phase,
    odd_one_of_first_phase,
    predictions,
)
from bench.model.errors import FitError
from bench.store.charts.chart import RUN_LENGTH, ChartedSeries, ChartedSubject, wanted
from bench.store.charts.phases import BY_DEFAULT, LEAST, phase_document, phase_of
from bench.store.database import reading
from bench.store.selection import Filters
from bench.store.series import YEAR_S, Series, read_series

LEAST_DOF = 4.0  # of the scatter, for limits that still find anything
_ODD = 0.01  # probability of any odd calibration in the first phases of a unit
_NS_PER_YEAR = YEAR_S * 1e9


def chart_unit(url: str, filters: Filters, run_length: float | None = None) -> ChartedSubject:
    """Chart all parameters of a unit against what its first phase lets one expect.

    Args:    url: of the history.   filters: the unit (may be left out if there is only one); campaign and quantity
             choose what is shown, the run length is that of all charts of the unit together.
             run_length: calibrations until the first false signal; None: as stated with the first phase, else 200.
    Returns: ChartedSubject.
    Raises:  StoreError B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    series = read_series(url, Filters(filters.uut))
    with reading(url) as connection:
        phase = phase_of(connection, "unit", " ".join(series.uut))
    declared = run_length or (RUN_LENGTH if phase is None else phase["run_length"])
    columns = [_column(series, number, phase) for number in range(len(series.parameters))]
    begun = [(number, rows, first, scatter) for number, (rows, first, scatter) in enumerate(columns) if scatter]
    charted = [_charted(series, *entry, declared, len(begun)) for entry in begun]
    notes = list(series.notes)
    if len(begun) < len(columns):
        notes.append(
            f"{len(columns) - len(begun)} of {len(columns)} parameters have no chart: too few calibrations for a first "
            f"phase ({BY_DEFAULT}, or {LEAST} that somebody states), or they do not tell how much they scatter"
        )
    notes += _odd_ones(series, begun)
    simulated = bool(series.calibrations and series.calibrations[-1]["simulated"])
    said = None if phase is None else phase_document(phase)
    return ChartedSubject(
        "unit", " ".join(series.uut), simulated, declared, said, charted, wanted(charted, filters), notes
    )


def _odd_ones(series: Series, begun: Sequence[tuple[int, NDArray[np.int64], int, Scatter]]) -> list[str]:
    """Return a sentence for each first phase with a calibration that does not belong to the others."""
    sentences = []
    for column, rows, _, scatter in begun:
        worst, probability = odd_one_of_first_phase(readings_of(series, column, rows), scatter)
        if probability < _ODD / len(begun):
            session = series.calibrations[rows[worst]]["session"]
            sentences.append(
                f"{series.parameters[column].label}: {session} does not belong to the rest of the first phase, which "
                "makes its limits wide; another first phase can be stated with 'bench history freeze'"
            )
    return sentences


def readings_of(series: Series, column: int, rows: NDArray[np.int64]) -> Readings:
    """Return the calibrations of one parameter."""
    value, std, shared = (grid[rows, column] for grid in (series.value, series.std, series.shared))
    return Readings(
        series.t_year[rows], value, std, np.minimum(shared, std), series.standard[rows, column], series.level[rows]
    )


def _column(series: Series, column: int, phase: dict[str, Any] | None) -> tuple[NDArray[np.int64], int, Scatter | None]:
    """Return calibrations of a parameter since its first phase began, how many are of that, and how they scatter."""
    rows = np.flatnonzero(np.isfinite(series.value[:, column]))
    first = BY_DEFAULT
    if phase is not None:
        begin, end = phase["from_utc_ns"] / _NS_PER_YEAR, phase["until_utc_ns"] / _NS_PER_YEAR
        rows = rows[series.t_year[rows] >= begin]
        first = int(np.count_nonzero(series.t_year[rows] <= end))
    if min(first, rows.size) < LEAST or rows.size < first:
        return rows, first, None
    try:
        scatter = first_phase(readings_of(series, column, rows), first)
    except FitError:  # an uncertainty of zero, or every calibration behind an adjustment of its own
        return rows, first, None
    return rows, first, scatter if scatter.dof >= LEAST_DOF else None


def _charted(
    series: Series,
    column: int,
    rows: NDArray[np.int64],
    first: int,
    scatter: Scatter | None,
    run_length: float,
    together: int,
) -> ChartedSeries:
    assert scatter is not None
    readings = readings_of(series, column, rows)
    predicted = predictions(readings, scatter)
    return ChartedSeries(
        parameter=series.parameters[column],
        names=[str(series.calibrations[row]["session"]) for row in rows],
        t_year=readings.t,
        value=readings.value,
        expected=predicted.expected,
        std=predicted.std,
        score=predicted.score,
        first=first,
        scatter_std=float(np.sqrt(scatter.variance)),
        limits=limits_for(run_length, together, scatter.dof),
        change=partial(change_until, readings, scatter),
    )
