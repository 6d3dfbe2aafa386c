"""Hard and soft iron of a magnetometer from a log of one that was turned through all attitudes, or about one axis.

Source: ``sphere``; of a turn about z ``estimators.magnetometer.plane`` (GNC-module paper equations (5) to (9)).
"""

from __future__ import annotations

import numpy as np

from bench.analysis import (
    Analysis,
    Floats,
    Material,
    Table,
    evidence_of,
    unseen_tables,
    value_and_uncertainty,
    with_uncertainty,
    worded_table,
)
from bench.maths.arrays import Flags, Integers
from bench.maths.samples import few, is_silent
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.declaration import AXES
from bench.systems.gnc.estimators.magnetometer.plane import ELLIPSE, PlaneComparison, compare_methods
from bench.systems.gnc.estimators.magnetometer.wander import change_of_surface, off_surface
from bench.systems.gnc.field_departures import searches_of
from bench.systems.gnc.field_evidence import endless_noise, shown_unit
from bench.systems.gnc.logs.log import triad_of
from bench.systems.gnc.magnetometer import Sphere, noise_notes, parameter_estimates, sphere_of, turn_cloud
from bench.systems.gnc.wording import say

METHODS = ("ellipsoid", "turn_about_z")
_FLAT = 0.5  # of the smaller width of x and y: readings of z that are wider are no turn about z
_MOST_LEFT_OUT = 0.01  # of the rows
_HELD = 10  # an axis clips where it holds its end more often than most of its values, by this factor
_NEAR = 0.05  # of the width of an axis: a value further from the next one is none at which an axis clips
_SHOWN = 6  # rows, or stretches of them, that are told


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return hard and soft iron; of a log that is a turn about z, offsets, gain and angle of x and y.

    Raises: FitError B-GNC-006 without three axes; B-FIT-090, -091 if the readings determine
            neither an ellipsoid nor an ellipse, B-GNC-009 if it is seen why they do not.
    """
    every, time_s, unit = _readings(material)
    field, off = every, off_surface(every)
    left_out = []
    if not few(off.sum(), off.size) and few(off.sum(), off.size, _MOST_LEFT_OUT):
        left_out = [say("log.off", rows=_rows(np.flatnonzero(off)), count=off.size)]
        field, time_s = field[~off], time_s[~off]
    rows = material.series["t_s"].size
    sphere = sphere_of([field], unit) if method == METHODS[0] else Sphere()
    if sphere.fit is None:
        try:
            return _turn(material, field, time_s, unit, sphere).leaving_out(rows - len(field), left_out)
        except FitError as error:
            raise _seen(material, every, off, unit) or error from None
    searches = searches_of([], sphere.cloud([1], [time_s]), shown_unit(unit))
    analysis = Analysis(
        "magnetometer_log",
        method,
        material.campaign["uut"],
        sphere.estimates,
        evidence=[*sphere.evidence, *evidence_of(searches)],
        notes=[*sphere.notes, say("log.no_size")],
        tables=[_table(sphere, unit), *unseen_tables(searches)],
        figures=sphere.figures,
    )
    return analysis.leaving_out(rows - len(field), left_out)


def _readings(material: Material) -> tuple[Floats, Floats, str]:
    """Return readings (n, 3) without rows that lack one, their times and unit. Raises: FitError B-GNC-006."""
    field, unit = triad_of(material, "magnetometer")
    if field is None:
        raise FitError(
            "B-GNC-006",
            "the log has no magnetometer of three axes",
            next_step="map three columns of the role magnetometer (docs/importing.md)",
        )
    silent = [axis for axis, values in zip(AXES, field.T, strict=True) if is_silent(values)]
    if silent:
        raise FitError(
            "B-GNC-006",
            f"the magnetometer has one and the same value in all rows along {', '.join(silent)}",
            next_step="check the sensor and its columns, and take the log again",
        )
    whole = np.isfinite(field).all(axis=1)
    return field[whole], material.series["t_s"][whole], unit


def _seen(material: Material, field: Floats, off: Flags, unit: str) -> FitError | None:
    """Return what keeps the readings (n, 3) from one surface, None if it is not seen: an axis that clips, iron that
    changes, or rows that are ``off`` the surface of most others.
    """
    factor, name = shown_unit(unit)
    headers = {column["axis"]: column["header"] for column in material.campaign["columns"] if "axis" in column}
    for axis, readings in zip(AXES, field.T, strict=True):
        values, counts = np.unique(readings, return_counts=True)
        for what, end, beside in (("smallest", 0, 1), ("largest", -1, -2)):
            near = abs(values[end] - values[beside]) < _NEAR * np.ptp(values)
            if near and counts[end] > _HELD * np.median(counts):
                reads = f"{headers[axis]} reads {factor * values[end]:.6g} {name}, its {what} value,"
                return _off(f"{reads} in {counts[end]} of {len(field)} rows: it clips", "take it in a larger range")
    change = change_of_surface(field)
    if change and all(sphere_of([part], unit).fit for part in (field[:change], field[change:])):
        reads = f"from row {change + 1} of {len(field)} on the readings lie on another ellipsoid"
        return _off(f"{reads}: the iron has changed", "import the rows before it and those from it on as two logs")
    kept = field[~off]
    if off.any() and off.mean() < 0.5 and (sphere_of([kept], unit).fit or _is_turn(kept)):
        reads = f"{off.sum()} of {len(field)} rows leave the surface of all others"
        return _off(f"{reads}: {_rows(np.flatnonzero(off))}", "look what was near then, and leave them out of the log")
    return None


def _off(seen: str, next_step: str) -> FitError:
    return FitError("B-GNC-009", f"no hard and soft iron of the magnetometer: {seen}", next_step=next_step)


def _rows(places: Integers) -> str:
    """Return the rows of readings by number, from 1, those next to each other together; the first few of many."""
    parts = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    names = [f"{part[0] + 1}" if part.size == 1 else f"{part[0] + 1} to {part[-1] + 1}" for part in parts]
    return ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")


def _is_turn(field: Floats) -> bool:
    """Return whether readings of z vary so little beside those of x and y that these turn about z."""
    width = np.ptp(field, axis=0)
    return bool(width[2] <= _FLAT * width[:2].min())


def _turn(material: Material, field: Floats, time_s: Floats, unit: str, sphere: Sphere) -> Analysis:
    """Return the ellipse of x and y; ``sphere`` says why it is no ellipsoid."""
    if sphere.missing and not _is_turn(field):
        raise FitError(
            "B-FIT-091", sphere.missing[0], next_step="turn the unit so that each axis points along the field"
        )
    fit = compare_methods(field[:, 0], field[:, 1])
    entries, odd = parameter_estimates(fit, {ELLIPSE: fit.by_method[ELLIPSE]}, {}, unit), fit.ellipse.odd
    searches = searches_of([turn_cloud(1, say("turn"), field, time_s, fit, entries)], None, shown_unit(unit))
    return Analysis(
        "magnetometer_log",
        METHODS[1],
        material.campaign["uut"],
        entries,
        evidence=[
            endless_noise(fit.ellipse.quadric, say("turn"), {}),
            *evidence_of(searches),
        ],
        notes=[
            *sphere.notes,
            *(say("log.gives_no", what=text) for text in sphere.missing),
            say("log.turn"),
            *noise_notes(say("of.turn"), fit.ellipse.quadric.wander, int(odd.sum()), odd.size),
        ],
        tables=[_turn_table(fit, unit), *unseen_tables(searches)],
    )


def _turn_table(fit: PlaneComparison, unit: str) -> Table:
    factor, name = shown_unit(unit)
    names = [say(f"log.turn.{row}", unit=name) for row in ("offset_x", "offset_y", "gain", "angle", "field")]
    found = fit.by_method[ELLIPSE]
    factors = (factor, factor, 1.0, 1.0, factor)
    rows = [
        [text, *value_and_uncertainty(by * value, by * coverage_factor(dof) * std)]
        for text, by, value, std, dof in zip(names, factors, found.values, found.std, found.dof, strict=True)
    ]
    headers = say.heads("log.turn", "parameter", "value", "U")
    return Table(say("log.turn.title"), "", headers, rows, lead=True)


def _table(sphere: Sphere, unit: str) -> Table:
    fit = sphere.fit
    assert fit is not None
    factor, name = shown_unit(unit)
    std = np.sqrt(np.diag(fit.hard_iron_covariance))
    rows = [
        [
            axis,
            with_uncertainty(factor * fit.hard_iron[k], factor * coverage_factor(fit.hard_iron_dof[k]) * std[k]),
            *(f"{fit.symmetric[k, column]:.5f}" for column in range(3)),
        ]
        for k, axis in enumerate(AXES)
    ]
    soft = [say("log.iron.soft", axis=axis) for axis in AXES]
    noise = factor * fit.noise
    return worded_table(say, "log.iron", ["axis", "hard"], rows, soft, lead=True, noise=noise, unit=name)
