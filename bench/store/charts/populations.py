"""Charts of what all units do at once: of the certificates of standards, and of a station (a bench)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.maths.control.common_mode import LEAST_FREEDOM, Population, certificate_steps, common_mode, population
from bench.maths.control.limits import limits_for
from bench.maths.control.predictions import Readings, predictions, step_until
from bench.maths.drift import NO_STANDARD
from bench.model.arrays import Floats
from bench.store.charts.chart import RUN_LENGTH, ChartedSeries, ChartedSubject, wanted
from bench.store.charts.phases import phase_document, phase_of
from bench.store.database import reading
from bench.store.selection import Filters, require, units
from bench.store.series import YEAR_S, Parameter, Series, read_series
from bench.store.tables import calibrations

Labels = NDArray[np.int64]
_ENOUGH = 30  # degrees of freedom that end the first phase of a station, where nobody has stated one
_NS_PER_YEAR = YEAR_S * 1e9


@dataclass(frozen=True)
class UnitSeries:
    """What the parameters of one quantity of a unit have in common, over its calibrations, (n,) each."""

    readings: Readings  # labels of certificates are those of the ``Quantity``
    names: list[str]
    stations: list[str]


@dataclass(frozen=True)
class Quantity:
    """One quantity of a campaign over all units that have it; ``certificates`` in order of their first use."""

    parameter: Parameter
    units: list[UnitSeries]
    certificates: list[str]
    stated: Floats  # standard uncertainty of each certificate


def chart_certificates(url: str, filters: Filters, run_length: float | None = None) -> ChartedSubject:
    """Chart every certificate by what all units moved by at once with it.

    Args:    url: of the history.   filters: campaign and quantity choose what is shown.
             run_length: certificates until the first false signal of any quantity; None: 200.
    Returns: ChartedSubject, a point for each certificate.
    Raises:  StoreError B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    histories, simulated, notes = _histories(url)
    declared = run_length or RUN_LENGTH
    quantities = [quantity for quantity in _quantities(histories) if quantity.certificates]
    charted = [_certificates(quantity, declared, len(quantities)) for quantity in quantities]
    few = sum(not np.isfinite(series.score).any() for series in charted)
    if few:
        notes.append(
            f"{few} of {len(charted)} quantities judge no certificate: units calibrated with two of them leave fewer "
            f"than {LEAST_FREEDOM} degrees of freedom"
        )
    shown = wanted(charted, filters)
    return ChartedSubject("certificates", "all units", simulated, declared, None, charted, shown, notes)


def _certificates(quantity: Quantity, run_length: float, together: int) -> ChartedSeries:
    limits = limits_for(run_length, together)
    everyone = [unit.readings for unit in quantity.units]
    steps = certificate_steps(everyone, quantity.stated, limits.shewhart)
    everything = population(everyone, len(quantity.certificates))
    label = np.concatenate([unit.standard for unit in everyone])
    t_year = np.concatenate([unit.t for unit in everyone])
    return ChartedSeries(
        parameter=quantity.parameter,
        names=quantity.certificates,
        t_year=np.array([t_year[label == number].min() for number in range(len(quantity.certificates))]),
        value=steps.moved,
        expected=np.zeros_like(steps.moved),
        std=steps.expected_std,
        score=steps.score,
        first=0,
        scatter_std=float(np.sqrt(everything.variance)),
        limits=limits,
        change=lambda place: step_until(steps.moved, steps.std, place, everything.freedom),
    )


