"""Accelerometers from many poses of an imported log, without a table: rests are found, gravity's length is known.

Source: Tedaldi, Pretto and Menegatti, ICRA 2014; ``estimators.static_intervals``, ``estimators.multi_position``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Estimate,
    Estimates,
    Figure,
    Labels,
    Material,
    Residuals,
    Searched,
    Table,
    curve,
    departures_of,
    estimate,
    evidence_of,
    search,
    unseen_tables,
    value_and_uncertainty,
    worded_figure,
    worded_table,
)
from bench.maths.arrays import Floats, rms
from bench.maths.stamps import check_ticks
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.declaration import AXES
from bench.systems.gnc.estimators.multi_position import NormFit, fit_multi_position
from bench.systems.gnc.estimators.static_intervals import StaticIntervals, static_intervals
from bench.systems.gnc.logs.log import ImuLog, imu_log, stuck_sensors
from bench.systems.gnc.rows import STANDARD_GRAVITY_M_S2, finding_text
from bench.systems.gnc.wording import say

METHODS = ("norm",)
_ELEMENTS = tuple(zip(*np.triu_indices(3), strict=True))  # of the matrix, as the covariance has them
INITIAL_s = 30.0  # of rest at the begin of a log; the public method asks for 30 s to 50 s


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Scale, misalignment and zero of the accelerometers from the rests of a log.

    Raises: FitError B-GNC-006; B-FIT-084 to -086 if the log does not determine them.
    """
    log = imu_log(material)
    rests = static_intervals(log.accel, log.rate_Hz, initial_s=INITIAL_s)
    means = rests.means(log.accel)
    gravity, unit = _gravity(log)
    fit = fit_multi_position(means, gravity)
    estimates = _estimates(fit, unit, log, _held_out(means, gravity))
    searches = list(searches_of(fit, means, _middle_s(rests, log), estimates))
    return Analysis(
        "imu_multi_position",
        method,
        material.campaign["uut"],
        estimates,
        notes=_notes(log, rests),
        tables=[_table(fit, unit), _rest_table(rests, log), *unseen_tables(searches)],
        figures=[_residual_figure(fit, unit), _rest_figure(rests, log)],
        evidence=[
            *stuck_sensors({"accelerometer": [log.accel]}),
            *evidence_of(searches),
        ],
    )


def _middle_s(rests: StaticIntervals, log: ImuLog) -> Floats:
    return (rests.begin + rests.end).astype(np.float64) / (2.0 * log.rate_Hz)


def searches_of(fit: NormFit, means: Floats, middle_s: Floats, entries: Estimates) -> Iterator[Searched]:
    """Yield what the lengths of the rests say against one ellipsoid that stays; their noise is what it leaves over.

    Rests that leave nothing over say nothing.

    Args:   means: (n, 3) reading of each rest.   middle_s: (n,).   entries: that follow from the ellipsoid are judged.
    Source: docs/method-uncertainty.md.
    """
    judged = ("accel_sensitivity", "accel_zero", "accel_matrix")
    stated = [entry for entry in entries if entry.quantity in judged and entry.expanded_uncertainty]
    if not stated:
        return
    jacobian, sigma = fit.jacobian(means), fit.residual_rms * math.sqrt(len(means) / fit.dof)
    operator = np.array([_gradient(fit, entry) for entry in stated]) @ -np.linalg.pinv(jacobian)
    rows = Residuals.of(
        readings=fit.residual + fit.gravity,
        error=fit.residual,
        free=jacobian,
        whiten=lambda columns: columns / sigma,
        operator=operator,
        stated=stated,
        noise_dof=0.0,
    )
    along = (means - fit.zero) * fit.matrix.diagonal() / fit.gravity
    number = np.arange(len(means))
    unit = next(entry.unit for entry in stated if entry.quantity == "accel_zero")
    labels = Labels(
        kinds={"rest": number + 1},
        hours=middle_s / 3600.0,
        visit=number,
        carriers={f"zero {axis}": (unit, -jacobian[:, 6 + k]) for k, axis in enumerate(AXES)},
        scales={f"along {axis}": (along[:, k], (3,)) for k, axis in enumerate(AXES)},
        steps_within=False,
    )
    yield Searched(search(rows, departures_of(labels)), _words)


def _gradient(fit: NormFit, entry: Estimate) -> Floats:
    """Return what an estimate gains per unit of each parameter of the covariance, (9,)."""
    one, place = np.zeros(9), entry.conditions
    if entry.quantity == "accel_zero":
        one[6 + AXES.index(place["axis"])] = 1.0
    elif entry.quantity == "accel_sensitivity":
        k = AXES.index(place["axis"])
        one[_ELEMENTS.index((k, k))] = -(fit.counts_per_unit[k] ** 2)
    else:
        one[_ELEMENTS.index((AXES.index(place["row"]), AXES.index(place["column"])))] = 1.0
    return one


