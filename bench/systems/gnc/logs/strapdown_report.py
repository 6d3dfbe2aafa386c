"""Estimates, tables, figures and notes of the drift of an inertial unit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Estimates, Figure, Table, curve, estimate, no_result, number, with_uncertainty
from bench.systems.gnc.estimators.between_rests import BetweenRests, TurnScale
from bench.systems.gnc.estimators.clocks import SampleStamps
from bench.systems.gnc.estimators.rest_drift import CLASSES, HORIZONS_s, RandomWalk, RestDrift, class_of, worst_class
from bench.systems.gnc.estimators.static_intervals import MULTIPLE, StaticIntervals
from bench.systems.gnc.logs.log import ImuLog
from bench.systems.gnc.rows import STANDARD_GRAVITY_M_S2

_WALK = math.degrees(1.0) * 60.0  # rad/sqrt(s) in deg/sqrt(h)
_CLASS_OF = {"gyro_drift": "gyro_deg_h", "angle_random_walk": "walk_deg_rt_h", "accelerometer_drift": "accel_mg"}


@dataclass(frozen=True)
class Found:
    """All that was found in a log; ``counts``: its numbers have no unit, ``missing``: what it does not tell."""

    method: str
    counts: bool
    log: ImuLog
    stamps: SampleStamps
    rests: StaticIntervals
    walk: RandomWalk
    drifts: list[RestDrift]
    between: BetweenRests | None
    scale: TurnScale | None
    missing: tuple[str, ...]


def estimates_of(result: Found) -> Estimates:
    """Drift for each horizon, rates of drift with the class they fit, errors from rest to rest."""
    entries = [entry for drift in result.drifts for entry in _at_rest(drift)]
    entries += _rates(result)
    if result.between is not None:
        entries += _between(result.between)
    if result.scale is not None and not result.counts:
        place = {"kind": "gyro"}
        entries.append(
            estimate("turn_scale", "1", result.scale.scale, result.scale.std, place, n=result.scale.turns,
                     dof=2 * result.scale.turns - 1)
        )  # fmt: skip
    return entries


def _at_rest(drift: RestDrift) -> Estimates:
    rows = (
        ("rest_drift_attitude", "deg", drift.attitude_rms_deg, "gyro"),
        ("rest_drift_velocity", "m/s", drift.velocity_rms_m_s, "accelerometer"),
        ("rest_drift_horizontal", "m", drift.horizontal_rms_m, "accelerometer"),
    )
    place = {"horizon_s": round(drift.horizon_s, 3)}
    return [
        estimate(name, unit, value, drift.std(value), {"kind": kind} | place, n=drift.windows, dof=drift.windows)
        for name, unit, value, kind in rows
    ]


def _rates(result: Found) -> Estimates:
    """Return what the longest horizon says per unit of time, and the angle random walk, each with its class."""
    rows: list[tuple[str, str, float, float, str, dict[str, Any], int]] = []
    if result.drifts:
        drift = result.drifts[-1]
        place = {"horizon_s": round(drift.horizon_s, 3)}
        gyro = drift.attitude_rms_deg / drift.horizon_s * 3600.0
        accel = drift.velocity_rms_m_s / drift.horizon_s / STANDARD_GRAVITY_M_S2 * 1e3
        rows.append(("gyro_drift", "deg/h", gyro, drift.std(gyro), "gyro", place, drift.windows))
        rows.append(("accelerometer_drift", "mg", accel, drift.std(accel), "accelerometer", place, drift.windows))
    walk = result.walk
    if walk.differences:
        rows.append(
            ("angle_random_walk", "deg/sqrt(h)", _WALK * walk.value, _WALK * walk.std, "gyro", {}, walk.differences)
        )
    return [
        estimate(
            name, unit, value, std, {"kind": kind, "sensor_class": class_of(_CLASS_OF[name], value)} | more, n=n, dof=n
        )
        for name, unit, value, std, kind, more, n in rows
    ]


def _between(between: BetweenRests) -> Estimates:
    count = len(between.rest)
    place = {"motion_s": round(float(between.motion_s.mean()), 3), "bias_s": round(float(between.bias_s.mean()), 3)}
    rows = (
        ("level_error", "deg", between.level_rms_deg, "gyro"),
        ("velocity_error", "m/s", between.velocity_rms_m_s, "accelerometer"),
    )
    return [
        estimate(name, unit, value, value / math.sqrt(2.0 * count), {"kind": kind} | place, n=count, dof=count)
        for name, unit, value, kind in rows
    ]


def notes_of(result: Found) -> list[str]:
    """Return what a reader has to know about rests, time and method."""
    lengths = (result.rests.end - result.rests.begin) / result.stamps.rate_Hz
    notes = [
        f"{len(lengths)} rests were found, {lengths.min():.3g} to {lengths.max():.3g} s long: stretches in which no "
        f"triad scatters with more than {MULTIPLE:g} times the variance of the quietest stretches of this log.",
        "Over rests: bias, level and size of gravity from one stretch, drift over the next one of the same length.",
        _class_note(result),
    ]
    if result.drifts and len(result.drifts) < len(HORIZONS_s):
        longer = ", ".join(f"{horizon_s:g}" for horizon_s in HORIZONS_s[len(result.drifts) :])
        notes.append(f"No rest is twice as long as {longer} s: nothing is said of such horizons.")
    if result.between is not None:
        notes.append(
            "Between rests: the level is compared with that of the next rest, the velocity with zero; a turn about the "
            "vertical is not seen. The Earth's rate counts as bias: up to 15 deg/h once the unit is turned."
        )
    if result.method == "calibrated":
        notes.append(
            "Accelerometers and gyroscopes were fitted to the rests of this log first, so errors between rests are "
            "those left after the fit; drift over rests hardly depends on it."
        )
    elif result.between is not None:
        notes.append("Readings are taken as indicated: errors of scale and alignment are part of those between rests.")
    return [*no_result(result.missing), *notes, *_stamp_notes(result.stamps)]


def _class_note(result: Found) -> str:
    names = [str(rate["conditions"]["sensor_class"]) for rate in _rates(result)]
    if not names:
        return "No class of sensors can be told."
    return (
        f"The drift left after bias and level were taken at rest is that of the class {worst_class(names)} (worst of "
        f"{', '.join(names)}; bounds of El-Sheimy and Youssef 2020, table 1, industrial: geometric mean of its "
        "neighbours). The bias at switch-on is not part of it."
    )


def _stamp_notes(stamps: SampleStamps) -> list[str]:
    rate = f"{stamps.rate_Hz:.6g} samples a second"
    if stamps.bursty:
        return [
            f"The time stamps come in bursts: {100 * stamps.crowded:.3g} % lie closer than half an interval, the worst "
            f"{stamps.worst_s:.3g} s beside even spacing. Samples are counted, at the mean of {rate}; lost ones "
            "would not show."
        ]
    notes = [
        f"Samples are counted, at {rate} by the time column; the worst stamp is {1e3 * stamps.worst_s:.3g} ms off."
    ]
    if len(stamps.breaks):
        notes.append(
            f"{stamps.missing} samples are missing in {len(stamps.breaks)} gaps; nothing is integrated across."
        )
    return notes


def tables_of(result: Found) -> list[Table]:
    """Drift over rests, class of the sensors, and errors from rest to rest."""
    tables = [_rest_table(result.drifts)] if result.drifts else []
    if rates := _rates(result):
        tables.append(_class_table(rates))
    if result.between is not None:
        tables.append(_between_table(result.between))
    return tables


def _rest_table(drifts: list[RestDrift]) -> Table:
    rows = [
        [
            f"{d.horizon_s:.3g}",
            d.windows,
            with_uncertainty(d.attitude_rms_deg, 2.0 * d.std(d.attitude_rms_deg)),
            number(d.white_deg, 4),
            with_uncertainty(d.velocity_rms_m_s, 2.0 * d.std(d.velocity_rms_m_s)),
            with_uncertainty(d.horizontal_rms_m, 2.0 * d.std(d.horizontal_rms_m)),
        ]
        for d in drifts
    ]
    headers = ["over, s", "stretches", "attitude, deg", "by random walk, deg", "velocity, m/s", "distance, m"]
    caption = (
        "Root mean squares, ± two standard uncertainties: attitude per axis, velocity per level axis, distance in the "
        "level plane. By random walk: attitude that the angle random walk alone gives, bias from as long a stretch."
    )
    return Table("Drift at rest", caption, headers, rows, lead=True)


def _class_table(rates: Estimates) -> Table:
    rows = []
    for rate in rates:
        bounds = [
            number(float(f"{getattr(sensor_class, _CLASS_OF[rate['quantity']]):.3g}")) for sensor_class in CLASSES
        ]
        shown = with_uncertainty(rate["value"], 2.0 * rate["std_uncertainty"])
        rows.append(
            [rate["quantity"].replace("_", " "), rate["unit"], shown, rate["conditions"]["sensor_class"], *bounds]
        )
    headers = ["figure", "unit", "found", "class", *(f"{sensor_class.name} up to" for sensor_class in CLASSES)]
    caption = (
        "Drift over the longest horizon per unit of time, ± two standard uncertainties; the class is that of the value."
    )
    return Table("Class of the sensors", caption, headers, rows, lead=True)


def _between_table(between: BetweenRests) -> Table:
    speed = np.linalg.norm(between.velocity_error_m_s, axis=1)
    columns = (between.bias_s, between.motion_s, between.tilted_deg, between.level_error_deg, speed)
    rows = [[int(rest) + 1, *(float(column[k]) for column in columns)] for k, rest in enumerate(between.rest)]
    headers = ["from rest", "its length, s", "motion, s", "tipped by, deg", "level error, deg", "velocity error, m/s"]
    caption = "Bias and level from one rest, strapdown through the motion, compared with the next rest."
    return Table("From rest to rest", caption, headers, rows)


def figures_of(result: Found) -> list[Figure]:
    """Drift against its horizon, and the errors of every motion."""
    figures = []
    if len(result.drifts) > 1:
        horizon = np.array([drift.horizon_s for drift in result.drifts])
        series = [
            curve("measured", horizon, np.array([drift.attitude_rms_deg for drift in result.drifts]), "points"),
            curve("angle random walk alone", horizon, np.array([drift.white_deg for drift in result.drifts]), "line"),
        ]
        figures.append(
            Figure("Attitude drift at rest", "", "horizon, s", "deg per axis", series, x_log=True, y_log=True)
        )
    if result.between is not None and len(result.between.rest) > 1:
        place = result.between.rest.astype(np.float64) + 1.0
        series = [curve("level error", place, result.between.level_error_deg, "points")]
        figures.append(Figure("Level error from rest to rest", "", "rest before", "deg", series))
    return figures