def chart_station(url: str, station: str, filters: Filters, run_length: float | None = None) -> ChartedSubject:
    """Chart a bench: every calibration on it against what the unit's earlier ones, on any bench, let one expect.

    The first phase ends when all units together have 30 degrees of freedom of their scatter, unless one is stated.

    Args:    url: of the history.   station: the bench.   filters: campaign and quantity choose what is shown.
             run_length: calibrations until the first false signal of any quantity; None: as stated, else 200.
    Returns: ChartedSubject, a point for each calibration on the station.
    Raises:  StoreError B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    with reading(url) as connection:
        require(connection, "station", station, calibrations.c.station)
        phase = phase_of(connection, "station", station)
    histories, simulated, notes = _histories(url)
    declared = run_length or (RUN_LENGTH if phase is None else phase["run_length"])
    since = -np.inf if phase is None else float(phase["from_utc_ns"] / _NS_PER_YEAR)
    quantities = [_since(quantity, since) for quantity in _quantities(histories)]
    there = [quantity for quantity in quantities if any(station in unit.stations for unit in quantity.units)]
    begun = [(quantity, until) for quantity in there if (until := _end_of_first(quantity, station, phase)) is not None]
    charted = [_station(quantity, station, until, declared, len(begun)) for quantity, until in begun]
    if len(begun) < len(there):
        notes.append(
            f"{len(there) - len(begun)} of {len(there)} quantities have no chart: units show their scatter with fewer "
            f"than {_ENOUGH} degrees of freedom ({LEAST_FREEDOM} in a first phase that somebody states)"
        )
    said = None if phase is None else phase_document(phase)
    shown = wanted(charted, filters)
    return ChartedSubject("station", station, simulated, declared, said, charted, shown, notes)


def _since(quantity: Quantity, year: float) -> Quantity:
    """Return a quantity without its calibrations before a year: what a bench did then is no evidence any more."""
    units = []
    for unit in quantity.units:
        kept = unit.readings.t >= year
        names, stations = (
            [text for text, keep in zip(texts, kept, strict=True) if keep] for texts in (unit.names, unit.stations)
        )
        units += [UnitSeries(unit.readings.of(kept), names, stations)] if names else []
    return replace(quantity, units=units)


def _end_of_first(quantity: Quantity, station: str, phase: dict[str, Any] | None) -> float | None:
    """Return the year in which the first phase of a station ends; None if it does not tell how much units scatter."""
    if phase is not None:
        until = float(phase["until_utc_ns"] / _NS_PER_YEAR)
        return until if _known_until(quantity, until).freedom >= LEAST_FREEDOM else None
    times = sorted(
        {
            t
            for unit in quantity.units
            for t, place in zip(unit.readings.t, unit.stations, strict=True)
            if place == station
        }
    )
    low, high = 0, len(times)
    while low < high:  # the freedom never falls with time
        middle = (low + high) // 2
        if _known_until(quantity, times[middle]).freedom >= _ENOUGH:
            high = middle
        else:
            low = middle + 1
    return float(times[low]) if low < len(times) else None


def _known_until(quantity: Quantity, until: float) -> Population:
    known = [unit.readings.of(unit.readings.t <= until) for unit in quantity.units]
    return population(known, len(quantity.certificates))


def _station(quantity: Quantity, station: str, until: float, run_length: float, together: int) -> ChartedSeries:
    """Predict each calibration from all before it, of every unit: they share the errors of certificates."""
    scatter = _known_until(quantity, until).scatter
    everyone, names, stations = _stacked(quantity)
    predicted = predictions(everyone, scatter)
    there = np.array([place == station for place in stations])
    readings = everyone.of(there)
    expected, std, score = predicted.expected[there], predicted.std[there], predicted.score[there]
    error = np.where(readings.t > until, readings.value - expected, np.nan)
    return ChartedSeries(
        parameter=quantity.parameter,
        names=[name for name, here in zip(names, there, strict=True) if here],
        t_year=readings.t,
        value=readings.value,
        expected=expected,
        std=std,
        score=score,
        first=int(np.count_nonzero(readings.t <= until)),
        scatter_std=float(np.sqrt(scatter.variance)),
        limits=limits_for(run_length, together, scatter.dof),
        change=lambda place: step_until(error, std, place, scatter.dof),
    )


def _stacked(quantity: Quantity) -> tuple[Readings, list[str], list[str]]:
    """Return the calibrations of all units in order of time, with their sessions and stations."""
    parts = [vars(unit.readings) for unit in quantity.units]
    owner = np.repeat(np.arange(len(parts)), [part["t"].size for part in parts])
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0] if name != "owner"}
    names = [name for unit in quantity.units for name in unit.names]
    stations = [station for unit in quantity.units for station in unit.stations]
    order = np.lexsort((owner, columns["t"]))
    readings = Readings(**columns, owner=owner).of(order)
    return readings, [names[row] for row in order], [stations[row] for row in order]


def _histories(url: str) -> tuple[list[Series], bool, list[str]]:
    """Return the calibrations of every unit, real ones if there are any, and what is left out."""
    with reading(url) as connection:
        known = units(connection)
    histories = [read_series(url, Filters(" ".join(unit))) for unit in known]
    histories = [series for series in histories if series.calibrations]
    real = [series for series in histories if not series.calibrations[-1]["simulated"]]
    notes = [note for series in real or histories for note in series.notes]
    if real and len(real) < len(histories):
        notes.append(f"{len(histories) - len(real)} units that are only simulated are left out")
    return real or histories, not real, notes


def _quantities(histories: Sequence[Series]) -> list[Quantity]:
    """Return every quantity of every campaign over all units."""
    columns: dict[tuple[str, str, str], list[tuple[Series, list[int]]]] = {}
    for series in histories:
        own: dict[tuple[str, str, str], list[int]] = {}
        for number, parameter in enumerate(series.parameters):
            own.setdefault((parameter.campaign, parameter.quantity, parameter.unit), []).append(number)
        for key, numbers in own.items():
            columns.setdefault(key, []).append((series, numbers))
    return [_quantity(Parameter(*key, {}), members) for key, members in sorted(columns.items())]


def _quantity(parameter: Parameter, members: Sequence[tuple[Series, list[int]]]) -> Quantity:
    used: dict[str, tuple[float, float]] = {}  # first use and standard uncertainty of a certificate
    parts = []
    for series, columns in members:
        table = series.value[:, columns]
        rows = np.flatnonzero(np.isfinite(table).any(axis=1))
        column = columns[0]  # what is shared is that of the quantity
        labels = series.standard[rows, column]
        for row, label in zip(rows, labels, strict=True):
            if label != NO_STANDARD:
                name, at = series.certificates[label], float(series.t_year[row])
                since, std = used.get(name, (at, float(series.shared[row, column])))
                used[name] = min(since, at), std
        parts.append((series, rows, table[rows], column))
    names = sorted(used, key=lambda name: (used[name][0], name))
    place = {name: number for number, name in enumerate(names)}
    return Quantity(
        parameter,
        [_unit_series(*part, place) for part in parts],
        names,
        np.array([used[name][1] for name in names]),
    )


def _unit_series(series: Series, rows: Labels, table: Floats, column: int, place: dict[str, int]) -> UnitSeries:
    labels, shared = series.standard[rows, column], series.shared[rows, column]
    standard = [NO_STANDARD if label == NO_STANDARD else place[series.certificates[label]] for label in labels]
    label = np.array(standard, dtype=np.int64)
    readings = Readings(series.t_year[rows], common_mode(table), shared, shared, label, series.level[rows])
    calibrations = [series.calibrations[row] for row in rows]
    return UnitSeries(
        readings, [str(row["session"]) for row in calibrations], [str(row["station"]) for row in calibrations]
    )