def _words(label: str, value: Any) -> str:
    """Return how a person names a label."""
    return say(f"departs.of.{label}" if value is None else f"departs.{label}", value=value)


def _gravity(log: ImuLog) -> tuple[float, str]:
    if log.accel_unit == "g":
        return log.gravity / STANDARD_GRAVITY_M_S2, "g"
    return log.gravity, "m/s2"


def _held_out(means: np.ndarray[Any, np.dtype[np.float64]], gravity: float) -> float | None:
    """RMS residual of each rest in the fit of all others; None if they determine nothing without it."""
    left = []
    for out in range(len(means)):
        try:
            fit = fit_multi_position(np.delete(means, out, axis=0), gravity)
        except FitError:
            return None
        left.append(float(np.linalg.norm(fit.apply(means[out : out + 1]))) - gravity)
    return rms(left)


def _estimates(fit: NormFit, unit: str, log: ImuLog, held_out: float | None) -> Estimates:
    read = "count" if log.accel_unit == "1" else log.accel_unit
    common: dict[str, Any] = {"n": len(fit.residual), "dof": fit.dof}
    entries = []
    for k, axis in enumerate(AXES):
        place = {"kind": "accelerometer", "axis": axis}
        value, std = fit.counts_per_unit[k], fit.counts_per_unit_std[k]
        entries.append(estimate("accel_sensitivity", f"{read}/({unit})", value, std, place, **common))
        entries.append(estimate("accel_zero", read, fit.zero[k], fit.zero_std[k], place, **common))
    elements = fit.covariance.diagonal()[:6] ** 0.5
    for (row, column), std in zip(_ELEMENTS, elements, strict=True):
        place = {"kind": "accelerometer", "row": AXES[row], "column": AXES[column]}
        entries.append(estimate("accel_matrix", f"{unit}/{read}", fit.matrix[row, column], std, place, **common))
    place = {"kind": "accelerometer"}
    spread = fit.residual_rms / (2.0 * fit.dof) ** 0.5
    entries.append(estimate("accel_residual", unit, fit.residual_rms, spread, place, n=len(fit.residual)))
    if held_out is not None:
        spread = held_out / (2.0 * len(fit.residual)) ** 0.5
        entries.append(estimate("accel_residual_held_out", unit, held_out, spread, place, n=len(fit.residual)))
    return entries


def _notes(log: ImuLog, rests: StaticIntervals) -> list[str]:
    sentences = [
        say(
            "log.rests",
            count=len(rests.begin),
            threshold=rests.threshold,
            times=rests.threshold / rests.initial,
            first=INITIAL_s,
        ),
        say("log.frame"),
    ]
    if log.gyro is not None:
        sentences.append(say("log.gyros_left"))
    counter = np.arange(len(log.t_s), dtype=np.int64)
    faults = check_ticks(log.t_s, counter, 1.0 / log.rate_Hz).faults
    sentences += [say("log.fault", text=finding_text(fault)) for fault in faults]
    if faults:
        sentences.append(say("log.not_timed"))
    return sentences


def _table(fit: NormFit, unit: str) -> Table:
    factor, rows = coverage_factor(fit.dof), []
    for k, axis in enumerate(AXES):
        output = value_and_uncertainty(fit.counts_per_unit[k], factor * fit.counts_per_unit_std[k])
        zero = value_and_uncertainty(fit.zero[k], factor * fit.zero_std[k])
        rows.append([axis, *output, *zero, *(float(value) for value in fit.matrix[k])])
    heads = ["axis", "output", "output_wide", "zero", "zero_wide"]
    return worded_table(
        say, "poses", heads, rows, [f"U {axis}" for axis in AXES], lead=True,
        rms=fit.residual_rms, unit=unit, rests=len(fit.residual), times=fit.amplification,
    )  # fmt: skip


def _rest_table(rests: StaticIntervals, log: ImuLog) -> Table:
    lengths = (rests.end - rests.begin) / log.rate_Hz
    row = [len(lengths), float(lengths.min()), float(np.median(lengths)), float(lengths.max())]
    headers = say.heads("rests", "intervals", "shortest", "median", "longest")
    return Table(say("rests.title"), "", headers, [row])


def _residual_figure(fit: NormFit, unit: str) -> Figure:
    places = np.arange(1, len(fit.residual) + 1, dtype=np.float64)
    parts = [curve(say("length.series"), places, fit.residual, "points")]
    return worded_figure(say, "length", ("length.x", "length.y"), parts, unit=unit)


def _rest_figure(rests: StaticIntervals, log: ImuLog) -> Figure:
    """Return the readings of the rests against the middle of each."""
    means = rests.means(log.accel)
    parts = [curve(axis, _middle_s(rests, log), means[:, k], "points") for k, axis in enumerate(AXES)]
    return Figure(say("rests.means"), "", say("time"), say("rests.y"), parts)
